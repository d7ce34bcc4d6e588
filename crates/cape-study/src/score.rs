//! Shares of generated pictures that were taken for real.

use std::collections::{BTreeMap, BTreeSet};

use cape_core::Outfit;
use cape_stats::bootstrap::ConfidenceInterval;
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use serde::Serialize;

use crate::{Answer, PairKind, StudyCase, StudyDesign, krippendorff_alpha};

/// Number of resamples of raters and pairs.
const RESAMPLES: usize = 2000;

/// Rules by which answers count.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ScoreOptions {
    /// Smallest share of catch pairs that a rater must answer rightly, 0 to 1.
    pub catch_share: f64,
    /// Answers faster than this are left out, milliseconds.
    pub fastest_ms: f64,
}

impl Default for ScoreOptions {
    fn default() -> Self {
        Self { catch_share: 0.75, fastest_ms: 200.0 }
    }
}

/// A rater whose answers are left out.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ExcludedRater {
    /// Name.
    pub rater: String,
    /// Share of the catch pairs that were answered rightly.
    pub catch_share: f64,
}

/// Score of the pairs of one case, or of one outfit in it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CaseScore {
    /// Kind of bodies.
    pub case: StudyCase,
    /// Outfit; none for all of the case.
    pub outfit: Option<Outfit>,
    /// Number of pairs with answers.
    pub pairs: usize,
    /// Number of raters.
    pub raters: usize,
    /// Number of answers.
    pub answers: usize,
    /// Share of answers that took the generated picture for real.
    pub share: f64,
    /// 95 % interval of the share over raters and pairs; none for one rater or one pair.
    pub interval: Option<ConfidenceInterval>,
    /// Krippendorff's alpha between raters.
    pub agreement: Option<f64>,
    /// Share in the paper.
    pub paper: Option<f64>,
}

/// Result of a study.
///
/// ```
/// use cape_core::Outfit;
/// use cape_study::{
///     PairKind, RaterModel, ScoreOptions, Stimulus, StimulusPair, StudyCase, StudyDesign, StudyScore,
///     stimulus_name,
/// };
///
/// let stimulus = |text: &str| Stimulus { file: stimulus_name(text.as_bytes()), frame: 0 };
/// let pairs = (0..40).map(|pair| StimulusPair {
///     kind: PairKind::Scored,
///     case: StudyCase::Poses,
///     outfit: Outfit::SHORT_LONG,
///     real: stimulus(&format!("real {pair}")),
///     generated: stimulus(&format!("generated {pair}")),
/// });
/// let design = StudyDesign::new(7, 40, ["registrations", "runs/cape"], pairs.collect())?;
/// let raters = RaterModel { share: 0.35, rater_deviation: 0.3, pair_deviation: 0.3 };
/// let score = StudyScore::new(&design, &raters.answers(&design, 30, 1), ScoreOptions::default());
/// let interval = score.cases[0].interval.ok_or("one rater or pair only")?;
/// assert!(interval.low < 0.35 && 0.35 < interval.high && interval.high < 0.5);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StudyScore {
    /// Rules by which answers count.
    pub options: ScoreOptions,
    /// Number of raters whose answers count.
    pub raters: usize,
    /// Raters that failed the catch pairs.
    pub excluded: Vec<ExcludedRater>,
    /// Number of answers that were too fast.
    pub too_fast: usize,
    /// Share of answers that chose the left side.
    pub left: f64,
    /// Median time of an answer, milliseconds.
    pub median_ms: f64,
    /// Cases, each followed by its outfits if it has several.
    pub cases: Vec<CaseScore>,
}

