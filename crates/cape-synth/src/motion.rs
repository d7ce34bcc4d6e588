//! Named motions as smooth joint-angle curves.

use std::{
    f64::consts::{PI, TAU},
    fmt,
    str::FromStr,
};

use glam::{DQuat, DVec3};
use rand::{Rng, RngExt, SeedableRng, rngs::ChaCha8Rng};

use super::regions::joint;
use crate::Error;

/// Motion of a synthetic subject.
///
/// ```
/// use cape_synth::{Motion, MotionStyle};
///
/// let motion: Motion = "squats".parse()?;
/// assert!(!motion.is_test());
/// let pose = motion.pose(&MotionStyle::default(), 0.4);
/// assert_eq!(pose.len(), 72);
/// // A slower subject has another pose at the same time.
/// let slow = MotionStyle { tempo: 0.5, ..MotionStyle::default() };
/// assert_ne!(motion.pose(&slow, 0.4), pose);
/// # Ok::<(), cape_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Motion {
    /// Marching in place.
    WalkMarch,
    /// Deep knee bends with the arms forward.
    Squats,
    /// Moving both arms sideways, up and forward.
    MoveArms,
    /// Twisting and tilting the upper body.
    TwistTilt,
    /// Bending forward and backward.
    BendBackAndFront,
    /// Straight punches.
    Punching,
    /// Circling hips, hands at the waist.
    Hips,
    /// Standing with small shifts of weight.
    Simple,
    /// Raising and lowering the elbows, hands at the chest.
    ChickenWings,
    /// Standing on one leg, arms spread.
    FlyingEagle,
    /// Circling arms.
    ShouldersMill,
    /// Stepping apart and raising the arms overhead.
    JumpingJacks,
    /// Bending and twisting towards each foot in turn.
    BendTwist,
    /// Kicking a ball.
    Soccer,
    /// Transitions between held poses.
    PoseModel,
    /// Random postures of trunk, arms and legs, one after another.
    RangeOfMotion,
}

impl Motion {
    /// All motions.
    pub const ALL: [Self; 16] = [
        Self::WalkMarch,
        Self::Squats,
        Self::MoveArms,
        Self::TwistTilt,
        Self::BendBackAndFront,
        Self::Punching,
        Self::Hips,
        Self::Simple,
        Self::ChickenWings,
        Self::FlyingEagle,
        Self::ShouldersMill,
        Self::JumpingJacks,
        Self::BendTwist,
        Self::Soccer,
        Self::PoseModel,
        Self::RangeOfMotion,
    ];

    /// Motions of the CAPE captures, by their names there: all but [`RangeOfMotion`](Self::RangeOfMotion).
    pub const CAPTURED: [Self; 15] = {
        let [captured @ .., _] = Self::ALL;
        captured
    };

    /// Motions of the test split.
    pub const TEST: [Self; 3] = [Self::BendTwist, Self::Soccer, Self::PoseModel];

    /// True if the motion belongs to the test split.
    pub fn is_test(self) -> bool {
        Self::TEST.contains(&self)
    }

