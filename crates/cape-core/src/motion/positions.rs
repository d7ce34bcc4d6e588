//! Positions of joints, which look like axis-angles by their shape.

use glam::DVec3;
use ndarray::ArrayView2;

use super::up_axis::bone;
use crate::joints::PARENTS;

/// Joints that SMPL, SMPL+H and SMPL-X share.
const SHARED: usize = 22;

/// True if rows `[frames, 3 · joints]` are positions of joints rather than rotations: the distances
/// between neighbours, which are the lengths of bones, do not change from frame to frame, or are in the
/// proportions of a person.
pub(super) fn are_positions(rows: ArrayView2<f64>) -> bool {
    if rows.ncols() < 3 * SHARED {
        return false;
    }
    let lengths: Vec<Vec<f64>> = rows
        .rows()
        .into_iter()
        .map(|row| {
            let at = |joint: usize| DVec3::from_array([0, 1, 2].map(|axis| row[3 * joint + axis]));
            (1..SHARED).map(|joint| at(joint).distance(at(PARENTS[joint].unwrap_or(0)))).collect()
        })
        .collect();
    let moving = rows.row(0) != rows.row(rows.nrows() - 1);
    (moving && are_rigid(&lengths)) || are_of_a_person(&lengths)
}

/// True if lengths `[frames][bones]` are the same in all of several frames.
fn are_rigid(lengths: &[Vec<f64>]) -> bool {
    /// Fewest frames that tell, largest relative change of a bone, and shortest bone in metres.
    const FRAMES: usize = 4;
    const CHANGE: f64 = 1e-3;
    const SHORTEST: f64 = 0.01;
    let first = &lengths[0];
    lengths.len() >= FRAMES
        && first.iter().all(|&length| length > SHORTEST)
        && lengths.iter().all(|frame| {
            frame.iter().zip(first).all(|(length, first)| (length - first).abs() < CHANGE * first)
        })
}

/// True if lengths `[frames][bones]` are those of SMPL's bones, in any unit, with noise.
fn are_of_a_person(lengths: &[Vec<f64>]) -> bool {
    /// Largest factor between a bone and its usual length, after scaling.
    const FACTOR: f64 = 2.5;
    let middle = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    let ratios: Vec<f64> = (0..SHARED - 1)
        .map(|index| {
            let length = middle(lengths.iter().map(|frame| frame[index]).collect());
            length / bone(index + 1).length()
        })
        .collect();
    let scale = middle(ratios.clone());
    scale > 0.0 && ratios.iter().all(|ratio| *ratio < FACTOR * scale && *ratio > scale / FACTOR)
}
