//! Garments over a moving body, simulated by extended position-based dynamics (Macklin et al. 2016)
//! with many small steps of one iteration each (Macklin et al. 2019).

mod contact;
mod fold;
mod garment;
mod nets;
mod sheet;
mod simulate;
mod tailor;
#[cfg(test)]
mod tests;

pub use contact::Contact;
pub use garment::{Garment, GarmentKind, Sewn};
pub use sheet::{Cloth, Material};
pub use simulate::{Simulated, Simulation, StepReport};
