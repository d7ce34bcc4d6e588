//! Motion of a take with its run-up.

use std::f64::consts::PI;

use cape_core::{BodyMotion, SmplModel, smpl::StandardPose};
use cape_synth::{Motion, MotionStyle};
use glam::{DQuat, DVec3, EulerRot};
use ndarray::Array2;
use rand::{RngExt, rngs::ChaCha8Rng};
use rayon::prelude::*;

use crate::Result;

/// Durations of the run-up, seconds: the movement after dressing, the transition to the motion, and
/// the motion before the first frame.
const DRESSING: f64 = 0.5;
const TRANSITION: f64 = 0.6;
const LEAD: f64 = 0.3;

/// Duration of the run-up of a take, seconds.
pub(crate) const RUN_UP: f64 = DRESSING + TRANSITION + LEAD;

/// Motion that a take records.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum RecordedMotion<'a> {
    /// A synthetic motion in a style.
    Synthetic(Motion, MotionStyle),
    /// A motion read from a file, from a time on, seconds.
    File(&'a BodyMotion, f64),
}

impl RecordedMotion<'_> {
    /// Rotations of the joints at `time` seconds after the first frame, and the translation, metres.
    fn at(&self, time: f64) -> (Vec<DQuat>, Option<DVec3>) {
        match self {
            Self::Synthetic(motion, style) => (rotations(&motion.pose(style, time)), None),
            Self::File(file, from) => {
                let last = file.frames().saturating_sub(1);
                let at = ((from + time) * file.frame_rate).clamp(0.0, last as f64);
                let (before, share) = (at.floor() as usize, at.fract());
                let after = (before + 1).min(last);
                let [a, b] =
                    [before, after].map(|frame| rotations(&file.poses.row(frame).to_vec()));
                let [s, t] = [before, after].map(|frame| DVec3::from(file.translation(frame)));
                let turned = a.iter().zip(&b).map(|(a, b)| a.slerp(*b, share)).collect();
                (turned, Some(s.lerp(t, share)))
            }
        }
    }
}

/// Frames of a take at `rate` frames per second: the run-up, then `frames` recorded ones. The run-up
/// begins in the A-pose, moves to a random posture, in which cloth slides over the body, and from there
/// into the motion, which runs before its first frame. The body's lowest vertex is on the floor
/// `y = 0`, or translations are those of the file.
pub(crate) fn take_motion(
    (model, shape): (&SmplModel, &Array2<f64>),
    motion: &RecordedMotion,
    (frames, rate): (usize, f64),
    rng: &mut ChaCha8Rng,
) -> Result<(BodyMotion, usize)> {
    let run_up = (RUN_UP * rate).round() as usize;
    let standing = rotations(&StandardPose::A.angles(model.joints()));
    let posture = random_posture(&standing, rng);
    let rows: Vec<(Vec<f64>, [f64; 3])> = (0..run_up + frames)
        .into_par_iter()
        .map(|frame| {
            let time = (frame as f64 - run_up as f64) / rate;
            let (target, transl) = motion.at(time.max(-TRANSITION - LEAD));
            let moved = smooth((time + RUN_UP) / DRESSING);
            let into = smooth((time + TRANSITION + LEAD) / TRANSITION);
            let turned = standing.iter().zip(&posture).zip(&target);
            let turned = turned.map(|((a, b), c)| a.slerp(*b, moved).slerp(*c, into));
            let pose: Vec<f64> = turned.flat_map(axis_angle).collect();
            let transl = if let Some(transl) = transl {
                transl.to_array()
            } else {
                let posed = model.pose_shape(shape, &pose, [0.0; 3], None)?.vertices;
                let floor = posed.column(1).iter().copied().fold(f64::INFINITY, f64::min);
                [0.0, -floor, 0.0]
            };
            Ok((pose, transl))
        })
        .collect::<Result<_>>()?;
    let poses = Array2::from_shape_fn((rows.len(), 3 * model.joints()), |(f, k)| rows[f].0[k]);
    let translations = Array2::from_shape_fn((rows.len(), 3), |(f, k)| rows[f].1[k]);
    Ok((BodyMotion::new(rate, poses, translations)?, run_up))
}

/// A random posture around `standing`: trunk turned and bent, shoulders moved, legs apart.
fn random_posture(standing: &[DQuat], rng: &mut ChaCha8Rng) -> Vec<DQuat> {
    let mut posture = standing.to_vec();
    let mut turn = |joint: usize, most: [f64; 3]| {
        let [x, y, z] = most.map(|most| rng.random_range(-most..most));
        if let Some(rotation) = posture.get_mut(joint) {
            *rotation = DQuat::from_euler(EulerRot::XYZ, x, y, z) * *rotation;
        }
    };
    for (joint, most) in [
        (3, [0.15, 0.2, 0.1]),
        (6, [0.15, 0.2, 0.1]),
        (1, [0.2, 0.1, 0.1]),
        (2, [0.2, 0.1, 0.1]),
        (16, [0.3, 0.5, 0.6]),
        (17, [0.3, 0.5, 0.6]),
    ] {
        turn(joint, most);
    }
    posture
}

/// Smooth rise from 0 at 0 to 1 at 1.
fn smooth(t: f64) -> f64 {
    let t = t.clamp(0.0, 1.0);
    0.5 - 0.5 * (PI * t).cos()
}

fn rotations(pose: &[f64]) -> Vec<DQuat> {
    let (joints, _) = pose.as_chunks::<3>();
    joints.iter().map(|&angles| DQuat::from_scaled_axis(DVec3::from(angles))).collect()
}

/// Axis-angle of an angle up to π, radians.
fn axis_angle(rotation: DQuat) -> [f64; 3] {
    let upper = if rotation.w < 0.0 { -rotation } else { rotation };
    upper.to_scaled_axis().to_array()
}
