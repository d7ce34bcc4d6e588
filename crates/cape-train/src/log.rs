//! Training log: `metrics.jsonl` and TensorBoard events of a run.

use std::{
    fs::{self, OpenOptions},
    io::Write,
    path::PathBuf,
};

use burn::module::Module;
use cape_model::weights::for_each_parameter;
use serde_json::json;

use crate::{
    Error, Result,
    learner::UpdateReport,
    tensorboard::EventWriter,
    validate::{TensorBoardImage, ValidationResult},
};
use cape_infer::RunPaths;

pub(crate) struct TrainLog {
    path: PathBuf,
    metrics: fs::File,
    events: EventWriter,
}

impl TrainLog {
    pub(crate) fn open(paths: &RunPaths) -> Result<Self> {
        let path = paths.metrics();
        let metrics = OpenOptions::new()
            .create(true)
            .append(true)
            .open(&path)
            .map_err(|source| Error::io(&path, source))?;
        let directory = paths.events();
        fs::create_dir_all(&directory).map_err(|source| Error::io(&directory, source))?;
        Ok(Self { path, metrics, events: EventWriter::create(directory)? })
    }

    fn line(&mut self, value: &serde_json::Value) -> Result<()> {
        self.metrics
            .write_all(format!("{value}\n").as_bytes())
            .map_err(|source| Error::io(&self.path, source))
    }

    pub(crate) fn step(
        &mut self,
        step: u64,
        epoch: usize,
        update: &UpdateReport,
        rate: f64,
        seconds: f64,
    ) -> Result<()> {
        let UpdateReport { losses, generator_norm, discriminator_norm, condition_norms } = update;
        for (name, value) in losses.named_values() {
            self.events.scalar(&format!("train/{name}"), step, value as f32)?;
        }
        self.events.scalar("train/rate", step, rate as f32)?;
        let [pose, outfit] = *condition_norms;
        for (name, norm) in [
            ("gradient_norm", Some(*generator_norm)),
            ("gradient_norm_discriminator", *discriminator_norm),
            ("gradient_norm_pose", pose),
            ("gradient_norm_outfit", outfit),
        ] {
            if let Some(norm) = norm {
                self.events.scalar(&format!("train/{name}"), step, norm as f32)?;
            }
        }
        self.line(&json!({
            "kind": "train", "step": step, "epoch": epoch, "losses": losses, "rate": rate,
            "gradient_norm": generator_norm, "gradient_norm_discriminator": discriminator_norm,
            "gradient_norm_pose": pose, "gradient_norm_outfit": outfit, "seconds": seconds,
        }))
    }

    pub(crate) fn validation(
        &mut self,
        step: u64,
        epoch: usize,
        found: &ValidationResult,
        discriminator_accuracy: Option<f64>,
    ) -> Result<()> {
        let ValidationResult { losses, errors, active_units, .. } = found;
        let mut scalar = |name: &str, value: f64| {
            self.events.scalar(&format!("validation/{name}"), step, value as f32)
        };
        scalar("millimetres", errors.mean)?;
        scalar("reconstruction", losses.reconstruction)?;
        scalar("edge", losses.edge)?;
        scalar("kl", losses.kl)?;
        scalar("active_units", *active_units as f64)?;
        if let Some(accuracy) = discriminator_accuracy {
            scalar("discriminator_accuracy", accuracy)?;
        }
        self.line(&json!({
            "kind": "validation", "step": step, "epoch": epoch, "millimetres": errors.mean,
            "reconstruction": losses.reconstruction, "edge": losses.edge, "kl": losses.kl,
            "active_units": active_units, "discriminator_accuracy": discriminator_accuracy,
        }))
    }

    /// Logs histograms of all parameters and of the errors and codes of the validation frames.
    pub(crate) fn histograms<M: Module>(
        &mut self,
        step: u64,
        model: &M,
        found: &ValidationResult,
    ) -> Result<()> {
        self.events.histogram("validation/error_mm", step, &found.sample_errors)?;
        self.events.histogram("validation/code", step, &found.codes)?;
        let mut outcome = Ok(());
        for_each_parameter(model, |parameter| {
            if outcome.is_ok() {
                let tag = format!("weights/{}", parameter.path);
                outcome = self.events.histogram(&tag, step, &parameter.read());
            }
        });
        outcome
    }

    pub(crate) fn picture(&mut self, step: u64, picture: &TensorBoardImage) -> Result<()> {
        let TensorBoardImage { tag, width, height, png } = picture;
        self.events.image(tag, step, [*width, *height], png)
    }

    pub(crate) fn flush(&mut self) -> Result<()> {
        self.events.flush()
    }
}
