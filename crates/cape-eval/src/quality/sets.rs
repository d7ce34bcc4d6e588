//! Comparison of a set of samples with a set of frames (Achlioptas et al. 2018, Yang et al. 2019).

use rayon::prelude::*;
use serde::Serialize;

/// Distances within and between two sets of point sets, millimetres.
///
/// ```
/// use cape_eval::quality::SetDistances;
///
/// // Two frames of one point each; both samples are near the first.
/// let frames = [vec![[0.0, 0.0, 0.0]], vec![[1.0, 0.0, 0.0]]];
/// let samples = [vec![[0.0, 0.1, 0.0]], vec![[0.0, 0.0, 0.1]]];
/// let distances = SetDistances::between(&frames, &samples);
/// assert_eq!(distances.coverage(), 0.5);
/// ```
#[derive(Debug, Clone)]
pub struct SetDistances {
    /// Distances between frames, `[frames][frames]`.
    frames: Vec<Vec<f64>>,
    /// Distances between samples, `[samples][samples]`.
    samples: Vec<Vec<f64>>,
    /// Distances between frames and samples, `[frames][samples]`.
    between: Vec<Vec<f64>>,
}

/// Measures of a set of samples against a set of frames.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SetQuality {
    /// Coverage: share of frames that are the nearest frame of a sample; higher is better.
    pub coverage: f64,
    /// Minimum matching distance: mean distance from a frame to the nearest sample, millimetres.
    pub minimum_matching_mm: f64,
    /// 1-nearest-neighbour accuracy: share of frames and samples whose nearest neighbour is of
    /// their own set; 0.5 if the distributions are equal, 1 if they are disjoint.
    pub nearest_neighbour_accuracy: f64,
}

/// Mean Euclidean distance of corresponding points in metres, as millimetres.
fn distance(a: &[[f32; 3]], b: &[[f32; 3]]) -> f64 {
    let sum: f64 = a
        .iter()
        .zip(b)
        .map(|(a, b)| {
            let squares = (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2) + (a[2] - b[2]).powi(2);
            f64::from(squares.sqrt())
        })
        .sum();
    1000.0 * sum / a.len().max(1) as f64
}

fn matrix(a: &[Vec<[f32; 3]>], b: &[Vec<[f32; 3]>]) -> Vec<Vec<f64>> {
    a.par_iter().map(|a| b.iter().map(|b| distance(a, b)).collect()).collect()
}

/// Mean distance between different members of a set; 0 if it has fewer than two.
pub(super) fn mean_distance(set: &[Vec<[f32; 3]>]) -> f64 {
    let pairs = set.len() * set.len().saturating_sub(1);
    matrix(set, set).iter().flatten().sum::<f64>() / pairs.max(1) as f64
}

fn nearest(distances: impl Iterator<Item = f64>) -> Option<(usize, f64)> {
    distances.enumerate().min_by(|a, b| a.1.total_cmp(&b.1))
}

impl SetDistances {
    /// Computes all distances; points are in correspondence, in metres.
    pub fn between(frames: &[Vec<[f32; 3]>], samples: &[Vec<[f32; 3]>]) -> Self {
        Self {
            frames: matrix(frames, frames),
            samples: matrix(samples, samples),
            between: matrix(frames, samples),
        }
    }

    /// All measures.
    pub fn quality(&self) -> SetQuality {
        SetQuality {
            coverage: self.coverage(),
            minimum_matching_mm: self.minimum_matching(),
            nearest_neighbour_accuracy: self.nearest_neighbour_accuracy(),
        }
    }

    /// Share of frames that are the nearest frame of a sample.
    pub fn coverage(&self) -> f64 {
        let mut covered = vec![false; self.frames.len()];
        for sample in 0..self.samples.len() {
            if let Some((frame, _)) = nearest(self.between.iter().map(|row| row[sample])) {
                covered[frame] = true;
            }
        }
        covered.iter().filter(|&&covered| covered).count() as f64 / covered.len().max(1) as f64
    }

    /// Mean distance from a frame to the nearest sample.
    pub fn minimum_matching(&self) -> f64 {
        let nearest = self.between.iter().filter_map(|row| nearest(row.iter().copied()));
        nearest.map(|(_, distance)| distance).sum::<f64>() / self.frames.len().max(1) as f64
    }

    /// Share of frames and samples whose nearest neighbour, other than themselves, is of their own
    /// set.
    pub fn nearest_neighbour_accuracy(&self) -> f64 {
        let others = |own: &[Vec<f64>], index: usize| {
            let row = own[index].iter().enumerate().filter(move |(other, _)| *other != index);
            row.map(|(_, &distance)| distance).fold(f64::INFINITY, f64::min)
        };
        let least =
            |distances: &mut dyn Iterator<Item = f64>| distances.fold(f64::INFINITY, f64::min);
        let frames = (0..self.frames.len()).filter(|&frame| {
            others(&self.frames, frame) < least(&mut self.between[frame].iter().copied())
        });
        let samples = (0..self.samples.len()).filter(|&sample| {
            others(&self.samples, sample) < least(&mut self.between.iter().map(|row| row[sample]))
        });
        let right = frames.count() + samples.count();
        right as f64 / (self.frames.len() + self.samples.len()).max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Point sets of one point each on a line.
    fn set(values: &[f32]) -> Vec<Vec<[f32; 3]>> {
        values.iter().map(|&x| vec![[x / 1000.0, 0.0, 0.0]]).collect()
    }

    #[test]
    fn figures_are_those_of_their_definitions() {
        let distances = SetDistances::between(&set(&[0.0, 10.0, 100.0]), &set(&[1.0, 2.0, 12.0]));
        // Frames nearest to samples: 0, 0 and 10.
        assert!((distances.coverage() - 2.0 / 3.0).abs() < 1e-12);
        assert!((distances.minimum_matching() - (1.0 + 2.0 + 88.0) / 3.0).abs() < 1e-4);
        // The samples 1, 12 and 12 are nearer to frames 0, 10 and 100 than any frame. Sample 1 is
        // as near to frame 0 as to sample 2 and does not count, sample 2 is nearest to 1, and 12 to
        // frame 10.
        assert!((distances.nearest_neighbour_accuracy() - 1.0 / 6.0).abs() < 1e-12);
        assert!((mean_distance(&set(&[0.0, 3.0, 6.0])) - 4.0).abs() < 1e-4);
        assert_eq!(mean_distance(&set(&[1.0])), 0.0);
    }

    #[test]
    fn sets_far_apart_are_told_apart_and_equal_ones_match() {
        let near: Vec<f32> = (0..20).map(|i| i as f32).collect();
        let far: Vec<f32> = near.iter().map(|x| x + 1000.0).collect();
        let apart = SetDistances::between(&set(&near), &set(&far));
        assert_eq!(apart.nearest_neighbour_accuracy(), 1.0);
        let same = SetDistances::between(&set(&near), &set(&near));
        assert_eq!((same.coverage(), same.minimum_matching()), (1.0, 0.0));
        assert_eq!(same.nearest_neighbour_accuracy(), 0.0);
    }
}
