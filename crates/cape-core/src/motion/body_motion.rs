use glam::{DQuat, DVec3};
use ndarray::{Array2, ArrayView1};

use super::UpAxis;
use crate::{BodyPose, Error, Result, expect_finite};

/// Poses and translations of a body at a fixed frame rate.
///
/// ```
/// use cape_core::BodyMotion;
/// use ndarray::Array2;
///
/// let motion = BodyMotion::new(30.0, Array2::zeros((60, 72)), Array2::zeros((60, 3)))?;
/// assert_eq!(motion.frames(), 60);
/// // Poses and translations must have the same number of frames.
/// assert!(BodyMotion::new(30.0, Array2::zeros((60, 72)), Array2::zeros((59, 3))).is_err());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct BodyMotion {
    /// Frames per second.
    pub frame_rate: f64,
    /// Poses in axis-angle, radians, `[frames, 3 · joints]`.
    pub poses: Array2<f64>,
    /// Translations of the body, metres, `[frames, 3]`.
    pub translations: Array2<f64>,
}

impl BodyMotion {
    /// Builds a motion from finite poses `[frames, 3 · joints]` and translations `[frames, 3]`.
    ///
    /// # Errors
    /// If the frame rate is not positive, shapes disagree, or a number is not finite.
    pub fn new(frame_rate: f64, poses: Array2<f64>, translations: Array2<f64>) -> Result<Self> {
        if !(frame_rate.is_finite() && frame_rate > 0.0) {
            return Err(Error::argument(format!(
                "frame rate {frame_rate}: expected a positive number"
            )));
        }
        let frames = poses.nrows();
        if poses.ncols() < 3
            || !poses.ncols().is_multiple_of(3)
            || translations.dim() != (frames, 3)
        {
            return Err(Error::argument(format!(
                "poses {:?} and translations {:?}: expected [frames, 3 · joints] and [frames, 3]",
                poses.shape(),
                translations.shape()
            )));
        }
        expect_finite("poses", &poses)?;
        expect_finite("translations", &translations)?;
        Ok(Self { frame_rate, poses, translations })
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.poses.nrows()
    }

    /// A motion of `poses` without translations.
    ///
    /// # Errors
    /// As of [`new`](Self::new).
    pub fn from_poses(frame_rate: f64, poses: &[BodyPose]) -> Result<Self> {
        let angles = poses.as_flattened().iter().map(|&angle| f64::from(angle)).collect();
        let table = Array2::from_shape_vec((poses.len(), 72), angles)
            .map_err(|error| Error::argument(error.to_string()))?;
        Self::new(frame_rate, table, Array2::zeros((poses.len(), 3)))
    }

    /// Pose of frame `frame` of a body of 24 joints, rounded to single precision.
    ///
    /// # Panics
    /// If there is no such frame, or the poses are not of 24 joints.
    pub fn pose(&self, frame: usize) -> BodyPose {
        let row = self.poses.row(frame);
        assert_eq!(row.len(), 72, "pose of 24 joints");
        std::array::from_fn(|angle| row[angle] as f32)
    }

    /// Translation of the body in frame `frame`, metres.
    ///
    /// # Panics
    /// If there is no such frame.
    pub fn translation(&self, frame: usize) -> [f64; 3] {
        [0, 1, 2].map(|axis| self.translations[(frame, axis)])
    }

    /// Duration from the first frame to the last, seconds.
    pub fn seconds(&self) -> f64 {
        self.frames().saturating_sub(1) as f64 / self.frame_rate
    }

    /// The motion in coordinates in which y points up, of a motion in coordinates in which `up` does.
    ///
    /// The whole body is turned about the origin. SMPL turns a body about its pelvis, so that the
    /// translation changes with `pelvis`, the rest position of the pelvis in metres:
    /// `t' = Q (p + t) - p`.
    #[must_use]
    pub fn turned_upright(&self, up: UpAxis, pelvis: [f64; 3]) -> Self {
        if up == UpAxis::Y {
            return self.clone();
        }
        let turn = up.to_y();
        let pelvis = DVec3::from_array(pelvis);
        let mut turned = self.clone();
        for frame in 0..self.frames() {
            let orientation = turn * quaternion(self.poses.row(frame), 0);
            let axis_angle = orientation.to_scaled_axis().to_array();
            let t = DVec3::from_array(self.translation(frame));
            let t = (turn * (pelvis + t) - pelvis).to_array();
            for axis in 0..3 {
                turned.poses[(frame, axis)] = axis_angle[axis];
                turned.translations[(frame, axis)] = t[axis];
            }
        }
        turned
    }

    /// The motion of a body that turns about its pelvis, of one whose root turns it about the origin:
    /// `t' = R p + t - p` with the root's rotation R and the rest position of the pelvis, metres.
    pub(super) fn about_pelvis(&self, pelvis: [f64; 3]) -> Self {
        let pelvis = DVec3::from_array(pelvis);
        let mut turned = self.clone();
        for frame in 0..self.frames() {
            let shift = quaternion(self.poses.row(frame), 0) * pelvis - pelvis;
            for axis in 0..3 {
                turned.translations[(frame, axis)] += shift[axis];
            }
        }
        turned
    }

    /// The motion at another frame rate, in frames per second: rotations are interpolated spherically
    /// (slerp), translations linearly. The first frame is kept; the last is kept if it falls on a new
    /// frame.
    ///
    /// # Errors
    /// If the rate is not positive, or there would be more than ten million frames.
    pub fn resampled(&self, frame_rate: f64) -> Result<Self> {
        const MOST: f64 = 1e7;
        if !(frame_rate.is_finite() && frame_rate > 0.0) {
            return Err(Error::argument(format!(
                "frame rate {frame_rate}: expected a positive number"
            )));
        }
        if (frame_rate - self.frame_rate).abs() < 1e-9 * frame_rate || self.frames() < 2 {
            return Ok(Self { frame_rate, ..self.clone() });
        }
        // Rounding must not lose the last frame.
        let last = (self.seconds() * frame_rate + 1e-6).floor();
        if last >= MOST {
            return Err(Error::argument(format!(
                "{frame_rate} frames per second of {} s: more than ten million frames",
                self.seconds()
            )));
        }
        let frames = last as usize + 1;
        let mut poses = Array2::zeros((frames, self.poses.ncols()));
        let mut translations = Array2::zeros((frames, 3));
        for frame in 0..frames {
            let at = frame as f64 * self.frame_rate / frame_rate;
            let before = (at.floor() as usize).min(self.frames() - 2);
            let share = (at - before as f64).clamp(0.0, 1.0);
            let [a, b] = [before, before + 1].map(|row| self.poses.row(row));
            for joint in 0..self.poses.ncols() / 3 {
                let between = quaternion(a, joint).slerp(quaternion(b, joint), share);
                // q and -q are the same rotation; of the two take the one of an angle up to π.
                let between = if between.w < 0.0 { -between } else { between };
                for (axis, angle) in between.to_scaled_axis().to_array().into_iter().enumerate() {
                    poses[(frame, 3 * joint + axis)] = angle;
                }
            }
            for axis in 0..3 {
                let [a, b] = [before, before + 1].map(|row| self.translations[(row, axis)]);
                translations[(frame, axis)] = a + share * (b - a);
            }
        }
        Self::new(frame_rate, poses, translations)
    }
}

fn quaternion(pose: ArrayView1<f64>, joint: usize) -> DQuat {
    DQuat::from_scaled_axis(DVec3::from_array([0, 1, 2].map(|axis| pose[3 * joint + axis])))
}
