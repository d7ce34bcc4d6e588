//! Training (CAPE §4.2 and appendix A.2), resumable at any step.

mod event;
mod resume;
mod step;

use std::{
    ops::ControlFlow,
    path::{Path, PathBuf},
    sync::Arc,
    time::{Duration, Instant},
};

use burn::tensor::Device;
use cape_core::{DirectoryLock, SmplModel, smpl::ClothingMask};
use cape_model::Cape;

pub use event::{TrainEvent, TrainOutcome};

use crate::{
    Result,
    collective::{Collective, SingleProcess, agree, in_first, require_same_weights},
    create::create,
    learner::Learner,
    log::TrainLog,
    validate::{PreviewFn, ValidationResult, Validator},
};
use cape_data::{
    BatchPart, DisplacementStatistics, Loader, LoaderOptions, LoaderState, PackedSet, Split,
    steps_per_epoch,
};
use cape_infer::{
    MIXTURE, Run, RunConfig, RunPaths, build_graphs,
    checkpoint::{self, DamagedCheckpoint, TrainState},
    prior::{Prior, PriorOptions},
};

/// Steps between comparisons of the weights of all processes, beside those at checkpoints.
const COMPARED: u64 = 100;

/// Data set, body and configuration of a new run.
///
/// ```
/// use cape_infer::RunConfig;
/// use cape_train::TrainerOptions;
///
/// let options = TrainerOptions {
///     clothing: Some("clothing_verts_idx.npy".into()),
///     ..TrainerOptions::new("packed", RunConfig::default())
/// };
/// assert!(options.body.is_none());
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct TrainerOptions {
    /// Directory of the packed set.
    pub data: PathBuf,
    /// Body of the data; `None` uses the `body.npz` of the packed set.
    pub body: Option<SmplModel>,
    /// File of the indices of clothing vertices; `None` uses those of the packed set, or derives
    /// them from the body's blend weights.
    pub clothing: Option<PathBuf>,
    /// Configuration of the run.
    pub config: RunConfig,
}

impl TrainerOptions {
    /// Options for a packed set with its own body and clothing vertices.
    pub fn new(data: impl Into<PathBuf>, config: RunConfig) -> Self {
        Self { data: data.into(), body: None, clothing: None, config }
    }
}

/// State before the first step.
fn beginning(seed: u64) -> TrainState {
    TrainState {
        step: 0,
        loader: LoaderState::new(seed),
        seconds: 0.0,
        accuracy_sum: (0.0, 0),
        validation: None,
        best: None,
    }
}

/// A run in training.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use std::ops::ControlFlow;
///
/// use burn::tensor::Device;
/// use cape_train::{Preview, TensorBoardImage, TrainEvent, Trainer, TrainerOptions};
///
/// // A packed set of four training frames; one epoch in batches of two.
/// let directory = captures()?;
/// let [packed, run] = ["packed", "run"].map(|name| directory.path().join(name));
/// let device = Device::default();
/// let options = TrainerOptions::new(&packed, small_config());
/// let mut trainer = Trainer::create(&run, options, &device)?;
/// let outcome = trainer.run(&mut |event| match event {
///     TrainEvent::Step { losses, .. } if losses.non_finite().is_none() => ControlFlow::Break(()),
///     _ => ControlFlow::Continue(()),
/// })?;
/// assert_eq!((outcome.finished, outcome.steps), (false, 1));
///
/// // Resumed later, with images for TensorBoard.
/// drop(trainer);
/// let mut trainer = Trainer::resume(&run, None, &device)?;
/// trainer.set_preview_fn(Box::new(|previews: &[Preview]| {
///     let draw = |preview: &Preview| TensorBoardImage {
///         tag: preview.outfit.to_string(),
///         width: 1,
///         height: 1,
///         png: Vec::new(),
///     };
///     previews.iter().map(draw).collect()
/// }));
/// let outcome = trainer.run(&mut |_| ControlFlow::Continue(()))?;
/// assert_eq!((outcome.finished, outcome.epochs), (true, 1));
/// assert!(outcome.best_validation.is_some());
/// # Ok(())
/// # }
/// ```
pub struct Trainer {
    paths: RunPaths,
    config: RunConfig,
    set: Arc<PackedSet>,
    statistics: Arc<DisplacementStatistics>,
    clothing: Vec<usize>,
    learner: Learner,
    preview_fn: Option<PreviewFn>,
    checkpoint_interval: Option<Duration>,
    progress: TrainState,
    device: Device,
    damaged: Vec<DamagedCheckpoint>,
    processes: Arc<dyn Collective>,
    /// True if `report` broke in this process, of which the others hear in the next step.
    stop_asked: bool,
    /// The lock of the directory, in the process that writes to it.
    _lock: Option<DirectoryLock>,
}

