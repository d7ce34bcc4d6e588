//! Import of the authors' TensorFlow checkpoints as runs.

mod settings;

use std::path::{Path, PathBuf};

use burn::tensor::Device;
use cape_core::{SmplModel, smpl::ClothingMask};
use cape_graph::Weighting;
use cape_model::{
    Cape,
    release::{ReleaseCheckpoint, check_vertices, infer},
    tensorflow::TensorFlowCheckpoint as TensorFlow,
    weights,
};
use serde::Serialize;
use settings::Settings;

use crate::{Error, Result};
use cape_core::StagingDirectory;
use cape_data::{DisplacementStatistics, LoaderState};
use cape_infer::{
    RunConfig, RunPaths, build_graphs,
    checkpoint::{Checkpoint, TrainState},
};

/// Files and settings of an import that a checkpoint does not contain.
///
/// ```no_run
/// use burn::tensor::Device;
/// use cape_infer::Run;
/// use cape_train::release::{ImportOptions, import};
///
/// let options = ImportOptions {
///     body: "SMPL_MALE.pkl".into(),
///     statistics: "trainset_stats.npz".into(),
///     clothing: Some("clothing_verts_idx.npy".into()),
///     factors: None,
///     discriminator_factors: None,
///     settings: Some("config.yaml".into()),
/// };
/// let device = Device::default();
/// let report = import("checkpoints/CAPE_male", &options, "cape-male", &device)?;
/// assert!(report.parameters > 0);
/// let run = Run::open("cape-male", &device)?;
/// # Ok::<(), cape_train::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct ImportOptions {
    /// File of the SMPL body whose template mesh the pyramid is built from.
    pub body: PathBuf,
    /// File of mean and standard deviation of the training displacements (`trainset_stats.npz`).
    pub statistics: PathBuf,
    /// File of the indices of clothing vertices; `None` derives them from the body's blend weights.
    pub clothing: Option<PathBuf>,
    /// Down-sampling factors of the generator, if they are not the release's defaults.
    pub factors: Option<Vec<u32>>,
    /// Down-sampling factors of the discriminator, if they are not the release's defaults.
    pub discriminator_factors: Option<Vec<u32>>,
    /// Configuration file of the release, flat YAML. Settings of the architecture are checked
    /// against the weights; the others are taken over for further training.
    pub settings: Option<PathBuf>,
}

/// Report of an import.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ImportReport {
    /// Prefix of the checkpoint, without the suffixes of its files.
    pub checkpoint: PathBuf,
    /// Number of variables of the model.
    pub variables: usize,
    /// Number of parameters in them.
    pub parameters: usize,
    /// Number of variables with momentum of the optimisers.
    pub velocities: usize,
    /// Training steps, if the checkpoint has them.
    pub step: Option<u64>,
    /// Names of variables that belong to neither model nor optimiser.
    pub ignored: Vec<String>,
    /// Keys of the configuration file that were not used.
    pub unused: Vec<String>,
}

/// Imports a checkpoint as a run in the new or empty directory `out`, which appears only when it is
/// complete. The pyramid uses the release's up-sampling weights, with which the model was trained.
///
/// # Errors
/// If the checkpoint is damaged; if a variable is missing, unknown or of another shape than body
/// and architecture require (it is named); if body, statistics and clothing vertices do not match.
pub fn import(
    checkpoint: impl AsRef<Path>,
    options: &ImportOptions,
    out: impl AsRef<Path>,
    device: &Device,
) -> Result<ImportReport> {
    let out = out.as_ref();
    let tensorflow = TensorFlow::open(checkpoint)?;
    let about = |error: cape_model::Error| Error::format(tensorflow.prefix(), error.to_string());
    let released = ReleaseCheckpoint::read(&tensorflow)?;
    let shapes = released.shapes();
    let mut config = RunConfig {
        model: infer(&shapes).map_err(about)?,
        weighting: Weighting::Release,
        ..RunConfig::default()
    };
    let mut unused = Vec::new();
    if let Some(path) = &options.settings {
        let mut settings = Settings::load(path)?;
        settings.apply(&mut config).map_err(|message| Error::format(path, message))?;
        unused = settings.unused();
    }
    take_factors(&mut config, options);
    config.validate()?;

    let body = SmplModel::load(&options.body)?;
    check_vertices(&config.model, &shapes, body.vertices()).map_err(about)?;
    let statistics = DisplacementStatistics::load(&options.statistics)?;
    statistics
        .expect_vertices(body.vertices())
        .map_err(|error| Error::format(&options.statistics, error.to_string()))?;
    let mask = match &options.clothing {
        Some(path) => ClothingMask::load(path, body.vertices())?,
        None => ClothingMask::from_weights(&body)?,
    };

    let model = released.weights(&config.model).map_err(about)?;
    let graphs = build_graphs(&config, &body, device)?;
    let empty = Cape::new(&config.model, &graphs, 0, device)?;
    // Checks that every parameter is there and has the right shape.
    weights::apply(empty, &model).map_err(|error| match error {
        cape_model::Error::Weight { name, message } => {
            let official = released.official_name(&config.model, &name);
            let message = format!("{message} (parameter `{name}`)");
            about(cape_model::Error::Weight { name: official.unwrap_or(name), message })
        }
        other => about(other),
    })?;
    let momentum = |part| released.momentum(&config.model, part).map_err(about);
    let saved = Checkpoint {
        progress: TrainState {
            step: released.step.unwrap_or(0),
            loader: LoaderState::new(config.train.seed),
            seconds: 0.0,
            accuracy_sum: (0.0, 0),
            validation: None,
            best: None,
        },
        generator_momentum: momentum("generator")?,
        discriminator_momentum: momentum("discriminator")?,
        average: None,
        model,
    };

    let staging = StagingDirectory::create(out)?;
    let paths = RunPaths::new(&staging.path);
    statistics.save(paths.statistics())?;
    body.save(paths.body())?;
    mask.save(paths.clothing())?;
    config.save(&paths.config())?;
    saved.save(&paths.checkpoints())?;
    let report = ImportReport {
        checkpoint: tensorflow.prefix().to_owned(),
        variables: released.variables.len(),
        parameters: saved.model.values().map(|array| array.values.len()).sum(),
        velocities: saved.generator_momentum.len() + saved.discriminator_momentum.len(),
        step: released.step,
        ignored: released.ignored,
        unused,
    };
    staging.commit(out)?;
    Ok(report)
}

/// Reads a configuration file of the release; unknown keys are ignored.
///
/// # Errors
/// If the file is not flat YAML, or a value has the wrong type.
pub fn check_settings(path: impl AsRef<Path>) -> Result<RunConfig> {
    let path = path.as_ref();
    let mut settings = Settings::load(path)?;
    let mut config = RunConfig::default();
    settings.apply(&mut config).map_err(|message| Error::format(path, message))?;
    Ok(config)
}

/// Applies the down-sampling factors of `options`, which override those of the configuration file.
fn take_factors(config: &mut RunConfig, options: &ImportOptions) {
    if let Some(factors) = &options.factors {
        config.model.factors.clone_from(factors);
    }
    if let (Some(discriminator), Some(factors)) =
        (&mut config.model.discriminator, &options.discriminator_factors)
    {
        discriminator.factors.clone_from(factors);
    }
}
