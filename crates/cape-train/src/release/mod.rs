//! Runs made of the authors' TensorFlow checkpoints.

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

/// What a checkpoint does not hold itself.
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
/// let report = import("checkpoints/CAPE_male".as_ref(), &options, "cape-male".as_ref(), &device)?;
/// assert!(report.parameters > 0);
/// let run = Run::open("cape-male".as_ref(), &device)?;
/// # Ok::<(), cape_train::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct ImportOptions {
    /// The body, whose template the mesh pyramid is made of.
    pub body: PathBuf,
    /// Mean and deviation of the training displacements (`trainset_stats.npz`).
    pub statistics: PathBuf,
    /// Indices of clothing vertices; else derived from the body's blend weights.
    pub clothing: Option<PathBuf>,
    /// The generator's down-sampling factors, where they are not the release's default.
    pub factors: Option<Vec<u32>>,
    /// The discriminator's.
    pub discriminator_factors: Option<Vec<u32>>,
    /// The release's configuration file: flat YAML. What the weights show is checked against them;
    /// the rest is for training on.
    pub settings: Option<PathBuf>,
}

/// What was imported.
///
/// See [`ImportOptions`] for an example.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ImportReport {
    /// The checkpoint, without the suffixes of its files.
    pub checkpoint: PathBuf,
    /// Variables of the model.
    pub variables: usize,
    /// Numbers in them.
    pub parameters: usize,
    /// Velocities of the optimisers.
    pub velocities: usize,
    /// Training steps done, if the checkpoint says.
    pub step: Option<u64>,
    /// Variables that belong to neither model nor optimiser.
    pub ignored: Vec<String>,
    /// Keys of the configuration file that mean nothing here.
    pub unused: Vec<String>,
}

/// Makes a run of a checkpoint in the new or empty directory `out`, which appears only when it is
/// complete. The pyramid gets the release's up-sampling weights, which the weights were trained
/// with.
///
/// # Errors
/// If the checkpoint is damaged; if a variable is missing, left over or of another shape than the
/// body and the architecture ask for (it is named); if body, statistics and clothing vertices do
/// not fit one another.
pub fn import(
    checkpoint: &Path,
    options: &ImportOptions,
    out: &Path,
    device: &Device,
) -> Result<ImportReport> {
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
    // Shapes are checked, and every parameter must be there.
    weights::apply(empty, &model).map_err(|error| match error {
        cape_model::Error::Weight { name, message } => {
            let official = released.official_name(&config.model, &name);
            let message = format!("{message} (`{name}` here)");
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

/// Reads a configuration file of the release, and takes over what it says as far as it is known.
///
/// # Errors
/// If it is not flat YAML, or a value is not what its key needs.
pub fn check_settings(path: &Path) -> Result<RunConfig> {
    let mut settings = Settings::load(path)?;
    let mut config = RunConfig::default();
    settings.apply(&mut config).map_err(|message| Error::format(path, message))?;
    Ok(config)
}

/// What is asked for holds against what a file says.
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
