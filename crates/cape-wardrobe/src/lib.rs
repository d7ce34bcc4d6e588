//! Simulated clothing of subjects on the topology of their body, in the raw layout of the CAPE data set.
//!
//! An [`OutfitCut`] has the garments of a subject in one of CAPE's four outfits. Sewn and simulated over
//! a motion, they are laid onto the body: each vertex follows its point of the garment
//! ([`SurfaceTransfer`]), and is unposed by the body's own blend weights.

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
