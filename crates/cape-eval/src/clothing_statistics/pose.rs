//! Dependence of clothing on the pose.

use std::collections::BTreeMap;

use cape_stats::ridge::ridge;
use ndarray::{Array2, ArrayView1, Axis, s};
use rayon::prelude::*;
use serde::Serialize;

use super::frames::{CaptureFrames, mean_length_mm};

/// Blocks of consecutive frames of a capture, each predicted from the others.
const BLOCKS: usize = 5;
/// Weights of the squared coefficients, relative to the mean squared feature.
const WEIGHTS: [f64; 5] = [1e-3, 1e-2, 1e-1, 1.0, 10.0];
/// Largest mean angle between the joints of two frames of the same pose, radians.
const SAME_POSE: f64 = 0.15;

/// Share of the variance within captures that a linear function of the pose explains: ridge regression
/// from the pose feature, fitted to four fifths of a capture's frames and tested on a fifth of
/// consecutive frames.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PoseVariance {
    /// Number of captures.
    pub captures: usize,
    /// Number of frames.
    pub frames: usize,
    /// Mean distance of a frame from its capture's mean, millimetres.
    pub variation_mm: f64,
    /// Mean error of the prediction, millimetres.
    pub error_mm: f64,
    /// Explained share of the variance, with the best of five weights of the coefficients.
    pub explained: f64,
    /// Correlation of what is not explained between consecutive frames: 0 for noise.
    pub autocorrelation: f64,
}

#[derive(Debug, Clone, Copy, Default)]
struct PoseSums {
    frames: f64,
    total: f64,
    left: f64,
    variation_mm: f64,
    error_mm: f64,
    products: f64,
    squares: f64,
}

impl PoseSums {
    fn add(self, other: Self) -> Self {
        Self {
            frames: self.frames + other.frames,
            total: self.total + other.total,
            left: self.left + other.left,
            variation_mm: self.variation_mm + other.variation_mm,
            error_mm: self.error_mm + other.error_mm,
            products: self.products + other.products,
            squares: self.squares + other.squares,
        }
    }
}

impl PoseVariance {
    /// Measures captures of at least ten frames.
    pub(super) fn measure(captures: &[CaptureFrames]) -> Option<Self> {
        let long: Vec<&CaptureFrames> =
            captures.iter().filter(|c| c.features.nrows() >= 2 * BLOCKS).collect();
        let of_weight = |weight: f64| {
            let sums: Vec<PoseSums> =
                long.par_iter().map(|capture| capture_sums(capture, weight)).collect();
            sums.into_iter().fold(PoseSums::default(), PoseSums::add)
        };
        let best = WEIGHTS.map(of_weight).into_iter().min_by(|a, b| a.left.total_cmp(&b.left))?;
        (best.frames > 0.0 && best.total > 0.0).then(|| Self {
            captures: long.len(),
            frames: best.frames as usize,
            variation_mm: best.variation_mm / best.frames,
            error_mm: best.error_mm / best.frames,
            explained: 1.0 - best.left / best.total,
            autocorrelation: best.products / best.squares,
        })
    }
}

fn capture_sums(capture: &CaptureFrames, weight: f64) -> PoseSums {
    let frames = capture.features.nrows();
    let centred = {
        let y = &capture.displacements;
        y - &(y.sum_axis(Axis(0)) / frames as f64)
    };
    let mut sums = PoseSums::default();
    for block in 0..BLOCKS {
        let [first, end] = [block, block + 1].map(|b| b * frames / BLOCKS);
        let others: Vec<usize> = (0..first).chain(end..frames).collect();
        let [x, y] = [&capture.features, &centred].map(|of| of.select(Axis(0), &others));
        let tested = capture.features.slice(s![first..end, ..]);
        // Positive definite by the penalty; without a solution the mean is the prediction.
        let predicted = ridge(x.view(), y.view(), tested, weight)
            .unwrap_or_else(|_| Array2::zeros((end - first, y.ncols())));
        let truth = centred.slice(s![first..end, ..]);
        let residual = &truth - &predicted;
        let square = |row: ArrayView1<f64>| row.dot(&row);
        for (row, left) in truth.rows().into_iter().zip(residual.rows()) {
            sums.frames += 1.0;
            sums.total += square(row);
            sums.left += square(left);
            sums.variation_mm += mean_length_mm(row);
            sums.error_mm += mean_length_mm(left);
        }
        for at in 1..residual.nrows() {
            let [before, now] = [residual.row(at - 1), residual.row(at)];
            sums.products += before.dot(&now);
            sums.squares += 0.5 * (square(before) + square(now));
        }
    }
    sums
}

/// Frames of the same pose in different captures of the same garments: for each frame the frame of
/// another capture with the least mean angle between the clothing-related joints' rotations, if that is
/// at most 0.15 rad.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RepeatedPoses {
    /// Number of pairs.
    pub pairs: usize,
    /// Mean angle between the joints of a pair, radians.
    pub angle: f64,
    /// Mean difference of the displacements of a pair, millimetres.
    pub difference_mm: f64,
}

