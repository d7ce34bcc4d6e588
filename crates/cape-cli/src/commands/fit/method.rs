//! Options of the commands that fit bodies to images.

use std::path::PathBuf;

use cape_core::SmplModel;
use cape_fit::{FitConfig, PosePrior, Smplify};
use clap::{Args, ValueEnum};

use crate::error::{Error, Result};

/// Width of soft silhouette edges, pixels.
const SOFTNESS: f64 = 0.5;

/// Silhouette terms.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub(crate) enum SilhouetteComparison {
    Distance,
    Soft,
}

/// Weights, pose prior and silhouette term of a fit.
#[derive(Debug, Clone, Args)]
pub(crate) struct FitMethodArgs {
    /// Weights and stages, TOML with [smplify] and [clothed].
    #[arg(long, value_name = "FILE.toml")]
    pub(crate) config: Option<PathBuf>,
    /// Pose prior, SMPLify's .pkl or .npz of `cape fit pose-prior` [default: synthetic motions].
    #[arg(long, value_name = "FILE")]
    pub(crate) pose_prior: Option<PathBuf>,
    /// Silhouette term: distance between silhouettes or soft rasterisation [default: from --config].
    #[arg(long, value_enum, value_name = "TERM")]
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
