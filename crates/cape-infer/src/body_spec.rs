//! Bodies to dress.

use cape_core::{BodyPose, Outfit};
use cape_data::PackedSet;
use ndarray::Array3;

use crate::{Error, Result};

/// Shape, pose and outfit of a body to dress.
#[derive(Debug, Clone, PartialEq)]
pub struct BodySpec {
    /// Shape coefficients; missing ones are zero.
    pub betas: Vec<f32>,
    /// Pose in axis-angle, `[72]`, radians.
    pub pose: BodyPose,
    /// Outfit, the paper's clothing type `c`.
    pub outfit: Outfit,
}

/// Displacements `[1, V, 3]` in metres of a frame of a packed set, and its body: of mean shape, since
/// packed sets hold no shape coefficients.
///
/// # Errors
/// If there is no such frame, or it cannot be read.
pub fn registration(set: &PackedSet, frame: usize) -> Result<(Array3<f32>, BodySpec)> {
    let count = set.frames();
    let outfit = *set.outfits().get(frame).filter(|_| frame < count).ok_or_else(|| {
        Error::argument(format!("frame {frame}: the set has {count}, counted from 0"))
    })?;
    let pose = BodyPose::try_from(set.pose(frame)?).map_err(|pose| {
        Error::argument(format!("frame {frame}: a pose of {} numbers", pose.len()))
    })?;
    let body = BodySpec { betas: Vec::new(), pose, outfit };
    Ok((set.batch(&[frame], None)?.displacement, body))
}
