//! Free-form displacement of a fitted surface to a scan, beyond the space of the clothing model.
//!
//! `E(d) = E_D(b + d) + (λ_L Σ_v ‖(L d)_v‖² + λ_0 Σ_v ‖d_v‖²) / V` over displacements `d_v` of the
//! vertices of the fitted surface, with the umbrella Laplacian `(L d)_v = d_v − mean of its
//! neighbours'`: over noise and holes the displacement continues smoothly and decays. `E_D` is from
//! the scan to the surface only: the other direction would attract vertices to the edges of holes.

use cape_core::optimise::{LbfgsOptions, minimise};
use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::{
    Scan, ScanDistance,
    energy::{ScanEnergy, ScanTarget, distance},
};
use crate::{Error, Result, body_energy::check_weight};

/// Configuration of the free-form displacement.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FreeFormConfig {
    /// Weight λ_L of the Laplacian of the displacement.
    pub smooth: f64,
    /// Weight λ_0 of the length of the displacement.
    pub small: f64,
    /// Number of samples of the scan.
    pub samples: usize,
    /// Geman–McClure scales σ (outlier thresholds) of the two rounds, metres.
    pub robust_scale: [f64; 2],
    /// Optimiser steps in each round, at most.
    pub steps: usize,
    /// Random seed of the samples.
    pub seed: u64,
}

impl Default for FreeFormConfig {
    fn default() -> Self {
        Self {
            smooth: 1.0,
            small: 0.03,
            samples: 20_000,
            robust_scale: [0.05, 0.02],
            steps: 40,
            seed: 1,
        }
    }
}

/// Surface after the free-form displacement.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use cape_fit::scan::{FreeFormConfig, Scan, Unit, free_displacement};
/// use glam::DVec3;
///
/// // A surface that fits the scan already stays in place.
/// let (vertices, faces) = person();
/// let scan = Scan::new(vertices.clone(), None, Vec::new(), Unit::M)?;
/// let config = FreeFormConfig { samples: 500, steps: 2, ..FreeFormConfig::default() };
/// let free = free_displacement(&scan, &vertices, &faces, &config, &mut |_, _| {})?;
/// assert_eq!(free.vertices.len(), vertices.len());
/// assert!(free.moved < 1e-3 && free.distance.mean < 1e-3);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct FreeFormSurface {
    /// Vertices, metres, `[V]`.
    pub vertices: Vec<DVec3>,
    /// Distances of the scan from the surface.
    pub distance: ScanDistance,
    /// Mean length of the displacement, millimetres.
    pub moved: f64,
    /// Energy after each optimiser step, one curve for each round, mm².
    pub curves: Vec<Vec<f64>>,
}

