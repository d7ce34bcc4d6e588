//! Reconstruction errors (table 2 of the paper): streaming mean, standard deviation and median of
//! per-vertex Euclidean errors, millimetres.

mod histogram;

use std::collections::BTreeMap;

use cape_core::Outfit;
use serde::{Deserialize, Serialize};

pub use histogram::Histogram;

use crate::{Error, Result};

/// Summary statistics of a set of errors.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ErrorSummary {
    /// Mean, mm.
    pub mean: f64,
    /// Population standard deviation, mm.
    pub std: f64,
    /// Median, mm; accurate to 0.0005 mm below 1 m and to 1/32768 of its value above.
    pub median: f64,
    /// Number of errors (frames × vertices).
    pub count: u64,
}

/// Streaming statistics of errors in millimetres.
///
/// Mean and standard deviation combine the two-pass values of each push in `f64`; the median comes from
/// a histogram of at most 24 MB. The same pushes in the same order give the same bits.
///
/// ```
/// use cape_stats::errors::{ErrorStats, vertex_errors_mm};
///
/// let mut stats = ErrorStats::new();
/// stats.push(&vertex_errors_mm(&[0.003, 0.004, 0.], &[0., 0., 0.], &[0])?);
/// stats.push(&[1.0, 3.0]);
/// let summary = stats.summary();
/// assert_eq!(summary.count, 3);
/// assert!((summary.mean - 3.0).abs() < 1e-5 && (summary.median - 3.0).abs() < 1e-3);
/// assert!((summary.std - (8f64 / 3.0).sqrt()).abs() < 1e-5);
/// # Ok::<(), cape_core::Error>(())
/// ```
#[derive(Debug, Clone, Default)]
pub struct ErrorStats {
    count: u64,
    mean: f64,
    squares: f64,
    has_invalid: bool,
    histogram: Vec<u64>,
}

/// Limit between bins of width 1 / [`BINS_PER_MM`] and bins of relative width, millimetres.
const LINEAR_MM: f32 = 1024.0;
const BINS_PER_MM: f32 = 1000.0;
/// Fraction bits of an `f32` within one relative bin; 14 of 23 select the bin.
const TAIL_SHIFT: u32 = 9;
const LINEAR_BINS: usize = (LINEAR_MM * BINS_PER_MM) as usize;

fn bin(error: f32) -> usize {
    if error < LINEAR_MM {
        (error * BINS_PER_MM) as usize
    } else {
        LINEAR_BINS + ((error.to_bits() - LINEAR_MM.to_bits()) >> TAIL_SHIFT) as usize
    }
}

/// Centre of a bin, millimetres.
fn middle(bin: usize) -> f64 {
    if bin < LINEAR_BINS {
        (bin as f64 + 0.5) / f64::from(BINS_PER_MM)
    } else {
        let bits = LINEAR_MM.to_bits() + (((bin - LINEAR_BINS) as u32) << TAIL_SHIFT);
        f64::from(f32::from_bits(bits + (1 << (TAIL_SHIFT - 1))))
    }
}

impl ErrorStats {
    /// Empty statistics.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds errors in millimetres, usually of one frame. A negative, infinite or NaN error makes all
    /// statistics NaN.
    pub fn push(&mut self, errors: &[f32]) {
        if errors.is_empty() {
            return;
        }
        let n = errors.len() as f64;
        let mean = errors.iter().map(|&e| f64::from(e)).sum::<f64>() / n;
        let squares: f64 = errors.iter().map(|&e| (f64::from(e) - mean).powi(2)).sum();
        let before = self.count as f64;
        let delta = mean - self.mean;
        self.squares += squares + delta * delta * before * n / (before + n);
        self.mean += delta * n / (before + n);
        self.count += errors.len() as u64;
        for &error in errors {
            if !(error.is_finite() && error >= 0.0) {
                self.has_invalid = true;
                continue;
            }
            let bin = bin(error);
            if bin >= self.histogram.len() {
                self.histogram.resize(bin + 1, 0);
            }
            self.histogram[bin] += 1;
        }
    }

    /// Summary of the errors so far; NaN without errors.
    pub fn summary(&self) -> ErrorSummary {
        if self.count == 0 || self.has_invalid {
            return ErrorSummary {
                mean: f64::NAN,
                std: f64::NAN,
                median: f64::NAN,
                count: self.count,
            };
        }
        ErrorSummary {
            mean: self.mean,
            std: (self.squares / self.count as f64).sqrt(),
            median: f64::midpoint(self.ranked((self.count - 1) / 2), self.ranked(self.count / 2)),
            count: self.count,
        }
    }

