use std::collections::VecDeque;

use ndarray::Array2;

use cape_core::BodyMotion;

use super::FeatureOptions;
use crate::Result;

/// A frame with its complete features.
#[derive(Debug, Clone, PartialEq)]
pub struct StreamedFrame {
    /// Frame number, from 0.
    pub frame: usize,
    /// Axis-angles, radians, `[3 · joints]`.
    pub pose: Vec<f64>,
    /// Translation, metres.
    pub transl: [f64; 3],
    /// Features, `[len]`.
    pub row: Vec<f64>,
}

/// The rows of [`FeatureOptions::rows`] for a motion that arrives frame by frame, bit for bit. A
/// row is returned as soon as its velocities are complete: one frame later, or, with smoothing, as
/// many frames later as the Gaussian is wide.
///
/// ```
/// use cape_layer::regress::{FeatureStream, FeatureOptions};
///
/// // The velocities of a frame are complete with the next frame.
/// let mut stream = FeatureStream::new(FeatureOptions::default(), 30.0);
/// assert!(stream.push(&[0.0; 72], [0.0; 3])?.is_none());
/// let first = stream.push(&[0.0; 72], [0.0, 0.0, 0.1])?.ok_or("no frame")?;
/// assert_eq!((first.frame, first.row.len()), (0, FeatureOptions::default().len(24)));
/// assert_eq!(stream.finish()?.ok_or("no frame")?.frame, 1);
/// assert!(stream.finish()?.is_none());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct FeatureStream {
    features: FeatureOptions,
    frame_rate: f64,
    /// Later frames that a row depends on.
    reach: usize,
    /// Earlier frames that a row depends on.
    back: usize,
    /// Frames that later rows depend on; the first has number `first`.
    window: VecDeque<(Vec<f64>, [f64; 3])>,
    first: usize,
    next: usize,
}

impl FeatureStream {
    /// A stream of a motion with `frame_rate` frames per second.
    pub fn new(features: FeatureOptions, frame_rate: f64) -> Self {
        let sigma = (features.smoothing * frame_rate).max(0.0);
        let reach = 1 + (3.0 * sigma).ceil() as usize;
        let back = reach + features.reach_back(frame_rate);
        Self { features, frame_rate, reach, back, window: VecDeque::new(), first: 0, next: 0 }
    }

    /// Adds the next frame, axis-angles `[3 · joints]`, radians, and a translation, metres; returns
    /// the frame whose row this completes.
    ///
    /// # Errors
    /// If the number of joints differs from the frames before, or numbers are not finite.
    pub fn push(&mut self, pose: &[f64], transl: [f64; 3]) -> Result<Option<StreamedFrame>> {
        self.window.push_back((pose.to_vec(), transl));
        let seen = self.first + self.window.len();
        if seen <= self.next + self.reach {
            return Ok(None);
        }
        self.emit().map(Some)
    }

    /// The next remaining frame after the last one was pushed; `None` at the end.
    pub fn finish(&mut self) -> Result<Option<StreamedFrame>> {
        if self.next == self.first + self.window.len() {
            return Ok(None);
        }
        self.emit().map(Some)
    }

    fn emit(&mut self) -> Result<StreamedFrame> {
        let at = self.next - self.first;
        let count = self.window.len().min(at + self.reach + 1);
        let joints = self.window[0].0.len();
        let angles = self.window.iter().take(count).flat_map(|(pose, _)| pose).copied().collect();
        let poses = Array2::from_shape_vec((count, joints), angles).map_err(|error| {
            crate::Error::argument(format!(
                "pose: the number of joints changed within the motion: {error}"
            ))
        })?;
        let translations = Array2::from_shape_fn((count, 3), |(f, k)| self.window[f].1[k]);
        let motion = BodyMotion::new(self.frame_rate, poses, translations)?;
        let row = self.features.rows(&motion).row(at).to_vec();
        let (pose, transl) = self.window[at].clone();
        let frame = self.next;
        self.next += 1;
        while self.first + self.back < self.next {
            self.window.pop_front();
            self.first += 1;
        }
        Ok(StreamedFrame { frame, pose, transl, row })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stream_is_the_whole() {
        for (frames, smoothing, history) in
            [(1, 0.0, 0), (2, 0.0, 1), (17, 0.0, 0), (17, 0.04, 0), (5, 0.2, 0), (31, 0.02, 3)]
        {
            let poses =
                Array2::from_shape_fn((frames, 9), |(f, k)| (0.3 * f as f64 + k as f64).sin());
            let moves =
                Array2::from_shape_fn((frames, 3), |(f, k)| (0.1 * f as f64).powi(k as i32));
            let motion = BodyMotion::new(30.0, poses, moves).unwrap();
            let features = FeatureOptions { smoothing, history, ..FeatureOptions::default() };
            let expected = features.rows(&motion);
            let mut stream = FeatureStream::new(features, 30.0);
            let mut found = Vec::new();
            for f in 0..frames {
                let transl = [0, 1, 2].map(|k| motion.translations[(f, k)]);
                found.extend(stream.push(&motion.poses.row(f).to_vec(), transl).unwrap());
                assert!(found.len() + stream.reach > f, "no later than it must be");
            }
            while let Some(arrived) = stream.finish().unwrap() {
                found.push(arrived);
            }
            assert_eq!(found.len(), frames);
            for (f, arrived) in found.iter().enumerate() {
                assert_eq!((arrived.frame, &arrived.row), (f, &expected.row(f).to_vec()));
                assert_eq!(arrived.pose, motion.poses.row(f).to_vec());
            }
        }
    }

    #[test]
    fn bad_frames_are_refused() {
        let stream = || FeatureStream::new(FeatureOptions::default(), 30.0);
        let mut ragged = stream();
        ragged.push(&[0.0; 9], [0.0; 3]).unwrap();
        assert!(ragged.push(&[0.0; 6], [0.0; 3]).is_err());
        let mut broken = stream();
        broken.push(&[0.0; 9], [f64::NAN, 0.0, 0.0]).unwrap();
        assert!(broken.finish().is_err());
    }
}