    /// Name of the motion in directory and file names.
    pub const fn name(self) -> &'static str {
        match self {
            Self::WalkMarch => "walk_march",
            Self::Squats => "squats",
            Self::MoveArms => "move_arms",
            Self::TwistTilt => "twist_tilt",
            Self::BendBackAndFront => "bend_back_and_front",
            Self::Punching => "punching",
            Self::Hips => "hips",
            Self::Simple => "simple",
            Self::ChickenWings => "chicken_wings",
            Self::FlyingEagle => "flying_eagle",
            Self::ShouldersMill => "shoulders_mill",
            Self::JumpingJacks => "jumping_jacks",
            Self::BendTwist => "bend_twist",
            Self::Soccer => "soccer",
            Self::PoseModel => "pose_model",
            Self::RangeOfMotion => "range_of_motion",
        }
    }

    /// Duration of one repetition, or from one random posture to the next, at normal tempo, seconds.
    fn period(self) -> f64 {
        match self {
            Self::RangeOfMotion => 1.1,
            Self::WalkMarch => 1.3,
            Self::Punching => 1.4,
            Self::JumpingJacks | Self::Soccer => 1.8,
            Self::ChickenWings | Self::ShouldersMill => 2.0,
            Self::Squats | Self::Hips => 2.8,
            Self::MoveArms | Self::FlyingEagle | Self::TwistTilt => 3.6,
            Self::BendBackAndFront | Self::BendTwist | Self::Simple => 4.2,
            Self::PoseModel => 7.0,
        }
    }

    /// Pose in axis-angle at `time` seconds, radians, `[72]`.
    pub fn pose(self, style: &MotionStyle, time: f64) -> [f64; 72] {
        let t = TAU * time * style.tempo / self.period() + style.phase;
        let mut builder = PoseBuilder::standing(style, time);
        self.perform(&mut builder, t, style);
        builder.axis_angles()
    }

    fn perform(self, f: &mut PoseBuilder, t: f64, style: &MotionStyle) {
        let a = style.amplitude;
        let (s, c) = t.sin_cos();
        // 0 to 1 and back once per repetition.
        let swell = 0.5 - 0.5 * c;
        let slow = (0.5 * t).sin();
        match self {
            Self::WalkMarch => {
                for (side, s) in [(0, s), (1, -s)] {
                    let lift = s.max(0.0);
                    f.leg(side, a * (1.15 * lift - 0.16 * (-s).max(0.0)), 0.02, a * 1.5 * lift);
                    f.arm(side, HANG, -0.55 * a * s, 0.0, 0.4 + 0.35 * (-s).max(0.0));
                }
                f.spine(0.04, 0.04 * s, -0.14 * a * s);
            }
            Self::Squats => {
                let d = a * swell;
                for side in 0..2 {
                    f.leg(side, 1.55 * d, 0.12 + 0.22 * d, 1.75 * d);
                    f.arm(side, HANG, 0.1 + 1.35 * d, 0.0, 0.15 + 0.1 * d);
                }
                f.root(0.42 * d, 0.0, 0.0);
                f.spine(0.25 * d, 0.0, 0.05 * slow);
            }
            Self::MoveArms => {
                let raise = HANG + a * 2.3 * swell;
                for side in 0..2 {
                    let front = (0.5 + 0.5 * slow) * (1.0 - (2.0 * swell - 1.0).powi(2));
                    let lag = if side == 0 { 0.0 } else { 0.25 * s * style.asymmetry };
                    f.arm(side, raise + lag, 0.0, 0.9 * front, 0.2 + 0.6 * front);
                }
                f.spine(-0.06 * swell, 0.05 * slow, 0.1 * slow);
            }
            Self::TwistTilt => {
                f.spine(0.08, 0.38 * a * c, 0.75 * a * s);
                f.root(0.0, 0.0, 0.22 * a * s);
                for side in 0..2 {
                    f.arm(side, -0.35 + 0.2 * slow, 0.0, 0.7, 1.35);
                    f.leg(side, 0.06, 0.16, 0.1);
                }
            }
            Self::BendBackAndFront => {
                let front = 1.15 * a * (-c).max(-0.32 * a);
                f.spine(front * 0.62, 0.0, 0.06 * slow);
                f.root(front * 0.55, 0.0, 0.0);
                for side in 0..2 {
                    f.leg(side, front * 0.52, 0.07, 0.12 + 0.1 * front.max(0.0));
                    f.arm(side, HANG + 0.1, 0.55 * front + 0.1, 0.0, 0.2);
                }
            }
            Self::Punching => {
                f.spine(0.1, 0.0, 0.42 * a * s);
                for (side, s) in [(0, s), (1, -s)] {
                    let out = (0.5 - 0.5 * s).powi(2);
                    f.arm(side, -0.75 + 0.7 * out, 0.25, 1.0 + 0.4 * out, 2.15 - 1.95 * a * out);
                    f.leg(side, 0.25 * (1.0 - side as f64) + 0.1, 0.16, 0.32);
                }
            }
            Self::Hips => {
                f.root(0.16 * a * c, 0.2 * a * s, 0.0);
                f.spine(-0.16 * a * c, -0.24 * a * s, 0.1 * a * slow);
                for side in 0..2 {
                    let lean = if side == 0 { s } else { -s };
                    f.leg(side, 0.16 * a * c + 0.1, 0.16 - 0.2 * a * lean, 0.16 + 0.14 * lean);
                    f.arm(side, -0.85, -0.35, 0.0, 1.6);
                }
            }
            Self::Simple => {
                f.spine(0.04 + 0.05 * slow, 0.07 * a * s, 0.14 * a * slow);
                for (side, s) in [(0, s), (1, -s)] {
                    f.leg(
                        side,
                        0.1 + 0.12 * a * s.max(0.0),
                        0.06 + 0.04 * s,
                        0.1 + 0.25 * s.max(0.0),
                    );
                    f.arm(side, HANG + 0.12 * swell, 0.18 * a * s, 0.0, 0.25 + 0.5 * swell);
                }
            }
            Self::ChickenWings => {
                for side in 0..2 {
                    let raise = -0.95 + 1.05 * a * swell;
                    f.arm(side, raise, 0.0, 0.25, 2.1);
                    f.leg(side, 0.1 + 0.1 * swell, 0.08, 0.15 + 0.15 * swell);
                }
                f.spine(0.08 * swell, 0.05 * slow, 0.1 * slow);
            }
            Self::FlyingEagle => {
                let side = usize::from(slow < 0.0);
                let lift = slow.abs().min(1.0) * a;
                f.leg(side, -0.35 * lift, 0.05, 0.9 * lift);
                f.leg(1 - side, 0.25 * lift, 0.03, 0.15 * lift);
                f.root(0.28 * lift, 0.0, 0.0);
                f.spine(0.12 * lift, 0.0, 0.0);
                for side in 0..2 {
                    f.arm(side, 0.1 + 0.45 * a * s, 0.0, 0.1 - 0.2 * c, 0.2 + 0.15 * c);
                }
            }
            Self::ShouldersMill => {
                for side in 0..2 {
                    let turn = t + style.asymmetry * PI * side as f64;
                    let raise = HANG + 1.25 * a * (1.0 - turn.cos());
                    f.arm(side, raise, 0.45 * turn.sin(), 0.35 * turn.sin().max(0.0), 0.25);
                    f.leg(side, 0.05, 0.1, 0.08);
                }
                f.spine(0.05 * s, 0.05 * slow, 0.12 * a * s * style.asymmetry);
            }
            Self::JumpingJacks => {
                for side in 0..2 {
                    f.arm(side, HANG + 2.45 * a * swell, 0.0, 0.12, 0.22);
                    f.leg(side, 0.12, 0.04 + 0.42 * a * swell, 0.22 * (1.0 - swell));
                }
                f.spine(0.03, 0.0, 0.0);
            }
            Self::BendTwist => {
                let down = a * (0.35 + 0.65 * s * s);
                f.root(0.35 * down, 0.0, 0.0);
                f.spine(0.62 * down, 0.16 * a * s, 0.62 * a * s);
                for (side, s) in [(0, s), (1, -s)] {
                    f.leg(side, 0.4 * down, 0.26, 0.18);
                    f.arm(side, -0.3 - 0.7 * down * (-s).max(0.0), 0.3 * s, 0.3, 0.25);
                }
            }
            Self::Soccer => {
                let swing = s * a;
                f.leg(0, 0.75 * swing, 0.1, 0.25 + 0.95 * (-swing).max(0.0));
                f.leg(1, 0.2, 0.06, 0.3);
                f.root(-0.1 * swing, 0.0, 0.25 * swing);
                f.spine(0.14 + 0.1 * swing, 0.05 * c, -0.45 * swing);
                f.arm(0, -0.8, -0.45 * swing, 0.2, 0.55);
                f.arm(1, -0.45, 0.65 * swing, 0.25, 0.6 + 0.3 * c);
            }
            Self::PoseModel => {
                let [u, v, w] = [0.0, 2.1, 4.2].map(|shift: f64| 0.5 - 0.5 * (t + shift).cos());
                f.spine(0.05, 0.2 * a * (u - v), 0.45 * a * (v - w));
                f.root(0.0, 0.06 * (w - u), 0.25 * (u - w));
                f.arm(0, -1.2 + 1.75 * a * u, 0.3 * v, 0.5 * w, 0.35 + 1.5 * v * a);
                f.arm(1, -1.1 + 1.15 * a * v, -0.3 * u, 0.6 * u, 0.4 + 1.6 * w * a);
                f.leg(0, 0.55 * w * a, 0.1 + 0.15 * v, 0.12 + 0.9 * w * a);
                f.leg(1, 0.15 + 0.15 * u, 0.1 + 0.1 * u, 0.2 + 0.3 * u);
            }
            Self::RangeOfMotion => {
                let number = (t / TAU).floor();
                let share = 0.5 - 0.5 * (0.5 * (t - TAU * number)).cos();
                let [from, to] = [0.0, 1.0].map(|next| Posture::random(style, number + next));
                f.assume(&from.lerp(&to, share));
            }
        }
    }
}

