//! Fine detail of clothing.

use cape_core::SmplModel;
use cape_data::PackedSet;
use cape_graph::Surface;
use glam::DVec3;
use rayon::prelude::*;
use serde::Serialize;

use crate::{Result, high_pass::HighPassFilter};

/// Wrinkles of the frames of a set, at clothing vertices and the faces between them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Wrinkles {
    /// Number of frames.
    pub frames: usize,
    /// Root mean square of the displacements' part in the upper half of the spectrum of the mesh's
    /// Laplacian, millimetres.
    pub fine_mm: f64,
    /// The energy of this part relative to that of the displacements.
    pub fine_share: f64,
    /// Mean angle between the faces' normals with and without displacement, degrees.
    pub normal_degrees: f64,
}

impl Wrinkles {
    /// Measures at most `most` frames, evenly spaced.
    pub(super) fn measure(
        set: &PackedSet,
        body: &SmplModel,
        clothing: &[usize],
        most: usize,
    ) -> Result<Self> {
        let surface = Surface::from(body);
        let filter = HighPassFilter::new(body.vertices(), &surface.edges());
        let mut covered = vec![false; body.vertices()];
        for &vertex in clothing {
            covered[vertex] = true;
        }
        let faces: Vec<[u32; 3]> = body
            .faces
            .iter()
            .filter(|face| face.iter().all(|&v| covered[v as usize]))
            .copied()
            .collect();
        let bare: Vec<DVec3> = surface.vertices.iter().map(|&v| DVec3::from(v)).collect();
        let step = set.frames().div_ceil(most.max(1)).max(1);
        let rows: Vec<usize> = (0..set.frames()).step_by(step).collect();
        let sums: Vec<[f64; 3]> = rows
            .par_iter()
            .map(|&row| {
                let whole = set.displacement_row(row)?;
                let signal = whole.as_chunks::<3>().0;
                let high = filter.apply(signal);
                let energy = |of: &[[f64; 3]]| {
                    clothing.iter().map(|&v| DVec3::from(of[v]).length_squared()).sum::<f64>()
                };
                let worn: Vec<DVec3> =
                    bare.iter().zip(signal).map(|(v, d)| *v + DVec3::from(*d)).collect();
                let normal = |of: &[DVec3], face: &[u32; 3]| {
                    let [a, b, c] = face.map(|v| of[v as usize]);
                    (b - a).cross(c - a)
                };
                let angles = faces.iter().map(|f| normal(&worn, f).angle_between(normal(&bare, f)));
                let angle = angles.filter(|angle| angle.is_finite()).sum::<f64>();
                Ok([energy(&high), energy(signal), angle / faces.len().max(1) as f64])
            })
            .collect::<Result<_>>()?;
        let sum = |at: usize| sums.iter().map(|sums| sums[at]).sum::<f64>();
        let count = rows.len().max(1) as f64;
        let vertices = clothing.len().max(1) as f64;
        Ok(Self {
            frames: rows.len(),
            fine_mm: 1000.0 * (sum(0) / (count * vertices)).sqrt(),
            fine_share: if sum(1) > 0.0 { sum(0) / sum(1) } else { 0.0 },
            normal_degrees: (sum(2) / count).to_degrees(),
        })
    }
}