impl StudyScore {
    /// Scores answers; of each rater and pair there is one at most.
    pub fn new(design: &StudyDesign, answers: &[Answer], options: ScoreOptions) -> Self {
        let excluded = excluded(design, answers, options.catch_share);
        let out: BTreeSet<&str> = excluded.iter().map(|rater| rater.rater.as_str()).collect();
        let of_included: Vec<&Answer> = answers
            .iter()
            .filter(|answer| design.pairs[answer.trial.pair].kind == PairKind::Scored)
            .filter(|answer| !out.contains(answer.rater.as_str()))
            .collect();
        let kept: Vec<&Answer> =
            of_included.iter().copied().filter(|a| a.rt_ms >= options.fastest_ms).collect();
        let mut times: Vec<f64> = kept.iter().map(|answer| answer.rt_ms).collect();
        times.sort_by(f64::total_cmp);
        let left = kept.iter().filter(|a| a.chosen == a.trial.left).count();
        let mut cases = Vec::new();
        for case in StudyCase::ALL {
            let mut of_outfit: BTreeMap<&str, Vec<&Answer>> = BTreeMap::new();
            let mut of_case = Vec::new();
            for &answer in &kept {
                let pair = &design.pairs[answer.trial.pair];
                if pair.case == case {
                    of_outfit.entry(pair.outfit.name()).or_default().push(answer);
                    of_case.push(answer);
                }
            }
            cases.extend(CaseScore::new(design, &of_case, case, None));
            if of_outfit.len() > 1 {
                cases.extend(of_outfit.values().filter_map(|answers| {
                    let outfit = design.pairs[answers[0].trial.pair].outfit;
                    CaseScore::new(design, answers, case, Some(outfit))
                }));
            }
        }
        Self {
            options,
            raters: kept.iter().map(|answer| &answer.rater).collect::<BTreeSet<_>>().len(),
            excluded,
            too_fast: of_included.len() - kept.len(),
            left: left as f64 / kept.len().max(1) as f64,
            median_ms: times.get(times.len() / 2).copied().unwrap_or(0.0),
            cases,
        }
    }
}

/// Raters that answered fewer catch pairs rightly than `least`.
fn excluded(design: &StudyDesign, answers: &[Answer], least: f64) -> Vec<ExcludedRater> {
    let mut catches: BTreeMap<&str, (usize, usize)> = BTreeMap::new();
    for answer in answers {
        if design.pairs[answer.trial.pair].kind == PairKind::Catch {
            let (right, count) = catches.entry(&answer.rater).or_default();
            *right += usize::from(!answer.is_fooled(design));
            *count += 1;
        }
    }
    let shares = catches.into_iter().map(|(rater, (right, count))| ExcludedRater {
        rater: rater.to_owned(),
        catch_share: right as f64 / count as f64,
    });
    shares.filter(|rater| rater.catch_share < least).collect()
}

impl CaseScore {
    /// The score of `answers`; `None` without any.
    fn new(
        design: &StudyDesign,
        answers: &[&Answer],
        case: StudyCase,
        outfit: Option<Outfit>,
    ) -> Option<Self> {
        if answers.is_empty() {
            return None;
        }
        let raters: BTreeSet<&str> = answers.iter().map(|answer| answer.rater.as_str()).collect();
        let raters: BTreeMap<&str, usize> = raters.into_iter().zip(0..).collect();
        let pairs: BTreeSet<usize> = answers.iter().map(|answer| answer.trial.pair).collect();
        let pairs: BTreeMap<usize, usize> = pairs.into_iter().zip(0..).collect();
        let ratings: Vec<Rating> = answers
            .iter()
            .map(|answer| Rating {
                rater: raters[answer.rater.as_str()],
                pair: pairs[&answer.trial.pair],
                fooled: answer.is_fooled(design),
            })
            .collect();
        let mut units = vec![Vec::new(); pairs.len()];
        for rating in &ratings {
            units[rating.pair].push(rating.fooled);
        }
        let fooled = ratings.iter().filter(|rating| rating.fooled).count();
        Some(Self {
            case,
            outfit,
            pairs: pairs.len(),
            raters: raters.len(),
            answers: answers.len(),
            share: fooled as f64 / answers.len() as f64,
            interval: interval(&ratings, raters.len(), pairs.len(), design.seed),
            agreement: krippendorff_alpha(&units),
            paper: if outfit.is_none() { case.paper() } else { None },
        })
    }
}