impl Trainer {
    /// Creates a run in the empty or new directory `root`, or in one where a process was killed while it
    /// created a run. No other process can train the run while the trainer lives.
    ///
    /// # Errors
    /// If the directory is not empty, the configuration is invalid, or data set and body do not
    /// match.
    pub fn create(
        root: impl AsRef<Path>,
        options: TrainerOptions,
        device: &Device,
    ) -> Result<Self> {
        Self::create_together(root, options, device, Arc::new(SingleProcess))
    }

    /// Creates a run that several processes train, as [`create`](Self::create) does: process 0 writes the
    /// directory, which the others read. All of them call this with the same arguments but the device.
    ///
    /// # Errors
    /// In all processes if one has an error.
    pub fn create_together(
        root: impl AsRef<Path>,
        options: TrainerOptions,
        device: &Device,
        processes: Arc<dyn Collective>,
    ) -> Result<Self> {
        let root = root.as_ref();
        let created = in_first(&*processes, || create(root, &options))?;
        let trainer = || {
            let (paths, config, lock) = if let Some((paths, config, lock)) = created {
                (paths, config, Some(lock))
            } else {
                let paths = RunPaths::new(root);
                let config = RunConfig::load(&paths.config())?;
                (paths, config, None)
            };
            let progress = beginning(config.train.seed);
            let place = (paths, lock, processes.clone());
            Self::assemble(place, &options.data, config, progress, device)
        };
        agree(&*processes, trainer())
    }

    fn assemble(
        (paths, lock, processes): (RunPaths, Option<DirectoryLock>, Arc<dyn Collective>),
        data: &Path,
        config: RunConfig,
        progress: TrainState,
        device: &Device,
    ) -> Result<Self> {
        let set = PackedSet::open(data, Split::Train)?;
        let mut set = set.with_vocabulary(&config.model.outfits)?;
        if config.train.preload {
            set.preload(&mut cape_core::silent)?;
        }
        let statistics = DisplacementStatistics::load(paths.statistics())?;
        let body = SmplModel::load(paths.body())?;
        let mask = ClothingMask::load(paths.clothing(), body.vertices())?;
        let device = device.clone().autodiff();
        let graphs = build_graphs(&config, &body, &device)?;
        let clothing: Vec<usize> = mask.indices().collect();
        let learner = Learner::for_data(&config, graphs, &statistics, &clothing, &device)?;
        Ok(Self {
            set: Arc::new(set),
            statistics: Arc::new(statistics),
            clothing,
            learner,
            preview_fn: None,
            checkpoint_interval: None,
            paths,
            config,
            progress,
            device,
            damaged: Vec::new(),
            processes,
            stop_asked: false,
            _lock: lock,
        })
    }

    /// Configuration of the run.
    pub fn config(&self) -> &RunConfig {
        &self.config
    }

    /// Number of steps of an epoch.
    pub fn steps_per_epoch(&self) -> usize {
        steps_per_epoch(self.training_rows().len(), self.config.train.batch)
    }

    /// Number of steps so far.
    pub fn step(&self) -> u64 {
        self.progress.step
    }

    /// The model with its current weights.
    pub fn model(&self) -> &Cape {
        self.learner.model()
    }

    /// Sets the function that renders a few validation frames after every epoch for TensorBoard.
    pub fn set_preview_fn(&mut self, preview_fn: PreviewFn) {
        self.preview_fn = Some(preview_fn);
    }

    /// Sets the time after which a checkpoint is saved within an epoch; by default there is none but by
    /// [`checkpoint_steps`](cape_infer::TrainConfig::checkpoint_steps).
    pub fn set_checkpoint_interval(&mut self, interval: Option<Duration>) {
        self.checkpoint_interval = interval;
    }

    /// Paths of the run's files.
    pub fn paths(&self) -> &RunPaths {
        &self.paths
    }

