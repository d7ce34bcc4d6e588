//! Poses from angles of trunk and limbs.

use std::f64::consts::TAU;

use glam::{DQuat, DVec3};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

use super::MotionStyle;
use crate::regions::joint;

/// Elevation of hanging arms, radians from the horizontal.
pub(super) const HANG: f64 = -1.3;

/// Builder of a pose from the postures of spine and limbs.
pub(super) struct PoseBuilder {
    rotations: [DQuat; joint::COUNT],
    /// Forward lean of the pelvis, and of each shin relative to it, radians.
    lean: f64,
    shins: [f64; 2],
}

impl PoseBuilder {
    /// Upright posture with hanging arms and breathing.
    pub(super) fn standing(style: &MotionStyle, time: f64) -> Self {
        let rotations = [DQuat::IDENTITY; joint::COUNT];
        let mut builder = Self { rotations, lean: 0.0, shins: [0.0; 2] };
        let [stoop, roll, spread, nod] = style.posture;
        for side in 0..2 {
            builder.arm(side, HANG, 0.05, 0.0, 0.2);
            builder.leg(side, 0.02, 0.05 + 0.03 * spread, 0.04);
            let tilt = 0.06 * roll * sign(side);
            builder.turn(joint::COLLARS[side], DQuat::from_rotation_z(tilt));
        }
        let breath = 0.012 * (TAU * time / 3.7 + style.phase).sin();
        builder.turn(joint::SPINE[2], DQuat::from_rotation_x(0.05 * stoop + breath));
        builder.turn(joint::NECK, DQuat::from_rotation_x(0.08 * nod - 0.05 * stoop));
        builder.turn(joint::PELVIS, DQuat::from_rotation_y(style.heading));
        builder
    }

    fn turn(&mut self, joint: usize, rotation: DQuat) {
        self.rotations[joint] *= rotation;
    }

    /// Sets an arm: elevation from the horizontal, forward swing about the left–right axis, forward
    /// reach about the vertical axis, elbow flexion; radians.
    pub(super) fn arm(&mut self, side: usize, raise: f64, swing: f64, reach: f64, elbow: f64) {
        let sign = sign(side);
        // The clavicle follows elevations above the horizontal.
        let collar = 0.22 * (raise + 0.4).max(0.0);
        self.rotations[joint::COLLARS[side]] =
            DQuat::from_rotation_z(sign * collar) * DQuat::from_rotation_y(-0.15 * sign * reach);
        self.rotations[joint::SHOULDERS[side]] = DQuat::from_rotation_x(-swing)
            * DQuat::from_rotation_y(-0.85 * sign * reach)
            * DQuat::from_rotation_z(sign * (raise - collar));
        self.rotations[joint::ELBOWS[side]] = DQuat::from_rotation_y(-sign * elbow.max(0.0));
        self.rotations[joint::WRISTS[side]] = DQuat::from_rotation_z(-sign * 0.08);
    }

    /// Sets a leg: hip flexion, abduction, knee flexion; radians.
    pub(super) fn leg(&mut self, side: usize, flexion: f64, spread: f64, knee: f64) {
        let sign = sign(side);
        let knee = knee.max(0.0);
        self.rotations[joint::HIPS[side]] = DQuat::from_rotation_x(-flexion)
            * DQuat::from_rotation_z(sign * spread)
            * DQuat::from_rotation_y(0.08 * sign);
        self.rotations[joint::KNEES[side]] = DQuat::from_rotation_x(knee);
        self.rotations[joint::ANKLES[side]] = DQuat::from_rotation_z(-sign * 0.6 * spread);
        self.shins[side] = knee - flexion;
    }

    /// Sets the spine: forward bend, tilt to the right, twist to the left; radians.
    pub(super) fn spine(&mut self, bend: f64, tilt: f64, twist: f64) {
        for (joint, share) in joint::SPINE.into_iter().zip([0.35, 0.35, 0.3]) {
            let turn = DQuat::from_rotation_y(share * twist)
                * DQuat::from_rotation_x(share * bend)
                * DQuat::from_rotation_z(-share * tilt);
            self.rotations[joint] = turn * self.rotations[joint];
        }
        let look = DQuat::from_rotation_x(-0.3 * bend) * DQuat::from_rotation_y(-0.2 * twist);
        self.rotations[joint::HEAD] = look;
    }

    /// Rotates the whole body: forward bend, tilt to the right, turn to the left; radians.
    pub(super) fn root(&mut self, bend: f64, tilt: f64, twist: f64) {
        self.lean += bend;
        self.turn(
            joint::PELVIS,
            DQuat::from_rotation_y(twist)
                * DQuat::from_rotation_x(bend)
                * DQuat::from_rotation_z(-tilt),
        );
    }

    /// Sets trunk, arms and legs.
    pub(super) fn assume(&mut self, posture: &Posture) {
        let [[bend, tilt, twist], [spine_bend, spine_tilt, spine_twist]] =
            [posture.root, posture.spine];
        self.root(bend, tilt, twist);
        self.spine(spine_bend, spine_tilt, spine_twist);
        for side in 0..2 {
            let ([raise, swing, reach, elbow], [flexion, spread, knee]) =
                (posture.arms[side], posture.legs[side]);
            self.arm(side, raise, swing, reach, elbow);
            self.leg(side, flexion, spread, knee);
        }
    }

