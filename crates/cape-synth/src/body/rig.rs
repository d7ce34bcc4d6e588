//! Blend weights and joint regressor.

use glam::{DMat4, DVec3, DVec4};

use super::{
    figure::{MIRRORED, parent, ramp},
    surface::{SymmetricMesh, neighbours},
};
use cape_core::joints::JOINTS;

/// Blend weights of one vertex, `[24]`.
pub(super) type Weights = [f64; JOINTS];

/// Blend weights of all vertices, `[6890][24]`: at most four joints per vertex, rows sum to 1,
/// symmetric in x = 0.
pub(super) fn blend_weights(skin: &SymmetricMesh) -> Vec<Weights> {
    let around = neighbours(skin.vertices.len(), &skin.faces);
    let mut rows: Vec<Weights> = skin.vertices.iter().map(|&p| row(p)).collect();
    for _ in 0..4 {
        rows = around
            .iter()
            .zip(&rows)
            .map(|(near, own)| {
                std::array::from_fn(|j| {
                    let mean = near.iter().map(|&n| rows[n as usize][j]).sum::<f64>();
                    0.5 * own[j] + 0.5 * mean / near.len() as f64
                })
            })
            .collect();
    }
    // The summation order differs between the two sides: symmetrise.
    (0..rows.len())
        .map(|v| {
            let m = skin.mirror[v] as usize;
            let even = |v: usize, m: usize| {
                four_largest(std::array::from_fn(|j| {
                    f64::midpoint(rows[v][j], rows[m][MIRRORED[j]])
                }))
            };
            if skin.vertices[v].x < 0.0 {
                let other = even(m, v);
                MIRRORED.map(|j| other[j])
            } else {
                even(v, m)
            }
        })
        .collect()
}

/// Keeps the four largest weights, less the fifth, so that the result is continuous.
fn four_largest(row: Weights) -> Weights {
    let mut sorted = row;
    sorted.sort_by(|a, b| b.total_cmp(a));
    let cut = sorted[4].max(1e-3);
    let kept = row.map(|w| (w - cut).max(0.0));
    let sum: f64 = kept.iter().sum();
    kept.map(|w| w / sum)
}

/// Weights before smoothing: each joint takes a share of the weight of its parent, which rises from 0
/// to 1 across the joint.
fn row(p: DVec3) -> Weights {
    let mut carried = [1.0; JOINTS];
    let mut row = [0.0; JOINTS];
    row[0] = 1.0;
    for joint in 1..JOINTS {
        let above = parent(joint);
        carried[joint] = carried[above] * share(joint, p);
        row[joint] += carried[joint];
        row[above] -= carried[joint];
    }
    row.map(|w| w.max(0.0))
}

/// True if `ancestor` is an ancestor of `joint` in the kinematic tree.
pub(super) fn is_ancestor(ancestor: usize, joint: usize) -> bool {
    let mut at = joint;
    while at != 0 {
        at = parent(at);
        if at == ancestor {
            return true;
        }
    }
    false
}

/// Share of a vertex's weights at `joint` and the joints below it.
pub(super) fn share_below(row: &Weights, joint: usize) -> f64 {
    (joint..JOINTS).filter(|&j| j == joint || is_ancestor(joint, j)).map(|j| row[j]).sum()
}

/// Share of the parent's weight that `joint` takes at rest position `p`.
fn share(joint: usize, p: DVec3) -> f64 {
    if MIRRORED[joint] < joint {
        return share(MIRRORED[joint], DVec3::new(-p.x, p.y, p.z));
    }
    let DVec3 { x, y, z } = p;
    let neck = || ramp(y + 0.38 * z, 0.225, 0.300);
    match joint {
        // Thigh: below a plane from the crotch to the hip bone, on its own side.
        1 => {
            let groin = -0.375 + 0.75 * x.abs().min(0.17) - 0.02 * ramp(-z, -0.02, 0.08);
            let shared = 0.002 + 0.028 * (1.0 - ramp(-y, 0.360, 0.420));
            ramp(groin - y, -0.070, 0.070) * ramp(x, -shared, shared)
        }
        3 => ramp(y, -0.205, -0.055),
        6 => ramp(y, -0.055, 0.055),
        9 => ramp(y, 0.030, 0.135),
        12 => neck() * (1.0 - ramp(x.abs(), 0.07, 0.13)),
        // Collar bone and shoulder blade.
        13 => {
            ramp(x, 0.010, 0.125)
                * ramp(y, 0.060, 0.200).max(ramp(x, 0.145, 0.200))
                * (1.0 - neck() * (1.0 - ramp(x, 0.07, 0.13)))
        }
        15 => ramp(y + 0.5 * (z - 0.03), 0.312, 0.382),
        16 => {
            ramp(x + 0.15 * (y - 0.2), 0.118, 0.222)
                * ramp(y, 0.085, 0.175).max(ramp(x, 0.18, 0.21))
        }
        4 => ramp(-y, 0.635, 0.745),
        7 => ramp(-y - 0.35 * (z + 0.034), 1.035, 1.110),
        10 => ramp(z, 0.068, 0.112),
        18 => ramp(x, 0.384, 0.480),
        20 => ramp(x, 0.648, 0.714),
        22 => ramp(x, 0.745, 0.795) * (1.0 - 0.6 * ramp(z, -0.005, 0.02)),
        _ => 0.0,
    }
}

