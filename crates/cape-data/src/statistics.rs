use std::path::Path;

use cape_core::npy::{Npz, NpzWriter};
use ndarray::{Array1, Array2, Ix2};

use crate::{Error, Result};

/// File name of the [`DisplacementStatistics`] of a packed set.
pub const STATISTICS_FILE: &str = "stats.npz";

/// Smallest standard deviation, metres: 0.1 mm, below the noise of a body scanner (the release's
/// male training data have at least 0.5 mm everywhere). It keeps normalised displacements small at
/// vertices that do not vary, such as on bare skin.
pub const MIN_STD: f64 = 1e-4;

/// Largest difference between statistics of the same data, metres.
const ROUNDING: f64 = 1e-7;

/// Number of validation frames, the last ones in packed order, of a training part of `frames`
/// frames: 100 as in the release; a rounded tenth, but at least 1, of fewer than 1000; 0 of a
/// single frame.
pub fn validation_count(frames: usize) -> usize {
    let tenth = (frames + 5) / 10;
    tenth.clamp(1, 100).min(frames.saturating_sub(1))
}

/// Mean and standard deviation of displacements per vertex and coordinate, metres, over the
/// training frames without validation frames; displacements are normalised with them for the
/// network.
///
/// ```
/// use cape_data::{MIN_STD, DisplacementStatistics};
/// use ndarray::array;
///
/// let statistics = DisplacementStatistics::new(array![[0.01, 0., 0.]], array![[0.005, 0.005, 0.]], 1)?;
/// // Standard deviations are at least `MIN_STD`.
/// assert_eq!(statistics.std()[[0, 2]], MIN_STD);
/// let mut displacement = [0.02, 0., 0.];
/// statistics.normalise(&mut displacement);
/// assert!((displacement[0] - 2.0).abs() < 1e-6);
/// statistics.denormalise(&mut displacement);
/// assert!((displacement[0] - 0.02).abs() < 1e-8);
/// # Ok::<(), cape_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct DisplacementStatistics {
    mean: Array2<f64>,
    std: Array2<f64>,
    validation: usize,
}

impl DisplacementStatistics {
    /// Statistics from `mean` and `std`, `[V, 3]`, metres, and the number of validation frames.
    /// Standard deviations below [`MIN_STD`] are raised to it.
    ///
    /// # Errors
    /// If a shape is not `[V, 3]`, or a value is not finite or a negative deviation.
    pub fn new(mean: Array2<f64>, std: Array2<f64>, validation: usize) -> Result<Self> {
        if mean.dim() != std.dim() || mean.ncols() != 3 {
            return Err(Error::argument(format!(
                "statistics: mean {:?} and std {:?}, expected both [vertices, 3]",
                mean.dim(),
                std.dim()
            )));
        }
        let finite = |x: &f64| x.is_finite();
        if !mean.iter().all(finite) || !std.iter().all(|x| finite(x) && *x >= 0.0) {
            return Err(Error::argument("statistics: mean and std must be finite, and std >= 0"));
        }
        Ok(Self { mean, std: std.mapv(|x| x.max(MIN_STD)), validation })
    }

    /// Mean, `[V, 3]`, metres.
    pub fn mean(&self) -> &Array2<f64> {
        &self.mean
    }

    /// Population standard deviation, at least [`MIN_STD`], `[V, 3]`, metres.
    pub fn std(&self) -> &Array2<f64> {
        &self.std
    }

    /// True if the statistics are equal up to rounding to f32, in which the release stores them.
    pub fn is_close(&self, other: &Self) -> bool {
        let close = |a: &Array2<f64>, b: &Array2<f64>| {
            a.dim() == b.dim() && a.iter().zip(b).all(|(a, b)| (a - b).abs() <= ROUNDING)
        };
        close(&self.mean, &other.mean) && close(&self.std, &other.std)
    }

    /// Number of vertices.
    pub fn vertices(&self) -> usize {
        self.mean.nrows()
    }

    /// Number of validation frames, the last ones of the training part.
    pub fn validation(&self) -> usize {
        self.validation
    }

    /// Normalises displacements `[frames · 3 V]` in place: metres to standard deviations from the
    /// mean.
    pub fn normalise(&self, displacements: &mut [f32]) {
        self.apply(displacements, |x, mean, std| (x - mean) / std);
    }

    /// Denormalises displacements in place, the inverse of [`normalise`](Self::normalise).
    pub fn denormalise(&self, displacements: &mut [f32]) {
        self.apply(displacements, |x, mean, std| x * std + mean);
    }

    fn apply(&self, displacements: &mut [f32], formula: impl Fn(f64, f64, f64) -> f64) {
        for frame in displacements.chunks_mut(self.mean.len().max(1)) {
            for ((x, &mean), &std) in frame.iter_mut().zip(&self.mean).zip(&self.std) {
                *x = formula(f64::from(*x), mean, std) as f32;
            }
        }
    }