    /// Histogram of `bins` bins of width `bin_mm`, without negative and non-finite errors.
    pub fn histogram(&self, bin_mm: f64, bins: usize) -> Histogram {
        let mut histogram = Histogram { bin_mm, ..Histogram::default() };
        for (fine, &count) in self.histogram.iter().enumerate().filter(|(_, count)| **count > 0) {
            let bin = (middle(fine) / bin_mm) as usize;
            if bin >= bins {
                histogram.beyond += count;
                continue;
            }
            if bin >= histogram.counts.len() {
                histogram.counts.resize(bin + 1, 0);
            }
            histogram.counts[bin] += count;
        }
        histogram
    }

    /// Error of rank `rank`, from 0, millimetres.
    fn ranked(&self, rank: u64) -> f64 {
        let mut seen = 0;
        let bin = self.histogram.iter().position(|&n| {
            seen += n;
            seen > rank
        });
        bin.map_or(f64::NAN, middle)
    }
}

/// Streaming error statistics over all frames, by outfit and by sequence.
///
/// ```
/// use cape_core::Outfit;
/// use cape_stats::errors::GroupedErrors;
///
/// let mut errors = GroupedErrors::new();
/// errors.push(Outfit::LONG_LONG, Some("hips"), &[1.0, 3.0]);
/// errors.push(Outfit::SHORT_LONG, Some("hips"), &[5.0]);
/// let summary = errors.summary();
/// assert_eq!(summary.overall.mean, 3.0);
/// assert_eq!(summary.outfits[&Outfit::LONG_LONG].mean, 2.0);
/// assert_eq!(summary.sequences["hips"].count, 3);
/// ```
#[derive(Debug, Clone, Default)]
pub struct GroupedErrors {
    overall: ErrorStats,
    outfits: BTreeMap<Outfit, ErrorStats>,
    sequences: BTreeMap<String, ErrorStats>,
}

/// Summary of [`GroupedErrors`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GroupedSummary {
    /// Statistics of all frames.
    pub overall: ErrorSummary,
    /// Statistics by outfit, of the outfits that occur.
    pub outfits: BTreeMap<Outfit, ErrorSummary>,
    /// Statistics by sequence name; empty if sequence names are unknown.
    pub sequences: BTreeMap<String, ErrorSummary>,
}

impl GroupedErrors {
    /// Empty statistics.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds the errors of one frame, millimetres.
    pub fn push(&mut self, outfit: Outfit, sequence: Option<&str>, errors: &[f32]) {
        self.overall.push(errors);
        self.outfits.entry(outfit).or_default().push(errors);
        if let Some(name) = sequence {
            if !self.sequences.contains_key(name) {
                self.sequences.insert(name.to_owned(), ErrorStats::new());
            }
            if let Some(stats) = self.sequences.get_mut(name) {
                stats.push(errors);
            }
        }
    }

    /// Statistics of all errors.
    pub fn overall(&self) -> &ErrorStats {
        &self.overall
    }

    /// Summary of the errors so far.
    pub fn summary(&self) -> GroupedSummary {
        GroupedSummary {
            overall: self.overall.summary(),
            outfits: self.outfits.iter().map(|(&k, v)| (k, v.summary())).collect(),
            sequences: self.sequences.iter().map(|(k, v)| (k.clone(), v.summary())).collect(),
        }
    }
}

/// Euclidean distance between two points in metres: millimetres.
///
/// ```
/// use cape_stats::errors::{distance_mm, mean_distance_mm};
///
/// assert!((distance_mm([0.003, 0.0, 0.0], [0.0, 0.004, 0.0]) - 5.0).abs() < 1e-12);
/// let pairs = [([0.0f32; 3], [0.0; 3]), ([1.0, 0.0, 0.0], [0.0; 3])];
/// assert_eq!(mean_distance_mm(pairs), 500.0);
/// ```
pub fn distance_mm<T: Into<f64>>(a: [T; 3], b: [T; 3]) -> f64 {
    let squares = a.into_iter().zip(b).map(|(a, b)| (a.into() - b.into()).powi(2));
    1000.0 * squares.sum::<f64>().sqrt()
}

/// Mean of [`distance_mm`] over pairs of points in metres: millimetres; 0 without pairs.
pub fn mean_distance_mm<T: Into<f64>>(pairs: impl IntoIterator<Item = ([T; 3], [T; 3])>) -> f64 {
    let (mut sum, mut count) = (0.0, 0usize);
    for (a, b) in pairs {
        sum += distance_mm(a, b);
        count += 1;
    }
    sum / count.max(1) as f64
}

