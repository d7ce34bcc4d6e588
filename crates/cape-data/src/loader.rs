use std::{
    collections::HashMap,
    ops::Range,
    sync::{
        Arc,
        mpsc::{Receiver, sync_channel},
    },
    thread::JoinHandle,
};

use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use serde::{Deserialize, Serialize};

use super::{
    DisplacementStatistics, HostBatch, PackedSet,
    shuffle::{Shuffle, ShufflePosition, ShuffleStream},
};
use crate::{Error, Result};

/// Options of a [`Loader`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoaderOptions {
    /// Frames per batch.
    pub batch: usize,
    /// Draw batches for the discriminator too.
    pub discriminator: bool,
    /// Number of steps read ahead in the background.
    pub prefetch: usize,
    /// Share of the generator's frames, 0 to 1, for which another frame of the same capture is encoded.
    pub transfer: f64,
}

impl Default for LoaderOptions {
    fn default() -> Self {
        Self { batch: 16, discriminator: true, prefetch: 2, transfer: 0.0 }
    }
}

/// State of a [`Loader`], from which drawing resumes exactly.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LoaderState {
    /// Seed of both shuffles.
    pub seed: u64,
    /// Position of the generator's shuffle.
    pub generator: ShufflePosition,
    /// Position of the discriminator's shuffle.
    pub discriminator: ShufflePosition,
}

impl LoaderState {
    /// The state at the start of training.
    pub fn new(seed: u64) -> Self {
        Self { seed, ..Self::default() }
    }
}

/// Batches of one training step, on the host.
#[derive(Debug, Clone, PartialEq)]
pub struct StepBatches {
    /// Batch of the generator.
    pub generator: HostBatch,
    /// Frames to encode in place of the generator's, of the same captures; `None` encodes those
    /// themselves.
    pub encoded: Option<HostBatch>,
    /// Batch of real frames of the discriminator; `None` without [`LoaderOptions::discriminator`].
    pub discriminator: Option<HostBatch>,
    /// State of the loader after this step.
    pub state: LoaderState,
}

/// Steps of an epoch: the number of batches that cover `frames` frames, rounded up.
pub fn steps_per_epoch(frames: usize, batch: usize) -> usize {
    frames.div_ceil(batch.max(1)).max(1)
}

/// Source of training batches that reads ahead in the background.
///
/// All batches are full: generator and discriminator each draw from an endless stream of
/// permutations of the training frames (see [`Shuffle`]), so that the last batch of an epoch is
/// filled from the next permutation, and a set smaller than a batch repeats. The batches depend on
/// the [`LoaderState`] alone.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use std::sync::Arc;
///
/// use cape_data::{Loader, LoaderOptions, LoaderState, PackedSet, Split, DisplacementStatistics};
///
/// let directory = triangles()?;
/// let packed = directory.path().join("packed");
/// let set = Arc::new(PackedSet::open(&packed, Split::Train)?);
/// let statistics = Arc::new(DisplacementStatistics::from_packed(&packed, &mut cape_core::silent)?);
/// let rows = statistics.training_rows(set.frames());
/// let options = LoaderOptions { batch: 2, ..LoaderOptions::default() };
/// let load = |state| Loader::new(set.clone(), statistics.clone(), rows.clone(), options, state);
///
/// let mut loader = load(LoaderState::new(1))?;
/// let first = loader.step()?;
/// assert_eq!(first.generator.displacement.dim(), (2, 3, 3));
/// // Another loader resumes from the state after the first step.
/// let second = loader.step()?;
/// assert_eq!(load(first.state)?.step()?, second);
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct Loader {
    steps: Prefetch<StepBatches>,
}

