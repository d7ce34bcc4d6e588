//! Bodies fitted to images.
//!
//! [`Smplify`] finds the bare body behind [`Keypoints`]: a pose that people take ([`PosePrior`]),
//! whose joints a [`Camera`] sees where a detector did.
//!
//! The camera is at the origin and looks along −z, y up; a body without orientation faces it. Units
//! are metres, radians and pixels; everything is computed in `f64`, and every gradient is exact.

mod body_energy;
mod camera;
mod error;
mod initial;
pub mod keypoints;
mod lbfgs;
mod line_search;
mod parameters;
mod pose_prior;
mod skeleton;
mod smplify;
#[cfg(test)]
mod smplify_tests;
#[cfg(test)]
mod testing;

pub use body_energy::{BodyEnergy, BodyTerms, BodyWeights};
pub use camera::Camera;
pub use error::{Error, Result};
pub use keypoints::{Detector, Keypoint, Keypoints, read_keypoints};
pub use lbfgs::{LbfgsOptions, Minimum, Stop, minimise};
pub use parameters::BodyParameters;
pub use pose_prior::{BODY_POSE, COMPONENTS, OPTIONS, PosePrior, synthetic_poses};
pub use skeleton::{PosedSkeleton, Skeleton, SkeletonGradient};
pub use smplify::{BodyFit, Smplify, SmplifyConfig};
