//! Tests of paired differences: the sign-flip (permutation) test of sums, and Wilcoxon's signed-rank
//! test, the same test of ranks.
//!
//! Null hypothesis: neither method is better, so that every difference could have the other sign.

use std::f64::consts::PI;

use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

/// Largest number of differences for which all sign changes are enumerated.
const EXACT_SIGNS: usize = 14;
/// Number of random sign changes above that.
const SIGN_CHANGES: usize = 20_000;
const SEED: u64 = 21;
/// Largest number of pairs for which the distribution of the signed-rank sum is exact.
const EXACT_RANKS: usize = 600;

/// Two-sided p-value of the sign-flip test of summed differences, one per capture; `None` for fewer
/// than two.
///
/// It is the probability of a sum of at least this size under random signs: all sign changes for at
/// most 14 differences, random ones above.
///
/// ```
/// use cape_stats::paired_test::sign_flip_test;
///
/// // 2 of the 2⁴ sign changes give a sum of at least this size.
/// assert_eq!(sign_flip_test(&[1.0, 2.0, 3.0, 4.0]), Some(2.0 / 16.0));
/// ```
pub fn sign_flip_test(differences: &[f64]) -> Option<f64> {
    let n = differences.len();
    if n < 2 {
        return None;
    }
    let size = |is_flipped: &dyn Fn(usize) -> bool| {
        let signed =
            differences.iter().enumerate().map(|(k, &d)| if is_flipped(k) { -d } else { d });
        signed.sum::<f64>().abs()
    };
    // The tolerance counts the observed signs and their negation in spite of rounding.
    let observed = size(&|_| false) * (1.0 - 1e-12);
    if n <= EXACT_SIGNS {
        let all = 1usize << n;
        let extreme = (0..all).filter(|signs| size(&|k| signs >> k & 1 == 1) >= observed).count();
        return Some(extreme as f64 / all as f64);
    }
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    let extreme = (0..SIGN_CHANGES)
        .filter(|_| {
            let signs: Vec<bool> = (0..n).map(|_| rng.random()).collect();
            size(&|k| signs[k]) >= observed
        })
        .count();
    // The observed signs are one of the possible sign changes.
    Some((extreme + 1) as f64 / (SIGN_CHANGES + 1) as f64)
}

/// Two-sided p-value of Wilcoxon's signed-rank test (1945): the sign-flip test of the signed ranks.
///
/// Zero differences are dropped, ties share their ranks. Up to [`EXACT_RANKS`] pairs the distribution
/// is exact, above it is approximated by a normal distribution.
pub(crate) fn wilcoxon_signed_rank(differences: &[f64]) -> f64 {
    let mut sorted: Vec<f64> = differences.iter().copied().filter(|&d| d != 0.0).collect();
    sorted.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
    // Ranks times two, so that shared ranks are whole numbers.
    let mut ranks = Vec::with_capacity(sorted.len());
    for group in sorted.chunk_by(|a, b| a.abs() == b.abs()) {
        let (before, size) = (ranks.len(), group.len());
        ranks.resize(before + size, 2 * before + size + 1);
    }
    let total: usize = ranks.iter().sum();
    let positive = ranks.iter().zip(&sorted).filter(|(_, d)| **d > 0.0).map(|(rank, _)| rank);
    let positive: usize = positive.sum();
    let smaller = positive.min(total - positive);
    let tail = if ranks.len() <= EXACT_RANKS {
        lower_tail(&ranks, smaller)
    } else {
        let mean = 0.5 * total as f64;
        let deviation = 0.5 * ranks.iter().map(|&rank| (rank * rank) as f64).sum::<f64>().sqrt();
        normal_tail((mean - smaller as f64 - 1.0).max(0.0) / deviation)
    };
    (2.0 * tail).min(1.0)
}

/// Probability that a random subset of `ranks`, each taken with probability ½, sums to at most `most`.
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

/// Probability that a standard normal variable exceeds `x` ≥ 0: power series below 3, Laplace's
/// continued fraction above.
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
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]

        /// Reference: enumeration of all sign changes, with ties.
        #[test]
        fn wilcoxons_test_agrees_with_all_sign_changes(
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
            let imbalance = |positive: f64| (positive - 0.5 * total).abs();
            let found: f64 = differences.iter().filter(|&&d| d > 0.0).map(|d| rank(d.abs())).sum();
            let all = 1usize << sizes.len();
            let extreme = (0..all).filter(|signs| {
                let heads = sizes.iter().enumerate().filter(|(k, _)| signs >> k & 1 == 1);
                imbalance(heads.map(|(_, &s)| rank(s)).sum()) >= imbalance(found) - 1e-9
            });
            let expected = extreme.count() as f64 / all as f64;
            prop_assert!((wilcoxon_signed_rank(&differences) - expected).abs() < 1e-12);
        }
    }

    #[test]
    fn the_normal_approximation_agrees_with_the_exact_distribution() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let ranks: Vec<usize> = (1..=EXACT_RANKS).map(|rank| 2 * rank).collect();
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
        let many: Vec<f64> =
            (0..2 * EXACT_RANKS).map(|_| StandardNormal.sample(&mut rng)).collect();
        assert!(wilcoxon_signed_rank(&many) > 0.001);
    }

    /// Without a difference, nearly 5 % of the tests reject at the 5 % level.
    #[test]
    fn the_sign_flip_test_is_calibrated() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let found = (0..300)
            .filter(|_| {
                let data: Vec<f64> = (0..24).map(|_| StandardNormal.sample(&mut rng)).collect();
                sign_flip_test(&data).unwrap() < 0.05
            })
            .count();
        assert!((4..=30).contains(&found), "{found} of 300");
    }

    #[test]
    fn few_differences_are_enumerated() {
        assert_eq!(sign_flip_test(&[1.0, 2.0, 3.0, 4.0]), Some(2.0 / 16.0));
        assert_eq!(sign_flip_test(&[1.0, -1.0]), Some(1.0));
        assert_eq!(sign_flip_test(&[1.0]), None);
    }
}
