use std::fmt;

/// Keypoint layout of a detector.
///
/// ```
/// use cape_fit::Detector;
///
/// assert_eq!(Detector::from_point_count(17), Some(Detector::Coco17));
/// assert_eq!(Detector::from_point_count(5), None);
/// // BODY_25 has a point between the hips, which corresponds to the pelvis.
/// assert!(Detector::Body25.joints().contains(&(8, 0)));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Detector {
    /// BODY_25 of OpenPose: body and feet.
    Body25,
    /// COCO layout of OpenPose with 18 points: those of COCO and the neck.
    Coco18,
    /// The 17 annotated points of COCO.
    Coco17,
    /// The 24 joints of SMPL.
    Smpl24,
}

/// Pairs `(keypoint, joint)` of a keypoint and the corresponding joint of SMPL, by index. The
/// orders are those of the published output formats of OpenPose and COCO. Points of the face and
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

impl Detector {
    /// All layouts.
    pub const ALL: [Self; 4] = [Self::Body25, Self::Coco18, Self::Coco17, Self::Smpl24];

    /// Number of keypoints of a person.
    pub const fn points(self) -> usize {
        match self {
            Self::Body25 => 25,
            Self::Coco18 => 18,
            Self::Coco17 => 17,
            Self::Smpl24 => 24,
        }
    }

    /// Layout with this number of keypoints.
    pub fn from_point_count(points: usize) -> Option<Self> {
        Self::ALL.into_iter().find(|detector| detector.points() == points)
    }

    /// Pairs `(keypoint, joint)` of keypoints and corresponding joints of SMPL, by index.
    pub const fn joints(self) -> &'static [(usize, usize)] {
        match self {
            Self::Body25 => BODY_25,
            Self::Coco18 => COCO_18,
            Self::Coco17 => COCO_17,
            Self::Smpl24 => SMPL_24,
        }
    }
}

impl fmt::Display for Detector {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Body25 => "BODY_25",
            Self::Coco18 => "COCO-18",
            Self::Coco17 => "COCO-17",
            Self::Smpl24 => "SMPL-24",
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
        for detector in Detector::ALL {
            let mut joints: Vec<usize> = detector.joints().iter().map(|&(_, j)| j).collect();
            joints.sort_unstable();
            joints.dedup();
            assert_eq!(joints.len(), detector.joints().len(), "{detector}");
            assert!(joints.iter().all(|&joint| joint < JOINTS));
            assert!(detector.joints().iter().all(|&(point, _)| point < detector.points()));
            for &joint in &joints {
                if let Some(limb) = JOINT_NAMES[joint].strip_prefix("l_") {
                    let other = JOINT_NAMES.iter().position(|n| *n == format!("r_{limb}"));
                    assert!(joints.contains(&other.unwrap()), "{detector} {limb}");
                }
            }
            assert_eq!(Detector::from_point_count(detector.points()), Some(detector));
        }
        assert_eq!(Detector::from_point_count(21), None);
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
