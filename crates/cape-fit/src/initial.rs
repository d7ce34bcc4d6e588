//! Initial placement of a body by its torso.

use glam::{DQuat, DVec2, DVec3};

use crate::{Error, PinholeCamera, Result, keypoints::KeypointDetection};

/// Shoulder and hip of each side.
const SIDES: [[usize; 2]; 2] = [[16, 1], [17, 2]];
/// Fewest detected joints that place a body.
const FEWEST: usize = 4;

/// Initial placement of a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct InitialPlacement {
    /// Global orientation in axis-angle, radians.
    pub(crate) orientation: DVec3,
    /// Translation, metres.
    pub(crate) transl: DVec3,
    /// Depth, metres.
    pub(crate) distance: f64,
}

/// Places a body with the joints `joints`, metres, without orientation and translation, under weak
/// perspective: the length of the torso gives the depth, its direction in the image the roll; the
/// yaw is `yaw` radians, 0 facing the camera.
///
/// # Errors
/// If too few joints are detected, or all detections coincide.
pub(crate) fn place(
    camera: &PinholeCamera,
    joints: &[DVec3],
    detections: &[KeypointDetection],
    yaw: f64,
) -> Result<InitialPlacement> {
    if detections.len() < FEWEST {
        return Err(Error::Observation(format!(
            "keypoints: {} joints with enough confidence, expected at least {FEWEST}",
            detections.len()
        )));
    }
    let turn = DQuat::from_rotation_y(yaw);
    let turned = |joint: usize| turn * (joints[joint] - joints[0]);
    let seen = |s: &KeypointDetection| camera.offset(s.at.x, s.at.y);
    let find = |joint: usize| detections.iter().find(|s| s.joint == joint);

    // Direction and length of the torso in space and in the image; else a similarity of all joints.
    let (mut up, mut up_seen, mut length, mut length_seen) = (DVec2::ZERO, DVec2::ZERO, 0.0, 0.0);
    for [shoulder, hip] in SIDES {
        if let (Some(upper), Some(lower)) = (find(shoulder), find(hip)) {
            let (trunk, trunk_seen) = (turned(shoulder) - turned(hip), seen(upper) - seen(lower));
            up += trunk.truncate();
            up_seen += trunk_seen;
            length += trunk.length();
            length_seen += trunk_seen.length();
        }
    }
    let count = detections.len() as f64;
    let middle = detections.iter().map(|s| turned(s.joint)).sum::<DVec3>() / count;
    let middle_seen = detections.iter().map(seen).sum::<DVec2>() / count;
    if length_seen < 1.0 {
        (up, up_seen, length, length_seen) = (DVec2::X, DVec2::ZERO, 0.0, 0.0);
        for detection in detections {
            let from = (turned(detection.joint) - middle).truncate();
            let to = seen(detection) - middle_seen;
            // Product of one complex number and the conjugate of the other.
            up_seen += DVec2::new(from.dot(to), from.perp_dot(to));
            length += from.length();
            length_seen += to.length();
        }
    }
    let scale = length_seen / length;
    if !(scale > 1e-6 && scale.is_finite()) {
        return Err(Error::Observation(
            "keypoints: all detections are in one place, expected a person".into(),
        ));
    }
    let roll = DQuat::from_rotation_z(up.angle_to(up_seen));
    let distance = camera.focal() / scale;
    let target = (middle_seen / scale).extend(-distance);
    let turned_pelvis_to_middle = roll * middle;
    Ok(InitialPlacement {
        orientation: (roll * turn).to_scaled_axis(),
        transl: target - turned_pelvis_to_middle - joints[0],
        distance,
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::{Skeleton, keypoints::Keypoint, testing::BODY};

    fn detections(
        camera: &PinholeCamera,
        joints: &[DVec3],
        which: &[usize],
    ) -> Vec<KeypointDetection> {
        let detection = |&joint: &usize| {
            let at = camera.project(joints[joint]);
            KeypointDetection { joint, at: Keypoint { x: at.x, y: at.y, confidence: 1.0 } }
        };
        which.iter().map(detection).collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        /// A distant body at rest with any roll.
        #[test]
        fn far_bodies_are_placed(
            roll in -3.1f64..3.1, side in any::<bool>(), x in -2.0f64..2.0, limbs in any::<bool>(),
        ) {
            let skeleton = Skeleton::new(&BODY).unwrap();
            let camera = PinholeCamera::new(500, 400, Some(4000.0)).unwrap();
            let yaw = if side { std::f64::consts::PI } else { 0.0 };
            let turn = DQuat::from_rotation_z(roll) * DQuat::from_rotation_y(yaw);
            let rest = skeleton.rest(&[]);
            let transl = DVec3::new(x, 0.5, -40.0);
            let moved: Vec<DVec3> =
                rest.iter().map(|&p| turn * (p - rest[0]) + rest[0] + transl).collect();
            // Without hips the torso is unknown.
            let which: &[usize] = if limbs { &[4, 5, 16, 17, 20] } else { &[1, 2, 16, 17, 4] };
            let seen = detections(&camera, &moved, which);
            let placed = place(&camera, &rest, &seen, yaw).unwrap();
            prop_assert!((placed.transl - transl).length() < 0.6, "{placed:?}");
            let off = DQuat::from_scaled_axis(placed.orientation).angle_between(turn);
            prop_assert!(off < 0.05, "{off}");
        }
    }

    #[test]
    fn too_few_or_coincident_joints_are_refused() {
        let camera = PinholeCamera::new(500, 400, None).unwrap();
        let rest = Skeleton::new(&BODY).unwrap().rest(&[]);
        let seen = detections(&camera, &rest, &[1, 2, 16]);
        let message = place(&camera, &rest, &seen, 0.0).unwrap_err().to_string();
        assert!(message.contains("3 joints"), "{message}");
        let at = Keypoint { x: 3.0, y: 3.0, confidence: 1.0 };
        let same: Vec<KeypointDetection> =
            (16..22).map(|joint| KeypointDetection { joint, at }).collect();
        let message = place(&camera, &rest, &same, 0.0).unwrap_err().to_string();
        assert!(message.contains("one place"), "{message}");
    }
}
