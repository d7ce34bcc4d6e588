//! Training (CAPE §4.3 and appendix A), resumable at any step.

use std::{
    fs,
    io::Write,
    ops::ControlFlow,
    path::{Path, PathBuf},
    sync::Arc,
    time::Instant,
};

use burn::tensor::Device;
use cape_core::{SmplModel, smpl::ClothingMask};
use cape_model::Cape;
use serde::Serialize;

use crate::{
    Error, Result,
    create::create,
    learner::{Learner, UpdateOptions},
    log::TrainLog,
    objective::{Losses, StepInput},
    validate::{PreviewFn, ValidationResult, Validator},
};
use cape_core::tensors::from_array2;
use cape_data::{
    DisplacementStatistics, Loader, LoaderOptions, LoaderState, PackedSet, Split, StepBatches,
    steps_per_epoch,
};
use cape_infer::{
    RunConfig, RunPaths, build_graphs,
    checkpoint::{self, Checkpoint, TrainState},
    normal, read_identity, to_device,
};

/// What training reports as it goes.
///
/// See [`Trainer`] for an example.
#[derive(Debug, Clone)]
pub enum TrainEvent {
    /// A step was done.
    Step {
        /// Epoch, from 1.
        epoch: usize,
        /// Step within the epoch, from 1.
        step: usize,
        /// Steps in an epoch.
        steps: usize,
        /// Steps since the run began.
        total_step: u64,
        /// Losses before the step's update.
        losses: Losses,
        /// The generator's learning rate.
        rate: f64,
        /// Seconds the step took.
        seconds: f64,
    },
    /// The validation frames were reconstructed.
    Validation {
        /// Epoch, from 1.
        epoch: usize,
        /// Reconstruction, edge and KL terms; the others are zero.
        losses: Losses,
        /// Mean error at clothing vertices, millimetres.
        millimetres: f64,
        /// Numbers of the code that carry something: whose posterior mean varies over the frames.
        active_units: usize,
        /// The share of patches that the discriminator judged rightly over the epoch's steps.
        discriminator_accuracy: Option<f64>,
    },
    /// A checkpoint was written.
    Checkpoint {
        /// Its directory.
        path: PathBuf,
    },
}

/// How training ended.
///
/// See [`Trainer`] for an example.
#[derive(Debug, Clone, Serialize)]
pub struct TrainOutcome {
    /// Whether every epoch was done; otherwise the run can be resumed.
    pub finished: bool,
    /// Whole epochs done.
    pub epochs: usize,
    /// Steps done.
    pub steps: u64,
    /// The lowest validation error, millimetres.
    pub best_validation: Option<f64>,
    /// Seconds spent training, all sessions together.
    pub seconds: f64,
}

/// A run being trained.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use std::ops::ControlFlow;
///
/// use burn::tensor::Device;
/// use cape_train::{TrainEvent, TensorBoardImage, Preview, Trainer};
///
/// // A packed set of four training frames, and an epoch in batches of two.
/// let directory = captures()?;
/// let [packed, run] = ["packed", "run"].map(|name| directory.path().join(name));
/// let device = Device::default();
/// let mut trainer = Trainer::create(&run, &packed, None, None, small_config(), &device)?;
/// let outcome = trainer.run(&mut |event| match event {
///     TrainEvent::Step { losses, .. } if losses.non_finite().is_none() => ControlFlow::Break(()),
///     _ => ControlFlow::Continue(()),
/// })?;
/// assert_eq!((outcome.finished, outcome.steps), (false, 1));
///
/// // Another day, with pictures for TensorBoard.
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
    progress: TrainState,
    device: Device,
}

impl Trainer {
    /// Starts a run in the empty or new directory `root`.
    ///
    /// `body` is SMPL's file for packed sets without one of their own; `clothing` the indices of
    /// clothing vertices, derived from the body's blend weights where neither is given.
    pub fn create(
        root: &Path,
        data: &Path,
        body: Option<&Path>,
        clothing: Option<&Path>,
        config: RunConfig,
        device: &Device,
    ) -> Result<Self> {
        let paths = create(root, data, body, clothing, &config)?;
        let progress = TrainState {
            step: 0,
            loader: LoaderState::new(config.train.seed),
            seconds: 0.0,
            accuracy_sum: (0.0, 0),
            validation: None,
            best: None,
        };
        Self::assemble(paths, data, config, progress, device)
    }

