//! Stages of a fit to a scan, coarse to fine.

use serde::{Deserialize, Serialize};

use crate::{BodyWeights, Error, Result, body_energy::check_weight};

/// What a stage solves for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Unknowns {
    /// Place and pose, in the mean clothes.
    Pose,
    /// Place, pose and shape, in the mean clothes.
    Shape,
    /// Everything, with the clothes' code.
    Clothes,
}

/// One stage.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScanStage {
    /// What is solved for.
    pub unknowns: Unknowns,
    /// Size of errors that are rather mistakes, metres.
    pub robust_scale: f64,
    /// Points of the scan.
    pub samples: usize,
    /// Most steps of the optimiser.
    pub steps: usize,
    /// λ_D of the surfaces' mean squared distance, per square metre.
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

/// How clothed bodies are fitted to scans.
///
/// ```
/// use cape_fit::scan::{ScanConfig, Unknowns};
///
/// // Coarse to fine: every stage solves for as much as the last one, and is less robust.
/// let stages = ScanConfig::default().stages;
/// assert!(stages.is_sorted_by_key(|stage| stage.unknowns));
/// assert!(stages.is_sorted_by(|first, second| first.robust_scale >= second.robust_scale));
/// assert_eq!(stages[0].unknowns, Unknowns::Pose);
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ScanConfig {
    /// Shape coefficients solved for, at most those of the body.
    pub betas: usize,
    /// Stages, in order of what they solve for.
    pub stages: Vec<ScanStage>,
    /// Starts for which the first stage is tried.
    pub starts: usize,
    /// Weight of the way from the body to the scan beside that from the scan to the body.
    pub back: f64,
    /// Weights of priors and of 3D joints, if some are known.
    pub body: BodyWeights,
    /// λ_z of the code's squared length.
    pub code: f64,
    /// Standard deviation of known joints, metres.
    pub joint_deviation: f64,
    /// Median distance of the scan's points above which the fit is said to have failed, metres.
    pub accepted: f64,
    /// The distance that 95 % of the scan's points may not exceed, metres.
    pub accepted_most: f64,
    /// Fixes which points are taken.
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
    /// Refuses what cannot be solved.
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
                    "configuration: `{field}` of {value}, expected above 0"
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
            "configuration: `stages`, `starts`: expected stages with samples, in order of what \
             they solve for, the last for clothes, and at least one start",
        ))
    }

    /// The most points of a scan that a stage takes.
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