    /// Pose in axis-angle `[72]`, with the feet levelled within the range of the ankles.
    pub(super) fn axis_angles(mut self) -> [f64; 72] {
        for (ankle, shin) in joint::ANKLES.into_iter().zip(self.shins) {
            let level = (-0.8 * (self.lean + shin)).clamp(-0.7, 0.5);
            self.rotations[ankle] = DQuat::from_rotation_x(level) * self.rotations[ankle];
        }
        let mut pose = [0.0; 72];
        for (angles, rotation) in pose.chunks_exact_mut(3).zip(&self.rotations) {
            let shortest = if rotation.w < 0.0 { -*rotation } else { *rotation };
            let axis_angle: DVec3 = shortest.to_scaled_axis();
            angles.copy_from_slice(&axis_angle.to_array());
        }
        pose
    }
}

/// Angles of trunk and limbs in the order of the parameters of [`PoseBuilder`], radians.
pub(super) struct Posture {
    root: [f64; 3],
    spine: [f64; 3],
    arms: [[f64; 4]; 2],
    legs: [[f64; 3]; 2],
}

impl Posture {
    /// Posture `number` of the sequence that belongs to `style`: a bent, tilted and twisted trunk, each
    /// arm by itself, and both legs bent as for sitting down or one of them lifted.
    pub(super) fn random(style: &MotionStyle, number: f64) -> Self {
        let seed = style.phase.to_bits() ^ number.to_bits().rotate_left(17);
        let rng = &mut ChaCha8Rng::seed_from_u64(seed);
        let mut draw = |[least, most]: [f64; 2]| style.amplitude * rng.random_range(least..most);
        let root = [[-0.15, 0.5], [-0.15, 0.15], [-0.25, 0.25]].map(&mut draw);
        let spine = [[-0.25, 0.7], [-0.35, 0.35], [-0.75, 0.75]].map(&mut draw);
        let arms = [(); 2].map(|()| {
            let [raise, swing, reach, elbow] =
                [[0.05, 2.2], [-0.6, 1.2], [0.0, 0.8], [0.1, 1.7]].map(&mut draw);
            [HANG + raise, swing, reach, elbow]
        });
        let [depth, lift, side, sits] =
            [[0.0, 1.0], [-0.4, 1.4], [-1.0, 1.0], [-1.0, 1.0]].map(&mut draw);
        let bent = depth * depth;
        let mut legs = [(); 2].map(|()| {
            let [flexion, spread, knee] = [[-0.1, 0.2], [0.03, 0.25], [0.05, 0.35]].map(&mut draw);
            [flexion + 1.45 * bent, spread + 0.2 * bent, knee + 1.6 * bent]
        });
        if sits < 0.0 {
            let [lifted, standing] = if side < 0.0 { [0, 1] } else { [1, 0] };
            let [spread, knee] = [[0.02, 0.45], [0.1, 1.5]].map(&mut draw);
            legs[lifted] = [lift, spread, knee];
            legs[standing] = [0.1 + 0.4 * bent, 0.06, 0.15 + 0.6 * bent];
        }
        Self { root, spine, arms, legs }
    }

    /// Posture between this one at `share` 0 and `other` at 1.
    pub(super) fn lerp(&self, other: &Self, share: f64) -> Self {
        fn between<const N: usize>(a: [f64; N], b: [f64; N], share: f64) -> [f64; N] {
            std::array::from_fn(|i| a[i] + (b[i] - a[i]) * share)
        }
        Self {
            root: between(self.root, other.root, share),
            spine: between(self.spine, other.spine, share),
            arms: std::array::from_fn(|side| between(self.arms[side], other.arms[side], share)),
            legs: std::array::from_fn(|side| between(self.legs[side], other.legs[side], share)),
        }
    }
}

/// Sign of a body side: +1 left, −1 right.
fn sign(side: usize) -> f64 {
    if side == 0 { 1.0 } else { -1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn joints_bend_in_anatomical_directions() {
        // A raised left arm points up, a flexed elbow forward, a flexed knee back.
        let mut builder = PoseBuilder::standing(&MotionStyle::default(), 0.0);
        builder.arm(0, 1.0, 0.0, 0.0, 1.0);
        let arm = builder.rotations[joint::COLLARS[0]] * builder.rotations[joint::SHOULDERS[0]];
        assert!((arm * DVec3::X).y > 0.8);
        assert!((builder.rotations[joint::ELBOWS[0]] * DVec3::X).z > 0.8);
        builder.arm(1, 0.0, 0.0, 1.2, 1.0);
        assert!((builder.rotations[joint::SHOULDERS[1]] * DVec3::NEG_X).z > 0.8);
        assert!((builder.rotations[joint::ELBOWS[1]] * DVec3::NEG_X).z > 0.8);
        builder.leg(0, 1.0, 0.0, 1.0);
        assert!((builder.rotations[joint::HIPS[0]] * DVec3::NEG_Y).z > 0.8);
        assert!((builder.rotations[joint::KNEES[0]] * DVec3::NEG_Y).z < -0.8);
    }
}
