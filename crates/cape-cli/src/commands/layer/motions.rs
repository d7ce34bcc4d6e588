//! Motions to predict clothing over, frame by frame.

use std::{
    fs::File,
    io::{self, BufRead, BufReader, Lines},
    path::Path,
};

use cape_core::npy::Npz;
use cape_layer::import_motion;
use cape_synth::poses;

use crate::{
    error::{Error, Result},
    mesh_file::has_extension,
};

/// Numbers per frame in text: a pose, optionally followed by a translation.
const POSE: usize = 72;
const WITH_TRANSLATION: usize = POSE + 3;

/// Pose in axis-angle, `[72]`, radians, and translation, metres.
pub(super) type MotionFrame = (Vec<f64>, [f64; 3]);

/// Frames of a motion with frame rate and shape, read one by one.
pub(super) struct MotionFrames {
    /// Number of frames, if known.
    pub(super) count: Option<usize>,
    /// Frames per second.
    pub(super) rate: f64,
    /// Shape coefficients of the source; empty if it has none.
    pub(super) betas: Vec<f64>,
    source: Source,
}

enum Source {
    Known(std::vec::IntoIter<MotionFrame>),
    Text { name: String, line: usize, started: bool, lines: Lines<Box<dyn BufRead>> },
}

impl MotionFrames {
    /// Opens `seconds` of a synthetic motion by name; the frames of a file (.npz with `poses` and `trans`,
    /// or any file of poses); or rows of 72 numbers, or 75 with the translation, of a .csv file or, with
    /// `-`, of standard input.
    pub(super) fn open(text: &str, seconds: f64, rate: f64) -> Result<Self> {
        if !(rate.is_finite() && rate > 0.0) {
            return Err(Error::message(format!("--fps {rate}: must be more than 0")));
        }
        let path = Path::new(text);
        if text == "-" {
            return Ok(Self::from_text(
                "standard input",
                Box::new(BufReader::new(io::stdin())),
                rate,
            ));
        }
        if has_extension(path, "csv") {
            let file = File::open(path).map_err(|error| Error::io(path, error))?;
            return Ok(Self::from_text(text, Box::new(BufReader::new(file)), rate));
        }
        if has_extension(path, "npz") {
            let archive = Npz::open(path)?;
            if archive.contains("trans") || archive.contains("transl") {
                let rate = (!archive.contains("mocap_framerate")).then_some(rate);
                let (motion, betas) = import_motion(path, rate)?;
                let poses = poses::poses(text)?;
                let frames = poses.iter().zip(motion.translations.rows());
                let frames: Vec<MotionFrame> = frames
                    .map(|((_, pose), t)| {
                        (pose.iter().map(|&x| x.into()).collect(), [t[0], t[1], t[2]])
                    })
                    .collect();
                return Ok(Self::known(frames, motion.frame_rate, betas));
            }
        }
        let poses = poses::motion_poses(text, seconds, rate)?.into_iter();
        let frames = poses.map(|pose| (pose.iter().map(|&x| f64::from(x)).collect(), [0.0; 3]));
        Ok(Self::known(frames.collect(), rate, Vec::new()))
    }

    fn known(frames: Vec<MotionFrame>, rate: f64, betas: Vec<f64>) -> Self {
        let count = Some(frames.len());
        Self { count, rate, betas, source: Source::Known(frames.into_iter()) }
    }

    fn from_text(name: &str, text: Box<dyn BufRead>, rate: f64) -> Self {
        let source =
            Source::Text { name: name.to_owned(), line: 0, started: false, lines: text.lines() };
        Self { count: None, rate, betas: Vec::new(), source }
    }
}

impl Iterator for MotionFrames {
    type Item = Result<MotionFrame>;

    fn next(&mut self) -> Option<Result<MotionFrame>> {
        match &mut self.source {
            Source::Known(frames) => frames.next().map(Ok),
            Source::Text { name, line, started, lines } => loop {
                let text = match lines.next()? {
                    Ok(text) => text,
                    Err(error) => return Some(Err(Error::io(name, error))),
                };
                *line += 1;
                if text.trim().is_empty() {
                    continue;
                }
                match frame_of(&text) {
                    Ok(frame) => {
                        *started = true;
                        return Some(Ok(frame));
                    }
                    // A header.
                    Err(RowError::NoNumbers) if !*started => *started = true,
                    Err(row) => {
                        let found = match row {
                            RowError::NoNumbers => {
                                "expected finite numbers separated by commas".to_owned()
                            }
                            RowError::Invalid(count) => format!(
                                "{count} numbers, expected {POSE} (pose) or {WITH_TRANSLATION} (pose and \
                                 translation)"
                            ),
                        };
                        return Some(Err(Error::message(format!("{name}: line {line}: {found}"))));
                    }
                }
            },
        }
    }
}

/// Error of a row.
enum RowError {
    NoNumbers,
    /// Wrong number of values.
    Invalid(usize),
}

fn frame_of(text: &str) -> Result<MotionFrame, RowError> {
    let number = |cell: &str| cell.trim().parse::<f64>().ok().filter(|x| x.is_finite());
    let numbers: Option<Vec<f64>> = text.split(',').map(number).collect();
    let mut pose = numbers.ok_or(RowError::NoNumbers)?;
    if ![POSE, WITH_TRANSLATION].contains(&pose.len()) {
        return Err(RowError::Invalid(pose.len()));
    }
    let shift = pose.split_off(POSE);
    Ok((pose, shift.try_into().unwrap_or_default()))
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
        let found = frames(&format!("p0,p1\n{}\n\n{}\n", row(72), row(75)));
        let found: Vec<MotionFrame> = found.into_iter().map(Result::unwrap).collect();
        assert_eq!((found[0].0.len(), found[0].1), (72, [0.0; 3]));
        assert_eq!((found[1].0[71], found[1].1), (71.0, [72.0, 73.0, 74.0]));
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
        assert!(said(&row(71)).contains("t: line 1: 71 numbers"));
        assert!(said(&format!("{}\nx", row(72))).contains("line 2: expected finite"));
        assert!(
            said(&format!("{}\n{}", row(72), row(72).replace("7,", "NaN,"))).contains("line 2")
        );
        assert!(said("a\nb").contains("line 2"));
    }
}
