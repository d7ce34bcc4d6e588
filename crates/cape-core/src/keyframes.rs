//! Keyframes of vertex offsets, between which the offsets are interpolated linearly.

use ndarray::{Array2, Zip};

use crate::{Error, Result};

/// Rule by which the keyframes of an animation are chosen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum KeyframeRule {
    /// As few as keep the error of every vertex in every frame below a distance, metres.
    Tolerance(f64),
    /// Every n-th frame, and the last.
    Every(usize),
}

/// Longest distance between keyframes, frames.
const LONGEST: usize = 240;

impl Default for KeyframeRule {
    /// A tolerance of 1 mm.
    fn default() -> Self {
        Self::Tolerance(1e-3)
    }
}

/// Chooses keyframes from offsets `[V, 3]` that arrive frame by frame.
///
/// The error of a frame is the largest distance of a vertex from where linear interpolation between
/// the keyframes around it puts that vertex, in the rest pose. Skinning blends rotations, which
/// lengthens no vector: the error in the posed body is not larger.
///
/// ```
/// use cape_core::{KeyframeRule, KeyframeSelector};
/// use ndarray::Array2;
///
/// // A vertex that moves forth for ten frames and back for ten.
/// let mut selector = KeyframeSelector::new(KeyframeRule::Tolerance(1e-3))?;
/// for frame in 0..=20_i32 {
///     let x = 0.01 * f64::from(10 - (frame - 10).abs());
///     selector.push(Array2::from_elem((1, 3), x))?;
/// }
/// let chosen = selector.finish();
/// let frames: Vec<usize> = chosen.keyframes.iter().map(|(frame, _)| *frame).collect();
/// assert_eq!(frames, [0, 10, 20]);
/// assert!(chosen.error < 1e-12);
/// # Ok::<(), cape_core::Error>(())
/// ```
#[derive(Debug)]
pub struct KeyframeSelector {
    rule: KeyframeRule,
    /// Offsets since the last keyframe.
    since: Vec<Array2<f64>>,
    chosen: ChosenKeyframes,
    /// Error of the frames in `since` if the last of them becomes a keyframe.
    pending: f64,
}

/// Keyframes of an animation.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ChosenKeyframes {
    /// Numbers of the frames with their offsets, metres, `[V, 3]`; the first and the last frame are
    /// among them.
    pub keyframes: Vec<(usize, Array2<f64>)>,
    /// Largest error of a vertex in any frame, metres.
    pub error: f64,
}

impl KeyframeSelector {
    /// A selector without frames.
    ///
    /// # Errors
    /// If the tolerance is negative or not finite, or every zeroth frame is asked for.
    pub fn new(rule: KeyframeRule) -> Result<Self> {
        let valid = match rule {
            KeyframeRule::Tolerance(most) => most.is_finite() && most >= 0.0,
            KeyframeRule::Every(step) => step > 0,
        };
        if !valid {
            return Err(Error::argument(format!(
                "{rule:?}: expected a tolerance of at least 0 m, or every n-th frame with n at least 1"
            )));
        }
        Ok(Self { rule, since: Vec::new(), chosen: ChosenKeyframes::default(), pending: 0.0 })
    }

    /// Takes the offsets of the next frame.
    ///
    /// # Errors
    /// If the shape differs from that of the frames before.
    pub fn push(&mut self, offset: Array2<f64>) -> Result<()> {
        let Some((_, last)) = self.chosen.keyframes.last() else {
            self.chosen.keyframes.push((0, offset));
            return Ok(());
        };
        if last.dim() != offset.dim() {
            return Err(Error::argument(format!(
                "offsets of shape {:?}, expected {:?}",
                offset.shape(),
                last.shape()
            )));
        }
        match self.rule {
            KeyframeRule::Tolerance(most) => {
                let error = error_between(last, &self.since, &offset, most);
                if error > most || self.since.len() >= LONGEST {
                    // Up to the frame before, the error was small enough.
                    self.keep();
                    self.pending = 0.0;
                } else {
                    self.pending = error;
                }
                self.since.push(offset);
            }
            KeyframeRule::Every(step) => {
                self.since.push(offset);
                if self.since.len() == step {
                    self.keep();
                }
            }
        }
        Ok(())
    }

    /// The keyframes, with the last frame.
    pub fn finish(mut self) -> ChosenKeyframes {
        self.keep();
        self.chosen
    }