/// Euclidean distances between two frames at `vertices`, millimetres, `[vertices]`.
///
/// `predicted` and `truth` are denormalised displacements (or positions), metres, `[V, 3]`.
pub fn vertex_errors_mm(predicted: &[f32], truth: &[f32], vertices: &[usize]) -> Result<Vec<f32>> {
    if predicted.len() != truth.len() {
        return Err(Error::argument(format!(
            "frames of {} and {} numbers cannot be compared: expected equal lengths",
            predicted.len(),
            truth.len()
        )));
    }
    let ((predicted, rest), (truth, _)) = (predicted.as_chunks::<3>(), truth.as_chunks::<3>());
    if !rest.is_empty() {
        return Err(Error::argument(format!(
            "{} numbers after the last vertex, expected 3 per vertex",
            rest.len()
        )));
    }
    let error = |&v: &usize| match (predicted.get(v), truth.get(v)) {
        (Some(&a), Some(&b)) => Ok(distance_mm(a, b) as f32),
        _ => Err(Error::argument(format!(
            "vertex {v} is out of range for frames of {} vertices",
            truth.len()
        ))),
    };
    vertices.iter().map(error).collect()
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

    use super::*;

    fn naive(errors: &[f32]) -> ErrorSummary {
        let n = errors.len();
        let mean = errors.iter().map(|&e| e as f64).sum::<f64>() / n as f64;
        let var = errors.iter().map(|&e| (e as f64 - mean).powi(2)).sum::<f64>() / n as f64;
        let mut sorted: Vec<f64> = errors.iter().map(|&e| e as f64).collect();
        sorted.sort_by(f64::total_cmp);
        let median = f64::midpoint(sorted[(n - 1) / 2], sorted[n / 2]);
        ErrorSummary { mean, std: var.sqrt(), median, count: n as u64 }
    }

    fn check(errors: &[f32], chunk: usize) {
        let mut stats = ErrorStats::new();
        errors.chunks(chunk).for_each(|chunk| stats.push(chunk));
        let (got, want) = (stats.summary(), naive(errors));
        assert_eq!(got.count, want.count);
        assert!((got.mean - want.mean).abs() <= 1e-12 * want.mean.max(1.0), "{got:?} {want:?}");
        assert!((got.std - want.std).abs() <= 1e-9 * want.std.max(1.0), "{got:?} {want:?}");
        let tolerance = (want.median / 32768.0).max(5.1e-4);
        assert!((got.median - want.median).abs() <= tolerance, "{got:?} {want:?}");
    }

    #[test]
    fn agrees_with_sorting() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for scale in [0.01, 6.0, 500.0, 4000.0, 1e9] {
            for n in [1, 2, 3, 10, 10_001] {
                let errors: Vec<f32> =
                    (0..n).map(|_| scale * rng.random::<f32>().powi(3)).collect();
                check(&errors, 7);
                check(&errors, n);
            }
        }
        check(&[0.0; 5], 2);
        check(&[1023.9999, 1024.0, 1024.0001, 1024.1], 3);
        check(&[f32::MAX; 3], 3);
        check(&[1e6, 1e6 + 1.0, 1e6 - 1.0], 1);
    }

    #[test]
    fn missing_and_invalid_errors_give_nan() {
        assert!(ErrorStats::new().summary().median.is_nan());
        for bad in [f32::NAN, f32::INFINITY, -1.0] {
            let mut stats = ErrorStats::new();
            stats.push(&[1.0, bad, 2.0]);
            let summary = stats.summary();
            assert!(summary.mean.is_nan() && summary.std.is_nan() && summary.median.is_nan());
            assert_eq!(summary.count, 3);
        }
    }

    #[test]
    fn groups_partition_the_whole() {
        let mut errors = GroupedErrors::new();
        errors.push(Outfit::LONG_LONG, Some("walk"), &[1.0, 2.0]);
        errors.push(Outfit::SHORT_LONG, Some("walk"), &[3.0, 4.0]);
        errors.push(Outfit::SHORT_LONG, None, &[8.0, 6.0]);
        let summary = errors.summary();
        assert_eq!(summary.overall.mean, 4.0);
        assert_eq!(summary.outfits[&Outfit::LONG_LONG].mean, 1.5);
        assert_eq!(summary.outfits[&Outfit::SHORT_LONG].count, 4);
        assert_eq!(summary.outfits.len(), 2);
        assert_eq!(summary.sequences["walk"].mean, 2.5);
    }

    #[test]
    fn vertex_errors_are_distances_in_millimetres() {
        let truth = [0.0, 0.0, 0.0, 1.0, 1.0, 1.0];
        let predicted = [0.003, 0.004, 0.0, 1.0, 1.0, 0.999];
        let errors = vertex_errors_mm(&predicted, &truth, &[1, 0]).unwrap();
        assert!((errors[0] - 1.0).abs() < 1e-4 && (errors[1] - 5.0).abs() < 1e-6, "{errors:?}");
        assert!(vertex_errors_mm(&predicted, &truth, &[2]).is_err());
        assert!(vertex_errors_mm(&predicted, &truth[..3], &[0]).is_err());
        assert!(vertex_errors_mm(&predicted[..4], &truth[..4], &[0]).is_err());
    }
}
