//! The axis that points up in a file, and turning a motion so that y does.

use std::{fmt, str::FromStr};

use glam::{DAffine3, DMat3, DQuat, DVec3};
use ndarray::ArrayView2;

use crate::{
    Error, Result,
    joints::{JOINTS, PARENTS, rotation},
};

/// Axis that points up in the coordinates of a motion.
///
/// ```
/// use cape_core::motion::UpAxis;
///
/// assert_eq!("z".parse::<UpAxis>()?, UpAxis::Z);
/// // Rotation by which z becomes this library's up axis, y.
/// let turned = UpAxis::Z.to_y() * glam::DVec3::Z;
/// assert!(turned.abs_diff_eq(glam::DVec3::Y, 1e-12));
/// # Ok::<(), cape_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum UpAxis {
    /// y, as in SMPL's own coordinates.
    Y,
    /// z, as in AMASS and Blender.
    Z,
    /// -y: camera coordinates, whose y axis points down.
    MinusY,
}

impl UpAxis {
    /// All axes.
    pub const ALL: [Self; 3] = [Self::Y, Self::Z, Self::MinusY];

    /// Name, `y`, `z` or `-y`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Y => "y",
            Self::Z => "z",
            Self::MinusY => "-y",
        }
    }

    /// Unit vector along the axis.
    pub const fn vector(self) -> DVec3 {
        match self {
            Self::Y => DVec3::Y,
            Self::Z => DVec3::Z,
            Self::MinusY => DVec3::NEG_Y,
        }
    }

    /// Rotation about x that takes the axis to y.
    pub fn to_y(self) -> DQuat {
        let angle = match self {
            Self::Y => 0.0,
            Self::Z => -std::f64::consts::FRAC_PI_2,
            Self::MinusY => std::f64::consts::PI,
        };
        DQuat::from_rotation_x(angle)
    }

    /// Axis along which the body of `poses` `[frames, 72]` stands, and the mean cosine of its
    /// uprightness with it: head above pelvis above feet, over all frames.
    pub(super) fn standing(poses: ArrayView2<f64>) -> (Self, f64) {
        let step = poses.nrows().div_ceil(MOST_FRAMES).max(1);
        let frames = poses.rows().into_iter().step_by(step);
        let count = frames.len().max(1) as f64;
        let mean = frames.map(|pose| uprightness(&pose.to_vec())).sum::<DVec3>() / count;
        let mut best = (Self::Y, f64::NEG_INFINITY);
        for axis in Self::ALL {
            let cosine = mean.dot(axis.vector());
            if cosine > best.1 {
                best = (axis, cosine);
            }
        }
        best
    }
}

impl fmt::Display for UpAxis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for UpAxis {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let named = Self::ALL.into_iter().find(|axis| axis.name() == text);
        named.ok_or_else(|| Error::argument(format!("up axis `{text}`: expected y, z or -y")))
    }
}

/// Largest number of frames of which the posture is evaluated.
const MOST_FRAMES: usize = 500;

/// Mean of the directions from the ankles to the pelvis and from the pelvis to the head.
fn uprightness(pose: &[f64]) -> DVec3 {
    let mut globals = [DAffine3::IDENTITY; JOINTS];
    for joint in 0..JOINTS {
        let turn: DMat3 = rotation([0, 1, 2].map(|axis| pose[3 * joint + axis]));
        globals[joint] = match PARENTS[joint] {
            None => DAffine3::from_mat3(turn),
            Some(parent) => globals[parent] * DAffine3::from_mat3_translation(turn, bone(joint)),
        };
    }
    let at = |joint: usize| globals[joint].translation;
    let ankles = 0.5 * (at(7) + at(8));
    let (above, below) = (at(15) - at(0), at(0) - ankles);
    0.5 * (above.normalize_or_zero() + below.normalize_or_zero())
}

/// Approximate vector from the parent of a joint to it in the rest pose, metres.
pub(super) fn bone(joint: usize) -> DVec3 {
    match joint {
        1 => DVec3::new(0.07, -0.09, 0.0),
        2 => DVec3::new(-0.07, -0.09, 0.0),
        4 | 5 => DVec3::new(0.0, -0.38, 0.0),
        7 | 8 => DVec3::new(0.0, -0.42, -0.03),
        3 | 6 | 15 => DVec3::new(0.0, 0.12, 0.0),
        9 => DVec3::new(0.0, 0.06, 0.0),
        10 | 11 => DVec3::new(0.0, -0.06, 0.13),
        12 => DVec3::new(0.0, 0.22, 0.0),
        13 => DVec3::new(0.08, 0.12, 0.0),
        14 => DVec3::new(-0.08, 0.12, 0.0),
        16 => DVec3::new(0.12, 0.04, 0.0),
        17 => DVec3::new(-0.12, 0.04, 0.0),
        18 | 20 => DVec3::new(0.26, 0.0, 0.0),
        19 | 21 => DVec3::new(-0.26, 0.0, 0.0),
        22 => DVec3::new(0.09, 0.0, 0.0),
        23 => DVec3::new(-0.09, 0.0, 0.0),
        _ => DVec3::ZERO,
    }
}
