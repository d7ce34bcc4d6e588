//! Garments over a moving body, simulated by extended position-based dynamics (Macklin et al. 2016)
//! with many small steps of one iteration each (Macklin et al. 2019).
//!
//! A step moves vertices freely, then corrects them: lengths of edges and between the far corners of
//! neighbouring triangles, places of a waistband, contact with the body at vertices and at the
//! middles of faces, layers of cloth that keep their sides, and last the longest that edges may
//! be. All of it goes in a fixed order, so that results do not depend on the number of threads.

//!
//! ```
//! # use cape_core::BodyMotion;
//! use cape_cloth::{Garment, GarmentKind, ClothMaterial};
//! use cape_synth::synthetic_body;
//!
//! let body = synthetic_body();
//! assert!(ClothMaterial::default().density > 0.0);
//! ```

mod contact;
mod garment;
mod isosurface;
mod pattern;
mod self_collision;
mod sheet;
mod simulate;
#[cfg(test)]
mod tests;

pub use cape_core::{Error, Result};

pub use contact::Contact;
pub use garment::{Garment, GarmentKind, GarmentMesh};
pub use sheet::{Cloth, ClothMaterial};
pub use simulate::{SimulatedGarment, SimulationOptions, SimulationQuality, StepReport};