/// Displaces the vertices of a fitted surface (metres, `[V]`, triangles `[F]`) to a scan.
/// `progress` is called with the number of steps done and of all at most.
///
/// # Errors
/// If a weight is negative or not finite.
pub fn free_displacement(
    scan: &Scan,
    vertices: &[DVec3],
    faces: &[[u32; 3]],
    config: &FreeFormConfig,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<FreeFormSurface> {
    check_weight("smooth", config.smooth)?;
    check_weight("small", config.small)?;
    let mut target = ScanTarget::new(scan, config.samples, config.seed);
    target.orient(vertices, faces);
    let umbrella = UmbrellaOperator::new(vertices.len(), faces);
    let mut x = vec![0.0; 3 * vertices.len()];
    let (mut curves, mut done) = (Vec::new(), 0);
    let total = config.steps * config.robust_scale.len();
    for robust_scale in config.robust_scale {
        let now = displaced(vertices, &x);
        let distances = ScanEnergy::new(&target, &now, faces, config.samples, robust_scale, 0.0);
        let options = LbfgsOptions { steps: config.steps, gain: 1e-4, ..<_>::default() };
        let mut within = 0;
        let found = minimise(x, &options, |x, gradient| {
            within += 1;
            progress((done + within).min(total), total);
            let value = energy(vertices, x, &distances, &umbrella, config, gradient);
            Ok::<_, Error>(value)
        })?;
        done += config.steps;
        x = found.x;
        curves.push(found.curve);
    }
    let moved = displaced(vertices, &x);
    let lengths = x.as_chunks::<3>().0.iter().map(|&d| DVec3::from_array(d).length());
    Ok(FreeFormSurface {
        distance: distance(&target, &moved, faces),
        moved: lengths.sum::<f64>() / vertices.len().max(1) as f64,
        vertices: moved,
        curves,
    })
}

/// Energy, mm², of displacements in millimetres, `[3 V]`, and its gradient.
fn energy(
    vertices: &[DVec3],
    x: &[f64],
    distances: &ScanEnergy<'_>,
    umbrella: &UmbrellaOperator,
    config: &FreeFormConfig,
    gradient: &mut [f64],
) -> f64 {
    let mut forces = vec![DVec3::ZERO; vertices.len()];
    // 1e3 converts the derivative of m² by m to mm² by mm.
    let terms = distances.evaluate(&displaced(vertices, x), 1e3, &mut forces);
    let d: Vec<DVec3> = x.as_chunks::<3>().0.iter().map(|&d| DVec3::from_array(d)).collect();
    let rough = umbrella.apply(&d);
    let count = vertices.len().max(1) as f64;
    let (smooth, small) = (config.smooth / count, config.small / count);
    let by_d = umbrella.apply_transposed(&rough);
    let slots = gradient.as_chunks_mut::<3>().0.iter_mut();
    for (((slot, force), by), d) in slots.zip(&forces).zip(&by_d).zip(&d) {
        *slot = (*force + *by * (2.0 * smooth) + *d * (2.0 * small)).to_array();
    }
    let squares = |all: &[DVec3]| all.iter().map(|x| x.length_squared()).sum::<f64>();
    1e6 * distances.total(&terms) + smooth * squares(&rough) + small * squares(&d)
}

fn displaced(vertices: &[DVec3], x: &[f64]) -> Vec<DVec3> {
    let d = x.as_chunks::<3>().0;
    vertices.iter().zip(d).map(|(&v, &d)| v + DVec3::from_array(d) * 1e-3).collect()
}

/// Umbrella Laplacian `(L d)_v = d_v − mean of its neighbours'`.
struct UmbrellaOperator {
    /// Neighbours of vertex `v` are at `starts[v]..starts[v + 1]`.
    starts: Vec<usize>,
    neighbours: Vec<u32>,
}

impl UmbrellaOperator {
    fn new(vertices: usize, faces: &[[u32; 3]]) -> Self {
        let sides = faces.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
        let mut pairs: Vec<[u32; 2]> = sides.flat_map(|[a, b]| [[a, b], [b, a]]).collect();
        pairs.sort_unstable();
        pairs.dedup();
        let start = |vertex: usize| pairs.partition_point(|pair| (pair[0] as usize) < vertex);
        Self {
            starts: (0..=vertices).map(start).collect(),
            neighbours: pairs.iter().map(|pair| pair[1]).collect(),
        }
    }

    fn neighbours_of(&self, vertex: usize) -> &[u32] {
        &self.neighbours[self.starts[vertex]..self.starts[vertex + 1]]
    }

    fn apply(&self, d: &[DVec3]) -> Vec<DVec3> {
        let rough = |(vertex, &own): (usize, &DVec3)| {
            let near = self.neighbours_of(vertex);
            if near.is_empty() {
                return DVec3::ZERO;
            }
            own - near.iter().map(|&other| d[other as usize]).sum::<DVec3>() / near.len() as f64
        };
        d.iter().enumerate().map(rough).collect()
    }

    fn apply_transposed(&self, rough: &[DVec3]) -> Vec<DVec3> {
        let mut sums = vec![DVec3::ZERO; rough.len()];
        for (vertex, &rough) in rough.iter().enumerate() {
            let near = self.neighbours_of(vertex);
            if !near.is_empty() {
                sums[vertex] += rough;
                let share = rough / near.len() as f64;
                for &other in near {
                    sums[other as usize] -= share;
                }
            }
        }
        sums
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        scan::Unit,
        testing::{BODY, assert_gradient},
    };

    fn body() -> Vec<DVec3> {
        let rows = BODY.v_template.rows().into_iter();
        rows.map(|v| DVec3::new(v[0], v[1], v[2])).collect()
    }

    fn bulge(at: DVec3) -> DVec3 {
        let height = 0.02 * (-(at - DVec3::new(0.0, 0.0, 0.1)).length_squared() / 0.02).exp();
        at + DVec3::new(0.0, 0.0, height * f64::from(at.z > 0.0))
    }

    #[test]
    fn the_gradient_agrees_with_finite_differences() {
        let vertices = body();
        let scan = Scan::new(vertices.iter().map(|&v| bulge(v)).collect(), None, vec![], Unit::M);
        let scan = scan.unwrap();
        let target = ScanTarget::new(&scan, 2000, 1);
        let faces = &BODY.faces;
        let distances = ScanEnergy::new(&target, &vertices, faces, 2000, 0.03, 0.5);
        let umbrella = UmbrellaOperator::new(vertices.len(), faces);
        let along = |which: usize, at: usize| ((at * (which + 3)) as f64 * 0.01).sin();
        let moved = |x: &[f64]| -> Vec<f64> {
            let sum = |at| (0..x.len()).map(|w| x[w] * along(w, at)).sum();
            (0..3 * vertices.len()).map(sum).collect()
        };
        let config = FreeFormConfig { smooth: 0.7, small: 0.2, ..FreeFormConfig::default() };
        let value = |x: &[f64], gradient: &mut [f64]| {
            energy(&vertices, &moved(x), &distances, &umbrella, &config, gradient)
        };
        let x = [0.9, -1.4];
        let mut by_vertices = vec![0.0; 3 * vertices.len()];
        value(&x, &mut by_vertices);
        let gradient: Vec<f64> = (0..2)
            .map(|w| by_vertices.iter().enumerate().map(|(at, g)| g * along(w, at)).sum())
            .collect();
        let none = &mut vec![0.0; 3 * vertices.len()];
        assert_gradient(&x, &gradient, 2e-3, |x| value(x, none));
    }

    #[test]
    fn a_bulge_is_followed_and_holes_are_bridged() {
        let vertices = body();
        let bulged: Vec<DVec3> = vertices.iter().map(|&v| bulge(v)).collect();
        let hole = |v: &DVec3| v.distance(DVec3::new(0.05, 0.05, 0.1)) < 0.04;
        let faces = BODY.faces.iter();
        let kept = faces.filter(|f| !f.iter().any(|&v| hole(&vertices[v as usize]))).copied();
        let scan = Scan::new(bulged.clone(), None, kept.collect(), Unit::M).unwrap();
        let config = FreeFormConfig::default();
        let found =
            free_displacement(&scan, &vertices, &BODY.faces, &config, &mut |_, _| {}).unwrap();
        let off = |surface: &[DVec3]| {
            let near = vertices.iter().enumerate().filter(|(_, v)| v.z > 0.0 && v.length() < 0.3);
            let all: Vec<f64> = near.map(|(i, _)| surface[i].distance(bulged[i])).collect();
            all.iter().sum::<f64>() / all.len() as f64
        };
        let (before, after) = (off(&vertices), off(&found.vertices));
        assert!(after < 0.5 * before, "{before} {after}");
        assert!(found.distance.mean < 1.0, "{:?}", found.distance);
        let again = free_displacement(&scan, &vertices, &BODY.faces, &config, &mut |_, _| {});
        assert_eq!(again.unwrap(), found);
    }

    #[test]
    fn rigid_movements_are_not_rough() {
        let faces = [[0, 1, 2], [1, 3, 2]];
        let umbrella = UmbrellaOperator::new(5, &faces);
        assert_eq!(umbrella.apply(&[DVec3::X; 5]), [DVec3::ZERO; 5]);
        let (a, b) = ([1.0, 2.0, 3.0, 4.0, 5.0], [2.0, 0.0, 1.0, -1.0, 3.0]);
        let [a, b] = [a, b].map(|all| all.map(|x| DVec3::new(x, x * x, 1.0)));
        let dot =
            |a: &[DVec3], b: &[DVec3]| -> f64 { a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum() };
        let difference = dot(&umbrella.apply(&a), &b) - dot(&a, &umbrella.apply_transposed(&b));
        assert!(difference.abs() < 1e-9);
    }
}