impl fmt::Display for Motion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Motion {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self, Error> {
        Self::ALL.into_iter().find(|motion| motion.name() == name).ok_or_else(|| {
            let names = Self::ALL.map(Self::name).join(", ");
            Error::Argument(format!("unknown motion `{name}`: expected one of {names}"))
        })
    }
}

/// Individual style in which a subject performs a motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionStyle {
    /// Phase at time 0, radians.
    pub phase: f64,
    /// Speed relative to the normal tempo.
    pub tempo: f64,
    /// Amplitude relative to the normal one.
    pub amplitude: f64,
    /// Asymmetry between left and right, 0 to 1.
    pub asymmetry: f64,
    /// Heading of the subject, radians around y from +z.
    pub heading: f64,
    /// Posture offsets: stoop, roll of the shoulders, spread of the legs, nod; each about 0 ± 1.
    pub posture: [f64; 4],
}

impl Default for MotionStyle {
    fn default() -> Self {
        Self {
            phase: 0.0,
            tempo: 1.0,
            amplitude: 1.0,
            asymmetry: 0.0,
            heading: 0.0,
            posture: [0.0; 4],
        }
    }
}

impl MotionStyle {
    /// Draws a random style.
    pub fn random(rng: &mut impl Rng) -> Self {
        Self {
            phase: rng.random_range(0.0..TAU),
            tempo: rng.random_range(0.8..1.25),
            amplitude: rng.random_range(0.75..1.08),
            asymmetry: rng.random_range(0.0..1.0),
            heading: rng.random_range(-0.6..0.6),
            posture: std::array::from_fn(|_| rng.random_range(-1.0..1.0)),
        }
    }
}

