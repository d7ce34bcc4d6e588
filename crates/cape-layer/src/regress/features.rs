use std::ops::Range;

use glam::{DMat3, DVec3};
use ndarray::{Array2, ArrayView2};
use serde::Serialize;

use cape_core::BodyMotion;

/// Motion features of each frame (§3.3): global velocity, joint angles and joint angular velocities.
///
/// The direction of gravity in the frame of the root, and the features of earlier moments, are additions to
/// the paper's features.
///
/// ```
/// use cape_core::BodyMotion;
/// use cape_layer::regress::FeatureOptions;
/// use ndarray::Array2;
///
/// // A body that moves forward at 1 m/s.
/// let way = Array2::from_shape_fn((5, 3), |(frame, axis)| 0.1 * frame as f64 * [0.0, 0.0, 1.0][axis]);
/// let motion = BodyMotion::new(10.0, Array2::zeros((5, 72)), way)?;
/// let features = FeatureOptions { angles: false, angular_speeds: false, ..FeatureOptions::default() };
/// let rows = features.rows(&motion);
/// assert_eq!(rows.dim(), (5, features.len(24)));
/// assert!(rows.rows().into_iter().all(|row| (row[2] - 1.0).abs() < 1e-9));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FeatureOptions {
    /// Use the velocity of the root in the frame of the root, `[3]`, m/s.
    pub speed: bool,
    /// Use the direction of gravity in the frame of the root, `[3]`, and the axis-angles of the other
    /// joints, `[3 · (joints − 1)]`, radians.
    pub angles: bool,
    /// Use the angular velocities of all joints, each in its own frame, `[3 · joints]`, rad/s.
    pub angular_speeds: bool,
    /// Standard deviation of the Gaussian that smooths velocities, seconds. Velocities are central
    /// differences of the frames, one-sided at both ends.
    pub smoothing: f64,
    /// Joints whose rotations are used.
    pub joints: FeatureJoints,
    /// Number of earlier moments, 0.1 s apart, whose features are used as well: for clothes that swing.
    /// Moments before the first frame have the features of the first.
    pub history: usize,
}

impl Default for FeatureOptions {
    fn default() -> Self {
        Self {
            speed: true,
            angles: true,
            angular_speeds: true,
            smoothing: 0.0,
            joints: FeatureJoints::WithoutHands,
            history: 0,
        }
    }
}

/// Joints whose rotations are inputs of a regression.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum FeatureJoints {
    /// All joints.
    All,
    /// All but wrists and hands, which no garment of a trunk or of legs follows.
    WithoutHands,
}

/// Time from one moment of the history to the one before, seconds.
const HISTORY_STEP: f64 = 0.1;

/// Joints of wrists and hands.
const HANDS: Range<usize> = 20..24;

/// Standard deviations below which inputs count as constant: of velocities, m/s; of the direction of
/// gravity and of angles, radians; of angular velocities, rad/s.
const FLOORS: [f64; 3] = [0.05, 0.05, 0.3];

impl FeatureOptions {
    /// Number of features of a body of `joints` joints.
    pub fn len(&self, joints: usize) -> usize {
        self.floors(joints).len()
    }

    /// Least standard deviation that each feature is divided by, in its own unit, `[len]`: one that
    /// hardly varies in training must not dominate the prediction when it varies later.
    pub fn floors(&self, joints: usize) -> Vec<f64> {
        let [speed, angle, turn] = FLOORS;
        let turned = 3 * self.used_joints(joints).filter(|&joint| joint > 0).count();
        let groups = [
            (self.speed, 3, speed),
            (self.angles, turned + 3, angle),
            (self.angular_speeds, turned + 3, turn),
        ];
        let moment: Vec<f64> = groups
            .into_iter()
            .filter(|(used, ..)| *used)
            .flat_map(|(_, count, floor)| std::iter::repeat_n(floor, count))
            .collect();
        moment.repeat(1 + self.history)
    }

    /// Joints whose rotations are used, of `joints`.
    fn used_joints(&self, joints: usize) -> impl Iterator<Item = usize> {
        let all = self.joints == FeatureJoints::All;
        (0..joints).filter(move |joint| all || !HANDS.contains(joint))
    }

    /// Number of earlier frames that the features of a frame depend on, apart from those of velocities.
    pub(super) fn reach_back(&self, frame_rate: f64) -> usize {
        self.history * history_frames(frame_rate)
    }

