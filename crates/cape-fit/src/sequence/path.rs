//! Choice of one body for each frame among those that explain it about equally well.

use glam::{DQuat, DVec3};

use super::temporal::TemporalConfig;
use crate::{
    BodyParameters, Result, Skeleton,
    parameters::{BETAS_AT, POSE_AT, transl},
    smplify::BodyCandidates,
};

/// Body of each frame: the path of the lowest sum of energies and of squared changes of the joints
/// relative to the pelvis, in standard deviations (Viterbi's algorithm). Frames without candidates
/// are interpolated; `None` if no frame has any.
pub(super) fn smoothest_path(
    skeleton: &Skeleton,
    betas: usize,
    frames: &[Option<BodyCandidates>],
    config: &TemporalConfig,
) -> Result<Option<Vec<BodyParameters>>> {
    let mut seen: Vec<(usize, Vec<PathNode>)> = Vec::new();
    for (frame, candidates) in frames.iter().enumerate() {
        let Some(candidates) = candidates else { continue };
        let BodyCandidates { best, leaning, others, .. } = candidates;
        let mut nodes = Vec::with_capacity(2 + others.len());
        for candidate in [best, leaning].into_iter().chain(others) {
            if !candidate.energy.is_finite() {
                continue;
            }
            let x = &candidate.x;
            let posed =
                skeleton.pose(&x[BETAS_AT..BETAS_AT + betas], &x[POSE_AT..BETAS_AT], transl(x))?;
            let pelvis = posed.joints()[0];
            let joints = posed.joints().iter().map(|joint| *joint - pelvis).collect();
            nodes.push(PathNode { x: x.clone(), joints, cost: candidate.energy, before: 0 });
        }
        if let Some((last, before)) = seen.last() {
            let seconds = (frame - last) as f64 / config.frame_rate;
            let scale = 0.5 / (config.velocity * seconds).powi(2);
            for node in &mut nodes {
                let costs = before.iter().map(|from| from.cost + scale * node.change(from));
                let best = costs.enumerate().min_by(|a, b| a.1.total_cmp(&b.1));
                if let Some((at, cost)) = best {
                    node.before = at;
                    node.cost += cost;
                }
            }
        }
        if !nodes.is_empty() {
            seen.push((frame, nodes));
        }
    }
    let Some((_, nodes)) = seen.last() else { return Ok(None) };
    let last = nodes.iter().enumerate().min_by(|a, b| a.1.cost.total_cmp(&b.1.cost));
    let mut at = last.map_or(0, |(at, _)| at);
    let mut chosen = Vec::with_capacity(seen.len());
    for (frame, nodes) in seen.iter().rev() {
        chosen.push((*frame, BodyParameters::from_vector(&nodes[at].x, betas)));
        at = nodes[at].before;
    }
    chosen.reverse();
    Ok((0..frames.len()).map(|frame| interpolate(&chosen, frame)).collect())
}

/// A body of one frame in the search.
#[derive(Debug)]
struct PathNode {
    x: Vec<f64>,
    /// Positions relative to the pelvis, metres.
    joints: Vec<DVec3>,
    /// Least cost of a path that ends here.
    cost: f64,
    /// Index of the body before on that path.
    before: usize,
}

impl PathNode {
    /// Sum of the squared changes of the joints, m².
    fn change(&self, from: &Self) -> f64 {
        self.joints.iter().zip(&from.joints).map(|(a, b)| a.distance_squared(*b)).sum()
    }
}

/// Body at a frame between those of `known` frames, in ascending order; the nearest beyond them.
/// `None` if there are none.
fn interpolate(known: &[(usize, BodyParameters)], frame: usize) -> Option<BodyParameters> {
    let after = known.partition_point(|(at, _)| *at < frame);
    match (after.checked_sub(1).map(|at| &known[at]), known.get(after)) {
        (None, None) => None,
        (_, Some((at, body))) if *at == frame => Some(body.clone()),
        (None, Some((_, body))) | (Some((_, body)), None) => Some(body.clone()),
        (Some((first, a)), Some((second, b))) => {
            let share = (frame - first) as f64 / (second - first) as f64;
            let blend = |a: &[f64], b: &[f64]| -> Vec<f64> {
                a.iter().zip(b).map(|(a, b)| a + share * (b - a)).collect()
            };
            let rotations = a.pose.as_chunks::<3>().0.iter().zip(b.pose.as_chunks::<3>().0);
            let between = |(a, b): (&[f64; 3], &[f64; 3])| {
                let [a, b] = [a, b].map(|angle| DQuat::from_scaled_axis(DVec3::from_array(*angle)));
                a.slerp(b, share).to_scaled_axis().to_array()
            };
            Some(BodyParameters {
                transl: std::array::from_fn(|axis| {
                    a.transl[axis] + share * (b.transl[axis] - a.transl[axis])
                }),
                pose: rotations.flat_map(between).collect(),
                betas: blend(&a.betas, &b.betas),
            })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_frames_lie_between_their_neighbours() {
        let body = |angle: f64, x: f64| BodyParameters {
            transl: [x, 0.0, -3.0],
            pose: [vec![0.0; 3], vec![angle, 0.0, 0.0], vec![0.0; 66]].concat(),
            betas: vec![angle],
        };
        let known = [(1, body(0.2, 0.0)), (5, body(1.0, 2.0))];
        for (frame, at) in [(0, 0), (5, 1), (9, 1)] {
            assert_eq!(interpolate(&known, frame).as_ref(), Some(&known[at].1));
        }
        assert_eq!(interpolate(&[], 3), None);
        let middle = interpolate(&known, 3).unwrap();
        let expected = body(0.6, 1.0);
        let off = middle.pose.iter().zip(&expected.pose).map(|(a, b)| (a - b).abs());
        assert!(off.fold(0.0, f64::max) < 1e-12);
        assert!((middle.transl[0] - 1.0).abs() < 1e-12 && (middle.betas[0] - 0.6).abs() < 1e-12);
    }
}
