use std::{fmt, str::FromStr};

use crate::Error;

/// Keypoint layout of a detector.
///
/// ```
/// use cape_fit::KeypointLayout;
///
/// assert_eq!("coco-17".parse::<KeypointLayout>()?, KeypointLayout::Coco17);
/// // COCO and Human3.6M have 17 points each, in another order.
/// assert_eq!(KeypointLayout::of_count(17).count(), 2);
/// // BODY_25 has a point between the hips, which corresponds to the pelvis.
/// assert!(KeypointLayout::Body25.joints().contains(&(8, 0)));
/// # Ok::<(), cape_fit::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum KeypointLayout {
    /// BODY_25 of OpenPose: body and feet.
    Body25,
    /// BODY_25B of OpenPose: COCO's points, upper neck, head and feet.
    Body25b,
    /// COCO layout of OpenPose with 18 points: those of COCO and the neck.
    Coco18,
    /// The 17 annotated points of COCO.
    Coco17,
    /// The 17 joints of Human3.6M.
    H36m17,
    /// The 16 joints of MPII.
    Mpii16,
    /// The 26 points of Halpe-FullBody's body: COCO's, head, neck, hip and feet.
    Halpe26,
    /// The 136 points of Halpe-FullBody: the 26 of the body, face and hands.
    Halpe136,
    /// The 133 points of COCO-WholeBody: COCO's, feet, face and hands.
    WholeBody133,
    /// The 33 landmarks of MediaPipe Pose (BlazePose).
    MediaPipe33,
    /// The 24 joints of SMPL.
    Smpl24,
}

/// Pairs `(keypoint, joint)` of a keypoint and the corresponding joint of SMPL, by index. The
/// orders are those of the published output formats. Points of the face and
/// the feet lie on the skin and have no joint; hips and neck of detectors and of SMPL differ by a
/// few centimetres.
type Table = &'static [(usize, usize)];

const BODY_25: Table = &[
    (1, 12), // neck
    (2, 17), // right shoulder
    (3, 19), // right elbow
    (4, 21), // right wrist
    (5, 16), // left shoulder
    (6, 18), // left elbow
    (7, 20), // left wrist
    (8, 0),  // middle of the hips: pelvis
    (9, 2),  // right hip
    (10, 5), // right knee
    (11, 8), // right ankle
    (12, 1), // left hip
    (13, 4), // left knee
    (14, 7), // left ankle
];

const COCO_18: Table = &[
    (1, 12), // neck
    (2, 17), // right shoulder
    (3, 19), // right elbow
    (4, 21), // right wrist
    (5, 16), // left shoulder
    (6, 18), // left elbow
    (7, 20), // left wrist
    (8, 2),  // right hip
    (9, 5),  // right knee
    (10, 8), // right ankle
    (11, 1), // left hip
    (12, 4), // left knee
    (13, 7), // left ankle
];

const COCO_17: Table = &[
    (5, 16),  // left shoulder
    (6, 17),  // right shoulder
    (7, 18),  // left elbow
    (8, 19),  // right elbow
    (9, 20),  // left wrist
    (10, 21), // right wrist
    (11, 1),  // left hip
    (12, 2),  // right hip
    (13, 4),  // left knee
    (14, 5),  // right knee
    (15, 7),  // left ankle
    (16, 8),  // right ankle
];

const SMPL_24: Table = &[
    (0, 0),
    (1, 1),
    (2, 2),
    (3, 3),
    (4, 4),
    (5, 5),
    (6, 6),
    (7, 7),
    (8, 8),
    (9, 9),
    (10, 10),
    (11, 11),
    (12, 12),
    (13, 13),
    (14, 14),
    (15, 15),
    (16, 16),
    (17, 17),
    (18, 18),
    (19, 19),
    (20, 20),
    (21, 21),
    (22, 22),
    (23, 23),
];

