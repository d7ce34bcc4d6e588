//! Comparison of a set of samples with a set of frames (Achlioptas et al. 2018, Yang et al. 2019).

use rayon::prelude::*;
use serde::Serialize;

/// Clothings as point sets in correspondence, and the capture of each.
///
/// Frames of a capture are much alike, as they have the same garments put on once: they do not count as
/// neighbours of each other, or else every frame would have one in its own set.
#[derive(Debug, Clone, Default)]
pub struct ClothingSet {
    /// Points of each clothing, metres.
    pub points: Vec<Vec<[f32; 3]>>,
    /// Number of the capture of each, within the set.
    pub captures: Vec<usize>,
}

/// Distances within and between two sets of clothings, millimetres.
///
/// ```
/// use cape_eval::quality::{ClothingSet, SetDistances};
///
/// // Two frames of one point each; both samples are near the first.
/// let set = |points: [[f32; 3]; 2]| ClothingSet {
///     points: points.map(|point| vec![point]).to_vec(),
///     captures: vec![0, 1],
/// };
/// let frames = set([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]);
/// let samples = set([[0.0, 0.1, 0.0], [0.0, 0.0, 0.1]]);
/// assert_eq!(SetDistances::between(&frames, &samples).coverage(), 0.5);
/// ```
#[derive(Debug, Clone)]
pub struct SetDistances {
    /// Distances between frames of different captures, `[frames][frames]`; infinite in one capture.
    frames: Vec<Vec<f64>>,
    /// Distances between samples, in the same way, `[samples][samples]`.
    samples: Vec<Vec<f64>>,
    /// Distances between frames and samples, `[frames][samples]`.
    between: Vec<Vec<f64>>,
}

/// Measures of a set of samples against a set of frames.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct SetQuality {
    /// Coverage: share of frames that are the nearest frame of a sample; higher is better.
    pub coverage: f64,
    /// Minimum matching distance: mean distance from a frame to the nearest sample, millimetres.
    pub minimum_matching_mm: f64,
    /// 1-nearest-neighbour accuracy: share of frames and samples whose nearest neighbour of another
    /// capture is of their own set; 0.5 if the distributions are equal, 1 if they are disjoint.
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

impl ClothingSet {
    /// Distances between clothings of different captures; infinite in one capture.
    fn distances(&self) -> Vec<Vec<f64>> {
        let mut distances = matrix(&self.points, &self.points);
        for (row, own) in distances.iter_mut().zip(&self.captures) {
            for (distance, capture) in row.iter_mut().zip(&self.captures) {
                if capture == own {
                    *distance = f64::INFINITY;
                }
            }
        }
        distances
    }

    /// The clothings whose captures are chosen.
    pub(super) fn of_captures(&self, chosen: impl Fn(usize) -> bool) -> Self {
        let members = self.points.iter().zip(&self.captures).filter(|(_, c)| chosen(**c));
        let (points, captures) = members.map(|(points, c)| (points.clone(), *c)).unzip();
        Self { points, captures }
    }
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
    /// Computes all distances.
    pub fn between(frames: &ClothingSet, samples: &ClothingSet) -> Self {
        Self {
            frames: frames.distances(),
            samples: samples.distances(),
            between: matrix(&frames.points, &samples.points),
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

    /// Share of frames and samples whose nearest neighbour of another capture is of their own set.
    pub fn nearest_neighbour_accuracy(&self) -> f64 {
        let least =
            |distances: &mut dyn Iterator<Item = f64>| distances.fold(f64::INFINITY, f64::min);
        let own = |row: &[f64]| least(&mut row.iter().copied());
        let frames = (0..self.frames.len())
            .filter(|&frame| own(&self.frames[frame]) < own(&self.between[frame]));
        let samples = (0..self.samples.len()).filter(|&sample| {
            own(&self.samples[sample]) < least(&mut self.between.iter().map(|row| row[sample]))
        });
        let right = frames.count() + samples.count();
        right as f64 / (self.frames.len() + self.samples.len()).max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Clothings of one point each on a line, each of a capture of its own.
    fn set(values: &[f32]) -> ClothingSet {
        let points = values.iter().map(|&x| vec![[x / 1000.0, 0.0, 0.0]]).collect();
        ClothingSet { points, captures: (0..values.len()).collect() }
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
        assert!((mean_distance(&set(&[0.0, 3.0, 6.0]).points) - 4.0).abs() < 1e-4);
        assert_eq!(mean_distance(&set(&[1.0]).points), 0.0);
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

    /// Captures of ten near frames, in turn of either set: every frame is nearest to one of its own
    /// capture, and then to one of the other set.
    #[test]
    fn frames_of_one_capture_are_no_neighbours() {
        let places = |start: f32| -> Vec<f32> {
            (0..40).map(|i| start + (i / 10) as f32 * 10.0 + (i % 10) as f32 * 0.1).collect()
        };
        let (mut frames, mut samples) = (set(&places(0.0)), set(&places(5.0)));
        let accuracy = |frames: &ClothingSet, samples: &ClothingSet| {
            SetDistances::between(frames, samples).nearest_neighbour_accuracy()
        };
        assert_eq!(accuracy(&frames, &samples), 1.0);
        for set in [&mut frames, &mut samples] {
            set.captures.iter_mut().for_each(|capture| *capture /= 10);
        }
        assert_eq!(accuracy(&frames, &samples), 0.0);
        let chosen = frames.of_captures(|capture| capture == 2);
        assert_eq!((chosen.points.len(), chosen.captures), (10, vec![2; 10]));
    }
}
