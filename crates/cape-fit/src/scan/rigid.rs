//! Rigid placement of a body in a scan: robust, annealed iterative closest points (ICP) from
//! several yaw angles.

use std::f64::consts::TAU;

use glam::{DMat3, DQuat, DVec3};
use nalgebra::Matrix3;
use rayon::prelude::*;

use super::{energy::ScanTarget, nearest::SurfaceTree};
use crate::body_energy::geman_mcclure;

/// Geman–McClure scales σ (outlier thresholds) of the first and the last iteration, metres.
const ROBUST: [f64; 2] = [0.4, 0.1];
/// Number of ICP iterations.
const MATCHINGS: usize = 16;
/// Number of matched points of the scan, and of the body.
const POINTS: usize = 300;
/// Number of initial yaw angles.
const FACINGS: usize = 4;

/// A rigid transform `x ↦ R x + t`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct RigidTransform {
    pub(crate) rotation: DMat3,
    pub(crate) translation: DVec3,
}

impl RigidTransform {
    pub(crate) fn apply(&self, point: DVec3) -> DVec3 {
        self.rotation * point + self.translation
    }

    fn undo(&self, point: DVec3) -> DVec3 {
        self.rotation.transpose() * (point - self.translation)
    }

    /// Rigid transform that minimises `Σ w ‖R x + t − y‖²` over pairs `(x, y, w)` (Kabsch 1976);
    /// `None` without positive weights.
    pub(crate) fn between(pairs: &[(DVec3, DVec3, f64)]) -> Option<Self> {
        let weight: f64 = pairs.iter().map(|pair| pair.2).sum();
        if !(weight > 0.0 && weight.is_finite()) {
            return None;
        }
        let from = pairs.iter().map(|&(x, _, w)| x * w).sum::<DVec3>() / weight;
        let to = pairs.iter().map(|&(_, y, w)| y * w).sum::<DVec3>() / weight;
        let mut spread = Matrix3::<f64>::zeros();
        for &(x, y, w) in pairs {
            let (x, y) = (x - from, (y - to) * w);
            spread += Matrix3::from_fn(|i, j| y[i] * x[j]);
        }
        let svd = spread.svd(true, true);
        let (u, v_t) = (svd.u?, svd.v_t?);
        let mut reflection = Matrix3::identity();
        reflection[(2, 2)] = (u * v_t).determinant().signum();
        let rotation = u * reflection * v_t;
        let rotation = DMat3::from_cols_slice(rotation.as_slice());
        Some(Self { rotation, translation: to - rotation * from })
    }
}

/// A rigid transform of a body onto a scan, and its energy, m².
#[derive(Debug, Clone, Copy)]
pub(crate) struct RigidAlignment {
    pub(crate) rigid: RigidTransform,
    pub(crate) energy: f64,
}

/// Placement of lowest energy of a body upright along `up` in the scan, over several initial yaw
/// angles.
pub(crate) fn place(
    target: &ScanTarget<'_>,
    vertices: &[DVec3],
    faces: &[[u32; 3]],
    up: DVec3,
) -> Option<RigidAlignment> {
    let body = SurfaceTree::from_faces(vertices, faces);
    let starts: Vec<DMat3> = (0..FACINGS)
        .map(|facing| TAU * facing as f64 / FACINGS as f64)
        .map(|yaw| DQuat::from_rotation_arc(DVec3::Y, up) * DQuat::from_rotation_y(yaw))
        .map(DMat3::from_quat)
        .collect();
    let placings: Vec<RigidAlignment> = starts
        .par_iter()
        .map(|&rotation| {
            let middle = target.samples().iter().map(|sample| sample.at);
            let middle = median(middle);
            let translation = middle - rotation * median(vertices.iter().copied());
            iterate(target, &body, vertices, RigidTransform { rotation, translation })
        })
        .collect();
    placings.into_iter().min_by(|a, b| a.energy.total_cmp(&b.energy))
}

