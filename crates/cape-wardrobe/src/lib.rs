//! Simulated clothing of subjects on the topology of their body, in the raw layout of the CAPE data set.
//!
//! An [`OutfitCut`] has the garments of a subject in one of CAPE's four outfits. Sewn and simulated over
//! a motion, they are laid onto the body: each vertex follows its point of the garment
//! ([`SurfaceTransfer`]), and is unposed by the body's own blend weights.
//!
//! ```no_run
//! use cape_synth::{SynthSpec, synthetic_body};
//! use cape_wardrobe::{SimulatedCaptures, WardrobeOptions};
//!
//! let body = synthetic_body();
//! let spec = SynthSpec { subjects: 2, ..SynthSpec::default() };
//! let captures = SimulatedCaptures::new(&body, spec, WardrobeOptions::default())?;
//! println!("{} takes", captures.takes().len());
//! # Ok::<(), cape_wardrobe::Error>(())
//! ```

mod canonical;
mod captures;
mod mesh_graph;
mod outfit;
mod record;
mod take;
mod take_motion;
#[cfg(test)]
mod tests;
mod transfer;

pub use cape_core::{Error, Result};

pub use captures::{PLAN_FILE, Shard, SimulatedCaptures, SimulatedTake, WardrobeOptions};
pub use outfit::{OutfitCut, SewnOutfit};
pub use record::{QUALITY_FILE, TakeRecord};
pub use take::{DressedSubject, TakeQuality};
pub use transfer::{GarmentPoint, SurfaceTransfer};