    /// Goes on with the run in `root` from its newest checkpoint; `data` is where its packed set is
    /// now, if it was moved.
    pub fn resume(root: &Path, data: Option<&Path>, device: &Device) -> Result<Self> {
        let paths = RunPaths::new(root);
        let config = RunConfig::load(&paths.config())?;
        // An imported run does not know the data it was trained on.
        let identity =
            if paths.data().exists() { Some(read_identity(&paths.data())?) } else { None };
        let Some(data) = data.or(identity.as_ref().map(|identity| identity.path.as_path())) else {
            return Err(Error::argument(format!(
                "{}: does not say what it was trained on: name the packed set",
                root.display()
            )));
        };
        let newest = checkpoint::list(&paths.checkpoints())?.pop();
        let Some((_, newest)) = newest else {
            return Err(Error::data(format!(
                "{}: no checkpoint to resume from: remove the directory and train afresh",
                root.display()
            )));
        };
        let saved = Checkpoint::load(&newest)?;
        let mut trainer = Self::assemble(paths, data, config, saved.progress.clone(), device)?;
        let found = (trainer.set.frames(), trainer.set.vertices());
        if let Some(identity) = &identity
            && found != (identity.frames, identity.vertices)
        {
            return Err(Error::data(format!(
                "{}: {} training frames of {} vertices, but the run was trained on {} of {}",
                data.display(),
                found.0,
                found.1,
                identity.frames,
                identity.vertices
            )));
        }
        trainer.statistics.expect_vertices(found.1)?;
        if !DisplacementStatistics::from_packed(data, &mut cape_core::silent)?
            .is_close(&trainer.statistics)
        {
            return Err(Error::data(format!(
                "{}: its displacements have another mean and deviation than those the run was \
                 trained on: it is another data set",
                data.display()
            )));
        }
        trainer
            .learner
            .restore(&saved)
            .map_err(|error| Error::format(&newest, format!("does not suit the run: {error}")))?;
        trainer.forget_metrics_after(trainer.progress.step)?;
        Ok(trainer)
    }

    fn assemble(
        paths: RunPaths,
        data: &Path,
        config: RunConfig,
        progress: TrainState,
        device: &Device,
    ) -> Result<Self> {
        let mut set = PackedSet::open(data, Split::Train)?;
        if config.train.preload {
            set.preload(&mut cape_core::silent)?;
        }
        let statistics = DisplacementStatistics::load(paths.statistics())?;
        let body = SmplModel::load(paths.body())?;
        let mask = ClothingMask::load(paths.clothing(), body.vertices())?;
        let device = device.clone().autodiff();
        let graphs = build_graphs(&config, &body, &device)?;
        let learner = Learner::new(&config, graphs, &device)?;
        Ok(Self {
            set: Arc::new(set),
            statistics: Arc::new(statistics),
            clothing: mask.indices().collect(),
            learner,
            preview_fn: None,
            paths,
            config,
            progress,
            device,
        })
    }

    /// The run's configuration.
    pub fn config(&self) -> &RunConfig {
        &self.config
    }

    /// Steps in an epoch.
    pub fn steps_per_epoch(&self) -> usize {
        steps_per_epoch(self.training_rows().len(), self.config.train.batch)
    }

    /// Steps done so far.
    pub fn step(&self) -> u64 {
        self.progress.step
    }

    /// The model as it is.
    pub fn model(&self) -> &Cape {
        self.learner.model()
    }

    /// Has a few validation frames drawn after every epoch, for TensorBoard.
    pub fn set_preview_fn(&mut self, preview_fn: PreviewFn) {
        self.preview_fn = Some(preview_fn);
    }

    /// Where things are.
    pub fn paths(&self) -> &RunPaths {
        &self.paths
    }

    fn training_rows(&self) -> std::ops::Range<usize> {
        self.statistics.training_rows(self.set.frames())
    }

