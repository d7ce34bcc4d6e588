//! Bending and twisting of the joints that fold the cloth.

use glam::{DMat3, DQuat, DVec3};

use crate::regions::{Regions, joint};
use cape_core::SmplModel;

/// Bend and twist of one joint.
#[derive(Debug, Clone, Copy)]
pub(super) struct JointBend {
    /// Rest position of the joint, metres.
    pub(super) centre: DVec3,
    /// Direction of the bone below the joint, unit.
    pub(super) axis: DVec3,
    /// Direction towards the inside of the bend, unit; zero if straight.
    pub(super) inside: DVec3,
    /// Bend angle, radians.
    pub(super) angle: f64,
    /// Twist angle about the bone, radians.
    pub(super) twist: f64,
}

impl JointBend {
    fn new(centre: DVec3, end: DVec3, rotation: DVec3) -> Self {
        let axis = (end - centre).normalize_or(DVec3::Y);
        let twist = rotation.dot(axis);
        let across = rotation - axis * twist;
        let inside = rotation.cross(axis).normalize_or_zero();
        Self { centre, axis, inside, angle: across.length(), twist }
    }
}

/// Joint bends of a pose; pairs are left and right.
#[derive(Debug, Clone)]
pub(super) struct JointBends {
    pub(super) elbows: [JointBend; 2],
    pub(super) shoulders: [JointBend; 2],
    pub(super) hips: [JointBend; 2],
    pub(super) knees: [JointBend; 2],
    pub(super) waist: JointBend,
    /// Direction of gravity in the rest frame of each joint, `[J]`.
    pub(super) down: Vec<DVec3>,
}

impl JointBends {
    /// Decomposes `pose`, one axis-angle per joint.
    pub(super) fn new(model: &SmplModel, regions: &Regions, pose: &[DVec3]) -> Self {
        let rest = &regions.joints;
        let pair = |centre: [usize; 2], end: [usize; 2], parts: [Option<[usize; 2]>; 2]| {
            [0, 1].map(|side| {
                let rotation = parts.iter().flatten().map(|part| pose[part[side]]).sum::<DVec3>();
                JointBend::new(rest[centre[side]], rest[end[side]], rotation)
            })
        };
        let mut globals: Vec<DMat3> = Vec::with_capacity(pose.len());
        for (&rotation, parent) in pose.iter().zip(&model.parents) {
            let local = DMat3::from_quat(DQuat::from_scaled_axis(rotation));
            globals.push(parent.map_or(local, |parent| globals[parent] * local));
        }
        let spine = joint::SPINE.map(|joint| pose[joint]).into_iter().sum();
        Self {
            elbows: pair(joint::ELBOWS, joint::WRISTS, [Some(joint::ELBOWS), None]),
            shoulders: pair(
                joint::SHOULDERS,
                joint::ELBOWS,
                [Some(joint::COLLARS), Some(joint::SHOULDERS)],
            ),
            hips: pair(joint::HIPS, joint::KNEES, [Some(joint::HIPS), None]),
            knees: pair(joint::KNEES, joint::ANKLES, [Some(joint::KNEES), None]),
            waist: JointBend::new(rest[joint::SPINE[0]], rest[joint::NECK], spine),
            down: globals.iter().map(|global| -global.row(1)).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_inside_of_a_bend_faces_where_the_bone_goes() {
        let bend = JointBend::new(DVec3::ZERO, DVec3::NEG_Y, DVec3::new(0.7, 0.2, 0.0));
        // A knee: turning about +x moves the shin backwards.
        assert!(bend.inside.abs_diff_eq(DVec3::NEG_Z, 1e-12));
        assert!((bend.angle - 0.7).abs() < 1e-12 && (bend.twist + 0.2).abs() < 1e-12);
        let moved = DQuat::from_rotation_x(0.7) * DVec3::NEG_Y;
        assert!(moved.dot(bend.inside) > 0.5);
    }
}
