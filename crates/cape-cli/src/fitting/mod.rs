//! What the commands that fit bodies to images have in common.

mod curves;
mod pictures;

use std::path::PathBuf;

use cape_core::SmplModel;
use cape_fit::{FitConfig, PosePrior, Smplify};
use clap::{Args, ValueEnum};

use crate::error::{Error, Result};

pub(crate) use curves::energies;
pub(crate) use pictures::{body, cut, difference, mark, mesh, paper, person_box};

/// Width of soft edges, pixels.
const SOFTNESS: f64 = 0.5;

/// How silhouettes are compared.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub(crate) enum SilhouetteComparison {
    Distance,
    Soft,
}

/// How bodies are fitted.
#[derive(Debug, Clone, Args)]
pub(crate) struct FitMethodArgs {
    /// Weights and stages as a TOML file, `[smplify]` and `[clothed]`; what it leaves out keeps its
    /// default.
    #[arg(long, value_name = "FILE.toml")]
    pub(crate) config: Option<PathBuf>,
    /// The pose prior: SMPLify's pickle, or .npz as `cape fit-pose-prior` writes; by default one of
    /// synthetic movements.
    #[arg(long, value_name = "FILE")]
    pub(crate) pose_prior: Option<PathBuf>,
    /// How silhouettes are compared: by distances, or finely by what soft edges cover; by default as
    /// --config says, or by distances.
    #[arg(long, value_enum, value_name = "WAY")]
    pub(crate) silhouette: Option<SilhouetteComparison>,
}

impl FitMethodArgs {
    pub(crate) fn config(&self) -> Result<FitConfig> {
        let mut config = self.read_config()?;
        match self.silhouette {
            Some(SilhouetteComparison::Distance) => config.clothed.soft = None,
            Some(SilhouetteComparison::Soft) => config.clothed.soft = Some(SOFTNESS),
            None => {}
        }
        Ok(config)
    }

    fn read_config(&self) -> Result<FitConfig> {
        let Some(path) = &self.config else { return Ok(FitConfig::default()) };
        let text = std::fs::read_to_string(path).map_err(|error| Error::io(path, error))?;
        let config: FitConfig = toml::from_str(&text)
            .map_err(|error| cape_core::Error::format(path, error.to_string()))?;
        config.check().map_err(|error| cape_core::Error::format(path, error.to_string()))?;
        Ok(config)
    }

    pub(crate) fn smplify(&self, body: &SmplModel, config: &FitConfig) -> Result<Smplify> {
        let prior = match &self.pose_prior {
            Some(path) => PosePrior::load(path)?,
            None => PosePrior::synthetic()?,
        };
        Ok(Smplify::new(body, prior, config.smplify.clone())?)
    }
}