    /// Trains until every epoch is done or `report` breaks; in both cases the state is saved.
    ///
    /// # Errors
    /// Besides those of reading and writing: a loss or gradient that is not finite. The update is
    /// not made, the error names the step and its frames, and the last checkpoint is kept.
    pub fn run(
        &mut self,
        report: &mut dyn FnMut(&TrainEvent) -> ControlFlow<()>,
    ) -> Result<TrainOutcome> {
        let steps = self.steps_per_epoch();
        let last = (self.config.train.epochs * steps) as u64;
        let options = LoaderOptions {
            batch: self.config.train.batch,
            discriminator: self.config.model.discriminator.is_some(),
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
                if stop || epoch_ends || (often > 0 && step.is_multiple_of(often)) {
                    let path = self.save()?;
                    if let Some(found) = found {
                        self.show(&found, &mut log)?;
                    }
                    log.flush()?;
                    // A reader of the report may break again; training is about to stop anyway.
                    let _ = report(&TrainEvent::Checkpoint { path });
                }
                if stop {
                    break;
                }
            }
        }
        Ok(TrainOutcome {
            finished: self.progress.step >= last,
            epochs: (self.progress.step / steps as u64) as usize,
            steps: self.progress.step,
            best_validation: self.progress.best.map(|(error, _)| error),
            seconds: self.progress.seconds,
        })
    }

    /// One update of generator and discriminator; whether the report asked to stop.
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
        let StepBatches { generator, discriminator, state } = loader.step()?;
        let frames = generator.frames.clone();
        let epsilon = self.config.model.variational.then(|| {
            let latent = self.config.model.latent;
            // Shuffles use the seed's first streams; noise has one a step, far from them.
            normal(train.seed, (1 << 32) + step, frames.len(), latent)
        });
        let input = StepInput {
            frames: to_device(generator, &self.device),
            epsilon: epsilon.map(|epsilon| from_array2(epsilon, &self.device)),
            real: discriminator.map(|batch| to_device(batch, &self.device)),
        };
        let logged = (step + 1).is_multiple_of(train.log_steps as u64);
        let pace = UpdateOptions { rate, kl_share: train.kl_share(step, steps), detailed: logged };
        let update = match self.learner.update(&input, pace) {
            Ok(update) => update,
            Err(what) => return Err(self.not_finite(what, &frames)?),
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

    /// The error of a step that came to something that is not finite.
    fn not_finite(&self, what: &str, frames: &[usize]) -> Result<Error> {
        let kept = checkpoint::list(&self.paths.checkpoints())?.pop();
        let kept = kept.map_or_else(
            || "there is no checkpoint yet".to_owned(),
            |(_, path)| format!("the last checkpoint is {}", path.display()),
        );
        Ok(Error::data(format!(
            "{what} is not a finite number at step {} (training frames {frames:?}); {kept}; a lower \
             train.peak_rate may help",
            self.progress.step + 1,
        )))
    }

    /// Reconstructs the validation frames from the posterior's mean, and logs the epoch.
    fn validate(
        &mut self,
        epoch: usize,
        log: &mut TrainLog,
        report: &mut dyn FnMut(&TrainEvent) -> ControlFlow<()>,
    ) -> Result<Option<ValidationResult>> {
        let (sum, count) = std::mem::take(&mut self.progress.accuracy_sum);
        let judged = self.config.model.discriminator.is_some() && count > 0;
        let discriminator_accuracy = judged.then(|| f64::from(sum) / count as f64);
        let step = self.progress.step;
        let generator = self.learner.valid_generator();
        let validator = Validator {
            generator: &generator,
            graphs: self.learner.graphs(),
            loss: &self.config.loss,
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
        // Stopping between epochs is the next step's business.
        let _ = report(&TrainEvent::Validation {
            epoch,
            losses: found.losses,
            millimetres,
            active_units: found.active_units,
            discriminator_accuracy,
        });
        Ok(Some(found))
    }

    /// Histograms and pictures, which are large: after the checkpoint, should the disk be full.
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
        checkpoint::prune(&directory, self.config.train.keep, best)?;
        Ok(path)
    }

    /// Drops the lines that an interrupted session logged after its last checkpoint.
    fn forget_metrics_after(&self, step: u64) -> Result<()> {
        let path = self.paths.metrics();
        let Ok(text) = fs::read_to_string(&path) else { return Ok(()) };
        let kept = text.lines().filter(|line| {
            serde_json::from_str::<serde_json::Value>(line)
                .ok()
                .and_then(|line| line["step"].as_u64())
                .is_some_and(|logged| logged <= step)
        });
        let kept: String = kept.flat_map(|line| [line, "\n"]).collect();
        Ok(cape_core::write_atomically(&path, |file| file.write_all(kept.as_bytes()))?)
    }
}