    /// Features of each frame, `[frames, len]`.
    pub fn rows(&self, motion: &BodyMotion) -> Array2<f64> {
        let moments = self.moments(motion);
        let step = history_frames(motion.frame_rate);
        let (frames, own) = moments.dim();
        Array2::from_shape_fn((frames, own * (1 + self.history)), |(frame, k)| {
            moments[(frame.saturating_sub(k / own * step), k % own)]
        })
    }

    /// Features of each frame without history.
    fn moments(&self, motion: &BodyMotion) -> Array2<f64> {
        let (frames, numbers) = motion.poses.dim();
        let used: Vec<usize> = self.used_joints(numbers / 3).collect();
        let smooth = |values: Array2<f64>| smoothed(&values, self.smoothing * motion.frame_rate);
        let speeds = smooth(differences(motion.translations.view(), motion.frame_rate));
        let turns = smooth(turns(motion));
        let mut rows = Vec::new();
        for frame in 0..frames {
            let root = rotation(motion, frame, 0);
            if self.speed {
                let speed = DVec3::from_array([0, 1, 2].map(|axis| speeds[(frame, axis)]));
                rows.extend((root.transpose() * speed).to_array());
            }
            let of = |values: &Array2<f64>, joint: usize| {
                [0, 1, 2].map(|axis| values[(frame, 3 * joint + axis)])
            };
            if self.angles {
                rows.extend((root.transpose() * DVec3::NEG_Y).to_array());
                let turned = used.iter().filter(|&&joint| joint > 0);
                rows.extend(turned.flat_map(|&joint| of(&motion.poses, joint)));
            }
            if self.angular_speeds {
                rows.extend(used.iter().flat_map(|&joint| of(&turns, joint)));
            }
        }
        let columns = rows.len().checked_div(frames).unwrap_or(0);
        Array2::from_shape_fn((frames, columns), |(frame, k)| rows[frame * columns + k])
    }
}

/// Number of frames from one moment of the history to the one before, at `frame_rate` frames per second.
fn history_frames(frame_rate: f64) -> usize {
    (HISTORY_STEP * frame_rate).round().max(1.0) as usize
}

/// Angular velocities of the joints, each in its own frame, rad/s, `[frames, 3 · joints]`.
fn turns(motion: &BodyMotion) -> Array2<f64> {
    let (frames, numbers) = motion.poses.dim();
    let mut turns = Array2::zeros((frames, numbers));
    for frame in 0..frames {
        let (from, to) = around(frame, frames);
        for joint in 0..numbers / 3 {
            let step = rotation(motion, from, joint).transpose() * rotation(motion, to, joint);
            let turn = glam::DQuat::from_mat3(&step).to_scaled_axis();
            let seconds = (to - from).max(1) as f64 / motion.frame_rate;
            for axis in 0..3 {
                turns[(frame, 3 * joint + axis)] = turn[axis] / seconds;
            }
        }
    }
    turns
}

fn rotation(motion: &BodyMotion, frame: usize, joint: usize) -> DMat3 {
    let angles = [0, 1, 2].map(|axis| motion.poses[(frame, 3 * joint + axis)]);
    DMat3::from_quat(glam::DQuat::from_scaled_axis(DVec3::from_array(angles)))
}

/// Frames before and after, clamped to the sequence.
fn around(frame: usize, frames: usize) -> (usize, usize) {
    (frame.saturating_sub(1), (frame + 1).min(frames - 1))
}

/// Central differences per second.
fn differences(values: ArrayView2<'_, f64>, rate: f64) -> Array2<f64> {
    let frames = values.nrows();
    Array2::from_shape_fn(values.dim(), |(frame, k)| {
        let (from, to) = around(frame, frames);
        (values[(to, k)] - values[(from, k)]) * rate / (to - from).max(1) as f64
    })
}

/// Columns smoothed by a Gaussian of `sigma` frames, renormalised at both ends.
fn smoothed(values: &Array2<f64>, sigma: f64) -> Array2<f64> {
    if sigma.is_nan() || sigma <= 0.0 {
        return values.clone();
    }
    let frames = values.nrows();
    let reach = (3.0 * sigma).ceil() as usize;
    let mut out = Array2::zeros(values.dim());
    for (frame, mut row) in out.rows_mut().into_iter().enumerate() {
        let mut sum = 0.0;
        for near in frame.saturating_sub(reach)..(frame + reach + 1).min(frames) {
            let weight = (-0.5 * ((near as f64 - frame as f64) / sigma).powi(2)).exp();
            row.scaled_add(weight, &values.row(near));
            sum += weight;
        }
        row /= sum;
    }
    out
}
