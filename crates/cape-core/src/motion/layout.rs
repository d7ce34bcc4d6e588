//! Layouts of arrays of the rotations of all joints.

use super::rotations::{RotationLayout, people_and_frames};

/// Numbers of joints: SMPL, the body joints alone, SMPL+H, SMPL-X.
pub(super) const JOINTS: [usize; 4] = [24, 22, 52, 55];
/// Numbers of joints without the root.
pub(super) const BODY_JOINTS: [usize; 2] = [23, 21];

/// Rows of rotations of all joints, alone or with other numbers.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Wide {
    Rotations(RotationLayout),
    /// Joints, their columns, those of translation and shape.
    Columns(Columns),
    /// Joints, representation, frames, as motion diffusion models have them: `[24, 6, n]`.
    FramesLast(usize),
}

/// Columns of a table of poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Columns {
    pub(super) width: usize,
    pub(super) pose: [usize; 2],
    pub(super) translation: Option<usize>,
    pub(super) betas: Option<[usize; 2]>,
    pub(super) name: &'static str,
}

/// Tables whose width tells their columns.
const TABLES: [Columns; 5] = [
    Columns {
        width: 75,
        pose: [0, 72],
        translation: Some(72),
        betas: None,
        name: "pose and translation",
    },
    Columns {
        width: 82,
        pose: [0, 72],
        translation: None,
        betas: Some([72, 82]),
        name: "pose and betas",
    },
    Columns {
        width: 85,
        pose: [3, 75],
        translation: None,
        betas: Some([75, 85]),
        name: "camera, pose and betas",
    },
    Columns {
        width: 159,
        pose: [0, 156],
        translation: Some(156),
        betas: None,
        name: "pose and translation",
    },
    Columns {
        width: 322,
        pose: [0, 156],
        translation: Some(309),
        betas: Some([312, 322]),
        name: "Motion-X (hands, jaw and face left out)",
    },
];

impl Wide {
    pub(super) fn of(shape: &[usize], name: &str) -> Option<Self> {
        if let ("thetas" | "motion", &[24, 6, frames]) = (name, shape) {
            return Some(Self::FramesLast(frames));
        }
        if let Some(layout) = RotationLayout::of(shape, &JOINTS) {
            return Some(Self::Rotations(layout));
        }
        let (&width, lead) = shape.split_last()?;
        people_and_frames(lead)?;
        TABLES.into_iter().find(|table| table.width == width).map(Self::Columns)
    }
}
