//! Synthetic stand-ins for licensed data: a body, clothes and captured sequences.

mod body;
mod dataset;
mod motion;
mod regions;
mod wardrobe;

pub use body::{FACES as BODY_FACES, VERTICES as BODY_VERTICES, synthetic_body};
pub use dataset::{Session, Synth, SynthFrame, SynthSpec, Take};
pub use motion::{Motion, MotionStyle};
pub use wardrobe::{Fitting, Garment, Wardrobe};
