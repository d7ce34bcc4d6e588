use std::{
    ops::Range,
    sync::{
        Arc,
        mpsc::{Receiver, sync_channel},
    },
    thread::JoinHandle,
};

use serde::{Deserialize, Serialize};

use super::{
    BatchPart, DisplacementStatistics, HostBatch, PackedSet,
    pairing::Pairing,
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
    /// Share of the generator's frames, 0 to 1, that are reconstructed under the pose of any training
    /// frame. They are encoded themselves.
    pub pose_swap: f64,
    /// Part of each batch to read: the whole in a training by one process. If the part has no rows, the
    /// first row of the batch is read in their place.
    pub part: BatchPart,
}

impl Default for LoaderOptions {
    fn default() -> Self {
        Self {
            batch: 16,
            discriminator: true,
            prefetch: 2,
            transfer: 0.0,
            pose_swap: 0.0,
            part: BatchPart::WHOLE,
        }
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

/// Batches of one training step, or their [parts](LoaderOptions::part), on the host.
#[derive(Debug, Clone, PartialEq)]
pub struct StepBatches {
    /// Frames of the generator's whole batch.
    pub drawn: Vec<usize>,
    /// Batch of the generator.
    pub generator: HostBatch,
    /// Frames to encode in place of the generator's: the same or others of their captures, under their own
    /// poses; `None` encodes the generator's.
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
/// the [`LoaderState`] alone; of a [part](LoaderOptions::part) only its rows are read.
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
        for (name, share) in [("transfer", options.transfer), ("pose_swap", options.pose_swap)] {
            if !(0.0..=1.0).contains(&share) {
                return Err(Error::argument(format!("{name}: expected 0 to 1, not {share}")));
            }
        }
        let LoaderState { seed, generator, discriminator } = state;
        let frames = rows.len();
        let pairing = Pairing::new(&set, rows.clone(), options)?;
        let mut generator = Shuffle::new(seed, ShuffleStream::Generator, frames, generator);
        let mut discriminator =
            Shuffle::new(seed, ShuffleStream::Discriminator, frames, discriminator);
        let draw = move |shuffle: &mut Shuffle| -> Vec<usize> {
            shuffle.draw(options.batch).into_iter().map(|frame| rows.start + frame).collect()
        };
        let steps = Prefetch::new(options.prefetch, move || {
            let rows = options.part.read_range(options.batch);
            let part = |frames: &[usize]| frames[rows.clone()].to_vec();
            let read = |frames: &[usize]| set.batch(&part(frames), Some(&statistics));
            let real = options.discriminator.then(|| read(&draw(&mut discriminator))).transpose();
            let at = generator.position();
            let frames = draw(&mut generator);
            let pairs = pairing.as_ref().map(|pairing| pairing.draw(&frames, (seed, at)));
            Some(read(&frames).and_then(|mut fitted| {
                let mut encoded = None;
                if let Some(pairs) = &pairs {
                    // Most often they are the same frames, which need not be read again.
                    let same = pairs.encoded == frames;
                    encoded = Some(if same { fitted.clone() } else { read(&pairs.encoded)? });
                    fitted.pose_feature = set.pose_features(&part(&pairs.posed))?;
                }
                Ok(StepBatches {
                    drawn: frames,
                    generator: fitted,
                    encoded,
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