/// Sparse row of the joint regressor: vertex indices and weights.
pub(super) type RegressorRow = Vec<(usize, f64)>;

/// Sparse rows of the joint regressor, `[24]`: positive weights of nearby vertices that sum to 1 and
/// average exactly to the joint, of minimal relative entropy to a Gaussian around it.
pub(super) fn joint_regressor(skin: &SymmetricMesh, joints: &[DVec3; JOINTS]) -> Vec<RegressorRow> {
    let mut rows: Vec<RegressorRow> =
        joints.iter().map(|&joint| regressor_row(skin, joint)).collect();
    for right in (0..JOINTS).filter(|&j| MIRRORED[j] < j) {
        rows[right] =
            rows[MIRRORED[right]].iter().map(|&(v, w)| (skin.mirror[v] as usize, w)).collect();
        rows[right].sort_by_key(|&(v, _)| v);
    }
    rows
}

fn regressor_row(skin: &SymmetricMesh, joint: DVec3) -> RegressorRow {
    let mut near: Vec<(f64, usize)> =
        skin.vertices.iter().enumerate().map(|(v, p)| (p.distance_squared(joint), v)).collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut count = 32;
    loop {
        let mut ring: Vec<(usize, f64)> =
            near[..count].iter().map(|&(d, v)| (v, (-0.5 * d / near[count - 1].0).exp())).collect();
        ring.sort_by_key(|&(v, _)| v);
        if let Some(row) = minimum_entropy_row(skin, joint, &ring) {
            return row;
        }
        // The joint is not well inside the hull of these vertices: take more.
        count = (count * 3 / 2).min(near.len());
    }
}

/// Weights of minimal relative entropy to `prior` that sum to 1 and average to `joint`, by Newton's
/// method on the dual problem; `None` if there are none.
fn minimum_entropy_row(
    skin: &SymmetricMesh,
    joint: DVec3,
    prior: &[(usize, f64)],
) -> Option<RegressorRow> {
    const SCALE: f64 = 20.0;
    const LARGEST: f64 = 0.2;
    let features: Vec<DVec4> =
        prior.iter().map(|&(v, _)| ((skin.vertices[v] - joint) * SCALE).extend(1.0)).collect();
    let mut multiplier = DVec4::new(0.0, 0.0, 0.0, -(prior.iter().map(|p| p.1).sum::<f64>()).ln());
    let mut weights: Vec<f64> = Vec::new();
    for _ in 0..60 {
        weights = features.iter().zip(prior).map(|(f, p)| p.1 * multiplier.dot(*f).exp()).collect();
        let mut gradient = DVec4::new(0.0, 0.0, 0.0, -1.0);
        let mut hessian = DMat4::ZERO;
        for (f, &w) in features.iter().zip(&weights) {
            gradient += *f * w;
            hessian += DMat4::from_cols(*f * f.x, *f * f.y, *f * f.z, *f) * w;
        }
        if gradient.length() < 1e-14 {
            break;
        }
        multiplier -= (hessian.inverse() * gradient).clamp_length_max(2.0);
    }
    let row: RegressorRow = prior.iter().zip(weights).map(|(&(v, _), w)| (v, w)).collect();
    let error = row.iter().map(|&(v, w)| skin.vertices[v] * w).sum::<DVec3>() - joint;
    let sum: f64 = row.iter().map(|r| r.1).sum();
    let valid = error.length() < 1e-10
        && (sum - 1.0).abs() < 1e-10
        && row.iter().all(|r| r.1.is_finite() && r.1 < LARGEST);
    valid.then_some(row)
}
