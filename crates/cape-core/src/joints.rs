//! SMPL's joints, and poses as axis-angles, rotation matrices and the network's pose feature.

use glam::{DMat3, DVec3};

use ndarray::Array2;

use crate::{Error, Result};

/// Number of joints of SMPL, 24.
pub const JOINTS: usize = 24;
/// Length of the pose feature, 126: a 3 × 3 rotation for each of [`CLOTHING_JOINTS`].
pub const POSE_FEATURE: usize = 9 * CLOTHING_JOINTS.len();

/// Pose of a body: the axis-angles of SMPL's 24 joints, `[72]`, radians.
pub type BodyPose = [f32; 3 * JOINTS];

/// Names of the joints, in SMPL's order.
pub const JOINT_NAMES: [&str; JOINTS] = [
    "pelvis",
    "l_hip",
    "r_hip",
    "spine1",
    "l_knee",
    "r_knee",
    "spine2",
    "l_ankle",
    "r_ankle",
    "spine3",
    "l_foot",
    "r_foot",
    "neck",
    "l_collar",
    "r_collar",
    "head",
    "l_shoulder",
    "r_shoulder",
    "l_elbow",
    "r_elbow",
    "l_wrist",
    "r_wrist",
    "l_hand",
    "r_hand",
];

/// Parent of each joint; `None` for the pelvis.
pub const PARENTS: [Option<usize>; JOINTS] = [
    None,
    Some(0),
    Some(0),
    Some(0),
    Some(1),
    Some(2),
    Some(3),
    Some(4),
    Some(5),
    Some(6),
    Some(7),
    Some(8),
    Some(9),
    Some(9),
    Some(9),
    Some(12),
    Some(13),
    Some(14),
    Some(16),
    Some(17),
    Some(18),
    Some(19),
    Some(20),
    Some(21),
];

/// Joint on the other side of each; those of the spine are their own.
pub const MIRRORED_JOINTS: [usize; JOINTS] =
    [0, 2, 1, 3, 5, 4, 6, 8, 7, 9, 11, 10, 12, 14, 13, 15, 17, 16, 19, 18, 21, 20, 23, 22];

/// Mirror image of a pose about the plane x = 0: left and right joints change places, and the parts of
/// their axis-angles along y and z change sign. `[72]`, radians.
///
/// ```
/// use cape_core::joints::{JOINTS, mirrored_pose};
///
/// // The left knee (joint 4) bent by 1.2 rad and turned by 0.3 rad.
/// let mut pose = [0.0; 3 * JOINTS];
/// [pose[12], pose[13]] = [1.2, 0.3];
/// let mirrored = mirrored_pose(&pose);
/// assert_eq!(mirrored[15..18], [1.2, -0.3, 0.0]);
/// assert_eq!(mirrored_pose(&mirrored), pose);
/// ```
pub fn mirrored_pose(pose: &[f64; 3 * JOINTS]) -> [f64; 3 * JOINTS] {
    std::array::from_fn(|index| {
        let value = pose[3 * MIRRORED_JOINTS[index / 3] + index % 3];
        if index % 3 == 0 { value } else { 0.0 - value }
    })
}

/// Joints that influence clothing, the only ones CAPE conditions on (§4): hips, knees, spine, neck,
/// collars, shoulders and elbows.
pub const CLOTHING_JOINTS: [usize; 14] = [1, 2, 3, 4, 5, 6, 9, 12, 13, 14, 16, 17, 18, 19];

/// Rotation matrix, `[3, 3]`, as rows.
///
/// ```
/// use cape_core::joints::{JOINTS, POSE_FEATURE, Rotation, pose_feature, pose_rotations};
///
/// let rotations: Vec<Rotation> = pose_rotations(&[0.0; 3 * JOINTS])?;
/// assert_eq!(rotations[0], [[1., 0., 0.], [0., 1., 0.], [0., 0., 1.]]);
/// // In the rest pose the feature is 14 identity matrices.
/// let feature = pose_feature(&rotations)?;
/// assert_eq!(feature.len(), POSE_FEATURE);
/// assert_eq!(feature.iter().sum::<f64>(), 3.0 * 14.0);
/// # Ok::<(), cape_core::Error>(())
/// ```
pub type Rotation = [[f64; 3]; 3];

