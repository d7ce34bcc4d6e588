//! Comparison of two methods on the same images.

use serde::{Deserialize, Serialize};

use crate::{Error, Result, bootstrap::percentile_intervals, paired_test::wilcoxon_signed_rank};

/// Paired comparison of the errors of two methods on the same images.
///
/// ```
/// use cape_stats::PairedComparison;
///
/// // The error of the second method is half that of the first on all six images.
/// let paired = PairedComparison::new(&[2.0; 6], &[1.0; 6], 1)?;
/// assert_eq!((paired.difference, paired.improvement), (-1.0, 0.5));
/// assert_eq!((paired.wins, paired.images), (6, 6));
/// // 2 of the 2⁶ sign changes are as extreme.
/// assert!((paired.wilcoxon - 2.0 / 64.0).abs() < 1e-9);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PairedComparison {
    /// Mean error of the second method minus that of the first.
    pub difference: f64,
    /// 95 % confidence interval of the difference, by bootstrap over images.
    pub interval: [f64; 2],
    /// Relative reduction of the mean error by the second method.
    pub improvement: f64,
    /// 95 % confidence interval of the reduction, by bootstrap over images.
    pub improvement_interval: [f64; 2],
    /// Two-sided p-value of Wilcoxon's signed-rank test.
    pub wilcoxon: f64,
    /// Number of images on which the second method has the lower error.
    pub wins: usize,
    /// Number of images.
    pub images: usize,
}

impl PairedComparison {
    /// Compares the errors of both methods, `[images]`; `seed` is that of the bootstrap.
    ///
    /// # Errors
    /// If the numbers of errors differ or are zero, or an error is not finite.
    pub fn new(first: &[f64], second: &[f64], seed: u64) -> Result<Self> {
        if first.is_empty() || first.len() != second.len() {
            return Err(Error::argument(format!(
                "errors of {} and {} images: expected equal numbers, at least 1",
                first.len(),
                second.len()
            )));
        }
        if first.iter().chain(second).any(|error| !error.is_finite()) {
            return Err(Error::argument("paired comparison: an error is not finite"));
        }
        let count = first.len();
        let intervals = percentile_intervals(count, seed, |images| {
            compare_means(first, second, images.iter().copied())
        });
        let [interval, improvement_interval] =
            intervals.map(|interval| [interval.low, interval.high]);
        let [difference, improvement] = compare_means(first, second, 0..count);
        let differences: Vec<f64> = second.iter().zip(first).map(|(b, a)| b - a).collect();
        Ok(Self {
            difference,
            interval,
            improvement,
            improvement_interval,
            wilcoxon: wilcoxon_signed_rank(&differences),
            wins: differences.iter().filter(|&&difference| difference < 0.0).count(),
            images: count,
        })
    }
}

/// Difference and relative reduction of the mean errors over `images`.
fn compare_means(first: &[f64], second: &[f64], images: impl Iterator<Item = usize>) -> [f64; 2] {
    let (mut a, mut b, mut count) = (0.0, 0.0, 0.0);
    for image in images {
        a += first[image];
        b += second[image];
        count += 1.0;
    }
    [(b - a) / count, if a > 0.0 { 1.0 - b / a } else { 0.0 }]
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
    use rand_distr::StandardNormal;

    use super::*;

    #[test]
    fn intervals_and_p_values_are_calibrated() {
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
