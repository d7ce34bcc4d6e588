//! Simulated raters, and the precision that a number of raters will give.

use std::collections::HashMap;

use cape_core::{Error, Result};
use rand::{SeedableRng, rngs::ChaCha8Rng};
use rand_distr::{Distribution, StandardNormal};
use serde::Serialize;

use crate::{Answer, PairKind, StudyCase, StudyDesign};

/// Number of simulated studies.
const STUDIES: usize = 400;
/// Largest number of simulated raters.
const MOST_RATERS: usize = 10_000;
/// Quantile of the standard normal distribution of a two-sided test at 5 %.
const TWO_SIDED: f64 = 1.96;

/// Raters of known preference: a generated picture is taken for real if a threshold is exceeded by the
/// sum of the rater's, the pair's and the trial's deviation, all normal, the last of variance 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RaterModel {
    /// Expected share of generated pictures that are taken for real.
    pub share: f64,
    /// Standard deviation between raters.
    pub rater_deviation: f64,
    /// Standard deviation between pairs.
    pub pair_deviation: f64,
}

impl RaterModel {
    /// Answers of raters `0..raters` to their schedules; catch and practice pairs are answered rightly.
    pub fn answers(&self, design: &StudyDesign, raters: usize, seed: u64) -> Vec<Answer> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut normal = |deviation: f64| -> f64 {
            let x: f64 = StandardNormal.sample(&mut rng);
            deviation * x
        };
        let variance = 1.0 + self.rater_deviation.powi(2) + self.pair_deviation.powi(2);
        let threshold = normal_quantile(self.share) * variance.sqrt();
        let pairs: Vec<f64> = design.pairs.iter().map(|_| normal(self.pair_deviation)).collect();
        let mut answers = Vec::new();
        for rater in 0..raters {
            let own = normal(self.rater_deviation);
            for trial in design.schedule(rater) {
                let pair = &design.pairs[trial.pair];
                let fooled = pair.kind == PairKind::Scored
                    && threshold + own + pairs[trial.pair] + normal(1.0) > 0.0;
                let chosen = if fooled { &pair.generated } else { &pair.real };
                let chosen = chosen.file.clone();
                answers.push(Answer { rater: format!("{rater}"), trial, chosen, rt_ms: 2000.0 });
            }
        }
        answers
    }
}

/// Precision of a planned study for one case.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PlannedPrecision {
    /// Kind of bodies.
    pub case: StudyCase,
    /// Number of raters.
    pub raters: usize,
    /// Mean number of answers to a pair.
    pub answers_per_pair: f64,
    /// Assumed share of generated pictures that are taken for real.
    pub share: f64,
    /// Standard deviation of the measured share.
    pub deviation: f64,
    /// Share of studies that tell the assumed share from one half, at a level of 5 %.
    pub power: f64,
    /// Distance from one half that four of five studies will find.
    pub detectable: f64,
}

/// Precision of the study for each case with `raters` raters of the `model`, by simulation; without a
/// share in `share`, that of the paper, or 0.4 where it has none.
///
/// # Errors
/// If there are no raters or very many, or the share is not between 0 and 1.
pub fn plan(
    design: &StudyDesign,
    raters: usize,
    share: Option<f64>,
    deviations: [f64; 2],
) -> Result<Vec<PlannedPrecision>> {
    if !(1..=MOST_RATERS).contains(&raters) {
        return Err(Error::argument(format!("{raters} raters: expected 1 to {MOST_RATERS}")));
    }
    if share.is_some_and(|share| share <= 0.0 || share >= 1.0) {
        return Err(Error::argument("expected share: must be between 0 and 1".to_string()));
    }
    let mut rows = Vec::new();
    for case in StudyCase::ALL {
        let pairs = design.pairs.iter();
        let pairs = pairs.filter(|p| p.kind == PairKind::Scored && p.case == case).count();
        if pairs == 0 {
            continue;
        }
        let share = share.or(case.paper()).unwrap_or(0.4);
        let [rater_deviation, pair_deviation] = deviations;
        let model = RaterModel { share, rater_deviation, pair_deviation };
        let trials: Vec<Vec<usize>> = (0..raters)
            .map(|rater| design.schedule(rater).iter().map(|trial| trial.pair).collect())
            .collect();
        let of_case = |pair: usize| {
            design.pairs[pair].kind == PairKind::Scored && design.pairs[pair].case == case
        };
        let shown: Vec<Vec<usize>> = trials
            .into_iter()
            .map(|pairs| pairs.into_iter().filter(|&pair| of_case(pair)).collect())
            .collect();
        let answers: usize = shown.iter().map(Vec::len).sum();
        if answers == 0 {
            continue;
        }
        let means: Vec<f64> =
            (0..STUDIES).map(|study| model.mean(&shown, design.seed ^ study as u64)).collect();
        let mean = means.iter().sum::<f64>() / STUDIES as f64;
        let square = means.iter().map(|x| (x - mean).powi(2)).sum::<f64>();
        let deviation = (square / (STUDIES - 1) as f64).sqrt();
        let found = means.iter().filter(|&x| (x - 0.5).abs() > TWO_SIDED * deviation).count();
        rows.push(PlannedPrecision {
            case,
            raters,
            answers_per_pair: answers as f64 / pairs as f64,
            share,
            deviation,
            power: found as f64 / STUDIES as f64,
            detectable: (TWO_SIDED + normal_quantile(0.8)) * deviation,
        });
    }
    Ok(rows)
}

