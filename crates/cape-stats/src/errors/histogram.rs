use serde::{Deserialize, Serialize};

/// Histogram of errors in bins of equal width.
///
/// ```
/// use cape_stats::errors::ErrorStats;
///
/// let mut stats = ErrorStats::new();
/// stats.push(&[0.2, 0.7, 0.8, 9.0]);
/// let mut histogram = stats.histogram(0.5, 4);
/// assert_eq!((histogram.counts.as_slice(), histogram.beyond), (&[1, 2][..], 1));
/// assert_eq!(histogram.quantile(0.75), 1.0);
/// // Half of the errors are between 0.5 and 1 mm.
/// assert_eq!(histogram.density()[1], (0.75, 1.0));
/// histogram.add(&stats.histogram(0.5, 4));
/// assert_eq!(histogram.total(), 8);
/// ```
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Histogram {
    /// Width of a bin, millimetres.
    pub bin_mm: f64,
    /// Number of errors per bin, from 0 mm; trailing empty bins are omitted.
    pub counts: Vec<u64>,
    /// Number of errors beyond the last bin.
    pub beyond: u64,
}

impl Histogram {
    /// Adds the counts of a histogram of the same bin width.
    ///
    /// # Panics
    /// If the bin widths differ.
    pub fn add(&mut self, other: &Self) {
        assert_eq!(self.bin_mm, other.bin_mm, "histograms of different bin widths");
        self.counts.resize(self.counts.len().max(other.counts.len()), 0);
        for (sum, count) in self.counts.iter_mut().zip(&other.counts) {
            *sum += count;
        }
        self.beyond += other.beyond;
    }

    /// Number of errors.
    pub fn total(&self) -> u64 {
        self.counts.iter().sum::<u64>() + self.beyond
    }

    /// Centre (millimetres) and density (per millimetre) of each bin.
    pub fn density(&self) -> Vec<(f64, f64)> {
        let unit = self.total().max(1) as f64 * self.bin_mm;
        let point =
            |(bin, &count): (usize, &u64)| ((bin as f64 + 0.5) * self.bin_mm, count as f64 / unit);
        self.counts.iter().enumerate().map(point).collect()
    }

    /// Quantile, millimetres: the upper end of the bin in which `share` of all errors is reached, or of
    /// the last bin.
    pub fn quantile(&self, share: f64) -> f64 {
        let enough = share * self.total() as f64;
        let mut seen = 0;
        let bin = self.counts.iter().position(|count| {
            seen += count;
            seen as f64 >= enough
        });
        bin.map_or(self.counts.len(), |bin| bin + 1) as f64 * self.bin_mm
    }
}

#[cfg(test)]
mod tests {
    use crate::errors::ErrorStats;

    #[test]
    fn errors_are_counted_by_bin_and_add_up() {
        let mut stats = ErrorStats::new();
        stats.push(&[0.0, 0.2, 0.25, 0.9, 49.9, 50.1, 2000.0]);
        let all = stats.histogram(0.25, 200);
        assert_eq!((all.counts[0], all.counts[1], all.counts[3]), (2, 1, 1));
        assert_eq!((all.counts.len(), all.counts[199], all.beyond, all.total()), (200, 1, 2, 7));
        let integral: f64 = all.density().iter().map(|(_, density)| density * 0.25).sum();
        assert!((integral - 5.0 / 7.0).abs() < 1e-12);
        assert_eq!(all.density()[1].0, 0.375);
        assert_eq!((all.quantile(0.5), all.quantile(1.0)), (1.0, 50.0));

        let mut few = ErrorStats::new();
        few.push(&[0.3]);
        let mut sum = few.histogram(0.25, 200);
        assert_eq!(sum.counts, [0, 1]);
        sum.add(&all);
        assert_eq!((sum.counts[1], sum.total()), (2, 8));
        assert_eq!(ErrorStats::new().histogram(0.25, 200).quantile(0.99), 0.0);
    }
}
