//! From MakeHuman's stance to SMPL's T-pose.

use glam::{DQuat, DVec3};

use crate::rig::{MIRRORED, Weights, follows};
use cape_core::joints::JOINTS;

/// Position of the pelvis, metres, as in SMPL's templates.
const PELVIS: DVec3 = DVec3::new(0.0, -0.228, 0.006);
/// Rotation by which the collar bone is raised, radians.
const COLLAR: f64 = 0.20;
/// Directions of upper arm, forearm and hand on the left.
const ARM: [(usize, usize, DVec3); 3] = [
    (16, 18, DVec3::new(1.0, -0.03, -0.06)),
    (18, 20, DVec3::new(1.0, 0.02, -0.01)),
    (20, 22, DVec3::new(1.0, -0.01, 0.0)),
];
/// Distance of ankle from hip along x, metres.
const STRIDE: f64 = 0.035;

/// Brings vertices and joints to the T-pose with the pelvis at SMPL's place. A vertex follows a joint by
/// the share of its weights at the joint and below: it turns by that part of the rotation, which
/// keeps its distance from the joint.
pub(crate) fn t_pose(vertices: &mut [DVec3], joints: &mut [DVec3; JOINTS], weights: &[Weights]) {
    let mut posing = Posing { vertices, joints, weights };
    posing.turn_both(13, DQuat::from_rotation_z(COLLAR));
    for (from, to, direction) in ARM {
        let bone = (posing.joints[to] - posing.joints[from]).normalize_or(DVec3::X);
        posing.turn_both(from, DQuat::from_rotation_arc(bone, direction.normalize()));
    }
    let leg = posing.joints[7] - posing.joints[1];
    let straight = DVec3::new(STRIDE, leg.y, leg.z).normalize_or(DVec3::NEG_Y);
    let turn = DQuat::from_rotation_arc(leg.normalize_or(DVec3::NEG_Y), straight);
    posing.turn_both(1, turn);
    posing.turn_both(7, turn.inverse());
    let shift = PELVIS - posing.joints[0];
    posing.vertices.iter_mut().for_each(|p| *p += shift);
    posing.joints.iter_mut().for_each(|p| *p += shift);
}

struct Posing<'a> {
    vertices: &'a mut [DVec3],
    joints: &'a mut [DVec3; JOINTS],
    weights: &'a [Weights],
}

impl Posing<'_> {
    /// Turns a left joint, and its mirror image by the mirrored rotation.
    fn turn_both(&mut self, joint: usize, turn: DQuat) {
        self.turn(joint, turn);
        self.turn(MIRRORED[joint], DQuat::from_xyzw(turn.x, -turn.y, -turn.z, turn.w));
    }

    fn turn(&mut self, joint: usize, turn: DQuat) {
        let centre = self.joints[joint];
        for (p, row) in self.vertices.iter_mut().zip(self.weights) {
            let share: f64 = (joint..JOINTS).filter(|&j| follows(j, joint)).map(|j| row[j]).sum();
            if share > 0.0 {
                *p = centre + DQuat::IDENTITY.slerp(turn, share.min(1.0)) * (*p - centre);
            }
        }
        for below in joint + 1..JOINTS {
            if follows(below, joint) {
                self.joints[below] = centre + turn * (self.joints[below] - centre);
            }
        }
    }
}