fn iterate(
    target: &ScanTarget<'_>,
    body: &SurfaceTree<'_>,
    vertices: &[DVec3],
    start: RigidTransform,
) -> RigidAlignment {
    let mut rigid = start;
    let steps = vertices.len().div_ceil(POINTS).max(1);
    let mut energy = f64::INFINITY;
    for matching in 0..=MATCHINGS {
        let along = matching as f64 / MATCHINGS as f64;
        let robust = ROBUST[0] * (ROBUST[1] / ROBUST[0]).powf(along);
        let mut pairs = Vec::with_capacity(2 * POINTS);
        energy = 0.0;
        let mut pair = |x: DVec3, y: DVec3, share: f64, rigid: &RigidTransform| {
            let (penalty, slope) = geman_mcclure(rigid.apply(x).distance_squared(y), robust);
            energy += share * penalty;
            pairs.push((x, y, share * slope));
        };
        let samples = &target.samples()[..POINTS.min(target.samples().len())];
        for sample in samples {
            let at = rigid.undo(sample.at);
            if let Some((_, nearest)) = body.nearest(at, DVec3::ZERO, f64::MAX) {
                pair(nearest.at, sample.at, 1.0 / samples.len() as f64, &rigid);
            }
        }
        for &vertex in vertices.iter().step_by(steps) {
            let at = rigid.apply(vertex);
            if let Some((_, nearest)) = target.tree().nearest(at, DVec3::ZERO, f64::MAX) {
                let share = steps as f64 / vertices.len() as f64;
                pair(vertex, nearest.at, share, &rigid);
            }
        }
        if matching < MATCHINGS {
            rigid = RigidTransform::between(&pairs).unwrap_or(rigid);
        }
    }
    RigidAlignment { rigid, energy }
}

/// Median of each coordinate, metres.
fn median(points: impl Iterator<Item = DVec3>) -> DVec3 {
    let points: Vec<DVec3> = points.collect();
    let of = |axis: usize| {
        let mut values: Vec<f64> = points.iter().map(|point| point[axis]).collect();
        values.sort_unstable_by(f64::total_cmp);
        values.get(values.len() / 2).copied().unwrap_or_default()
    };
    DVec3::new(of(0), of(1), of(2))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::{
        scan::{Scan, Unit},
        testing::BODY,
    };

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        #[test]
        fn a_movement_is_found_from_its_pairs(
            numbers in prop::collection::vec(-1.0f64..1.0, 24),
            w in prop::collection::vec(0.1f64..1.0, 8), x in -3.0f64..3.0, y in -3.0f64..3.0,
        ) {
            let rotation = DMat3::from_quat(DQuat::from_scaled_axis(DVec3::new(x, y, 0.5)));
            let rigid = RigidTransform { rotation, translation: DVec3::new(y, x, 2.0) };
            let points = numbers.as_chunks::<3>().0.iter().map(|&p| DVec3::from_array(p));
            let pairs: Vec<_> = points.zip(w).map(|(p, w)| (p, rigid.apply(p), w)).collect();
            let found = RigidTransform::between(&pairs).unwrap();
            prop_assert!(found.rotation.abs_diff_eq(rigid.rotation, 1e-9), "{found:?}");
            prop_assert!(found.translation.abs_diff_eq(rigid.translation, 1e-9));
            prop_assert!(found.undo(found.apply(pairs[0].0)).abs_diff_eq(pairs[0].0, 1e-9));
        }
    }

    #[test]
    fn a_body_is_placed_whichever_way_it_faces() {
        let rows = BODY.v_template.rows().into_iter();
        let vertices: Vec<DVec3> = rows.map(|v| DVec3::new(v[0], v[1], v[2])).collect();
        for yaw in [0.6, 2.9] {
            let rotation = DMat3::from_rotation_y(yaw) * DMat3::from_rotation_x(0.15);
            let rigid = RigidTransform { rotation, translation: DVec3::new(3.0, 0.8, -1.0) };
            let moved: Vec<DVec3> = vertices.iter().map(|&v| rigid.apply(v)).collect();
            let scan = Scan::new(moved, None, Vec::new(), Unit::M).unwrap();
            let target = ScanTarget::new(&scan, 1000, 1);
            let upright = place(&target, &vertices, &BODY.faces, DVec3::Y).unwrap();
            let off = vertices.iter().map(|&v| upright.rigid.apply(v).distance(rigid.apply(v)));
            let off = off.fold(0.0, f64::max);
            assert!(off < 0.03, "{yaw}: {off}");
            let upside_down = place(&target, &vertices, &BODY.faces, DVec3::NEG_Y).unwrap();
            assert!(upright.energy < 0.2 * upside_down.energy);
        }
    }
}