    /// Makes the last frame a keyframe.
    fn keep(&mut self) {
        let count = self.since.len();
        let (Some(offset), Some((last, from))) = (self.since.pop(), self.chosen.keyframes.last())
        else {
            return;
        };
        if let KeyframeRule::Every(_) = self.rule {
            self.pending = error_between(from, &self.since, &offset, f64::INFINITY);
        }
        let frame = last + count;
        self.chosen.keyframes.push((frame, offset));
        self.chosen.error = self.chosen.error.max(self.pending);
        self.since.clear();
        self.pending = 0.0;
    }
}

/// Largest error of the frames `between` two keyframes, metres; stops beyond `most`.
fn error_between(from: &Array2<f64>, between: &[Array2<f64>], to: &Array2<f64>, most: f64) -> f64 {
    let steps = between.len() as f64 + 1.0;
    let mut worst: f64 = 0.0;
    // The middle deviates most, so that it is looked at first.
    let middle = between.len() / 2;
    let order = (middle..between.len()).chain(0..middle);
    for at in order {
        let share = (at as f64 + 1.0) / steps;
        let mut largest: f64 = 0.0;
        Zip::from(between[at].rows()).and(from.rows()).and(to.rows()).for_each(|x, a, b| {
            let d = [0, 1, 2].map(|k| x[k] - a[k] - share * (b[k] - a[k]));
            largest = largest.max(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
        });
        worst = worst.max(largest.sqrt());
        if worst > most {
            return worst;
        }
    }
    worst
}

#[cfg(test)]
mod tests {
    use super::*;

    fn offset(frame: usize) -> Array2<f64> {
        let t = frame as f64 / 120.0;
        Array2::from_shape_fn((5, 3), |(v, k)| 0.05 * ((3.0 + v as f64) * t + k as f64).sin())
    }

    /// Largest distance of any frame from the interpolated keyframes.
    fn measured(chosen: &ChosenKeyframes, frames: usize) -> f64 {
        let mut worst: f64 = 0.0;
        for frame in 0..frames {
            let after = chosen.keyframes.iter().position(|(at, _)| *at >= frame).unwrap();
            let (b, to) = &chosen.keyframes[after];
            let (a, from) = &chosen.keyframes[after.saturating_sub(1)];
            let share = if a == b { 1.0 } else { (frame - a) as f64 / (b - a) as f64 };
            let error = offset(frame) - (from * (1.0 - share) + to * share);
            for row in error.rows() {
                worst = worst.max(row.dot(&row).sqrt());
            }
        }
        worst
    }

    #[test]
    fn the_error_of_every_frame_is_below_the_tolerance() {
        let frames = 600;
        let mut before = usize::MAX;
        for most in [1e-4, 1e-3, 5e-3] {
            let mut selector = KeyframeSelector::new(KeyframeRule::Tolerance(most)).unwrap();
            (0..frames).for_each(|frame| selector.push(offset(frame)).unwrap());
            let chosen = selector.finish();
            let error = measured(&chosen, frames);
            assert!(error <= most && (error - chosen.error).abs() < 1e-12, "{error} {chosen:?}");
            assert_eq!(chosen.keyframes.last().unwrap().0, frames - 1);
            assert!(chosen.keyframes.len() < before);
            before = chosen.keyframes.len();
        }
    }

    #[test]
    fn every_nth_frame_and_the_last_are_chosen() {
        let mut selector = KeyframeSelector::new(KeyframeRule::Every(4)).unwrap();
        (0..10).for_each(|frame| selector.push(offset(frame)).unwrap());
        let chosen = selector.finish();
        let frames: Vec<usize> = chosen.keyframes.iter().map(|(frame, _)| *frame).collect();
        assert_eq!(frames, [0, 4, 8, 9]);
        assert!((measured(&chosen, 10) - chosen.error).abs() < 1e-12 && chosen.error > 0.0);
        assert!(KeyframeSelector::new(KeyframeRule::Every(0)).is_err());
        assert!(KeyframeSelector::new(KeyframeRule::Tolerance(f64::NAN)).is_err());
    }

    #[test]
    fn a_single_frame_is_a_keyframe() {
        let mut selector = KeyframeSelector::new(KeyframeRule::default()).unwrap();
        selector.push(offset(0)).unwrap();
        assert!(selector.push(Array2::zeros((2, 3))).is_err());
        assert_eq!(selector.finish().keyframes.len(), 1);
    }
}
