use ndarray::Array2;

use crate::{Error, Result, expect_finite};

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
}
