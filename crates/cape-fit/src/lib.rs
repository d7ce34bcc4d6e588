//! Bodies fitted to images and scans.
//!
//! [`Smplify`] finds the bare body behind [`Keypoints`]: a pose that people take ([`PosePrior`]),
//! whose joints a [`PinholeCamera`] sees where a detector did. [`Smplify::fit_clothed`] goes on to the body
//! in clothes ([`DressedBody`], of a trained model) whose [silhouette] is a given
//! [`Mask`]. [`aligned_error`] compares outcomes with the truth. [`scan`] has what finds bodies in
//! points and meshes.
//!
//! The camera is at the origin and looks along −z, y up; a body without orientation faces it. Units
//! are metres, radians and pixels; everything is computed in `f64`, and every gradient is exact.
//!
//! ```
//! # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/sets.rs"));
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use cape_synth::synthetic_body;
//! use cape_fit::{PinholeCamera, PosePrior, Smplify, SmplifyConfig};
//!
//! // A walking body is found again from where a camera saw its joints.
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
#[cfg(test)]
mod clothed_tests;
mod config;
mod depth_ambiguity;
mod dressed_body;
mod error;
mod initial;
pub mod keypoints;
mod parameters;
mod pose_collection;
mod pose_prior;
pub mod scan;
pub mod silhouette;
mod skeleton;
mod smplify;
#[cfg(test)]
mod smplify_tests;
#[cfg(test)]
mod testing;

pub use cape_core::optimise::{LbfgsOptions, Minimum, StopReason};

pub use alignment::{AlignedError, Alignment, aligned_error};
pub use body_energy::{BodyEnergy, BodyTerms, BodyWeights};
pub use camera::PinholeCamera;
pub use clothed::{ClothedConfig, ClothedFit, ClothedTerms, SilhouetteLevel};
pub use config::FitConfig;
pub use dressed_body::{DressedBody, DressedGradient, DressedSurface, FixedClothing};
pub use error::{Error, Result};
pub use keypoints::{Detector, Keypoint, Keypoints, read_keypoints};
pub use parameters::BodyParameters;
pub use pose_collection::PoseCollection;
pub use pose_prior::{BODY_POSE, COMPONENTS, OPTIONS, PosePrior, synthetic_poses};
pub use silhouette::Mask;
pub use skeleton::{PosedSkeleton, Skeleton, SkeletonGradient};
pub use smplify::{BodyFit, Smplify, SmplifyConfig};
