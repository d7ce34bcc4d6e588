//! Error of geodesic metrics within the support of the association. The table is printed by
//! `cargo test --release -p cape-layer --lib -- --nocapture methods_are_compared`.

use std::{f64::consts::PI, time::Instant};

use cape_core::geometry::{
    SurfaceMesh,
    primitives::{grid, sphere},
};
use glam::DVec3;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use super::{
    GeodesicMetric, Geodesics,
    tests::{exact, straight_lines},
};

/// The heat method (Crane et al. 2013) with cotangent weights and a time step of one squared mean
/// edge.
struct HeatMethod<'a> {
    surface: &'a SurfaceMesh,
    diffusion: Cholesky<f64, Dyn>,
    poisson: Cholesky<f64, Dyn>,
}

impl<'a> HeatMethod<'a> {
    fn new(surface: &'a SurfaceMesh) -> Self {
        let count = surface.vertices.len();
        let mut laplacian = DMatrix::<f64>::zeros(count, count);
        let mut mass = DVector::<f64>::zeros(count);
        for (face, corners) in surface.faces.iter().enumerate() {
            let at = surface.corners(face);
            let area = 0.5 * (at[1] - at[0]).cross(at[2] - at[0]).length();
            for k in 0..3 {
                let (i, j) = (corners[(k + 1) % 3] as usize, corners[(k + 2) % 3] as usize);
                let (p, q) = (at[(k + 1) % 3] - at[k], at[(k + 2) % 3] - at[k]);
                let weight = 0.5 * p.dot(q) / p.cross(q).length();
                laplacian[(i, i)] += weight;
                laplacian[(j, j)] += weight;
                laplacian[(i, j)] -= weight;
                laplacian[(j, i)] -= weight;
                mass[corners[k] as usize] += area / 3.0;
            }
        }
        let mass = DMatrix::from_diagonal(&mass);
        let diffusion = &mass + &laplacian * surface.mean_edge().powi(2);
        let poisson = &laplacian + &mass * 1e-6;
        let factor = |matrix| Cholesky::new(matrix).unwrap();
        Self { surface, diffusion: factor(diffusion), poisson: factor(poisson) }
    }

    fn distances(&self, source: usize) -> Vec<f64> {
        let count = self.surface.vertices.len();
        let mut delta = DVector::zeros(count);
        delta[source] = 1.0;
        let heat = self.diffusion.solve(&delta);
        let mut divergence = DVector::<f64>::zeros(count);
        for (face, corners) in self.surface.faces.iter().enumerate() {
            let at = self.surface.corners(face);
            let normal = (at[1] - at[0]).cross(at[2] - at[0]).normalize();
            let opposite = |k: usize| at[(k + 2) % 3] - at[(k + 1) % 3];
            let slope: DVec3 =
                (0..3).map(|k| normal.cross(opposite(k)) * heat[corners[k] as usize]).sum();
            let away = -slope.normalize_or_zero();
            for k in 0..3 {
                let (p, q) = (at[(k + 1) % 3] - at[k], at[(k + 2) % 3] - at[k]);
                let cotangent = |at: usize| {
                    let (u, v) = (
                        self.surface.vertices[corners[(at + 1) % 3] as usize]
                            - self.surface.vertices[corners[at] as usize],
                        self.surface.vertices[corners[(at + 2) % 3] as usize]
                            - self.surface.vertices[corners[at] as usize],
                    );
                    u.dot(v) / u.cross(v).length()
                };
                divergence[corners[k] as usize] += 0.5
                    * (cotangent((k + 2) % 3) * p.dot(away) + cotangent((k + 1) % 3) * q.dot(away));
            }
        }
        let distances = self.poisson.solve(&-divergence);
        let zero = distances[source];
        distances.iter().map(|d| d - zero).collect()
    }
}

/// Mean and largest relative error, and microseconds per source.
struct ComparisonLine {
    mean: f64,
    largest: f64,
    micros: f64,
}

fn measure(
    sources: &[u32],
    reach: f64,
    truth: &[Vec<f64>],
    distances: impl Fn(u32) -> Vec<f64>,
) -> ComparisonLine {
    let start = Instant::now();
    let found: Vec<Vec<f64>> = sources.iter().map(|&source| distances(source)).collect();
    let micros = 1e6 * start.elapsed().as_secs_f64() / sources.len() as f64;
    let pairs = truth.iter().flatten().zip(found.iter().flatten());
    let errors: Vec<f64> =
        pairs.filter(|&(&t, _)| t > 0.0 && t < reach).map(|(t, d)| (d - t).abs() / t).collect();
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    ComparisonLine { mean, largest: errors.into_iter().fold(0.0, f64::max), micros }
}

/// Meshes of the association's size: edges of about 1.5 cm, distances of up to 3 cm.
fn meshes() -> [(&'static str, SurfaceMesh); 4] {
    let uneven = grid(13, 13, |u, v| {
        let inner = (PI * u).sin() * (PI * v).sin();
        let (x, y) = (0.06 * inner * (29.0 * v).sin(), 0.06 * inner * (23.0 * u).sin());
        DVec3::new(u + x, v + y, 0.0) * 0.17
    });
    let rolled = grid(21, 13, |u, v| {
        DVec3::new((2.0 * PI * u * 0.95).cos() * 0.05, 0.17 * v, (2.0 * PI * u * 0.95).sin() * 0.05)
    });
    let folded =
        grid(13, 13, |u, v| DVec3::new(u, v, 0.1 * (9.0 * u).sin() * (7.0 * v).cos()) * 0.17);
    [("uneven plane", uneven), ("sleeve", rolled), ("folds", folded), ("ball", sphere(0.1, 3))]
}

#[test]
fn methods_are_compared_within_the_support() {
    let reach = 0.03;
    println!("| mesh | method | mean error | largest | time a source |\n|---|---|---|---|---|");
    for (name, mesh) in meshes() {
        let count = mesh.vertices.len() as u32;
        let sources: Vec<u32> = (0..count).step_by(23).collect();
        let lines = straight_lines(&mesh, reach);
        let truth: Vec<Vec<f64>> = sources.iter().map(|&source| exact(&lines, source)).collect();
        let local = |metric: GeodesicMetric| {
            let geodesics = Geodesics::new(&mesh, metric);
            measure(&sources, reach, &truth, |source| {
                let mut all = vec![f64::INFINITY; mesh.vertices.len()];
                // Dijkstra's distances are too long: some within reach lie beyond it.
                for (v, d) in geodesics.within(source, 2.0 * reach) {
                    all[v as usize] = d;
                }
                all
            })
        };
        let heat = HeatMethod::new(&mesh);
        let heat = measure(&sources, reach, &truth, |source| heat.distances(source as usize));
        let (graph, unfolded) = (local(GeodesicMetric::Graph), local(GeodesicMetric::Unfolded));
        for (method, line) in [("edges", &graph), ("heat", &heat), ("unfolded", &unfolded)] {
            println!(
                "| {name} | {method} | {:.2} % | {:.1} % | {:.0} µs |",
                100.0 * line.mean,
                100.0 * line.largest,
                line.micros
            );
        }
        assert!(unfolded.mean < 0.01 && unfolded.largest < 0.06, "{name}");
        assert!(unfolded.mean < graph.mean && unfolded.mean < heat.mean, "{name}");
        assert!(heat.mean < 0.3, "{name}: the heat method is at work: {}", heat.mean);
    }
}
