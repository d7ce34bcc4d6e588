//! Configuration and terms of the clothed fit (CAPE eq. 10 and 11).

use serde::{Deserialize, Serialize};

use crate::{
    BodyTerms, BodyWeights, Error, FitProblem, Result, body_energy::check_weight,
    clothed::SilhouetteOverlap, silhouette::SilhouetteTerms,
};

/// Least side of a silhouette level, pixels.
const SMALLEST: u32 = 16;

/// One level of the coarse-to-fine comparison of silhouettes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SilhouetteLevel {
    /// Longer side of the image, pixels, at most.
    pub side: u32,
    /// Number of matchings of surface and silhouette.
    pub rounds: usize,
    /// Optimiser steps after each matching.
    pub steps: usize,
}

/// Configuration of the clothed fit.
///
/// The default weights are those of a negative log-likelihood (Gaussian keypoints, a mixture of
/// poses, standard normal shapes and codes). λ_S is from a search over 48 held-out frames of the
/// synthetic set for the least error at clothing vertices: it reduces the squared error of the
/// unclothed body by 23 % at 2e4, by 26 % at 5e4 and by 26 % at 1.5e5. The paper gives no weights.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ClothedConfig {
    /// Weight λ_S of the silhouette term `E_S`, 1/m.
    pub silhouette: f64,
    /// Width of soft edges, pixels of the level, for soft silhouettes on all levels but the first;
    /// by default all levels use distances.
    pub soft: Option<f64>,
    /// Weight λ_z of the code prior `‖z‖²`.
    pub code: f64,
    /// Weights of the body terms.
    pub body: BodyWeights,
    /// Silhouette levels, coarse to fine.
    pub levels: Vec<SilhouetteLevel>,
    /// Share of the rendered silhouette on the mask below which a second fit starts from the body
    /// with the trunk mirrored in depth, which keypoints alone hardly distinguish.
    pub doubtful: f64,
    /// Least share of the rendered silhouette on the mask of a reliable fit: what lies beside the mask
    /// contradicts the image.
    pub inside: f64,
    /// Least share of the mask that the rendered silhouette covers of a reliable fit. Hair, shoes and
    /// what a person carries are in masks, but not in any silhouette of SMPL.
    pub explained: f64,
    /// Number of outfits that are fitted on all levels where several are compared: those of the
    /// lowest energy on the first level.
    pub finalists: usize,
}

impl Default for ClothedConfig {
    fn default() -> Self {
        Self {
            silhouette: 5e4,
            soft: None,
            code: 0.5,
            body: BodyWeights::default(),
            levels: vec![
                SilhouetteLevel { side: 128, rounds: 2, steps: 12 },
                SilhouetteLevel { side: 256, rounds: 2, steps: 10 },
                SilhouetteLevel { side: 512, rounds: 2, steps: 10 },
            ],
            doubtful: 0.95,
            inside: 0.75,
            explained: 0.5,
            finalists: 2,
        }
    }
}

impl ClothedConfig {
    /// Problem of a fit with these shares of the silhouettes, if one is too small.
    pub(crate) fn problem(&self, overlap: &SilhouetteOverlap) -> Option<FitProblem> {
        let &SilhouetteOverlap { inside, explained, .. } = overlap;
        if inside < self.inside {
            return Some(FitProblem::BesideMask { share: inside, limit: self.inside });
        }
        let limit = self.explained;
        (explained < limit).then_some(FitProblem::Unexplained { share: explained, limit })
    }

    pub(crate) fn check(&self) -> Result<()> {
        self.body.check()?;
        check_weight("silhouette", self.silhouette)?;
        check_weight("code", self.code)?;
        if self.finalists == 0 {
            return Err(Error::argument("configuration: `finalists` 0, expected 1 or more"));
        }
        if self.levels.is_empty() || self.levels.iter().any(|level| level.side < SMALLEST) {
            return Err(Error::argument(format!(
                "configuration: `levels`: expected at least one, each of {SMALLEST} pixels or more"
            )));
        }
        Ok(())
    }
}

/// Unweighted terms of the energy (CAPE eq. 11).
///
/// ```
/// use cape_fit::{ClothedConfig, ClothedTerms};
///
/// let terms = ClothedTerms { code: 2.0, ..ClothedTerms::default() };
/// let config = ClothedConfig { code: 0.25, ..ClothedConfig::default() };
/// assert_eq!(terms.weighted(&config), 0.5);
/// ```
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct ClothedTerms {
    /// Body terms.
    pub body: BodyTerms,
    /// Silhouette term `E_S` (CAPE eq. 10), metres.
    pub silhouette: SilhouetteTerms,
    /// Code prior `‖z‖²`.
    pub code: f64,
}

impl ClothedTerms {
    /// Energy `E_J + λ_S E_S + λ_θ E_θ + λ_β E_β + λ_a E_a + λ_z ‖z‖²` (CAPE eq. 11).
    pub fn weighted(&self, config: &ClothedConfig) -> f64 {
        self.body.weighted(&config.body)
            + config.silhouette * self.silhouette.total()
            + config.code * self.code
    }
}
