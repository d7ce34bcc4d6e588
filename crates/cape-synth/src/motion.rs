//! Named motions as smooth joint-angle curves.

mod posture;

use std::{
    f64::consts::{PI, TAU},
    fmt,
    str::FromStr,
};

use rand::{Rng, RngExt};

use self::posture::{HANG, PoseBuilder, Posture};
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

#[cfg(test)]
mod tests {
    use glam::{DQuat, DVec3};
    use rand::{SeedableRng, rngs::ChaCha8Rng};

    use super::*;
    use crate::regions::joint;

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
}