    /// Reads a `.npz` file with `mean` and `std`, `[V, 3]`, and `validation`, the number of
    /// validation frames (100 if absent, as in the release's files).
    pub fn load(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let mut file = Npz::open(path)?;
        let mut read = |name: &str| {
            let array = file.f64(name)?;
            file.expect_shape(name, array.shape(), &[None, Some(3)])?;
            array.into_dimensionality::<Ix2>().map_err(|e| Error::field(path, name, e.to_string()))
        };
        let (mean, std) = (read("mean")?, read("std")?);
        let validation = if file.contains("validation") {
            let count = file.i64("validation")?;
            let count = count.first().and_then(|&n| usize::try_from(n).ok());
            count.ok_or_else(|| {
                Error::field(path, "validation", "expected one integer of at least 0")
            })?
        } else {
            100
        };
        Self::new(mean, std, validation).map_err(|e| Error::format(path, e.to_string()))
    }

    /// Writes a `.npz` file with `mean`, `std` and `validation`, atomically.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<()> {
        let mut file = NpzWriter::create(path)?;
        file.add("mean", &self.mean)?;
        file.add("std", &self.std)?;
        file.add("validation", &Array1::from_elem(1, self.validation as i64))?;
        file.finish()
    }
}

/// Mean and standard deviation in one pass (Welford).
#[derive(Debug)]
pub(super) struct Accumulator {
    count: u64,
    mean: Vec<f64>,
    squares: Vec<f64>,
}

impl Accumulator {
    /// Creates an accumulator for frames of `numbers` numbers.
    pub(super) fn new(numbers: usize) -> Self {
        Self { count: 0, mean: vec![0.0; numbers], squares: vec![0.0; numbers] }
    }

    pub(super) fn push(&mut self, frame: impl IntoIterator<Item = f64>) {
        self.count += 1;
        let weight = 1.0 / self.count as f64;
        for ((x, mean), squares) in frame.into_iter().zip(&mut self.mean).zip(&mut self.squares) {
            let delta = x - *mean;
            *mean += delta * weight;
            *squares += delta * (x - *mean);
        }
    }

    pub(super) fn finish(self, validation: usize) -> Result<DisplacementStatistics> {
        let shape = (self.mean.len() / 3, 3);
        let count = self.count.max(1) as f64;
        let std = self.squares.into_iter().map(|squares| (squares / count).sqrt()).collect();
        let array = |numbers| {
            Array2::from_shape_vec(shape, numbers).map_err(|e| Error::argument(e.to_string()))
        };
        DisplacementStatistics::new(array(self.mean)?, array(std)?, validation)
    }
}

#[cfg(test)]
mod tests {
    use ndarray::array;

    use super::*;

    #[test]
    fn validation_is_the_papers_or_a_tenth() {
        for (frames, count) in
            [(0, 0), (1, 0), (2, 1), (14, 1), (15, 2), (994, 99), (1000, 100), (31_036, 100)]
        {
            assert_eq!(validation_count(frames), count, "{frames}");
        }
    }

    #[test]
    fn welford_agrees_with_two_passes() {
        // Cancellation: the mean is far larger than the standard deviation.
        let frame = |k: usize| [1000.0 + 1e-3 * (k as f64 * 1.7).sin(), 5.0, -(k as f64)];
        let mut one_pass = Accumulator::new(3);
        (0..500).for_each(|k| one_pass.push(frame(k)));
        let stats = one_pass.finish(7).unwrap();
        for i in 0..3 {
            let mean = (0..500).map(|k| frame(k)[i]).sum::<f64>() / 500.0;
            let var = (0..500).map(|k| (frame(k)[i] - mean).powi(2)).sum::<f64>() / 500.0;
            assert!((stats.mean()[[0, i]] - mean).abs() < 1e-12 * mean.abs());
            let std = var.sqrt().max(MIN_STD);
            assert!((stats.std()[[0, i]] - std).abs() < 1e-9 * std, "{i}: {stats:?} {std}");
        }
        assert_eq!(stats.std()[[0, 1]], MIN_STD);
    }

    #[test]
    fn normalising_is_undone() {
        let stats =
            DisplacementStatistics::new(array![[0.01, -0.02, 0.0]], array![[0.005, 0.01, 0.0]], 1)
                .unwrap();
        let mut values = vec![0.02, -0.02, 0.0, 0.01, 0.0, 1e-4];
        stats.normalise(&mut values);
        let expected = [2.0, 0.0, 0.0, 0.0, 2.0, 1.0];
        assert!(values.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{values:?}");
        stats.denormalise(&mut values);
        assert!((values[0] - 0.02).abs() < 1e-8 && (values[4]).abs() < 1e-8, "{values:?}");
    }

    #[test]
    fn files_round_trip_and_bad_ones_are_named() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("s.npz");
        let stats =
            DisplacementStatistics::new(array![[1.0, 2.0, 3.0]], array![[1.0, 0.0, 3.0]], 42)
                .unwrap();
        stats.save(&path).unwrap();
        assert_eq!(DisplacementStatistics::load(&path).unwrap(), stats);
        let write = |std: Array2<f64>| {
            let mut file = NpzWriter::create(&path).unwrap();
            file.add("mean", stats.mean()).unwrap();
            file.add("std", &std).unwrap();
            file.finish().unwrap();
            DisplacementStatistics::load(&path)
        };
        assert_eq!(write(stats.std().clone()).unwrap().validation(), 100);
        for (std, expected) in [
            (array![[1.0, f64::NAN, 1.0]], "s.npz"),
            (array![[1.0, -1.0, 1.0]], "s.npz"),
            (array![[1.0, 1.0]], "`std`"),
            (array![[1.0, 1.0, 1.0], [1.0, 1.0, 1.0]], "expected both"),
        ] {
            let message = write(std).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
    }
}
