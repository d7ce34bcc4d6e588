//! Coarse-to-fine stages of a fit to a scan.

use serde::{Deserialize, Serialize};

use crate::{BodyWeights, Error, Result, body_energy::check_weight};

/// Unknowns of a stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Unknowns {
    /// Translation and pose, in the mean clothing.
    Pose,
    /// Translation, pose and shape, in the mean clothing.
    Shape,
    /// Translation, pose, shape and latent code.
    Clothes,
}

/// One stage of a fit to a scan.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScanStage {
    /// Unknowns.
    pub unknowns: Unknowns,
    /// Geman–McClure scale σ (outlier threshold), metres.
    pub robust_scale: f64,
    /// Number of samples of the scan.
    pub samples: usize,
    /// Optimiser steps, at most.
    pub steps: usize,
    /// Weight λ_D of the distance energy `E_D`, 1/m².
    pub distance: f64,
}

impl ScanStage {
    pub(super) const fn new(
        unknowns: Unknowns,
        robust_scale: f64,
        samples: usize,
        steps: usize,
        distance: f64,
    ) -> Self {
        Self { unknowns, robust_scale, samples, steps, distance }
    }
}

/// Configuration of a fit to a scan.
///
/// ```
/// use cape_fit::scan::{ScanConfig, Unknowns};
///
/// // Coarse to fine: unknowns grow and outlier thresholds shrink from stage to stage.
/// let stages = ScanConfig::default().stages;
/// assert!(stages.is_sorted_by_key(|stage| stage.unknowns));
/// assert!(stages.is_sorted_by(|first, second| first.robust_scale >= second.robust_scale));
/// assert_eq!(stages[0].unknowns, Unknowns::Pose);
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ScanConfig {
    /// Number of shape coefficients to fit, at most those of the body.
    pub betas: usize,
    /// Stages, ordered by their unknowns.
    pub stages: Vec<ScanStage>,
    /// Number of initial bodies in the first stage.
    pub starts: usize,
    /// Weight of the distance from the body to the scan, relative to that from the scan to the body.
    pub back: f64,
    /// Weights of the priors and of known joints.
    pub body: BodyWeights,
    /// Weight λ_z of the code prior `‖z‖²`.
    pub code: f64,
    /// Standard deviation of known joints, metres.
    pub joint_deviation: f64,
    /// Largest median distance of the scan in a reliable fit, metres.
    pub accepted: f64,
    /// Largest 95th percentile of the distances of the scan in a reliable fit, metres.
    pub accepted_most: f64,
    /// Random seed of the samples.
    pub seed: u64,
}

impl Default for ScanConfig {
    fn default() -> Self {
        Self {
            betas: 10,
            stages: vec![
                ScanStage::new(Unknowns::Pose, 0.2, 1000, 30, 1e5),
                ScanStage::new(Unknowns::Shape, 0.1, 1500, 30, 3e5),
                ScanStage::new(Unknowns::Shape, 0.05, 2000, 20, 1e6),
                ScanStage::new(Unknowns::Clothes, 0.05, 2500, 20, 1e6),
                ScanStage::new(Unknowns::Clothes, 0.02, 6000, 30, 3e6),
            ],
            starts: 3,
            back: 0.5,
            body: BodyWeights::default(),
            code: 0.5,
            joint_deviation: 0.03,
            accepted: 0.012,
            accepted_most: 0.08,
            seed: 1,
        }
    }
}

impl ScanConfig {
    /// An error if a field is out of range or the stages are not in order.
    pub(crate) fn check(&self) -> Result<()> {
        self.body.check()?;
        let weights = [("back", self.back), ("code", self.code)];
        weights.iter().try_for_each(|&(field, weight)| check_weight(field, weight))?;
        let positive = self.stages.iter().flat_map(|stage| {
            [("stages.robust_scale", stage.robust_scale), ("stages.distance", stage.distance)]
        });
        for (field, value) in positive.chain([("joint_deviation", self.joint_deviation)]) {
            if !(value > 0.0 && value.is_finite()) {
                return Err(Error::argument(format!(
                    "configuration: `{field}` {value}, expected above 0"
                )));
            }
        }
        let in_order = self.stages.is_sorted_by_key(|stage| stage.unknowns);
        let ends = self.stages.last().is_some_and(|stage| stage.unknowns == Unknowns::Clothes);
        let some = self.stages.iter().all(|stage| stage.samples > 0) && self.starts > 0;
        if in_order && ends && some {
            return Ok(());
        }
        Err(Error::argument(
            "configuration: `stages`, `starts`: expected stages with samples, in order of their unknowns, the \
             last with clothes, and at least one start",
        ))
    }

    /// Largest number of samples of a stage.
    pub(crate) fn samples(&self) -> usize {
        self.stages.iter().map(|stage| stage.samples).max().unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn configurations_that_solve_nothing_are_refused() {
        let good = ScanConfig::default();
        assert!(good.check().is_ok());
        assert!(good.samples() >= 1000);
        let refused = |change: fn(&mut ScanConfig)| {
            let mut config = ScanConfig::default();
            change(&mut config);
            config.check().unwrap_err().to_string()
        };
        assert!(refused(|config| config.stages.clear()).contains("stages"));
        assert!(refused(|config| config.stages.reverse()).contains("in order"));
        assert!(refused(|config| config.stages.truncate(2)).contains("clothes"));
        assert!(refused(|config| config.starts = 0).contains("starts"));
        assert!(refused(|config| config.stages[0].robust_scale = 0.0).contains("robust_scale"));
        assert!(refused(|config| config.code = f64::NAN).contains("code"));
    }
}