/// Elevation of hanging arms, radians from the horizontal.
const HANG: f64 = -1.3;

/// Builder of a pose from the postures of spine and limbs.
struct PoseBuilder {
    rotations: [DQuat; joint::COUNT],
    /// Forward lean of the pelvis, and of each shin relative to it, radians.
    lean: f64,
    shins: [f64; 2],
}

impl PoseBuilder {
    /// Upright posture with hanging arms and breathing.
    fn standing(style: &MotionStyle, time: f64) -> Self {
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
    fn arm(&mut self, side: usize, raise: f64, swing: f64, reach: f64, elbow: f64) {
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
    fn leg(&mut self, side: usize, flexion: f64, spread: f64, knee: f64) {
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
    fn spine(&mut self, bend: f64, tilt: f64, twist: f64) {
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
    fn root(&mut self, bend: f64, tilt: f64, twist: f64) {
        self.lean += bend;
        self.turn(
            joint::PELVIS,
            DQuat::from_rotation_y(twist)
                * DQuat::from_rotation_x(bend)
                * DQuat::from_rotation_z(-tilt),
        );
    }

    /// Sets trunk, arms and legs.
    fn assume(&mut self, posture: &Posture) {
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
    fn axis_angles(mut self) -> [f64; 72] {
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
struct Posture {
    root: [f64; 3],
    spine: [f64; 3],
    arms: [[f64; 4]; 2],
    legs: [[f64; 3]; 2],
}

impl Posture {
    /// Posture `number` of the sequence that belongs to `style`: a bent, tilted and twisted trunk, each
    /// arm by itself, and both legs bent as for sitting down or one of them lifted.
    fn random(style: &MotionStyle, number: f64) -> Self {
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
    fn lerp(&self, other: &Self, share: f64) -> Self {
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
    fn names_parse_back() {
        for motion in Motion::ALL {
            assert_eq!(motion.name().parse::<Motion>().unwrap(), motion);
        }
        assert!("moonwalk".parse::<Motion>().unwrap_err().to_string().contains("moonwalk"));
    }

    #[test]
    fn motions_are_smooth_and_within_joint_limits() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        for motion in Motion::ALL {
            let style = MotionStyle::random(&mut rng);
            let mut last = motion.pose(&style, 0.0);
            for frame in 1..600 {
                let pose = motion.pose(&style, f64::from(frame) / 60.0);
                for joint in 0..joint::COUNT {
                    let at = |p: &[f64; 72]| DVec3::from_slice(&p[3 * joint..]);
                    assert!(at(&pose).length() < 2.6, "{motion} joint {joint}: {}", at(&pose));
                    let step = (DQuat::from_scaled_axis(at(&last)).inverse()
                        * DQuat::from_scaled_axis(at(&pose)))
                    .to_scaled_axis()
                    .length();
                    assert!(step < 0.25, "{motion} joint {joint} jumps by {step}");
                }
                last = pose;
            }
        }
    }

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
