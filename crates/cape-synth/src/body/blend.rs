//! Pose directions that compensate the volume loss of linear blend skinning at bent and twisted
//! joints.

use std::ops::{Mul, SubAssign};

use glam::{DMat3, DQuat, DVec3};

use super::rig::{Weights, share_below};
use cape_core::joints::JOINTS;

/// Number of entries of a rotation matrix.
pub(super) const ENTRIES: usize = 9;
/// Smallest correction that is kept, metres per entry of `R − I`.
const NEGLIGIBLE: f64 = 1e-7;

/// Pose directions of joints 1 to 23, metres per entry of `R_j − I` (row-major), `[vertices][23 · 9]`.
///
/// For a share `s` of the weights at joint `j`, linear blending maps a rest offset `q` by
/// `B = (1 − s) I + s R`, which shortens it. The target is `R^s q`, which keeps its length (as dual
/// quaternion skinning does), so the correction before skinning is `B⁻¹ R^s q − q`. For each
/// vertex the directions are the least-squares fit of that, over rotations sampled in the joint's
/// range, by a linear function of `R − I`. The correction is linear in `q`, so the fit is a
/// matrix for each share `s`, tabulated and interpolated.
pub(super) fn pose_directions(
    vertices: &[DVec3],
    weights: &[Weights],
    joints: &[DVec3; JOINTS],
) -> Vec<Vec<DVec3>> {
    let mut directions = vec![vec![DVec3::ZERO; (JOINTS - 1) * ENTRIES]; vertices.len()];
    for joint in 1..JOINTS {
        let rotations: Vec<DMat3> = samples(joint).into_iter().map(rotation).collect();
        let table = CorrectionTable::new(&rotations);
        let strength = strength(joint);
        for (v, direction) in directions.iter_mut().enumerate() {
            let share = share_below(&weights[v], joint);
            if !(1e-6..=1.0 - 1e-6).contains(&share) {
                continue;
            }
            let offset = vertices[v] - joints[joint];
            for (entry, matrix) in table.at(share).iter().enumerate() {
                let d = *matrix * offset * strength;
                if d.length() > NEGLIGIBLE {
                    direction[(joint - 1) * ENTRIES + entry] = d;
                }
            }
        }
    }
    directions
}

/// Share of the correction to apply; at hips and shoulders the full correction would bulge.
fn strength(joint: usize) -> f64 {
    match joint {
        1 | 2 | 16 | 17 => 0.6,
        _ => 1.0,
    }
}

/// Rotation vectors in the range of motion of a joint, on a lattice, radians.
pub(super) fn samples(joint: usize) -> Vec<DVec3> {
    // Largest rotation about x, y and z, radians.
    let reach = match joint {
        1 | 2 => DVec3::new(1.9, 0.8, 0.9),
        4 | 5 => DVec3::new(2.1, 0.4, 0.3),
        3 | 6 | 9 => DVec3::new(0.7, 0.7, 0.5),
        7 | 8 | 10 | 11 => DVec3::new(0.8, 0.5, 0.4),
        12 | 15 => DVec3::new(0.7, 0.9, 0.5),
        13 | 14 => DVec3::new(0.3, 0.4, 0.5),
        16 | 17 => DVec3::new(1.2, 1.3, 1.5),
        18 | 19 => DVec3::new(1.0, 2.1, 1.2),
        _ => DVec3::new(1.0, 0.8, 1.1),
    };
    let ticks = [-1.0, -0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75, 1.0];
    let mut samples = Vec::new();
    for x in ticks {
        for y in ticks {
            for z in ticks {
                let at = DVec3::new(x, y, z);
                if at.length() <= 1.0 {
                    samples.push(at * reach);
                }
            }
        }
    }
    samples
}

/// Rotation matrix of a rotation vector.
pub(super) fn rotation(vector: DVec3) -> DMat3 {
    DMat3::from_quat(DQuat::from_scaled_axis(vector))
}

/// Nine matrices for each share 0, 1/N, …, 1, one per entry of `R − I`, that map a rest offset to its
/// correction.
struct CorrectionTable {
    rows: Vec<[DMat3; ENTRIES]>,
}

impl CorrectionTable {
    const STEPS: usize = 32;

    fn new(rotations: &[DMat3]) -> Self {
        let features: Vec<[f64; ENTRIES]> = rotations.iter().map(entries).collect();
        // The ridge bounds combinations of entries that rotations hardly vary.
        let ridge = 1e-3 * rotations.len() as f64;
        let mut normal = [[0.0; ENTRIES]; ENTRIES];
        for f in &features {
            for (row, a) in normal.iter_mut().zip(f) {
                row.iter_mut().zip(f).for_each(|(n, b)| *n += a * b);
            }
        }
        for (i, row) in normal.iter_mut().enumerate() {
            row[i] += ridge;
        }
        let factor = cholesky(&normal);
        let rows = (0..=Self::STEPS)
            .map(|step| {
                let share = step as f64 / Self::STEPS as f64;
                let mut moment = [DMat3::ZERO; ENTRIES];
                for (rotation, f) in rotations.iter().zip(&features) {
                    let blended = DMat3::IDENTITY * (1.0 - share) + *rotation * share;
                    let part = DQuat::IDENTITY.slerp(DQuat::from_mat3(rotation), share);
                    let target = blended.inverse() * DMat3::from_quat(part) - DMat3::IDENTITY;
                    moment.iter_mut().zip(f).for_each(|(m, &f)| *m += target * f);
                }
                solve(&factor, moment)
            })
            .collect();
        Self { rows }
    }

    fn at(&self, share: f64) -> [DMat3; ENTRIES] {
        let at = share * Self::STEPS as f64;
        let low = (at as usize).min(Self::STEPS - 1);
        let t = at - low as f64;
        std::array::from_fn(|i| self.rows[low][i] * (1.0 - t) + self.rows[low + 1][i] * t)
    }
}

/// Entries of `R − I`, row-major.
pub(super) fn entries(rotation: &DMat3) -> [f64; ENTRIES] {
    (rotation.transpose() - DMat3::IDENTITY).to_cols_array()
}

/// Lower Cholesky factor of a positive definite matrix.
pub(super) fn cholesky(a: &[[f64; ENTRIES]; ENTRIES]) -> [[f64; ENTRIES]; ENTRIES] {
    let mut l = [[0.0; ENTRIES]; ENTRIES];
    for i in 0..ENTRIES {
        for j in 0..=i {
            let rest = a[i][j] - (0..j).map(|k| l[i][k] * l[j][k]).sum::<f64>();
            l[i][j] = if i == j { rest.sqrt() } else { rest / l[j][j] };
        }
    }
    l
}

/// Solves `L Lᵀ x = b`.
pub(super) fn solve<T>(l: &[[f64; ENTRIES]; ENTRIES], mut b: [T; ENTRIES]) -> [T; ENTRIES]
where
    T: Copy + SubAssign + Mul<f64, Output = T>,
{
    for i in 0..ENTRIES {
        for k in 0..i {
            let known = b[k] * l[i][k];
            b[i] -= known;
        }
        b[i] = b[i] * (1.0 / l[i][i]);
    }
    for i in (0..ENTRIES).rev() {
        for k in i + 1..ENTRIES {
            let known = b[k] * l[k][i];
            b[i] -= known;
        }
        b[i] = b[i] * (1.0 / l[i][i]);
    }
    b
}
