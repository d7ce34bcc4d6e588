//! The whole dressed surface: clothing and the skin that it leaves bare.

use cape_core::geometry::{SurfaceIndex, SurfaceMesh};
use rayon::prelude::*;

use super::UnposedSet;
use crate::Result;

/// Distance to which clothing covers the skin, metres: that of the rays of the association.
const COVERED: f64 = 0.15;

/// Depth of the skin's vertices below which rays begin, metres, so that a layer that includes the body
/// covers its own skin.
const BELOW: f64 = 1e-3;

impl UnposedSet<'_> {
    /// Share of the clothing in the area of the dressed surface, clothing and bare skin, in the first
    /// frames of the sequences, 0 to 1. The skin is known where clothing is predicted, so that the mean
    /// error over the dressed surface, as the paper has it, is this share of the clothing's.
    ///
    /// # Errors
    /// If a motion does not fit the body.
    pub fn clothing_share(&self) -> Result<f64> {
        let mut sum = 0.0;
        let sequences = &self.set().sequences;
        for (index, sequence) in sequences.iter().enumerate() {
            let posed = sequence.body(self.model(), 0, self.standard())?.posed;
            let body = SurfaceMesh { vertices: posed, faces: self.model().faces.clone() };
            sum += share(&body, &self.set().clothing(index, 0)?);
        }
        Ok(sum / sequences.len().max(1) as f64)
    }
}

/// Share of the clothing in the area of clothing and bare skin.
fn share(body: &SurfaceMesh, clothing: &SurfaceMesh) -> f64 {
    let index = SurfaceIndex::new(clothing);
    let normals = body.vertex_normals();
    let bare: Vec<bool> = body
        .vertices
        .par_iter()
        .zip(normals)
        .map(|(&at, normal)| index.cast(at - BELOW * normal, normal, COVERED + BELOW).is_none())
        .collect();
    let area = |surface: &SurfaceMesh, face: usize| {
        let [a, b, c] = surface.corners(face);
        0.5 * (b - a).cross(c - a).length()
    };
    let skin: f64 = (0..body.faces.len())
        .map(|face| {
            let corners = body.faces[face].iter().filter(|&&corner| bare[corner as usize]).count();
            area(body, face) * corners as f64 / 3.0
        })
        .sum();
    let cloth: f64 = (0..clothing.faces.len()).map(|face| area(clothing, face)).sum();
    if cloth > 0.0 { cloth / (cloth + skin) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use cape_core::geometry::primitives::sphere;

    use super::*;

    #[test]
    fn bare_skin_counts_with_the_clothing() {
        let body = sphere(0.5, 4);
        // The upper half of a sphere 5 cm outside.
        let whole = sphere(0.55, 4);
        let upper = |face: &&[u32; 3]| {
            face.iter().map(|&v| whole.vertices[v as usize].y).sum::<f64>() > 0.0
        };
        let faces = whole.faces.iter().filter(upper).copied().collect();
        let half = SurfaceMesh { vertices: whole.vertices.clone(), faces };
        let expected = 0.55f64.powi(2) / (0.55f64.powi(2) + 0.5f64.powi(2));
        let found = share(&body, &half);
        assert!((found - expected).abs() < 0.02, "{found} {expected}");
        assert!((share(&body, &whole) - 1.0).abs() < 1e-12, "no skin is bare");
        assert!((share(&body, &body) - 1.0).abs() < 1e-12, "a layer that includes the body");
        let away = sphere(5.0, 3);
        assert!(share(&body, &away) < 1.0, "out of reach");
    }
}