impl RaterModel {
    /// Share of generated pictures taken for real in one study, in which rater `r` sees `shown[r]`.
    fn mean(&self, shown: &[Vec<usize>], seed: u64) -> f64 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let variance = 1.0 + self.rater_deviation.powi(2) + self.pair_deviation.powi(2);
        let threshold = normal_quantile(self.share) * variance.sqrt();
        let mut pairs: HashMap<usize, f64> = HashMap::new();
        let (mut fooled, mut count) = (0, 0);
        for shown in shown {
            let own: f64 = StandardNormal.sample(&mut rng);
            for &pair in shown {
                let of_pair: f64 =
                    *pairs.entry(pair).or_insert_with(|| StandardNormal.sample(&mut rng));
                let rest: f64 = StandardNormal.sample(&mut rng);
                let sum = self.rater_deviation * own + self.pair_deviation * of_pair + rest;
                fooled += usize::from(threshold + sum > 0.0);
                count += 1;
            }
        }
        f64::from(fooled as u32) / f64::from(count.max(1) as u32)
    }
}

/// Quantile of the standard normal distribution, to 5e-4 (Abramowitz and Stegun, 26.2.23).
fn normal_quantile(share: f64) -> f64 {
    let tail = share.min(1.0 - share).max(1e-300);
    let t = (-2.0 * tail.ln()).sqrt();
    let above = 2.515517 + t * (0.802853 + t * 0.010328);
    let below = 1.0 + t * (1.432788 + t * (0.189269 + t * 0.001308));
    (t - above / below).copysign(share - 0.5)
}

#[cfg(test)]
pub(crate) mod tests {
    use cape_core::Outfit;

    use super::*;
    use crate::{Stimulus, StimulusPair, stimulus_name};

    /// A study of the A-pose with so many scored, catch and practice pairs.
    pub(crate) fn design(
        scored: usize,
        catches: usize,
        practice: usize,
        trials: usize,
    ) -> StudyDesign {
        let kinds = [
            (PairKind::Scored, scored),
            (PairKind::Catch, catches),
            (PairKind::Practice, practice),
        ];
        let kinds = kinds.into_iter().flat_map(|(kind, count)| vec![kind; count]);
        let stimulus = |text: String| Stimulus { file: stimulus_name(text.as_bytes()), frame: 0 };
        let pairs = kinds.enumerate().map(|(pair, kind)| StimulusPair {
            kind,
            case: StudyCase::APose,
            outfit: Outfit::PAPER[pair % 4],
            real: stimulus(format!("real {pair}")),
            generated: stimulus(format!("generated {pair}")),
        });
        StudyDesign::new(5, trials, ["registrations", "run"], pairs.collect()).unwrap()
    }

    #[test]
    fn quantiles_are_those_of_the_tables() {
        for (share, expected) in [(0.5, 0.0), (0.975, 1.959964), (0.2, -0.841621)] {
            assert!((normal_quantile(share) - expected).abs() < 5e-4, "{share}");
        }
    }

    #[test]
    fn simulated_raters_have_the_share_they_were_given() {
        let design = design(100, 0, 0, 100);
        for share in [0.2, 0.35, 0.5] {
            let model = RaterModel { share, rater_deviation: 0.5, pair_deviation: 0.5 };
            let answers = model.answers(&design, 400, 3);
            let fooled = answers.iter().filter(|answer| answer.is_fooled(&design)).count();
            let found = fooled as f64 / answers.len() as f64;
            assert!((found - share).abs() < 0.03, "{found} for {share}");
        }
    }

    #[test]
    fn precision_of_independent_answers_is_the_binomial_one() {
        let design = design(50, 0, 0, 50);
        let [row] = &plan(&design, 8, Some(0.4), [0.0, 0.0]).unwrap()[..] else { panic!() };
        let expected = (0.4f64 * 0.6 / 400.0).sqrt();
        assert!((row.deviation / expected - 1.0).abs() < 0.1, "{row:?}");
        assert_eq!(row.answers_per_pair, 8.0);
        let [varied] = &plan(&design, 8, Some(0.4), [0.7, 0.7]).unwrap()[..] else { panic!() };
        assert!(varied.deviation > 2.0 * expected && varied.power < row.power);
        assert!(plan(&design, 0, None, [0.0; 2]).is_err());
        assert!(plan(&design, 5, Some(1.0), [0.0; 2]).is_err());
    }
}
