//! Whether one method is better than another on the same images.

use std::f64::consts::PI;

use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use serde::{Deserialize, Serialize};

use crate::{Error, Result};

/// Resamples of the bootstrap.
const RESAMPLES: usize = 4000;
/// Pairs up to which the distribution of the signed-rank sum is computed exactly.
const EXACT: usize = 600;

/// Two methods' errors on the same images, compared.
///
/// ```
/// use cape_stats::PairedComparison;
///
/// // The second method's error is half the first's on all of six images.
/// let paired = PairedComparison::new(&[2.0; 6], &[1.0; 6], 1)?;
/// assert_eq!((paired.difference, paired.improvement), (-1.0, 0.5));
/// assert_eq!((paired.wins, paired.images), (6, 6));
/// // Of the 2⁶ ways to sign them two are as extreme.
/// assert!((paired.wilcoxon - 2.0 / 64.0).abs() < 1e-9);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PairedComparison {
    /// Mean of the second less that of the first.
    pub difference: f64,
    /// An interval that contains it in 95 of 100 such sets of images, by bootstrap.
    pub interval: [f64; 2],
    /// By which part the second's mean is lower.
    pub improvement: f64,
    /// The same of that.
    pub improvement_interval: [f64; 2],
    /// Probability of signed ranks as uneven if none were better (Wilcoxon 1945, both sides).
    pub wilcoxon: f64,
    /// Images in which the second's is lower.
    pub wins: usize,
    /// Images.
    pub images: usize,
}

impl PairedComparison {
    /// Of errors of both methods, image by image; `seed` fixes the resamples.
    ///
    /// # Errors
    /// If there is no image, there are not as many errors of both, or one is not finite.
    pub fn new(first: &[f64], second: &[f64], seed: u64) -> Result<Self> {
        if first.is_empty() || first.len() != second.len() {
            return Err(Error::argument(format!(
                "errors of {} and {} images, expected as many of both, at least one",
                first.len(),
                second.len()
            )));
        }
        if first.iter().chain(second).any(|error| !error.is_finite()) {
            return Err(Error::argument("an error to compare is not finite"));
        }
        let count = first.len();
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let resampled: Vec<[f64; 2]> = (0..RESAMPLES)
            .map(|_| compared(first, second, (0..count).map(|_| rng.random_range(0..count))))
            .collect();
        let interval = |of: usize| {
            let mut values: Vec<f64> = resampled.iter().map(|pair| pair[of]).collect();
            values.sort_by(f64::total_cmp);
            [0.025, 0.975].map(|at: f64| values[((RESAMPLES - 1) as f64 * at).round() as usize])
        };
        let [difference, improvement] = compared(first, second, 0..count);
        let differences: Vec<f64> = second.iter().zip(first).map(|(b, a)| b - a).collect();
        Ok(Self {
            difference,
            interval: interval(0),
            improvement,
            improvement_interval: interval(1),
            wilcoxon: signed_rank(&differences),
            wins: differences.iter().filter(|&&difference| difference < 0.0).count(),
            images: count,
        })
    }
}

/// Difference of the means over the images named, and the second's improvement.
fn compared(first: &[f64], second: &[f64], images: impl Iterator<Item = usize>) -> [f64; 2] {
    let (mut a, mut b, mut count) = (0.0, 0.0, 0.0);
    for image in images {
        a += first[image];
        b += second[image];
        count += 1.0;
    }
    [(b - a) / count, if a > 0.0 { 1.0 - b / a } else { 0.0 }]
}

/// The two-sided probability of Wilcoxon's signed-rank test. Differences of zero are left out, equal
/// ones share their ranks.
fn signed_rank(differences: &[f64]) -> f64 {
    let mut sorted: Vec<f64> = differences.iter().copied().filter(|&d| d != 0.0).collect();
    sorted.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
    // Twice the ranks, which shared ones make whole.
    let mut ranks = Vec::with_capacity(sorted.len());
    for group in sorted.chunk_by(|a, b| a.abs() == b.abs()) {
        let (before, size) = (ranks.len(), group.len());
        ranks.resize(before + size, 2 * before + size + 1);
    }
    let total: usize = ranks.iter().sum();
    let positive = ranks.iter().zip(&sorted).filter(|(_, d)| **d > 0.0).map(|(rank, _)| rank);
    let positive: usize = positive.sum();
    let smaller = positive.min(total - positive);
    let tail = if ranks.len() <= EXACT {
        lower_tail(&ranks, smaller)
    } else {
        let mean = 0.5 * total as f64;
        let deviation = 0.5 * ranks.iter().map(|&rank| (rank * rank) as f64).sum::<f64>().sqrt();
        normal_tail((mean - smaller as f64 - 1.0).max(0.0) / deviation)
    };
    (2.0 * tail).min(1.0)
}