    /// Damaged checkpoints that [`resume`](Self::resume) passed over.
    pub fn damaged_checkpoints(&self) -> &[DamagedCheckpoint] {
        &self.damaged
    }

    /// The part of every batch that this process works on.
    fn part(&self) -> BatchPart {
        BatchPart { index: self.processes.rank(), count: self.processes.size() }
    }

    fn training_rows(&self) -> std::ops::Range<usize> {
        self.statistics.training_rows(self.set.frames())
    }

    /// Trains until all epochs are done or `report` breaks; in both cases the state is saved. After the
    /// last epoch of a variational model a mixture of normal distributions is fitted to the codes of
    /// the training frames, from which samples are drawn.
    ///
    /// If there are several processes, each reports its steps, and the first one also validation,
    /// checkpoints and the prior, for which the others wait. A break in one process stops all after the
    /// next step.
    ///
    /// # Errors
    /// If a file cannot be read or written, or a loss or gradient is not finite. In the latter case
    /// the update is not applied, the error names the step and its frames, and the last checkpoint
    /// is kept. An error other than [`Error::Processes`](crate::Error::Processes) may have occurred in
    /// this process alone: the others wait until it [ends](Collective::abort) them.
    pub fn run(
        &mut self,
        report: &mut dyn FnMut(&TrainEvent) -> ControlFlow<()>,
    ) -> Result<TrainOutcome> {
        let processes = self.processes.clone();
        let first = processes.rank() == 0;
        self.stop_asked = false;
        let steps = self.steps_per_epoch();
        let last = (self.config.train.epochs * steps) as u64;
        let options = LoaderOptions {
            batch: self.config.train.batch,
            discriminator: self.config.model.discriminator.is_some(),
            transfer: self.config.train.transfer,
            pose_swap: self.config.train.pose_swap,
            part: self.part(),
            ..LoaderOptions::default()
        };
        let mut log = in_first(&*processes, || TrainLog::open(&self.paths))?;
        require_same_weights(&*processes, self.learner.model(), self.progress.step)?;
        if self.progress.step < last {
            let mut loader = Loader::new(
                self.set.clone(),
                self.statistics.clone(),
                self.training_rows(),
                options,
                self.progress.loader,
            )?;
            let mut saved = Instant::now();
            while self.progress.step < last {
                let stop = self.one_step(&mut loader, log.as_mut(), steps, report)?;
                let step = self.progress.step;
                let epoch_ends = step.is_multiple_of(steps as u64);
                let often = self.config.train.checkpoint_steps as u64;
                let shared = stop || epoch_ends || often > 0 && step.is_multiple_of(often);
                if shared || step.is_multiple_of(COMPARED) {
                    require_same_weights(&*processes, self.learner.model(), step)?;
                }
                let due = self.checkpoint_interval.is_some_and(|most| saved.elapsed() >= most);
                if shared {
                    let epoch = epoch_ends.then_some((step / steps as u64) as usize);
                    in_first(&*processes, || self.record(epoch, log.as_mut(), report))?;
                    if epoch_ends {
                        self.hear_of_validation()?;
                    }
                } else if due && first {
                    self.record(None, log.as_mut(), report)?;
                }
                if shared || due {
                    saved = Instant::now();
                }
                if stop {
                    break;
                }
            }
        }
        let finished = self.progress.step >= last;
        if finished && self.config.model.variational {
            in_first(&*processes, || self.fit_prior(report))?;
        }
        Ok(TrainOutcome {
            finished,
            epochs: (self.progress.step / steps as u64) as usize,
            steps: self.progress.step,
            best_validation: self.progress.best.map(|(error, _)| error),
            seconds: self.progress.seconds,
        })
    }

    /// Validates at the end of an `epoch`, saves a checkpoint, and writes the log to disk.
    fn record(
        &mut self,
        epoch: Option<usize>,
        log: Option<&mut TrainLog>,
        report: &mut dyn FnMut(&TrainEvent) -> ControlFlow<()>,
    ) -> Result<()> {
        let Some(log) = log else { return Ok(()) };
        let found = match epoch {
            Some(epoch) => self.validate(epoch, log, report)?,
            None => None,
        };
        let path = self.save()?;
        if let Some(found) = found {
            self.show(&found, log)?;
        }
        log.flush()?;
        // Training stops by the break of a step alone; a break here is ignored.
        let _ = report(&TrainEvent::Checkpoint { path });
        Ok(())
    }