struct Rating {
    rater: usize,
    pair: usize,
    fooled: bool,
}

/// 95 % percentile interval by resampling raters and pairs, each with replacement; an answer counts as
/// often as its rater times its pair (Owen's pigeonhole bootstrap).
fn interval(
    ratings: &[Rating],
    raters: usize,
    pairs: usize,
    seed: u64,
) -> Option<ConfidenceInterval> {
    if raters < 2 || pairs < 2 {
        return None;
    }
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut weights = |count: usize| {
        let mut weights = vec![0.0; count];
        (0..count).for_each(|_| weights[rng.random_range(0..count as u64) as usize] += 1.0);
        weights
    };
    let mut shares = Vec::with_capacity(RESAMPLES);
    for _ in 0..RESAMPLES {
        let (of_rater, of_pair): (Vec<f64>, Vec<f64>) = (weights(raters), weights(pairs));
        let (mut fooled, mut total) = (0.0, 0.0);
        for rating in ratings {
            let weight = of_rater[rating.rater] * of_pair[rating.pair];
            total += weight;
            fooled += if rating.fooled { weight } else { 0.0 };
        }
        if total > 0.0 {
            shares.push(fooled / total);
        }
    }
    shares.sort_by(f64::total_cmp);
    let last = shares.len().checked_sub(1)?;
    let quantile = |share: f64| shares[(last as f64 * share).round() as usize];
    Some(ConfidenceInterval { low: quantile(0.025), high: quantile(0.975) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{RaterModel, simulation::tests::design};

    /// At least 93 % of the intervals contain the raters' known preference.
    #[test]
    fn intervals_cover_the_preference_of_simulated_raters() {
        let design = design(40, 0, 0, 20);
        let model = RaterModel { share: 0.38, rater_deviation: 0.5, pair_deviation: 0.5 };
        let studies = 200;
        let contained = (0..studies).filter(|&study| {
            let answers = model.answers(&design, 20, study);
            let score = StudyScore::new(&design, &answers, ScoreOptions::default());
            let interval = score.cases[0].interval.unwrap();
            interval.low <= model.share && model.share <= interval.high
        });
        let contained = contained.count();
        assert!((186..=200).contains(&contained), "{contained} of {studies}");
    }

    #[test]
    fn careless_raters_and_hasty_answers_are_left_out() {
        let design = design(8, 4, 2, 8);
        let model = RaterModel { share: 0.4, rater_deviation: 0.0, pair_deviation: 0.0 };
        let mut answers = model.answers(&design, 6, 1);
        for answer in &mut answers {
            let pair = &design.pairs[answer.trial.pair];
            if answer.rater == "2" {
                answer.chosen = pair.generated.file.clone();
            }
        }
        let hasty = answers.iter_mut().find(|answer| {
            answer.rater == "0" && design.pairs[answer.trial.pair].kind == PairKind::Scored
        });
        hasty.unwrap().rt_ms = 100.0;
        let score = StudyScore::new(&design, &answers, ScoreOptions::default());
        let out = ExcludedRater { rater: "2".into(), catch_share: 0.0 };
        assert_eq!((score.raters, &score.excluded[..], score.too_fast), (5, &[out][..], 1));
        let [all, outfits @ ..] = &score.cases[..] else { panic!("no case") };
        assert_eq!((all.answers, all.pairs, outfits.len()), (39, 8, 4));
        assert_eq!(outfits.iter().map(|case| case.answers).sum::<usize>(), 39);
        assert_eq!((all.paper, outfits[0].paper), (Some(0.387), None));
        assert!(StudyScore::new(&design, &[], ScoreOptions::default()).cases.is_empty());
    }
}
