use glam::{DMat3, DVec3};
use ndarray::{Array2, ArrayView2};
use serde::Serialize;

use cape_core::BodyMotion;

/// Motion features of each frame (§3.3): global velocity, joint angles and joint angular velocities.
///
/// The direction of gravity in the frame of the root is an addition to the paper's features.
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
}

impl Default for FeatureOptions {
    fn default() -> Self {
        Self { speed: true, angles: true, angular_speeds: true, smoothing: 0.0 }
    }
}

impl FeatureOptions {
    /// Number of features of a body of `joints` joints.
    pub fn len(&self, joints: usize) -> usize {
        let turned = 3 * joints.saturating_sub(1);
        3 * usize::from(self.speed)
            + (turned + 3) * usize::from(self.angles)
            + (turned + 3) * usize::from(self.angular_speeds)
    }

    /// Features of each frame, `[frames, len]`.
    pub fn rows(&self, motion: &BodyMotion) -> Array2<f64> {
        let (frames, numbers) = motion.poses.dim();
        let joints = numbers / 3;
        let smooth = |values: Array2<f64>| smoothed(&values, self.smoothing * motion.frame_rate);
        let speeds = smooth(differences(motion.translations.view(), motion.frame_rate));
        let turns = smooth(turns(motion));
        let mut rows = Array2::zeros((frames, self.len(joints)));
        for (frame, mut row) in rows.rows_mut().into_iter().enumerate() {
            let root = rotation(motion, frame, 0);
            let mut numbers = Vec::with_capacity(row.len());
            if self.speed {
                let speed = DVec3::from_array([0, 1, 2].map(|axis| speeds[(frame, axis)]));
                numbers.extend((root.transpose() * speed).to_array());
            }
            if self.angles {
                numbers.extend((root.transpose() * DVec3::NEG_Y).to_array());
                numbers.extend(motion.poses.row(frame).iter().skip(3));
            }
            if self.angular_speeds {
                numbers.extend(turns.row(frame));
            }
            row.iter_mut().zip(numbers).for_each(|(place, number)| *place = number);
        }
        rows
    }
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
