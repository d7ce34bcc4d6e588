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
    DisplacementStatistics, HostBatch, PackedSet,
    shuffle::{Shuffle, ShufflePosition, ShuffleStream},
};
use crate::{Error, Result};

/// How training data are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LoaderOptions {
    /// Frames in a batch.
    pub batch: usize,
    /// Whether the discriminator's batches are drawn as well.
    pub discriminator: bool,
    /// Steps read ahead in the background.
    pub prefetch: usize,
}

impl Default for LoaderOptions {
    fn default() -> Self {
        Self { batch: 16, discriminator: true, prefetch: 2 }
    }
}

/// Everything needed to go on drawing where training stopped.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LoaderState {
    /// Seed of both streams.
    pub seed: u64,
    /// The generator's stream.
    pub generator: ShufflePosition,
    /// The discriminator's stream.
    pub discriminator: ShufflePosition,
}

impl LoaderState {
    /// The beginning of training.
    pub fn new(seed: u64) -> Self {
        Self { seed, ..Self::default() }
    }
}

/// The data of one training step.
#[derive(Debug, Clone, PartialEq)]
pub struct StepBatches {
    /// The generator's batch.
    pub generator: HostBatch,
    /// The discriminator's batch of real frames, if asked for.
    pub discriminator: Option<HostBatch>,
    /// Where to go on after this step.
    pub state: LoaderState,
}

/// Steps in an epoch: as many batches as it takes to see every one of `frames` frames, rounded up.
pub fn steps_per_epoch(frames: usize, batch: usize) -> usize {
    frames.div_ceil(batch.max(1)).max(1)
}

/// Draws batches for training, reading ahead in the background.
///
/// All batches are full: generator and discriminator each draw from an endless stream of
/// permutations of the training frames (see [`Shuffle`]), so the batch that ends an epoch is
/// filled from the next permutation, and a set smaller than a batch repeats. What is drawn depends
/// on the [`LoaderState`] alone.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/../cape-train/doc/sets.rs"));
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
/// // Another loader goes on where this one is.
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
    /// Draws from the given `rows` of a set (see [`DisplacementStatistics::training_rows`]), normalised.
    pub fn new(
        set: Arc<PackedSet>,
        statistics: Arc<DisplacementStatistics>,
        rows: Range<usize>,
        options: LoaderOptions,
        state: LoaderState,
    ) -> Result<Self> {
        if rows.is_empty() || rows.end > set.frames() {
            return Err(Error::Data(format!(
                "frames {}..{} of a set of {} were to be drawn: there must be at least one",
                rows.start,
                rows.end,
                set.frames()
            )));
        }
        if options.batch == 0 {
            return Err(Error::argument("batch is 0: expected at least 1"));
        }
        statistics.expect_vertices(set.vertices())?;
        let LoaderState { seed, generator, discriminator } = state;
        let frames = rows.len();
        let mut generator = Shuffle::new(seed, ShuffleStream::Generator, frames, generator);
        let mut discriminator =
            Shuffle::new(seed, ShuffleStream::Discriminator, frames, discriminator);
        let read = move |shuffle: &mut Shuffle| {
            let drawn = shuffle.draw(options.batch);
            let frames: Vec<usize> = drawn.into_iter().map(|frame| rows.start + frame).collect();
            set.batch(&frames, Some(&statistics))
        };
        let steps = Prefetch::new(options.prefetch, move || {
            let real = options.discriminator.then(|| read(&mut discriminator)).transpose();
            Some(read(&mut generator).and_then(|fitted| {
                Ok(StepBatches {
                    generator: fitted,
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

    /// The next step's data. After an error, there are no more.
    pub fn step(&mut self) -> Result<StepBatches> {
        let stopped = || Err(Error::Data("reading training data has stopped".to_owned()));
        self.steps.next().unwrap_or_else(stopped)
    }
}

/// Reads `rows` of a set in order, each once, in batches of at most `batch`, ahead in the
/// background: for validation and evaluation. The last batch may be smaller.
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

/// Items made by a background thread, which stops at `None`, at an error, or when this is dropped.
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
            .map_err(|e| Error::Data(format!("cannot start a thread to read data: {e}")))?;
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
        // Closing the channel first lets a thread that waits to send go on to its end.
        self.items = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
#[path = "loader_tests.rs"]
mod tests;
