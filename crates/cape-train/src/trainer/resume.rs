//! Resuming of an interrupted training.

use std::{
    fs,
    io::Write,
    path::{Path, PathBuf},
    sync::Arc,
};

use burn::tensor::Device;
use cape_core::DirectoryLock;
use cape_data::DisplacementStatistics;
use cape_infer::{
    RunConfig, RunPaths,
    checkpoint::{self, Checkpoint},
    read_identity,
};

use super::{Trainer, beginning};
use crate::{
    Error, Result,
    collective::{Collective, SingleProcess, agree, in_first},
};

impl Trainer {
    /// Resumes the run in `root` from its newest checkpoint, or starts it over if it was interrupted
    /// before the first one. Damaged checkpoints are [passed over](Self::damaged_checkpoints). `data` is the
    /// directory of the packed set; `None` uses the one that the run was created with.
    ///
    /// # Errors
    /// If the run cannot be read, another process trains it, or the packed set is not the one it was
    /// trained on.
    pub fn resume(root: impl AsRef<Path>, data: Option<&Path>, device: &Device) -> Result<Self> {
        Self::resume_together(root, data, device, Arc::new(SingleProcess))
    }

    /// Resumes the run in `root` by several processes, as [`resume`](Self::resume) does, whatever their
    /// number was before. All of them call this with the same arguments but the device.
    ///
    /// # Errors
    /// In all processes if one has an error.
    pub fn resume_together(
        root: impl AsRef<Path>,
        data: Option<&Path>,
        device: &Device,
        processes: Arc<dyn Collective>,
    ) -> Result<Self> {
        let root = root.as_ref();
        let paths = RunPaths::new(root);
        let directory = paths.checkpoints();
        let first = in_first(&*processes, || {
            // Before the lock, which makes a file in the directory.
            RunConfig::load(&paths.config())?;
            let lock = DirectoryLock::acquire(root)?;
            let (saved, damaged) = Checkpoint::load_newest(&directory)?;
            Ok((lock, saved, damaged))
        })?;
        let newest = first.as_ref().and_then(|(_, saved, _)| Some(saved.as_ref()?.1.progress.step));
        let mut bytes = newest.unwrap_or(u64::MAX).to_le_bytes();
        processes.broadcast(&mut bytes)?;
        let step = u64::from_le_bytes(bytes);
        let trainer = || {
            let (lock, saved, damaged) = match first {
                Some((lock, saved, damaged)) => (Some(lock), saved, damaged),
                None => (None, load_step(&directory, step)?, Vec::new()),
            };
            let mut trainer = Self::open((paths, lock, processes.clone()), data, saved, device)?;
            trainer.damaged = damaged;
            if processes.rank() == 0 {
                trainer.forget_metrics_after(trainer.progress.step)?;
            }
            Ok(trainer)
        };
        agree(&*processes, trainer())
    }

    fn open(
        place: (RunPaths, Option<DirectoryLock>, Arc<dyn Collective>),
        data: Option<&Path>,
        saved: Option<(PathBuf, Checkpoint)>,
        device: &Device,
    ) -> Result<Self> {
        let paths = &place.0;
        let config = RunConfig::load(&paths.config())?;
        // An imported run has no record of its data set.
        let identity =
            if paths.data().exists() { Some(read_identity(&paths.data())?) } else { None };
        let Some(data) = data.or(identity.as_ref().map(|identity| identity.path.as_path())) else {
            return Err(Error::argument(format!(
                "{}: the run has no record of its packed set: give its directory",
                paths.root().display()
            )));
        };
        let progress = saved
            .as_ref()
            .map_or_else(|| beginning(config.train.seed), |(_, saved)| saved.progress.clone());
        let mut trainer = Self::assemble(place, data, config, progress, device)?;
        let found = (trainer.set.frames(), trainer.set.vertices());
        if let Some(identity) = &identity
            && found != (identity.frames, identity.vertices)
        {
            return Err(Error::data(format!(
                "{}: {} training frames of {} vertices, but the run was trained on {} frames of {}",
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
                "{}: mean and standard deviation of the displacements differ from those of the run's \
                 packed set: give the packed set that the run was trained on",
                data.display()
            )));
        }
        if let Some((path, saved)) = &saved {
            trainer
                .learner
                .restore(saved)
                .map_err(|error| Error::format(path, format!("does not suit the run: {error}")))?;
        }
        Ok(trainer)
    }

    /// Drops the metrics that an interrupted session logged after its last checkpoint.
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

/// The checkpoint of `step`, if that is not `u64::MAX`.
fn load_step(directory: &Path, step: u64) -> Result<Option<(PathBuf, Checkpoint)>> {
    if step == u64::MAX {
        return Ok(None);
    }
    let found = checkpoint::list(directory)?.into_iter().find(|(own, _)| *own == step);
    let Some((_, path)) = found else {
        return Err(Error::argument(format!(
            "{}: no checkpoint of step {step}, from which the first process resumes: all processes need the \
             same directory",
            directory.display()
        )));
    };
    let saved = Checkpoint::load(&path)?;
    Ok(Some((path, saved)))
}
