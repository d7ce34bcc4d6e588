use std::collections::BTreeSet;

use cape_core::Outfit;
use serde::{Deserialize, Serialize};

use super::{BenchmarkCase, FitError};
use crate::Result;
use cape_stats::PairedComparison;

/// Mean, median and maximum of a value over the cases.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ValueSummary {
    /// Mean.
    pub mean: f64,
    /// Median.
    pub median: f64,
    /// Maximum.
    pub most: f64,
}

/// Scores of one method over the cases.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MethodScores {
    /// Mean squared distance at clothing vertices, m².
    pub squared: ValueSummary,
    /// Mean distance at clothing vertices, millimetres.
    pub distance_mm: ValueSummary,
    /// Intersection over union of the silhouettes, 0 to 1.
    pub intersection_over_union: ValueSummary,
    /// Duration of a fit, seconds.
    pub seconds: ValueSummary,
}

/// Scores of the cases in one outfit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct OutfitSummary {
    /// Outfit.
    pub outfit: Outfit,
    /// Number of images.
    pub images: usize,
    /// Scores of the unclothed body of SMPLify.
    pub bare: MethodScores,
    /// Scores of the clothed body.
    pub clothed: MethodScores,
}

/// Summary of the benchmark.
///
/// ```
/// use cape_core::Outfit;
/// use cape_fit::{
///     BodyParameters,
///     benchmark::{BenchmarkCase, FitError, BenchmarkSummary},
/// };
///
/// // Three images where clothing reduces the error from 20 mm to 10 mm.
/// let error = |distance_mm: f64| FitError {
///     squared: 1e-6 * distance_mm * distance_mm,
///     distance_mm,
///     intersection_over_union: 0.9,
///     seconds: 1.0,
/// };
/// let body = BodyParameters::new(vec![0.0; 72], Vec::new())?;
/// let cases = [0, 1, 2].map(|frame| BenchmarkCase {
///     frame,
///     capture: Some("anna".into()),
///     outfit: Outfit::LONG_LONG,
///     bare: error(20.0),
///     clothed: error(10.0),
///     problem: None,
///     bare_body: body.clone(),
///     clothed_body: body.clone(),
///     code: vec![0.0],
/// });
/// let summary = BenchmarkSummary::from_cases(&cases, 1)?;
/// assert_eq!((summary.images, summary.captures, summary.failed), (3, Some(1), 0));
/// assert_eq!((summary.bare.distance_mm.mean, summary.clothed.distance_mm.median), (20.0, 10.0));
/// assert_eq!((summary.distance_mm.wins, summary.outfits[0].images), (3, 3));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BenchmarkSummary {
    /// Number of images.
    pub images: usize,
    /// Number of different captures; `None` if they are unknown.
    pub captures: Option<usize>,
    /// Scores of the unclothed body of SMPLify.
    pub bare: MethodScores,
    /// Scores of the clothed body.
    pub clothed: MethodScores,
    /// Comparison of the squared distances, m², clothed against unclothed.
    pub squared: PairedComparison,
    /// Comparison of the distances, millimetres, clothed against unclothed.
    pub distance_mm: PairedComparison,
    /// Number of unreliable fits.
    pub failed: usize,
    /// Comparison of the squared distances of the reliable fits; `None` if there is none.
    pub squared_of_trusted: Option<PairedComparison>,
    /// Summaries by outfit.
    pub outfits: Vec<OutfitSummary>,
}

impl BenchmarkSummary {
    /// Summary of `cases`; `seed` is the random seed of the bootstrap.
    ///
    /// # Errors
    /// If there is no case.
    pub fn from_cases(cases: &[BenchmarkCase], seed: u64) -> Result<Self> {
        let all: Vec<&BenchmarkCase> = cases.iter().collect();
        let trusted: Vec<&BenchmarkCase> =
            cases.iter().filter(|case| case.problem.is_none()).collect();
        let of_outfit = |outfit| {
            let worn: Vec<&BenchmarkCase> =
                cases.iter().filter(|case| case.outfit == outfit).collect();
            OutfitSummary {
                outfit,
                images: worn.len(),
                bare: score(&worn, |case| &case.bare),
                clothed: score(&worn, |case| &case.clothed),
            }
        };
        let outfits: BTreeSet<Outfit> = cases.iter().map(|case| case.outfit).collect();
        let captures: Option<BTreeSet<&str>> =
            cases.iter().map(|case| case.capture.as_deref()).collect();
        let squared = |error: &FitError| error.squared;
        Ok(Self {
            images: cases.len(),
            captures: captures.map(|captures| captures.len()),
            bare: score(&all, |case| &case.bare),
            clothed: score(&all, |case| &case.clothed),
            squared: compare_paired(&all, seed, squared)?,
            distance_mm: compare_paired(&all, seed, |error| error.distance_mm)?,
            failed: cases.len() - trusted.len(),
            squared_of_trusted: match trusted.as_slice() {
                [] => None,
                trusted => Some(compare_paired(trusted, seed, squared)?),
            },
            outfits: outfits.into_iter().map(of_outfit).collect(),
        })
    }
}

