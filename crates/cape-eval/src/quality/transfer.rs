//! Clothing of one frame under the pose of another frame of the same capture.

use std::collections::BTreeMap;

use cape_core::{BodyPose, Outfit};
use cape_data::PackedSet;
use cape_infer::Run;
use cape_stats::errors::vertex_errors_mm;
use ndarray::Array2;
use serde::Serialize;

use super::{decoded, pose_of};
use crate::Result;

/// Largest number of pairs of frames.
const PAIRS: usize = 200;

/// Errors of transferring clothing between two poses of a capture, which has the same garments put on
/// once. Frame A is encoded, its code decoded under the pose of frame B, and compared with B's true
/// displacements; means over the clothing vertices, millimetres.
///
/// ```
/// use cape_eval::quality::PoseTransfer;
///
/// let transfer = PoseTransfer {
///     pairs: 40,
///     transferred_mm: 6.0,
///     fixed_offsets_mm: 8.0,
///     reconstructed_mm: 5.0,
///     mean_shape_mm: 12.0,
///     model_change_mm: 3.0,
///     true_change_mm: 4.0,
/// };
/// assert_eq!(transfer.reduction(), 0.25);
/// assert_eq!(transfer.sensitivity_ratio(), 0.75);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PoseTransfer {
    /// Number of pairs of frames.
    pub pairs: usize,
    /// Error of A's code decoded under B's pose.
    pub transferred_mm: f64,
    /// Error of A's displacements in place of B's: offsets fixed to the body.
    pub fixed_offsets_mm: f64,
    /// Error of B's own reconstruction, the least that a transfer can have.
    pub reconstructed_mm: f64,
    /// Error of the mean training displacement.
    pub mean_shape_mm: f64,
    /// Change of the decoded displacements from A's pose to B's at A's code.
    pub model_change_mm: f64,
    /// Change of the true displacements from A to B, with what does not depend on the pose.
    pub true_change_mm: f64,
}

impl PoseTransfer {
    /// Reduction of the error of fixed offsets by the model, relative.
    pub fn reduction(&self) -> f64 {
        1.0 - self.transferred_mm / self.fixed_offsets_mm
    }

    /// Change of the decoded displacements relative to that of the true ones.
    pub fn sensitivity_ratio(&self) -> f64 {
        self.model_change_mm / self.true_change_mm
    }

    /// Measures the transfer on at most 200 pairs of test frames, evenly over the captures; `None` if
    /// the captures are unknown or have one frame each.
    pub fn measure(run: &Run, set: &PackedSet) -> Result<Option<Self>> {
        let pairs = pairs(set);
        if pairs.is_empty() {
            return Ok(None);
        }
        let mean: Vec<f32> = run.statistics().mean().iter().map(|&x| x as f32).collect();
        let mut sums = [0.0; 6];
        for chunk in pairs.chunks(cape_infer::BATCH) {
            let side = |at: usize| chunk.iter().map(move |pair| pair[at]);
            let outfits: Vec<Outfit> = side(0).map(|row| set.outfits()[row]).collect();
            let poses =
                |at: usize| side(at).map(|row| pose_of(set, row)).collect::<Result<Vec<_>>>();
            let [a, b] = [poses(0)?, poses(1)?];
            let truth = |at: usize| {
                let rows = side(at).map(|row| set.displacement_row(row));
                let rows = rows.map(|row| Ok(row?.iter().map(|&x| x as f32).collect()));
                rows.collect::<Result<Vec<Vec<f32>>>>()
            };
            let [true_a, true_b] = [truth(0)?, truth(1)?];
            let codes = |at: usize| run.encode_frames(set, &side(at).collect::<Vec<_>>());
            let (code_a, code_b) = (codes(0)?, codes(1)?);
            let decode =
                |codes: &Array2<f32>, poses: &[BodyPose]| decoded(run, codes, poses, &outfits);
            let [in_a, in_b, own] =
                [decode(&code_a, &a)?, decode(&code_a, &b)?, decode(&code_b, &b)?];
            for pair in 0..chunk.len() {
                let compared = [
                    (&in_b[pair], &true_b[pair]),
                    (&true_a[pair], &true_b[pair]),
                    (&own[pair], &true_b[pair]),
                    (&mean, &true_b[pair]),
                    (&in_a[pair], &in_b[pair]),
                    (&true_a[pair], &true_b[pair]),
                ];
                for (sum, (found, expected)) in sums.iter_mut().zip(compared) {
                    *sum += mean_error_mm(found, expected, run.clothing())?;
                }
            }
        }
        let [transferred, fixed, reconstructed, mean_shape, model, truth] =
            sums.map(|sum| sum / pairs.len() as f64);
        Ok(Some(Self {
            pairs: pairs.len(),
            transferred_mm: transferred,
            fixed_offsets_mm: fixed,
            reconstructed_mm: reconstructed,
            mean_shape_mm: mean_shape,
            model_change_mm: model,
            true_change_mm: truth,
        }))
    }
}

fn mean_error_mm(found: &[f32], expected: &[f32], clothing: &[usize]) -> Result<f64> {
    let errors = vertex_errors_mm(found, expected, clothing)?;
    Ok(errors.iter().map(|&x| f64::from(x)).sum::<f64>() / errors.len().max(1) as f64)
}

/// Pairs of frames of one capture, half a capture apart, evenly over all captures.
fn pairs(set: &PackedSet) -> Vec<[usize; 2]> {
    let mut captures: BTreeMap<String, Vec<usize>> = BTreeMap::new();
    for row in 0..set.frames() {
        if let Some(capture) = set.capture(row) {
            captures.entry(capture).or_default().push(row);
        }
    }
    let mut found = Vec::new();
    for rows in captures.values().filter(|rows| rows.len() > 1) {
        let half = rows.len() / 2;
        found.extend((0..rows.len() - half).map(|i| [rows[i], rows[i + half]]));
    }
    let step = found.len().div_ceil(PAIRS).max(1);
    found.into_iter().step_by(step).collect()
}