impl Loader {
    /// Creates a loader of normalised batches from the given `rows` of a set (see
    /// [`DisplacementStatistics::training_rows`]).
    pub fn new(
        set: Arc<PackedSet>,
        statistics: Arc<DisplacementStatistics>,
        rows: Range<usize>,
        options: LoaderOptions,
        state: LoaderState,
    ) -> Result<Self> {
        if rows.is_empty() || rows.end > set.frames() {
            return Err(Error::Data(format!(
                "rows {}..{} of a set of {} frames: expected at least one row within the set",
                rows.start,
                rows.end,
                set.frames()
            )));
        }
        if options.batch == 0 {
            return Err(Error::argument("batch: expected at least 1, not 0"));
        }
        statistics.expect_vertices(set.vertices())?;
        if !(0.0..=1.0).contains(&options.transfer) {
            let message = format!("transfer: expected 0 to 1, not {}", options.transfer);
            return Err(Error::argument(message));
        }
        let LoaderState { seed, generator, discriminator } = state;
        let frames = rows.len();
        let captures = if options.transfer > 0.0 {
            Some(CaptureFrames::new(&set, rows.clone())?)
        } else {
            None
        };
        let mut generator = Shuffle::new(seed, ShuffleStream::Generator, frames, generator);
        let mut discriminator =
            Shuffle::new(seed, ShuffleStream::Discriminator, frames, discriminator);
        let draw = move |shuffle: &mut Shuffle| -> Vec<usize> {
            shuffle.draw(options.batch).into_iter().map(|frame| rows.start + frame).collect()
        };
        let read = move |frames: &[usize]| set.batch(frames, Some(&statistics));
        let steps = Prefetch::new(options.prefetch, move || {
            let real = options.discriminator.then(|| read(&draw(&mut discriminator))).transpose();
            let at = generator.position();
            let frames = draw(&mut generator);
            let encoded = captures
                .as_ref()
                .map(|captures| read(&captures.others(&frames, options.transfer, (seed, at))));
            Some(read(&frames).and_then(|fitted| {
                Ok(StepBatches {
                    generator: fitted,
                    encoded: encoded.transpose()?,
                    discriminator: real?,
                    state: LoaderState {
                        seed,
                        generator: generator.position(),
                        discriminator: discriminator.position(),
                    },
                })
            }))
        })?;
        Ok(Self { steps })
    }

    /// Batches of the next step. After an error, there are no more.
    pub fn step(&mut self) -> Result<StepBatches> {
        let stopped =
            || Err(Error::Data("training data: reading stopped after an error".to_owned()));
        self.steps.next().unwrap_or_else(stopped)
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

    /// For a `share` of the frames another one of its capture, for the others the frame itself. They
    /// depend on the seed and the position of the shuffle alone.
    fn others(
        &self,
        frames: &[usize],
        share: f64,
        (seed, at): (u64, ShufflePosition),
    ) -> Vec<usize> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(TRANSFER + at.epoch);
        // Eight words for each frame that was drawn before.
        rng.set_word_pos(8 * at.drawn as u128);
        let other = |&frame: &usize| {
            let rows = &self.rows[self.of[frame - self.first]];
            let chosen = rows[rng.random_range(0..rows.len())];
            if rng.random::<f64>() < share { chosen } else { frame }
        };
        frames.iter().map(other).collect()
    }
}

/// First stream of the seed's random numbers that choose frames to encode.
const TRANSFER: u64 = 1 << 62;

/// Batches of the `rows` of a set in order, each once, for validation and evaluation; read ahead in
/// the background. The last batch can be smaller than `batch`.
pub fn sequential(
    set: Arc<PackedSet>,
    statistics: Option<Arc<DisplacementStatistics>>,
    rows: Range<usize>,
    batch: usize,
) -> Result<impl Iterator<Item = Result<HostBatch>>> {
    let rows = rows.start..rows.end.min(set.frames());
    let mut next = rows.start;
    Prefetch::new(2, move || {
        let frames: Vec<usize> = (next..rows.end).take(batch.max(1)).collect();
        next += frames.len();
        (!frames.is_empty()).then(|| set.batch(&frames, statistics.as_deref()))
    })
}

/// Iterator over items of a background thread, which stops at `None`, at an error, or when the
/// iterator is dropped.
#[derive(Debug)]
struct Prefetch<T> {
    items: Option<Receiver<Result<T>>>,
    thread: Option<JoinHandle<()>>,
}

impl<T: Send + 'static> Prefetch<T> {
    fn new(
        ahead: usize,
        mut make: impl FnMut() -> Option<Result<T>> + Send + 'static,
    ) -> Result<Self> {
        let (sender, items) = sync_channel(ahead.max(1));
        let thread = std::thread::Builder::new()
            .name("cape-loader".to_owned())
            .spawn(move || {
                while let Some(item) = make() {
                    let last = item.is_err();
                    if sender.send(item).is_err() || last {
                        break;
                    }
                }
            })
            .map_err(|e| {
                Error::Data(format!("cannot start the thread that reads training data: {e}"))
            })?;
        Ok(Self { items: Some(items), thread: Some(thread) })
    }
}

impl<T> Iterator for Prefetch<T> {
    type Item = Result<T>;

    fn next(&mut self) -> Option<Self::Item> {
        self.items.as_ref()?.recv().ok()
    }
}

impl<T> Drop for Prefetch<T> {
    fn drop(&mut self) {
        // Closing the channel first ends a thread that waits to send.
        self.items = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
#[path = "loader_tests.rs"]
mod tests;