const BODY_25B: Table = &[
    (5, 16),  // left shoulder
    (6, 17),  // right shoulder
    (7, 18),  // left elbow
    (8, 19),  // right elbow
    (9, 20),  // left wrist
    (10, 21), // right wrist
    (11, 1),  // left hip
    (12, 2),  // right hip
    (13, 4),  // left knee
    (14, 5),  // right knee
    (15, 7),  // left ankle
    (16, 8),  // right ankle
];

const HALPE: Table = &[
    (5, 16),  // left shoulder
    (6, 17),  // right shoulder
    (7, 18),  // left elbow
    (8, 19),  // right elbow
    (9, 20),  // left wrist
    (10, 21), // right wrist
    (11, 1),  // left hip
    (12, 2),  // right hip
    (13, 4),  // left knee
    (14, 5),  // right knee
    (15, 7),  // left ankle
    (16, 8),  // right ankle
    (18, 12), // neck
    (19, 0),  // hip: pelvis
];

const H36M_17: Table = &[
    (0, 0),   // hip: pelvis
    (1, 2),   // right hip
    (2, 5),   // right knee
    (3, 8),   // right ankle
    (4, 1),   // left hip
    (5, 4),   // left knee
    (6, 7),   // left ankle
    (8, 12),  // thorax: neck
    (11, 16), // left shoulder
    (12, 18), // left elbow
    (13, 20), // left wrist
    (14, 17), // right shoulder
    (15, 19), // right elbow
    (16, 21), // right wrist
];

const MPII_16: Table = &[
    (0, 8),   // right ankle
    (1, 5),   // right knee
    (2, 2),   // right hip
    (3, 1),   // left hip
    (4, 4),   // left knee
    (5, 7),   // left ankle
    (6, 0),   // pelvis
    (7, 12),  // thorax: neck
    (10, 21), // right wrist
    (11, 19), // right elbow
    (12, 17), // right shoulder
    (13, 16), // left shoulder
    (14, 18), // left elbow
    (15, 20), // left wrist
];

const MEDIA_PIPE_33: Table = &[
    (11, 16), // left shoulder
    (12, 17), // right shoulder
    (13, 18), // left elbow
    (14, 19), // right elbow
    (15, 20), // left wrist
    (16, 21), // right wrist
    (23, 1),  // left hip
    (24, 2),  // right hip
    (25, 4),  // left knee
    (26, 5),  // right knee
    (27, 7),  // left ankle
    (28, 8),  // right ankle
];

impl KeypointLayout {
    /// All layouts; among those of one number of points the most common one is first.
    pub const ALL: [Self; 11] = [
        Self::Body25,
        Self::Body25b,
        Self::Coco18,
        Self::Coco17,
        Self::H36m17,
        Self::Mpii16,
        Self::Halpe26,
        Self::Halpe136,
        Self::WholeBody133,
        Self::MediaPipe33,
        Self::Smpl24,
    ];

    /// Number of keypoints of a person.
    pub const fn points(self) -> usize {
        match self {
            Self::Body25 | Self::Body25b => 25,
            Self::Coco18 => 18,
            Self::Coco17 | Self::H36m17 => 17,
            Self::Mpii16 => 16,
            Self::Halpe26 => 26,
            Self::Halpe136 => 136,
            Self::WholeBody133 => 133,
            Self::MediaPipe33 => 33,
            Self::Smpl24 => 24,
        }
    }

