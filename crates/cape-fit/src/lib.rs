//! Bare and clothed bodies fitted to images and scans (CAPE §6.3).
//!
//! [`Smplify`] fits an unclothed body to [`Keypoints`] seen by a [`PinholeCamera`], with a
//! [`PosePrior`]. [`Smplify::fit_clothed`] continues with a clothed body ([`DressedBody`], of a
//! trained model) and the [silhouette] in a [`Mask`]. [`aligned_error`] compares a fit with the
//! ground truth. [`scan`] fits clothed bodies to point clouds and meshes; [`GarmentTracker`] lays a
//! template of a garment onto the scans of a sequence.
//!
//! The camera is at the origin and looks along −z, y up; a body without global orientation faces
//! it. Units are metres, radians and pixels. Energies and gradients are in `f64`; the clothed body
//! itself is decoded and differentiated in `f32` by the model's backend.
//!
//! ```
//! # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/sets.rs"));
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use cape_synth::synthetic_body;
//! use cape_fit::{PinholeCamera, PosePrior, Smplify, SmplifyConfig};
//!
//! // Recover a walking body from the projections of its joints.
//! let model = synthetic_body();
//! let camera = PinholeCamera::new(512, 512, None)?;
//! let (truth, keypoints) = seen(&model, &camera)?;
//! let smplify = Smplify::new(&model, PosePrior::synthetic()?, SmplifyConfig::default())?;
//! let fit = smplify.fit(&camera, &keypoints, None)?;
//! assert!(fit.problem.is_none());
//! assert!((fit.parameters.transl[2] - truth.transl[2]).abs() < 0.3);
//! # Ok(())
//! # }
//! ```

mod alignment;
pub mod benchmark;
mod body_energy;
mod camera;
mod clothed;
mod clothed_config;
#[cfg(test)]
mod clothed_tests;
mod config;
mod depth_ambiguity;
mod dressed_body;
mod error;
mod garment;
mod initial;
pub mod keypoints;
mod parameters;
mod pose_collection;
mod pose_prior;
mod problem;
pub mod scan;
mod sequence;
pub mod silhouette;
mod skeleton;
mod smplify;
#[cfg(test)]
mod smplify_tests;
#[cfg(test)]
mod testing;
mod workers;

pub use cape_core::optimise::{LbfgsOptions, Minimum, StopReason};

pub use alignment::{AlignedError, Alignment, aligned_error};
pub use body_energy::{BodyEnergy, BodyTerms, BodyWeights};
pub use camera::PinholeCamera;
pub use clothed::{ClothedFit, ImageObservation};
pub use clothed_config::{ClothedConfig, ClothedTerms, SilhouetteLevel};
pub use config::FitConfig;
pub use dressed_body::{DressedBody, DressedGradient, DressedSurface, FixedClothing};
pub use error::{Error, Result};
pub use garment::{GarmentConfig, GarmentFit, GarmentStage, GarmentTracker};
pub use keypoints::{
    Keypoint, KeypointLayout, KeypointOptions, Keypoints, People, Person, read_keypoints,
    read_keypoints_with,
};
pub use parameters::BodyParameters;
pub use pose_collection::PoseCollection;
pub use pose_prior::{BODY_POSE, COMPONENTS, OPTIONS, PosePrior, synthetic_poses};
pub use problem::FitProblem;
pub use sequence::{SequenceConfig, SequenceFit, SequenceFrame, TemporalConfig};
pub use silhouette::Mask;
pub use skeleton::{PosedSkeleton, Skeleton, SkeletonGradient};
pub use smplify::{BodyFit, Smplify, SmplifyConfig};
pub use workers::FitWorkers;
