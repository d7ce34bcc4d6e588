//! Clothed bodies fitted to scans: point clouds or meshes, with holes and noise.
//!
//! [`ScanFitter`] fits shape, pose, translation and latent code of a clothed body to a [`Scan`] by
//! robust bidirectional surface distances, from coarse to fine: rigid placement, pose, shape,
//! clothing. [`free_displacement`] then moves every vertex to the scan, beyond the space of the
//! model, which gives a [`Registration`]. Scans may have any position and any up axis.

pub mod benchmark;
pub(crate) mod energy;
mod file;
mod fit;
mod free_form;
mod init;
mod joints;
pub(crate) mod nearest;
mod registration;
pub(crate) mod rigid;
pub(crate) mod sample;
mod stage;

pub use energy::{ScanDistance, ScanTerms, distances_to};
pub use file::{RemovedElements, Scan, ScanUnit, Unit};
pub use fit::{ScanFit, ScanFitTerms, ScanFitter, ScanProgressFn};
pub use free_form::{FreeFormConfig, FreeFormSurface, free_displacement};
pub use init::{ScanInit, UpAxis};
pub use joints::KnownJoints;
pub use registration::{FrameLocation, Registration};
pub use stage::{ScanConfig, ScanStage, Unknowns};