    /// Takes over the validation of the first process, so that all know the best checkpoint.
    fn hear_of_validation(&mut self) -> Result<()> {
        self.progress.accuracy_sum = (0.0, 0);
        // A validation error is not negative.
        let mut bytes = self.progress.validation.unwrap_or(-1.0).to_le_bytes();
        self.processes.broadcast(&mut bytes)?;
        let millimetres = f64::from_le_bytes(bytes);
        if self.processes.rank() != 0 && millimetres >= 0.0 {
            self.note_validation(millimetres);
        }
        Ok(())
    }

    fn note_validation(&mut self, millimetres: f64) {
        self.progress.validation = Some(millimetres);
        if self.progress.best.is_none_or(|(best, _)| millimetres < best) {
            self.progress.best = Some((millimetres, self.progress.step));
        }
    }

    /// Fits the mixture of latent codes at the checkpoint that the run is used with, unless it is there.
    fn fit_prior(&self, report: &mut dyn FnMut(&TrainEvent) -> ControlFlow<()>) -> Result<()> {
        let run = Run::open(self.paths.root(), &self.device)?;
        let path = self.paths.prior(MIXTURE);
        if path.exists() && Prior::load(&path)?.step() == Some(run.progress().step) {
            return Ok(());
        }
        let options = PriorOptions { seed: self.config.train.seed, ..PriorOptions::default() };
        let prior = Prior::of_run(&run, &self.set, &options, &mut |done, total| {
            // Training is over; there is nothing to break.
            let _ = report(&TrainEvent::Prior { done, total });
        })?;
        prior.save(&path)
    }

    /// Reconstructs the validation frames from the mean of the posterior, and logs the epoch.
    fn validate(
        &mut self,
        epoch: usize,
        log: &mut TrainLog,
        report: &mut dyn FnMut(&TrainEvent) -> ControlFlow<()>,
    ) -> Result<Option<ValidationResult>> {
        let (sum, count) = std::mem::take(&mut self.progress.accuracy_sum);
        let adversarial = self.config.model.discriminator.is_some() && count > 0;
        let discriminator_accuracy = adversarial.then(|| f64::from(sum) / count as f64);
        let step = self.progress.step;
        let generator = self.learner.valid_generator();
        let validator = Validator {
            generator: &generator,
            graphs: self.learner.graphs(),
            loss: &self.config.loss,
            loss_weights: self.learner.loss_weights(),
            set: &self.set,
            statistics: &self.statistics,
            clothing: &self.clothing,
            batch: self.config.train.batch,
            device: self.device.clone().inner(),
        };
        let Some(found) = validator.run()? else { return Ok(None) };
        let millimetres = found.errors.mean;
        self.note_validation(millimetres);
        log.validation(step, epoch, &found, discriminator_accuracy)?;
        // A break between epochs takes effect at the next step.
        let _ = report(&TrainEvent::Validation {
            epoch,
            losses: found.losses,
            millimetres,
            active_units: found.active_units,
            discriminator_accuracy,
        });
        Ok(Some(found))
    }

    /// Logs histograms and images. They are large, and follow the checkpoint in case the disk is
    /// full.
    fn show(&mut self, found: &ValidationResult, log: &mut TrainLog) -> Result<()> {
        let step = self.progress.step;
        log.histograms(step, self.learner.model(), found)?;
        if let Some(preview_fn) = &mut self.preview_fn {
            for picture in preview_fn(&found.previews) {
                log.picture(step, &picture)?;
            }
        }
        Ok(())
    }

    fn save(&self) -> Result<PathBuf> {
        let checkpoint = self.learner.checkpoint(self.progress.clone());
        let directory = self.paths.checkpoints();
        let path = checkpoint.save(&directory)?;
        let best = self.progress.best.map(|(_, step)| step);
        let often = self.config.train.checkpoint_steps as u64;
        let steps = self.steps_per_epoch() as u64;
        let regular =
            |step: u64| step.is_multiple_of(steps) || often > 0 && step.is_multiple_of(often);
        checkpoint::prune(&directory, self.config.train.keep, best, regular)?;
        Ok(path)
    }
}