impl RepeatedPoses {
    pub(super) fn measure(captures: &[CaptureFrames]) -> Option<Self> {
        let mut garments: BTreeMap<&str, Vec<&CaptureFrames>> = BTreeMap::new();
        for capture in captures {
            garments.entry(&capture.garments).or_default().push(capture);
        }
        let mut pairs: Vec<[f64; 2]> = Vec::new();
        for worn in garments.values() {
            for (index, capture) in worn.iter().enumerate() {
                let others =
                    || worn.iter().enumerate().filter(|(i, _)| *i != index).map(|(_, other)| other);
                let found: Vec<Option<[f64; 2]>> = (0..capture.features.nrows())
                    .into_par_iter()
                    .map(|frame| {
                        let own = capture.features.row(frame);
                        let distances = others().flat_map(|other| {
                            let rows = other.features.rows().into_iter().enumerate();
                            rows.map(move |(at, row)| (mean_angle(own, row), other, at))
                        });
                        let (angle, other, at) = distances.min_by(|a, b| a.0.total_cmp(&b.0))?;
                        let change =
                            &capture.displacements.row(frame) - &other.displacements.row(at);
                        (angle <= SAME_POSE).then(|| [angle, mean_length_mm(change.view())])
                    })
                    .collect();
                pairs.extend(found.into_iter().flatten());
            }
        }
        let count = pairs.len();
        let mean = |at: usize| pairs.iter().map(|pair| pair[at]).sum::<f64>() / count as f64;
        (count > 0).then(|| Self { pairs: count, angle: mean(0), difference_mm: mean(1) })
    }
}

/// Mean angle between the rotations of two pose features, radians.
fn mean_angle(a: ArrayView1<'_, f64>, b: ArrayView1<'_, f64>) -> f64 {
    let joints = a.len() / 9;
    let angle = |joint: usize| {
        let of = s![9 * joint..9 * joint + 9];
        // The trace of AᵀB is the sum of the products.
        (0.5 * (a.slice(of).dot(&b.slice(of)) - 1.0)).clamp(-1.0, 1.0).acos()
    };
    (0..joints).map(angle).sum::<f64>() / joints.max(1) as f64
}

#[cfg(test)]
mod tests {
    use cape_core::joints::{pose_feature, pose_rotations};

    use super::*;

    /// A capture whose left knee swings, with a displacement that is `gain` times a number of its
    /// feature plus `drift` that the pose does not tell.
    fn capture(
        frames: usize,
        phase: f64,
        gain: f64,
        drift: impl Fn(usize) -> f64,
    ) -> CaptureFrames {
        let features: Vec<_> = (0..frames)
            .map(|frame| {
                let mut pose = [0.0; 72];
                pose[3 * 4] = 0.6 * (1.1 * frame as f64 + phase).sin();
                pose_feature(&pose_rotations(&pose).unwrap()).unwrap()
            })
            .collect();
        let features = Array2::from_shape_fn((frames, 126), |(row, column)| features[row][column]);
        // Row 1, column 2 of the left knee's rotation, the fourth joint of the feature.
        let displacements = Array2::from_shape_fn((frames, 3), |(row, axis)| {
            if axis == 1 { gain * features[(row, 9 * 3 + 5)] + drift(row) } else { 0.2 }
        });
        CaptureFrames { garments: "s o".into(), displacements, features }
    }

    #[test]
    fn what_depends_on_the_pose_is_explained() {
        let found = PoseVariance::measure(&[capture(40, 0.0, 0.01, |_| 0.0)]).unwrap();
        assert!(found.explained > 0.99, "{found:?}");
        assert!((found.captures, found.frames) == (1, 40) && found.error_mm < 0.5);
        // A slow wave that the pose does not tell.
        let slow = capture(40, 0.0, 0.0, |frame| 0.01 * (0.15 * frame as f64).sin());
        let found = PoseVariance::measure(&[slow]).unwrap();
        assert!(found.explained < 0.2 && found.autocorrelation > 0.8, "{found:?}");
        // Alternating noise.
        let noise = capture(40, 0.0, 0.0, |frame| if frame % 2 == 0 { 0.01 } else { -0.01 });
        let found = PoseVariance::measure(&[noise]).unwrap();
        assert!(found.explained < 0.2 && found.autocorrelation < -0.8, "{found:?}");
        assert!((found.variation_mm - 10.0).abs() < 1e-6);
        assert_eq!(PoseVariance::measure(&[capture(9, 0.0, 0.01, |_| 0.0)]), None);
    }

    #[test]
    fn the_same_pose_is_found_in_another_capture() {
        let worn = [capture(12, 0.0, 0.0, |_| 0.0), capture(12, 0.0, 0.0, |_| 0.004)];
        let found = RepeatedPoses::measure(&worn).unwrap();
        assert_eq!(found.pairs, 24);
        assert!(found.angle < 1e-6 && (found.difference_mm - 4.0).abs() < 1e-9, "{found:?}");
        let other = CaptureFrames { garments: "another".into(), ..capture(12, 0.0, 0.0, |_| 0.0) };
        assert_eq!(RepeatedPoses::measure(&[capture(12, 0.0, 0.0, |_| 0.0), other]), None);
    }
}