fn compare_paired(
    cases: &[&BenchmarkCase],
    seed: u64,
    of: fn(&FitError) -> f64,
) -> Result<PairedComparison> {
    let [bare, clothed]: [Vec<f64>; 2] =
        [|case: &BenchmarkCase| case.bare, |case: &BenchmarkCase| case.clothed]
            .map(|method| cases.iter().map(|case| of(&method(case))).collect());
    Ok(PairedComparison::new(&bare, &clothed, seed)?)
}

fn score(cases: &[&BenchmarkCase], method: fn(&BenchmarkCase) -> &FitError) -> MethodScores {
    let spread = |of: fn(&FitError) -> f64| {
        let mut values: Vec<f64> = cases.iter().map(|case| of(method(case))).collect();
        values.sort_by(f64::total_cmp);
        let at = |index: usize| values.get(index).copied().unwrap_or(0.0);
        let count = values.len();
        ValueSummary {
            mean: values.iter().sum::<f64>() / count.max(1) as f64,
            median: 0.5 * (at(count / 2) + at(count.saturating_sub(1) / 2)),
            most: at(count.saturating_sub(1)),
        }
    };
    MethodScores {
        squared: spread(|error| error.squared),
        distance_mm: spread(|error| error.distance_mm),
        intersection_over_union: spread(|error| error.intersection_over_union),
        seconds: spread(|error| error.seconds),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{BodyParameters, FitProblem};

    fn case(frame: usize, squared: [f64; 2], problem: Option<&str>) -> BenchmarkCase {
        let error = |squared: f64| FitError {
            squared,
            distance_mm: 1000.0 * squared.sqrt(),
            intersection_over_union: 0.9,
            seconds: frame as f64,
        };
        let body = BodyParameters::new(vec![0.0; 72], Vec::new()).unwrap();
        BenchmarkCase {
            frame,
            capture: Some(format!("capture {}", frame / 2)),
            outfit: Outfit::PAPER[frame % 2],
            bare: error(squared[0]),
            clothed: error(squared[1]),
            problem: problem.map(|reason| FitProblem::Failed(reason.to_owned())),
            bare_body: body.clone(),
            clothed_body: body,
            code: vec![0.5],
        }
    }

    #[test]
    fn cases_are_counted_and_averaged() {
        let cases = [
            case(0, [4.0, 1.0], None),
            case(1, [1.0, 1.0], None),
            case(2, [1.0, 4.0], Some("lost")),
            case(3, [2.0, 1.0], None),
        ];
        let summary = BenchmarkSummary::from_cases(&cases, 1).unwrap();
        assert_eq!((summary.images, summary.captures, summary.failed), (4, Some(2), 1));
        assert_eq!(summary.bare.squared, ValueSummary { mean: 2.0, median: 1.5, most: 4.0 });
        assert_eq!(summary.clothed.squared.median, 1.0);
        assert_eq!((summary.squared.wins, summary.squared.difference), (2, -0.25));
        let trusted = summary.squared_of_trusted.unwrap();
        assert_eq!((trusted.images, trusted.improvement), (3, 1.0 - 3.0 / 7.0));
        let outfits: Vec<usize> = summary.outfits.iter().map(|outfit| outfit.images).collect();
        assert_eq!(outfits, [2, 2]);
        assert_eq!(summary.outfits[1].bare.seconds.mean, 2.0);
        let lost = BenchmarkSummary::from_cases(&cases[2..3], 1).unwrap();
        assert_eq!(lost.squared_of_trusted, None);
        assert!(BenchmarkSummary::from_cases(&[], 1).is_err());
    }
}
