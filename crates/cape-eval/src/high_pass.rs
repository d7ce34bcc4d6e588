//! Fine detail of a signal on a mesh.

use std::f64::consts::PI;

use cape_graph::rescaled_laplacian;
use sprs::{CsMat, TriMat};

/// Terms of the Chebyshev series.
const TERMS: usize = 64;

/// High-pass filter on a mesh: a step at 1 in the spectrum of the normalised Laplacian `L`, whose
/// eigenvalues are between 0 and 2, as a Chebyshev series in `L − 1` with Jackson damping.
#[derive(Debug, Clone)]
pub(crate) struct HighPassFilter {
    laplacian: CsMat<f64>,
    coefficients: Vec<f64>,
}

impl HighPassFilter {
    /// Filter on the graph of `edges` between `vertices` vertices.
    pub(crate) fn new(vertices: usize, edges: &[[u32; 2]]) -> Self {
        let mut adjacency = TriMat::new((vertices, vertices));
        for &[a, b] in edges {
            adjacency.add_triplet(a as usize, b as usize, 1.0);
            adjacency.add_triplet(b as usize, a as usize, 1.0);
        }
        let laplacian = rescaled_laplacian(&adjacency.to_csr());
        let n = TERMS as f64;
        let damping = |k: f64| {
            let angle = PI / (n + 1.0);
            ((n - k + 1.0) * (angle * k).cos() + (angle * k).sin() / angle.tan()) / (n + 1.0)
        };
        // Coefficients of the step: 1/2, and 2 sin(kπ/2) / (kπ).
        let step = |k: usize| match k {
            0 => 0.5,
            _ if k.is_multiple_of(2) => 0.0,
            _ => 2.0 / (k as f64 * PI) * if k % 4 == 1 { 1.0 } else { -1.0 },
        };
        let coefficients = (0..TERMS).map(|k| step(k) * damping(k as f64)).collect();
        Self { laplacian, coefficients }
    }

    /// The part of a signal in the upper half of the spectrum, `[V, 3]`.
    pub(crate) fn apply(&self, signal: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let mut before = signal.to_vec();
        let mut now = self.multiply(signal);
        let mut out: Vec<[f64; 3]> = before
            .iter()
            .zip(&now)
            .map(|(a, b)| {
                [0, 1, 2].map(|i| self.coefficients[0] * a[i] + self.coefficients[1] * b[i])
            })
            .collect();
        for &coefficient in &self.coefficients[2..] {
            let mut next = self.multiply(&now);
            for (next, before) in next.iter_mut().zip(&before) {
                *next = [0, 1, 2].map(|i| 2.0 * next[i] - before[i]);
            }
            if coefficient != 0.0 {
                for (out, next) in out.iter_mut().zip(&next) {
                    *out = [0, 1, 2].map(|i| out[i] + coefficient * next[i]);
                }
            }
            before = std::mem::replace(&mut now, next);
        }
        out
    }

    fn multiply(&self, signal: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let row = |row: sprs::CsVecViewI<f64, usize>| {
            row.iter().fold([0.0; 3], |sum, (j, &w)| [0, 1, 2].map(|i| sum[i] + w * signal[j][i]))
        };
        self.laplacian.outer_iterator().map(row).collect()
    }
}

#[cfg(test)]
mod tests {
    use cape_core::geometry::{SurfaceMesh, primitives::sphere};
    use cape_graph::Surface;
    use glam::DVec3;
    use nalgebra::{DMatrix, SymmetricEigen};

    use super::*;

    /// An octahedron, twice subdivided: 66 vertices.
    fn octahedron() -> Surface {
        let SurfaceMesh { vertices, faces, .. } = sphere(1.0, 2);
        Surface { vertices: vertices.iter().map(DVec3::to_array).collect(), faces }
    }

    /// The gain is 0 or 1 at the exact eigenvalues away from the step.
    #[test]
    fn the_filter_is_a_step_in_the_spectrum() {
        let surface = octahedron();
        let n = surface.vertices.len();
        let filter = HighPassFilter::new(n, &surface.edges());
        let mut dense = DMatrix::zeros(n, n);
        for (row, values) in filter.laplacian.outer_iterator().enumerate() {
            for (column, &value) in values.iter() {
                dense[(row, column)] = value;
            }
        }
        let eigen = SymmetricEigen::new(dense);
        let mut checked = [0, 0];
        for (k, &value) in eigen.eigenvalues.iter().enumerate() {
            let vector: Vec<[f64; 3]> =
                eigen.eigenvectors.column(k).iter().map(|&x| [x, -2.0 * x, 0.0]).collect();
            let out = filter.apply(&vector);
            let gain =
                out.iter().zip(&vector).map(|(a, b)| a[0] * b[0] + a[1] * b[1]).sum::<f64>() / 5.0;
            let expected = f64::from(value > 0.0);
            if value.abs() > 0.08 {
                assert!((gain - expected).abs() < 0.02, "eigenvalue {value}: gain {gain}");
                checked[usize::from(value > 0.0)] += 1;
            }
            assert!((-0.01..1.01).contains(&gain));
        }
        assert!(checked[0] > 10 && checked[1] > 5, "{checked:?}");
    }
}
