//! Frames of a packed set at its clothing vertices.

use std::collections::BTreeMap;

use cape_core::joints::{CLOTHING_JOINTS, pose_feature, pose_rotations};
use cape_data::PackedSet;
use ndarray::Array2;
use rayon::prelude::*;

use crate::Result;

/// Displacements at clothing vertices, metres, `[frames, 3 C]`.
pub(super) struct ClothingFrames {
    pub(super) rows: Array2<f64>,
}

impl ClothingFrames {
    /// At most `most` of the frames `rows`, evenly spaced.
    pub(super) fn spread(
        set: &PackedSet,
        rows: &[usize],
        clothing: &[usize],
        most: usize,
    ) -> Result<Self> {
        let step = rows.len().div_ceil(most.max(1)).max(1);
        let picked: Vec<usize> = rows.iter().copied().step_by(step).collect();
        Self::read(set, &picked, clothing)
    }

    fn read(set: &PackedSet, rows: &[usize], clothing: &[usize]) -> Result<Self> {
        let read: Vec<Vec<f64>> = rows
            .par_iter()
            .map(|&row| {
                let whole = set.displacement_row(row)?;
                Ok(clothing
                    .iter()
                    .flat_map(|&v| [0, 1, 2].map(|axis| whole[3 * v + axis]))
                    .collect())
            })
            .collect::<Result<_>>()?;
        let shape = (rows.len(), 3 * clothing.len());
        Ok(Self { rows: Array2::from_shape_fn(shape, |(row, column)| read[row][column]) })
    }
}

/// Consecutive frames of one capture.
pub(super) struct CaptureFrames {
    /// Subject and outfit: the garments.
    pub(super) garments: String,
    /// Displacements, metres, `[frames, 3 C]`.
    pub(super) displacements: Array2<f64>,
    /// Pose features, `[frames, 126]`.
    pub(super) features: Array2<f64>,
}

/// Captures of a set, evenly spaced, with at most `most` frames in all but at least one capture; none if
/// their origins are unknown.
pub(super) fn captures(
    set: &PackedSet,
    clothing: &[usize],
    most: usize,
) -> Result<Vec<CaptureFrames>> {
    let Some(origins) = set.origins() else { return Ok(Vec::new()) };
    let mut rows: BTreeMap<(String, String), Vec<usize>> = BTreeMap::new();
    for (row, origin) in origins.iter().enumerate() {
        let garments = format!("{} {}", origin.subject, origin.outfit);
        rows.entry((garments, origin.sequence.clone())).or_default().push(row);
    }
    let frames: usize = rows.values().map(Vec::len).sum();
    let step = frames.div_ceil(most.max(1)).max(1);
    let mut found = Vec::new();
    for ((garments, _), mut rows) in rows.into_iter().step_by(step) {
        rows.sort_by(|&a, &b| origins[a].frame.cmp(&origins[b].frame));
        let features: Vec<[f64; 9 * CLOTHING_JOINTS.len()]> = rows
            .iter()
            .map(|&row| {
                let pose: Vec<f64> = set.pose(row)?.into_iter().map(f64::from).collect();
                Ok(pose_feature(&pose_rotations(&pose)?)?)
            })
            .collect::<Result<_>>()?;
        let shape = (rows.len(), 9 * CLOTHING_JOINTS.len());
        found.push(CaptureFrames {
            garments,
            displacements: ClothingFrames::read(set, &rows, clothing)?.rows,
            features: Array2::from_shape_fn(shape, |(row, column)| features[row][column]),
        });
    }
    Ok(found)
}

/// Mean length of the rows' points, millimetres.
pub(super) fn mean_length_mm(row: ndarray::ArrayView1<'_, f64>) -> f64 {
    let (mut sum, mut points) = (0.0, 0.0f64);
    for point in row.exact_chunks(3) {
        sum += point.dot(&point).sqrt();
        points += 1.0;
    }
    1000.0 * sum / points.max(1.0)
}
