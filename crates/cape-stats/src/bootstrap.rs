//! Percentile bootstrap: confidence intervals by resampling with replacement.
//!
//! Frames of one capture are correlated, so that whole captures ([`Cluster`]s) are resampled, not
//! frames.

use std::collections::BTreeMap;

use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use serde::{Deserialize, Serialize};

/// Number of resamples.
const RESAMPLES: usize = 4000;
const SEED: u64 = 20;

/// Sum and count of the observations of one capture.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Cluster {
    /// Sum of the observations.
    pub sum: f64,
    /// Number of observations.
    pub count: f64,
}

/// Observations `(capture, value)` summed by capture.
pub fn clusters<'a>(
    observations: impl Iterator<Item = (&'a str, f64)>,
) -> BTreeMap<&'a str, Cluster> {
    let mut clusters: BTreeMap<&str, Cluster> = BTreeMap::new();
    for (capture, value) in observations {
        let cluster = clusters.entry(capture).or_default();
        cluster.sum += value;
        cluster.count += 1.0;
    }
    clusters
}

/// 95 % confidence interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ConfidenceInterval {
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

fn mean_of(clusters: impl Iterator<Item = Cluster>) -> f64 {
    let (sum, count) = clusters.fold((0.0, 0.0), |(s, c), x| (s + x.sum, c + x.count));
    sum / count
}

/// 95 % confidence interval of the mean over all observations, by resampling clusters; `None` for
/// fewer than two clusters.
///
/// ```
/// use cape_stats::bootstrap::{clusters, mean_interval};
///
/// let frames = [("a", 1.0), ("a", 3.0), ("b", 4.0), ("c", 2.0), ("c", 2.0)];
/// let by_capture: Vec<_> = clusters(frames.into_iter()).into_values().collect();
/// let interval = mean_interval(&by_capture).ok_or("fewer than two captures")?;
/// assert!(interval.low >= 2.0 && interval.high <= 4.0);
/// # Ok::<(), &str>(())
/// ```
pub fn mean_interval(clusters: &[Cluster]) -> Option<ConfidenceInterval> {
    if clusters.len() < 2 {
        return None;
    }
    let mean = |drawn: &[usize]| [mean_of(drawn.iter().map(|&index| clusters[index]))];
    let [interval] = percentile_intervals(clusters.len(), SEED, mean);
    Some(interval)
}

/// 95 % confidence intervals of `N` statistics of `count` observations. `statistics` gets the indices
/// of the observations in a resample.
pub(crate) fn percentile_intervals<const N: usize>(
    count: usize,
    seed: u64,
    statistics: impl Fn(&[usize]) -> [f64; N],
) -> [ConfidenceInterval; N] {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut drawn = vec![0; count];
    let mut samples: [Vec<f64>; N] = std::array::from_fn(|_| Vec::with_capacity(RESAMPLES));
    for _ in 0..RESAMPLES {
        drawn.fill_with(|| rng.random_range(0..count));
        for (samples, value) in samples.iter_mut().zip(statistics(&drawn)) {
            samples.push(value);
        }
    }
    samples.map(|mut values| {
        values.sort_by(f64::total_cmp);
        let quantile = |share: f64| values[((RESAMPLES - 1) as f64 * share).round() as usize];
        ConfidenceInterval { low: quantile(0.025), high: quantile(0.975) }
    })
}

#[cfg(test)]
mod tests {
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    fn cluster(sum: f64) -> Cluster {
        Cluster { sum, count: 1.0 }
    }

    /// Nearly 95 % of the intervals contain the known mean.
    #[test]
    fn intervals_are_calibrated() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut contained = 0;
        for _ in 0..300 {
            let data: Vec<Cluster> =
                (0..24).map(|_| cluster(StandardNormal.sample(&mut rng))).collect();
            let interval = mean_interval(&data).unwrap();
            contained += usize::from(interval.low <= 0.0 && 0.0 <= interval.high);
        }
        assert!((265..=297).contains(&contained), "{contained} of 300");
    }

    #[test]
    fn equal_clusters_have_an_interval_of_width_zero() {
        assert_eq!(mean_interval(&[cluster(1.0)]), None);
        let same = [cluster(2.0); 5];
        assert_eq!(mean_interval(&same), Some(ConfidenceInterval { low: 2.0, high: 2.0 }));
    }

    #[test]
    fn clusters_are_weighted_by_their_observations() {
        let frames = [("a", 1.0), ("b", 5.0), ("a", 3.0)];
        let found = clusters(frames.into_iter());
        assert_eq!(found["a"], Cluster { sum: 4.0, count: 2.0 });
        assert_eq!(mean_of(found.into_values()), 3.0);
    }
}