/// Probability that the ranks of fair coins' heads add up to at most `most`.
fn lower_tail(ranks: &[usize], most: usize) -> f64 {
    let mut probability = vec![0.0; most + 1];
    probability[0] = 1.0;
    for &rank in ranks {
        for sum in (0..=most).rev() {
            let with = if sum >= rank { probability[sum - rank] } else { 0.0 };
            probability[sum] = 0.5 * (probability[sum] + with);
        }
    }
    probability.iter().sum()
}

/// Probability that a standard normal variable exceeds `x`, at least 0: by its series near 0, by
/// Laplace's continued fraction farther out.
fn normal_tail(x: f64) -> f64 {
    let density = (-0.5 * x * x).exp() / (2.0 * PI).sqrt();
    if x < 3.0 {
        let (mut term, mut sum) = (x, x);
        for k in 1..60 {
            term *= x * x / f64::from(2 * k + 1);
            sum += term;
        }
        0.5 - density * sum
    } else {
        density / (1..60).rev().fold(x, |below, k| x + f64::from(k) / below)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rand::RngExt;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]

        /// All changes of signs, with ties.
        #[test]
        fn the_test_is_that_of_all_changes_of_signs(
            tenths in prop::collection::vec(-6i32..=6, 1..11),
        ) {
            let differences: Vec<f64> = tenths.iter().map(|&d| 0.1 * f64::from(d)).collect();
            let sizes: Vec<f64> =
                differences.iter().map(|d| d.abs()).filter(|&d| d > 0.0).collect();
            let rank = |size: f64| {
                let below = sizes.iter().filter(|&&s| s < size).count() as f64;
                let same = sizes.iter().filter(|&&s| s == size).count() as f64;
                below + 0.5 * (same + 1.0)
            };
            let total: f64 = sizes.iter().map(|&s| rank(s)).sum();
            let uneven = |positive: f64| (positive - 0.5 * total).abs();
            let found: f64 = differences.iter().filter(|&&d| d > 0.0).map(|d| rank(d.abs())).sum();
            let all = 1usize << sizes.len();
            let extreme = (0..all).filter(|signs| {
                let heads = sizes.iter().enumerate().filter(|(k, _)| signs >> k & 1 == 1);
                uneven(heads.map(|(_, &s)| rank(s)).sum()) >= uneven(found) - 1e-9
            });
            let expected = extreme.count() as f64 / all as f64;
            prop_assert!((signed_rank(&differences) - expected).abs() < 1e-12);
        }
    }

    #[test]
    fn the_approximation_meets_the_exact_distribution() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let ranks: Vec<usize> = (1..=EXACT).map(|rank| 2 * rank).collect();
        let total: usize = ranks.iter().sum();
        let deviation = 0.5 * ranks.iter().map(|&r| (r * r) as f64).sum::<f64>().sqrt();
        for z in [0.1, 1.0, 2.0, 2.9, 3.1, 4.0] {
            let sum = (0.5 * total as f64 - z * deviation) as usize / 2 * 2;
            let exact = lower_tail(&ranks, sum);
            let found = normal_tail((0.5 * total as f64 - sum as f64 - 1.0) / deviation);
            assert!((found / exact - 1.0).abs() < 0.06, "{z}: {found} {exact}");
        }
        assert!((normal_tail(1.959_963_985) - 0.025).abs() < 1e-9);
        assert!((normal_tail(2.999_999) / normal_tail(3.000_001) - 1.0).abs() < 1e-4);
        let many: Vec<f64> = (0..2 * EXACT).map(|_| StandardNormal.sample(&mut rng)).collect();
        assert!(signed_rank(&many) > 0.001);
    }

    #[test]
    fn what_is_better_is_found_and_what_is_not_is_not() {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let (mut contained, mut found) = (0, 0);
        for seed in 0..100 {
            let mut draw = || -> Vec<f64> {
                (0..40).map(|_| 5.0 + rng.sample::<f64, _>(StandardNormal)).collect()
            };
            let paired = PairedComparison::new(&draw(), &draw(), seed).unwrap();
            contained += usize::from(paired.interval[0] <= 0.0 && 0.0 <= paired.interval[1]);
            found += usize::from(paired.wilcoxon < 0.05);
        }
        assert!((85..=100).contains(&contained), "{contained}");
        assert!(found <= 12, "{found}");

        let first: Vec<f64> = (1..=10).map(f64::from).collect();
        let second: Vec<f64> = first.iter().map(|x| 0.5 * x).collect();
        let paired = PairedComparison::new(&first, &second, 1).unwrap();
        assert_eq!((paired.wins, paired.images, paired.difference), (10, 10, -2.75));
        assert_eq!(paired.improvement_interval, [0.5, 0.5]);
        assert_eq!(paired.wilcoxon, 2.0 / 1024.0);
        assert_eq!(PairedComparison::new(&first, &second, 1).unwrap(), paired);
        let same = PairedComparison::new(&first, &first, 1).unwrap();
        assert_eq!((same.wins, same.wilcoxon), (0, 1.0));
        assert!(PairedComparison::new(&[], &[], 1).is_err());
        assert!(PairedComparison::new(&[f64::NAN], &[1.0], 1).is_err());
    }
}
