//! Training (CAPE §4.2 and appendix A.2), resumable at any step.

mod event;
mod resume;

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
    Error, Result,
    create::create,
    learner::{Learner, NonFinite, UpdateOptions},
    log::TrainLog,
    objective::StepInput,
    validate::{PreviewFn, ValidationResult, Validator},
};
use cape_core::tensors::from_array2;
use cape_data::{
    DisplacementStatistics, Loader, LoaderOptions, LoaderState, PackedSet, Split, StepBatches,
    steps_per_epoch,
};
use cape_infer::{
    MIXTURE, Run, RunConfig, RunPaths, build_graphs,
    checkpoint::{self, DamagedCheckpoint, TrainState},
    normal,
    prior::{Prior, PriorOptions},
    to_device,
};

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
    _lock: DirectoryLock,
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
        let (paths, config, lock) = create(root.as_ref(), &options)?;
        let progress = beginning(config.train.seed);
        Self::assemble((paths, lock), &options.data, config, progress, device)
    }

    fn assemble(
        (paths, lock): (RunPaths, DirectoryLock),
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

    fn training_rows(&self) -> std::ops::Range<usize> {
        self.statistics.training_rows(self.set.frames())
    }

    /// Trains until all epochs are done or `report` breaks; in both cases the state is saved. After the
    /// last epoch of a variational model a mixture of normal distributions is fitted to the codes of
    /// the training frames, from which samples are drawn.
    ///
    /// # Errors
    /// If a file cannot be read or written, or a loss or gradient is not finite. In the latter case
    /// the update is not applied, the error names the step and its frames, and the last checkpoint
    /// is kept.
    pub fn run(
        &mut self,
        report: &mut dyn FnMut(&TrainEvent) -> ControlFlow<()>,
    ) -> Result<TrainOutcome> {
        let steps = self.steps_per_epoch();
        let last = (self.config.train.epochs * steps) as u64;
        let options = LoaderOptions {
            batch: self.config.train.batch,
            discriminator: self.config.model.discriminator.is_some(),
            transfer: self.config.train.transfer,
            pose_swap: self.config.train.pose_swap,
            ..LoaderOptions::default()
        };
        let mut log = TrainLog::open(&self.paths)?;
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
                let stop = self.one_step(&mut loader, &mut log, steps, report)?;
                let step = self.progress.step;
                let epoch_ends = step.is_multiple_of(steps as u64);
                let found = if epoch_ends {
                    self.validate((step / steps as u64) as usize, &mut log, report)?
                } else {
                    None
                };
                let often = self.config.train.checkpoint_steps as u64;
                let due = self.checkpoint_interval.is_some_and(|most| saved.elapsed() >= most);
                if stop || epoch_ends || due || (often > 0 && step.is_multiple_of(often)) {
                    let path = self.save()?;
                    saved = Instant::now();
                    if let Some(found) = found {
                        self.show(&found, &mut log)?;
                    }
                    log.flush()?;
                    // Training stops by `stop` alone; a break here is ignored.
                    let _ = report(&TrainEvent::Checkpoint { path });
                }
                if stop {
                    break;
                }
            }
        }
        let finished = self.progress.step >= last;
        if finished && self.config.model.variational {
            self.fit_prior(report)?;
        }
        Ok(TrainOutcome {
            finished,
            epochs: (self.progress.step / steps as u64) as usize,
            steps: self.progress.step,
            best_validation: self.progress.best.map(|(error, _)| error),
            seconds: self.progress.seconds,
        })
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

    /// One update of generator and discriminator; true if `report` breaks.
    fn one_step(
        &mut self,
        loader: &mut Loader,
        log: &mut TrainLog,
        steps: usize,
        report: &mut dyn FnMut(&TrainEvent) -> ControlFlow<()>,
    ) -> Result<bool> {
        let start = Instant::now();
        let step = self.progress.step;
        let train = &self.config.train;
        let rate = train.rate(step, steps);
        let StepBatches { generator, encoded, discriminator, state } = loader.step()?;
        let frames = generator.frames.clone();
        let epsilon = self.config.model.variational.then(|| {
            let latent = self.config.model.latent;
            // Shuffles use the first streams of the seed; noise has one per step beyond them.
            normal(train.seed, (1 << 32) + step, frames.len(), latent)
        });
        let input = StepInput {
            frames: to_device(generator, &self.device),
            encoded: encoded.map(|batch| to_device(batch, &self.device)),
            epsilon: epsilon.map(|epsilon| from_array2(epsilon, &self.device)),
            real: discriminator.map(|batch| to_device(batch, &self.device)),
        };
        let logged = (step + 1).is_multiple_of(train.log_steps as u64);
        let options =
            UpdateOptions { rate, kl_share: train.kl_share(step, steps), detailed: logged };
        let update = match self.learner.update(&input, options) {
            Ok(update) => update,
            Err(error) => return Err(self.not_finite(error, &frames)?),
        };
        let losses = update.losses;
        self.progress.accuracy_sum.0 += losses.discriminator_accuracy as f32;
        self.progress.accuracy_sum.1 += 1;
        self.progress.step += 1;
        self.progress.loader = state;

        let seconds = start.elapsed().as_secs_f64();
        self.progress.seconds += seconds;
        let (epoch, step) =
            ((step / steps as u64) as usize + 1, (step % steps as u64) as usize + 1);
        if logged {
            log.step(self.progress.step, epoch, &update, rate, seconds)?;
        }
        let total_step = self.progress.step;
        let event = TrainEvent::Step { epoch, step, steps, total_step, losses, rate, seconds };
        Ok(report(&event).is_break())
    }

    /// The error of a step with a loss or gradient that is not finite.
    fn not_finite(&self, error: NonFinite, frames: &[usize]) -> Result<Error> {
        let kept = checkpoint::list(&self.paths.checkpoints())?.pop();
        let kept = kept.map_or_else(
            || "there is no checkpoint yet".to_owned(),
            |(_, path)| format!("the last checkpoint is {}", path.display()),
        );
        Ok(Error::data(format!(
            "{error} at step {} (training frames {frames:?}); {kept}; a lower train.peak_rate may \
             help",
            self.progress.step + 1,
        )))
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
        self.progress.validation = Some(millimetres);
        if self.progress.best.is_none_or(|(best, _)| millimetres < best) {
            self.progress.best = Some((millimetres, step));
        }
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
