//! Blend weights as glTF has them: sets of four joints a vertex.

use crate::SmplModel;

/// Weights smaller than this are left out.
const NEGLIGIBLE: f64 = 1e-5;
/// Sets of four that a vertex may have.
const MOST_SETS: usize = 4;

/// A joint and its weight, four times.
pub(super) type JointInfluences = [(u8, f32); 4];

/// For each set, the joints and weights of every vertex, the heaviest first; weights of a vertex
/// sum to 1 over all sets. SMPL's own weights fit into one set.
pub(super) fn influences(body: &SmplModel) -> Vec<Vec<JointInfluences>> {
    let vertices: Vec<Vec<(u8, f32)>> = body
        .weights
        .rows()
        .into_iter()
        .map(|row| {
            let mut kept: Vec<(u8, f64)> = row
                .iter()
                .enumerate()
                .filter(|(_, weight)| **weight > NEGLIGIBLE)
                .map(|(joint, &weight)| (joint as u8, weight))
                .collect();
            kept.sort_by(|a, b| b.1.total_cmp(&a.1));
            kept.truncate(4 * MOST_SETS);
            let sum: f64 = kept.iter().map(|(_, weight)| weight).sum();
            let share = |(joint, weight): (u8, f64)| (joint, (weight / sum) as f32);
            if kept.is_empty() { vec![(0, 1.0)] } else { kept.into_iter().map(share).collect() }
        })
        .collect();
    let most = vertices.iter().map(Vec::len).max().unwrap_or(1);
    (0..most.div_ceil(4))
        .map(|set| {
            let four = |vertex: &Vec<(u8, f32)>| {
                std::array::from_fn(|k| vertex.get(4 * set + k).copied().unwrap_or((0, 0.0)))
            };
            vertices.iter().map(four).collect()
        })
        .collect()
}
