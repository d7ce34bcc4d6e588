//! Confidence intervals and tests for errors of frames that are not independent: frames of one
//! capture resemble each other, so captures are drawn, not frames.

use std::collections::BTreeMap;

use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use serde::{Deserialize, Serialize};

/// Resamples of a bootstrap.
const RESAMPLES: usize = 4000;
/// Captures up to which all sign changes are tried.
const EXACT: usize = 14;
/// Random sign changes otherwise.
const SIGN_CHANGES: usize = 20_000;
const SEED: u64 = 20;

/// Frames of one capture: their errors added up, and how many there are.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Cluster {
    /// Sum of the observations.
    pub sum: f64,
    /// Number of observations.
    pub count: f64,
}

/// Errors by capture.
pub fn clusters<'a>(frames: impl Iterator<Item = (&'a str, f64)>) -> BTreeMap<&'a str, Cluster> {
    let mut clusters: BTreeMap<&str, Cluster> = BTreeMap::new();
    for (capture, error) in frames {
        let cluster = clusters.entry(capture).or_default();
        cluster.sum += error;
        cluster.count += 1.0;
    }
    clusters
}

/// An interval that contains the mean in 95 of 100 such data sets.
///
/// See [`ComparisonTable`](super::ComparisonTable) for an example.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ConfidenceInterval {
    /// Its lower end.
    pub low: f64,
    /// Its upper end.
    pub high: f64,
}

fn mean_of(clusters: impl Iterator<Item = Cluster>) -> f64 {
    let (sum, count) = clusters.fold((0.0, 0.0), |(s, c), x| (s + x.sum, c + x.count));
    sum / count
}

/// Percentile bootstrap of the mean over frames, by captures; none for fewer than two.
pub fn interval(clusters: &[Cluster]) -> Option<ConfidenceInterval> {
    if clusters.len() < 2 {
        return None;
    }
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    let mut means: Vec<f64> = (0..RESAMPLES)
        .map(|_| {
            let draw = |_| clusters[rng.random_range(0..clusters.len())];
            mean_of((0..clusters.len()).map(draw))
        })
        .collect();
    means.sort_by(f64::total_cmp);
    let at = |share: f64| means[((RESAMPLES - 1) as f64 * share).round() as usize];
    Some(ConfidenceInterval { low: at(0.025), high: at(0.975) })
}

/// Probability of a difference of means at least as large if none of the two methods were better:
/// signs of the captures' differences changed at random (all changes, for few captures).
pub fn sign_test(differences: &[Cluster]) -> Option<f64> {
    let n = differences.len();
    if n < 2 {
        return None;
    }
    let size = |signs: &dyn Fn(usize) -> bool| {
        let signed =
            differences.iter().enumerate().map(|(k, d)| if signs(k) { -d.sum } else { d.sum });
        signed.sum::<f64>().abs()
    };
    // Rounding must not make a change of all signs smaller than no change.
    let observed = size(&|_| false) * (1.0 - 1e-12);
    if n <= EXACT {
        let all = 1usize << n;
        let extreme = (0..all).filter(|signs| size(&|k| signs >> k & 1 == 1) >= observed).count();
        return Some(extreme as f64 / all as f64);
    }
    let mut rng = ChaCha8Rng::seed_from_u64(SEED + 1);
    let extreme = (0..SIGN_CHANGES)
        .filter(|_| {
            let signs: Vec<bool> = (0..n).map(|_| rng.random()).collect();
            size(&|k| signs[k]) >= observed
        })
        .count();
    // What was observed is one of the possible changes.
    Some((extreme + 1) as f64 / (SIGN_CHANGES + 1) as f64)
}

#[cfg(test)]
mod tests {
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    fn cluster(sum: f64) -> Cluster {
        Cluster { sum, count: 1.0 }
    }

    /// Data sets whose mean is known: nearly 95 of 100 intervals contain it, and nearly 5 of 100
    /// tests find a difference that is not there.
    #[test]
    fn intervals_and_tests_are_calibrated() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let (mut contained, mut found) = (0, 0);
        for _ in 0..300 {
            let data: Vec<Cluster> =
                (0..24).map(|_| cluster(StandardNormal.sample(&mut rng))).collect();
            let interval = interval(&data).unwrap();
            contained += usize::from(interval.low <= 0.0 && 0.0 <= interval.high);
            found += usize::from(sign_test(&data).unwrap() < 0.05);
        }
        assert!((265..=297).contains(&contained), "{contained} of 300");
        assert!((4..=30).contains(&found), "{found} of 300");
    }

    #[test]
    fn few_captures_are_tried_in_all_ways() {
        let one_sided = [1.0, 2.0, 3.0, 4.0].map(cluster);
        assert_eq!(sign_test(&one_sided), Some(2.0 / 16.0));
        assert_eq!(sign_test(&[1.0, -1.0].map(cluster)), Some(1.0));
        assert_eq!(sign_test(&one_sided[..1]), None);
        assert_eq!(interval(&one_sided[..1]), None);
        let same = [cluster(2.0); 5];
        assert_eq!(interval(&same), Some(ConfidenceInterval { low: 2.0, high: 2.0 }));
    }

    #[test]
    fn captures_count_by_their_frames() {
        let frames = [("a", 1.0), ("b", 5.0), ("a", 3.0)];
        let found = clusters(frames.into_iter());
        assert_eq!(found["a"], Cluster { sum: 4.0, count: 2.0 });
        assert_eq!(mean_of(found.into_values()), 3.0);
    }
}
