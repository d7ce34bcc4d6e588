//! Motions to predict clothing over, frame by frame.

use std::io::{self, BufRead, BufReader};

use cape_core::{BodyMotion, motion::MotionRows};

use crate::error::{Error, Result};

/// Numbers per frame in text: a pose, optionally followed by a translation.
const POSE: usize = 72;
const WITH_TRANSLATION: usize = POSE + 3;

/// Pose in axis-angle, `[72]`, radians, and translation, metres.
pub(super) type MotionFrame = (Vec<f64>, [f64; 3]);

/// Frames of a motion with its frame rate, read one by one.
pub(super) struct MotionFrames {
    /// Number of frames, if known.
    pub(super) count: Option<usize>,
    /// Frames per second.
    pub(super) rate: f64,
    source: Source,
}

enum Source {
    Known(std::vec::IntoIter<MotionFrame>),
    Text(MotionRows<Box<dyn BufRead>>),
}

impl MotionFrames {
    /// Rows of 72 numbers, or 75 with the translation, on standard input.
    pub(super) fn from_standard_input(rate: f64) -> Self {
        Self::from_text("standard input", Box::new(BufReader::new(io::stdin())), rate)
    }

    pub(super) fn from_motion(motion: &BodyMotion) -> Self {
        let frame = |at: usize| (motion.poses.row(at).to_vec(), motion.translation(at));
        let frames: Vec<MotionFrame> = (0..motion.frames()).map(frame).collect();
        let count = Some(frames.len());
        Self { count, rate: motion.frame_rate, source: Source::Known(frames.into_iter()) }
    }

    fn from_text(name: &str, text: Box<dyn BufRead>, rate: f64) -> Self {
        Self { count: None, rate, source: Source::Text(MotionRows::new(name, text)) }
    }
}

impl Iterator for MotionFrames {
    type Item = Result<MotionFrame>;

    fn next(&mut self) -> Option<Result<MotionFrame>> {
        match &mut self.source {
            Source::Known(frames) => frames.next().map(Ok),
            Source::Text(rows) => Some(rows.next()?.map_err(Error::from).and_then(frame_of)),
        }
    }
}

fn frame_of(mut row: Vec<f64>) -> Result<MotionFrame> {
    if ![POSE, WITH_TRANSLATION].contains(&row.len()) {
        return Err(Error::message(format!(
            "standard input: rows of {} numbers, expected {POSE} (pose) or {WITH_TRANSLATION} (pose and \
             translation)",
            row.len()
        )));
    }
    let shift = row.split_off(POSE);
    Ok((row, shift.try_into().unwrap_or_default()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frames(text: &str) -> Vec<Result<MotionFrame>> {
        MotionFrames::from_text("t", Box::new(io::Cursor::new(text.to_owned())), 30.0).collect()
    }

    fn row(count: usize) -> String {
        (0..count).map(|k| k.to_string()).collect::<Vec<_>>().join(",")
    }

    #[test]
    fn rows_are_frames() {
        let found = frames(&format!("p0,p1\n{}\n\n{}\n", row(75), row(75)));
        let found: Vec<MotionFrame> = found.into_iter().map(Result::unwrap).collect();
        assert_eq!((found.len(), found[1].0[71], found[1].1), (2, 71.0, [72.0, 73.0, 74.0]));
        assert_eq!(frames(&row(72))[0].as_ref().unwrap().1, [0.0; 3]);
    }

    #[test]
    fn other_rows_are_named() {
        let said = |text: &str| {
            frames(text)
                .into_iter()
                .find_map(Result::err)
                .map(|e| e.to_string())
                .unwrap_or_default()
        };
        assert!(said(&row(71)).contains("71 numbers"));
        assert!(said(&format!("{}\nx", row(72))).contains("line 2"));
        assert!(said(&format!("{}\n{}", row(72), row(75))).contains("line 2"));
        assert!(
            said(&format!("{}\n{}", row(72), row(72).replace("7,", "NaN,"))).contains("line 2")
        );
        assert!(said("a\nb").contains("line 2"));
    }
}
