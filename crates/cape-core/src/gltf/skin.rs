//! Blend weights as glTF stores them: sets of four joints per vertex.

use crate::SmplModel;

/// Smallest blend weight that is written.
const NEGLIGIBLE: f64 = 1e-5;
/// Largest number of sets of four joints per vertex.
const MAX_SETS: usize = 4;

/// Four joints of a vertex with their weights.
pub type JointInfluences = [(u8, f32); 4];

/// Joint influences of all vertices, `[sets][V]`, heaviest first; the weights of a vertex sum to 1
/// over all sets. SMPL's weights fit into one set.
///
/// ```
/// let body = cape_synth::synthetic_body();
/// let sets = cape_core::gltf::joint_influences(&body);
/// let sum: f32 = sets.iter().flat_map(|set| set[0]).map(|(_, weight)| weight).sum();
/// assert!((sum - 1.0).abs() < 1e-6);
/// ```
pub fn joint_influences(body: &SmplModel) -> Vec<Vec<JointInfluences>> {
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
            kept.truncate(4 * MAX_SETS);
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
