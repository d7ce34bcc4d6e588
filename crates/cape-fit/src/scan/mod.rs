//! Clothed bodies fitted to scans: points or meshes, with holes and noise.
//!
//! [`ScanFitter`] finds β, θ, translation and code of the clothed body whose surface a [`Scan`] is
//! of, by robust distances both ways, from coarse to fine: rigidly, in pose, in shape, in clothes.
//! [`free_displacement`] then lets every vertex leave what the model can say, which makes a
//! registration of the scan. Unlike an image's, a scan's space may be anywhere and of any side up.

pub mod benchmark;
mod energy;
mod file;
mod fit;
mod free_form;
mod init;
mod joints;
mod nearest;
mod registration;
mod rigid;
pub(crate) mod sample;
mod stage;

pub use energy::{ScanDistance, ScanTerms, distances_to};
pub use file::{Scan, Unit};
pub use fit::{ScanFit, ScanFitTerms, ScanFitter, ScanProgressFn};
pub use free_form::{FreeFormConfig, FreeFormSurface, free_displacement};
pub use init::{ScanInit, UpAxis};
pub use joints::KnownJoints;
pub use registration::{FrameLocation, Registration};
pub use stage::{ScanConfig, ScanStage, Unknowns};
