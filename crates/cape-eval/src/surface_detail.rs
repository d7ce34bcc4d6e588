//! Reconstruction of wrinkles, which the mean error does not measure: it favours smooth surfaces.

use cape_core::SmplModel;
use cape_graph::Surface;
use serde::{Deserialize, Serialize};

use crate::high_pass::HighPassFilter;

/// Surface detail of reconstructions at clothing vertices, over all frames.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct SurfaceDetail {
    /// Mean length of the difference between reconstructed and true edge vectors, millimetres.
    pub edge_mm: f64,
    /// Mean angle between true and reconstructed face normals on the template body, degrees.
    pub normal_degrees: f64,
    /// Energy of the reconstructed displacements in the upper half of the spectrum of the
    /// Laplacian, relative to the true displacements; below 1 wrinkles are smoothed.
    pub high_energy: f64,
}

/// Accumulator of [`SurfaceDetail`] over frames.
///
/// ```
/// use cape_synth::synthetic_body;
/// use cape_eval::surface_detail::SurfaceDetailMeter;
///
/// let body = synthetic_body();
/// let clothing: Vec<usize> = (0..body.vertices()).collect();
/// let truth: Vec<f32> = (0..3 * body.vertices()).map(|i| 0.01 * (i as f32).sin()).collect();
/// let half: Vec<f32> = truth.iter().map(|x| 0.5 * x).collect();
/// let mut meter = SurfaceDetailMeter::new(&body, &clothing);
/// meter.push(&half, &truth);
/// // Wrinkles of half the size have a quarter of the energy.
/// let detail = meter.detail();
/// assert!((detail.high_energy - 0.25).abs() < 1e-3);
/// assert!(detail.edge_mm > 0.0 && detail.normal_degrees > 0.0);
/// ```
#[derive(Debug, Clone)]
pub struct SurfaceDetailMeter {
    template: Vec<[f64; 3]>,
    faces: Vec<[usize; 3]>,
    edges: Vec<[usize; 2]>,
    clothing: Vec<usize>,
    filter: HighPassFilter,
    edge_sum: f64,
    angle_sum: f64,
    energies: [f64; 2],
    frames: usize,
}

impl SurfaceDetailMeter {
    /// Creates an empty accumulator for displacements of `body`, compared at the vertices
    /// `clothing` and at the edges and faces between them.
    pub fn new(body: &SmplModel, clothing: &[usize]) -> Self {
        let surface = Surface::from(body);
        let mut covered = vec![false; body.vertices()];
        for &vertex in clothing {
            covered[vertex] = true;
        }
        let edges = surface.edges();
        let indices =
            |corners: &[u32]| -> Vec<usize> { corners.iter().map(|&v| v as usize).collect() };
        let inside = |corners: &[usize]| corners.iter().all(|&vertex| covered[vertex]);
        Self {
            faces: body
                .faces
                .iter()
                .map(|face| face.map(|vertex| vertex as usize))
                .filter(|face| inside(face))
                .collect(),
            edges: edges
                .iter()
                .filter(|edge| inside(&indices(&edge[..])))
                .map(|edge| edge.map(|vertex| vertex as usize))
                .collect(),
            filter: HighPassFilter::new(body.vertices(), &edges),
            clothing: clothing.to_vec(),
            template: surface.vertices,
            edge_sum: 0.0,
            angle_sum: 0.0,
            energies: [0.0; 2],
            frames: 0,
        }
    }

    /// Adds a frame; `predicted` and `truth` are displacements, `[3 V]`, metres.
    pub fn push(&mut self, predicted: &[f32], truth: &[f32]) {
        let rows = |values: &[f32]| -> Vec<[f64; 3]> {
            values.as_chunks::<3>().0.iter().map(|row| row.map(f64::from)).collect()
        };
        let [predicted, truth] = [rows(predicted), rows(truth)];
        let difference = |a: usize, b: usize, of: &[[f64; 3]]| minus(of[a], of[b]);
        let edge = |&[a, b]: &[usize; 2]| {
            length(minus(difference(a, b, &predicted), difference(a, b, &truth)))
        };
        self.edge_sum += mean(self.edges.iter().map(edge));
        let normal = |face: &[usize; 3], of: &[[f64; 3]]| {
            let [a, b, c] = face.map(|v| plus(self.template[v], of[v]));
            cross(minus(b, a), minus(c, a))
        };
        let angle = |face: &[usize; 3]| {
            let (a, b) = (normal(face, &predicted), normal(face, &truth));
            // By the tangent, because the cosine is inaccurate for small angles.
            length(cross(a, b)).atan2(dot(a, b))
        };
        self.angle_sum += mean(self.faces.iter().map(angle));
        for (energy, of) in self.energies.iter_mut().zip([&predicted, &truth]) {
            let high = self.filter.apply(of);
            *energy += self.clothing.iter().map(|&v| dot(high[v], high[v])).sum::<f64>();
        }
        self.frames += 1;
    }

    /// Detail over the frames so far; NaN without frames.
    pub fn detail(&self) -> SurfaceDetail {
        let count = self.frames as f64;
        SurfaceDetail {
            edge_mm: 1000.0 * self.edge_sum / count,
            normal_degrees: (self.angle_sum / count).to_degrees(),
            high_energy: self.energies[0] / self.energies[1],
        }
    }
}

fn plus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|i| a[i] + b[i])
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|i| a[i] - b[i])
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn length(a: [f64; 3]) -> f64 {
    dot(a, a).sqrt()
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len().max(1) as f64;
    values.sum::<f64>() / count
}

#[cfg(test)]
mod tests {
    use cape_synth::synthetic_body;

    use super::*;

    #[test]
    fn detail_of_known_differences() {
        let body = synthetic_body();
        let clothing: Vec<usize> = (0..body.vertices()).filter(|v| v % 7 != 0).collect();
        let mut meter = SurfaceDetailMeter::new(&body, &clothing);
        let truth: Vec<f32> =
            (0..3 * body.vertices()).map(|i| 0.01 * ((i * i) as f32 * 0.37).sin()).collect();
        // A constant shift changes neither edges nor normals.
        let shifted: Vec<f32> = truth.iter().map(|x| x + 0.02).collect();
        meter.push(&shifted, &truth);
        let detail = meter.detail();
        assert!(detail.edge_mm < 1e-4 && detail.normal_degrees < 1e-2, "{detail:?}");
        // Displacements of half the length: half the edge differences, a quarter of the energy.
        let mut meter = SurfaceDetailMeter::new(&body, &clothing);
        let half: Vec<f32> = truth.iter().map(|x| 0.5 * x).collect();
        meter.push(&half, &truth);
        let detail = meter.detail();
        assert!((detail.high_energy - 0.25).abs() < 1e-6, "{detail:?}");
        let expected = mean(meter.edges.iter().map(|&[a, b]| {
            let d = |v: usize, i: usize| f64::from(truth[3 * v + i]);
            500.0 * (0..3).map(|i| (d(a, i) - d(b, i)).powi(2)).sum::<f64>().sqrt()
        }));
        assert!((detail.edge_mm - expected).abs() < 1e-3 * expected, "{detail:?} {expected}");
        assert!(detail.normal_degrees > 1.0);
    }
}