/// Rotation matrix of an axis-angle in radians (Rodrigues' formula).
pub fn rotation_matrix(axis_angle: [f64; 3]) -> Rotation {
    let matrix = rotation(axis_angle).transpose();
    matrix.to_cols_array_2d()
}

/// [`rotation_matrix`] as a `glam` matrix.
pub(crate) fn rotation(axis_angle: [f64; 3]) -> DMat3 {
    DMat3::from_quat(glam::DQuat::from_scaled_axis(DVec3::from_array(axis_angle)))
}

/// Rotation matrices of a pose in axis-angle, radians: `[3 · joints]` → `[joints, 3, 3]`.
pub fn pose_rotations(pose: &[f64]) -> Result<Vec<Rotation>> {
    let (joints, rest) = pose.as_chunks::<3>();
    if rest.is_empty() {
        return Ok(joints.iter().map(|&joint| rotation_matrix(joint)).collect());
    }
    Err(Error::Argument(format!("pose of {} numbers, expected 3 per joint", pose.len())))
}

/// Pose feature of joint rotations: matrices of [`CLOTHING_JOINTS`], row-major,
/// `[24, 3, 3]` → `[126]`.
pub fn pose_feature(rotations: &[Rotation]) -> Result<[f64; POSE_FEATURE]> {
    if rotations.len() != JOINTS {
        let found = rotations.len();
        return Err(Error::Argument(format!("{found} rotations, expected {JOINTS}")));
    }
    let mut feature = [0.0; POSE_FEATURE];
    let numbers = CLOTHING_JOINTS.iter().flat_map(|&joint| rotations[joint].as_flattened());
    for (slot, &number) in feature.iter_mut().zip(numbers) {
        *slot = number;
    }
    Ok(feature)
}

/// Pose features of `n` poses, `[n, 126]`.
pub fn pose_features(poses: &[BodyPose]) -> Result<Array2<f32>> {
    let mut features = Array2::zeros((poses.len(), POSE_FEATURE));
    for (mut row, pose) in features.rows_mut().into_iter().zip(poses) {
        let feature = pose_feature(&pose_rotations(&pose.map(f64::from))?)?;
        row.iter_mut().zip(feature).for_each(|(to, value)| *to = value as f32);
    }
    Ok(features)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_quarter_turn_about_z_maps_x_to_y() {
        let r = rotation_matrix([0.0, 0.0, PI / 2.0]);
        let x_image = [r[0][0], r[1][0], r[2][0]];
        for (found, expected) in x_image.into_iter().zip([0.0, 1.0, 0.0]) {
            assert!((found - expected).abs() < 1e-15);
        }
        assert_eq!(rotation_matrix([0.0; 3]), [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
    }

    #[test]
    fn the_feature_takes_the_clothing_joints_row_by_row() {
        let rotations: Vec<Rotation> = (0..JOINTS)
            .map(|j| {
                let n = |k: usize| (10 * j + k) as f64;
                [[n(0), n(1), n(2)], [n(3), n(4), n(5)], [n(6), n(7), n(8)]]
            })
            .collect();
        let feature = pose_feature(&rotations).unwrap();
        assert_eq!(feature[..10], [10.0, 11.0, 12.0, 13.0, 14.0, 15.0, 16.0, 17.0, 18.0, 20.0]);
        assert_eq!(feature[125], 198.0);
        assert!(pose_feature(&rotations[1..]).is_err());
        assert!(pose_rotations(&[0.0; 4]).is_err());
    }

    #[test]
    fn parents_come_first() {
        assert!(PARENTS.iter().enumerate().all(|(j, p)| p.map_or(j == 0, |p| p < j)));
    }

    proptest! {
        /// Reference: the power series of `exp([v]ₓ)`.
        #[test]
        fn a_rotation_is_the_exponential_of_its_cross_product(
            v in prop::array::uniform3(-2.0f64..2.0),
        ) {
            let [x, y, z] = v;
            let k = DMat3::from_cols_array_2d(&[[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]).transpose();
            let (mut term, mut sum) = (DMat3::IDENTITY, DMat3::IDENTITY);
            for i in 1..40 {
                term = term * k * (1.0 / f64::from(i));
                sum += term;
            }
            prop_assert!(rotation(v).abs_diff_eq(sum, 1e-12));
        }
    }
}