    /// Name, as `--layout` has it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Body25 => "body-25",
            Self::Body25b => "body-25b",
            Self::Coco18 => "coco-18",
            Self::Coco17 => "coco-17",
            Self::H36m17 => "h36m-17",
            Self::Mpii16 => "mpii-16",
            Self::Halpe26 => "halpe-26",
            Self::Halpe136 => "halpe-136",
            Self::WholeBody133 => "wholebody-133",
            Self::MediaPipe33 => "mediapipe-33",
            Self::Smpl24 => "smpl-24",
        }
    }

    /// Layouts with this number of keypoints, the most common one first.
    pub fn of_count(points: usize) -> impl Iterator<Item = Self> {
        Self::ALL.into_iter().filter(move |layout| layout.points() == points)
    }

    /// Pairs `(keypoint, joint)` of keypoints and corresponding joints of SMPL, by index.
    pub const fn joints(self) -> &'static [(usize, usize)] {
        match self {
            Self::Body25 => BODY_25,
            Self::Body25b => BODY_25B,
            Self::Coco18 => COCO_18,
            Self::Coco17 | Self::WholeBody133 => COCO_17,
            Self::H36m17 => H36M_17,
            Self::Mpii16 => MPII_16,
            Self::Halpe26 | Self::Halpe136 => HALPE,
            Self::MediaPipe33 => MEDIA_PIPE_33,
            Self::Smpl24 => SMPL_24,
        }
    }
}

impl fmt::Display for KeypointLayout {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Body25 => "BODY_25",
            Self::Body25b => "BODY_25B",
            Self::Coco18 => "COCO-18",
            Self::Coco17 => "COCO-17",
            Self::H36m17 => "H36M-17",
            Self::Mpii16 => "MPII-16",
            Self::Halpe26 => "Halpe-26",
            Self::Halpe136 => "Halpe-136",
            Self::WholeBody133 => "COCO-WholeBody-133",
            Self::MediaPipe33 => "MediaPipe-33",
            Self::Smpl24 => "SMPL-24",
        })
    }
}

impl FromStr for KeypointLayout {
    type Err = Error;

    /// Reads a name; case, hyphens and underscores do not matter.
    fn from_str(text: &str) -> Result<Self, Error> {
        let plain = |text: &str| text.to_lowercase().replace(['-', '_', ' '], "");
        let found = Self::ALL.into_iter().find(|layout| plain(layout.name()) == plain(text));
        found.ok_or_else(|| {
            let names: Vec<&str> = Self::ALL.iter().map(|layout| layout.name()).collect();
            Error::argument(format!(
                "unknown keypoint layout `{text}`, expected one of {}",
                names.join(", ")
            ))
        })
    }
}

#[cfg(test)]
mod tests {
    use cape_core::joints::{JOINT_NAMES, JOINTS};

    use super::*;

    #[test]
    fn every_joint_is_named_once_and_sides_are_kept() {
        // Left and right joints occur in pairs.
        for layout in KeypointLayout::ALL {
            let mut joints: Vec<usize> = layout.joints().iter().map(|&(_, j)| j).collect();
            joints.sort_unstable();
            joints.dedup();
            assert_eq!(joints.len(), layout.joints().len(), "{layout}");
            assert!(joints.iter().all(|&joint| joint < JOINTS));
            assert!(layout.joints().iter().all(|&(point, _)| point < layout.points()));
            for &joint in &joints {
                if let Some(limb) = JOINT_NAMES[joint].strip_prefix("l_") {
                    let other = JOINT_NAMES.iter().position(|n| *n == format!("r_{limb}"));
                    assert!(joints.contains(&other.unwrap()), "{layout} {limb}");
                }
            }
            assert!(KeypointLayout::of_count(layout.points()).any(|other| other == layout));
            assert_eq!(
                layout.to_string().replace("COCO-W", "W").parse::<KeypointLayout>().unwrap(),
                layout
            );
        }
        assert_eq!(KeypointLayout::of_count(21).count(), 0);
        assert!("body-26".parse::<KeypointLayout>().unwrap_err().to_string().contains("h36m-17"));
    }

    #[test]
    fn the_layouts_agree_where_they_overlap() {
        // COCO-18 is COCO-17 reordered by OpenPose, with the neck.
        let order = [0, 15, 14, 17, 16, 5, 2, 6, 3, 7, 4, 11, 8, 12, 9, 13, 10];
        for &(point, joint) in COCO_17 {
            assert!(COCO_18.contains(&(order[point], joint)), "{point}");
        }
    }
}
