//! Choice of the frames to encode and of the poses to decode under, where these are not those of the
//! frames to reconstruct.

use std::{collections::HashMap, ops::Range};

use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

use super::{LoaderOptions, PackedSet, shuffle::ShufflePosition};
use crate::{Error, Result};

/// First streams of the seed's random numbers that choose frames to encode, and poses.
const TRANSFER: u64 = 1 << 62;
const POSE_SWAP: u64 = 1 << 61;

/// Words of a stream for each frame.
const WORDS: u128 = 8;

/// Chooses frames by the shares of [`LoaderOptions`].
#[derive(Debug)]
pub(crate) struct Pairing {
    rows: Range<usize>,
    transfer: f64,
    pose_swap: f64,
    /// Needed for transfers.
    captures: Option<CaptureFrames>,
}

/// For each frame to reconstruct, the frame that is encoded and the one whose pose it is decoded under.
#[derive(Debug)]
pub(crate) struct Pairs {
    pub(crate) encoded: Vec<usize>,
    pub(crate) posed: Vec<usize>,
}

impl Pairing {
    /// `None` if all frames are encoded themselves and decoded under their own pose.
    ///
    /// # Errors
    /// If frames of the same capture are asked for and the set does not tell captures.
    pub(crate) fn new(
        set: &PackedSet,
        rows: Range<usize>,
        options: LoaderOptions,
    ) -> Result<Option<Self>> {
        let LoaderOptions { transfer, pose_swap, .. } = options;
        if transfer == 0.0 && pose_swap == 0.0 {
            return Ok(None);
        }
        let captures =
            if transfer > 0.0 { Some(CaptureFrames::new(set, rows.clone())?) } else { None };
        Ok(Some(Self { rows, transfer, pose_swap, captures }))
    }

    /// Pairs for frames that are drawn at a position of the shuffle. They depend on the seed and the
    /// position alone.
    pub(crate) fn draw(&self, frames: &[usize], (seed, at): (u64, ShufflePosition)) -> Pairs {
        let stream = |first: u64| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            rng.set_stream(first + at.epoch);
            rng.set_word_pos(WORDS * at.drawn as u128);
            rng
        };
        let (mut transfers, mut swaps) = (stream(TRANSFER), stream(POSE_SWAP));
        let pair = |&frame: &usize| {
            let pose = swaps.random_range(self.rows.clone());
            if swaps.random::<f64>() < self.pose_swap {
                return (frame, pose);
            }
            match &self.captures {
                Some(captures) => (captures.other(frame, self.transfer, &mut transfers), frame),
                None => (frame, frame),
            }
        };
        let (encoded, posed) = frames.iter().map(pair).unzip();
        Pairs { encoded, posed }
    }
}

/// Frames of each capture.
#[derive(Debug)]
struct CaptureFrames {
    /// Capture of each row from the first on.
    of: Vec<usize>,
    first: usize,
    rows: Vec<Vec<usize>>,
}

impl CaptureFrames {
    fn new(set: &PackedSet, rows: Range<usize>) -> Result<Self> {
        let mut names: HashMap<String, usize> = HashMap::new();
        let mut captures = Self { of: Vec::new(), first: rows.start, rows: Vec::new() };
        for row in rows {
            let name = set.capture(row).ok_or_else(|| {
                Error::Data(
                    "training frames: their captures are unknown (no train_frames.csv), which \
                     `train.transfer` needs"
                        .to_owned(),
                )
            })?;
            let next = names.len();
            let capture = *names.entry(name).or_insert(next);
            if capture == captures.rows.len() {
                captures.rows.push(Vec::new());
            }
            captures.rows[capture].push(row);
            captures.of.push(capture);
        }
        Ok(captures)
    }

    /// With probability `share` any frame of the capture, and otherwise the frame itself.
    fn other(&self, frame: usize, share: f64, rng: &mut ChaCha8Rng) -> usize {
        let rows = &self.rows[self.of[frame - self.first]];
        let chosen = rows[rng.random_range(0..rows.len())];
        if rng.random::<f64>() < share { chosen } else { frame }
    }
}
