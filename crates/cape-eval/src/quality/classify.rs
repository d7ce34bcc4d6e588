//! Outfit classifier on displacements.

use std::{collections::BTreeMap, path::Path};

use cape_core::Outfit;

use crate::Result;
use cape_data::Split;
use cape_infer::Run;

/// Nearest-centroid classifier: mean displacement length at every clothing vertex by outfit, which
/// shows the hems.
pub(super) struct OutfitCentroids {
    outfits: BTreeMap<Outfit, Vec<f64>>,
}

impl OutfitCentroids {
    /// Centroids of at most `frames` training frames, evenly spaced.
    pub(super) fn from_training(run: &Run, data: &Path, frames: usize) -> Result<Self> {
        let set = run.open_set(data, Split::Train)?;
        let rows = run.statistics().training_rows(set.frames());
        let step = rows.len().div_ceil(frames.max(1)).max(1);
        let mut lengths = Vec::new();
        for row in rows.step_by(step) {
            let displacement = set.displacement_row(row)?;
            let length = |&v: &usize| {
                displacement[3 * v..3 * v + 3].iter().map(|x| x * x).sum::<f64>().sqrt()
            };
            lengths.push((set.outfits()[row], run.clothing().iter().map(length).collect()));
        }
        Ok(Self::new(&lengths))
    }

    fn new(lengths: &[(Outfit, Vec<f64>)]) -> Self {
        let mut sums: BTreeMap<Outfit, (usize, Vec<f64>)> = BTreeMap::new();
        for (outfit, lengths) in lengths {
            let (count, sum) = sums.entry(*outfit).or_insert_with(|| (0, vec![0.0; lengths.len()]));
            *count += 1;
            for (sum, length) in sum.iter_mut().zip(lengths) {
                *sum += length;
            }
        }
        let means = sums.into_iter().map(|(outfit, (count, sum))| {
            (outfit, sum.into_iter().map(|x| x / count as f64).collect())
        });
        Self { outfits: means.collect() }
    }

    /// Outfit with the nearest centroid, if there are any; `points` are displacements of clothing vertices, metres.
    pub(super) fn classify(&self, points: &[[f32; 3]]) -> Option<Outfit> {
        let lengths: Vec<f64> = points
            .iter()
            .map(|point| point.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>().sqrt())
            .collect();
        let far = |mean: &[f64]| -> f64 {
            mean.iter().zip(&lengths).map(|(mean, length)| (mean - length).powi(2)).sum()
        };
        let nearest = self.outfits.iter().min_by(|a, b| far(a.1).total_cmp(&far(b.1)));
        nearest.map(|(&outfit, _)| outfit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_mean_wins() {
        let lengths = [
            (Outfit::LONG_LONG, vec![2.0, 2.0]),
            (Outfit::LONG_LONG, vec![2.2, 1.8]),
            (Outfit::SHORT_SHORT, vec![0.0, 1.0]),
        ];
        let centroids = OutfitCentroids::new(&lengths);
        let of = |a: f32, b: f32| centroids.classify(&[[a, 0.0, 0.0], [0.0, -b, 0.0]]);
        assert_eq!(of(2.0, 2.0), Some(Outfit::LONG_LONG));
        assert_eq!(of(0.1, 1.2), Some(Outfit::SHORT_SHORT));
    }
}
