//! Visible points of a surface for each pixel of a camera.

use cape_render::visible_faces;
use glam::{DVec2, DVec3};

use super::Mask;
use crate::{PinholeCamera, Result, camera::depth};

/// A point of a surface by triangle and barycentric weights, which moves with the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfacePoint {
    /// Vertex indices of the triangle.
    pub corners: [u32; 3],
    /// Barycentric weights.
    pub weights: [f64; 3],
}

impl SurfacePoint {
    /// Position, metres.
    pub fn at(&self, vertices: &[DVec3]) -> DVec3 {
        let parts = self.corners.iter().zip(self.weights);
        parts.map(|(&corner, weight)| vertices[corner as usize] * weight).sum()
    }

    /// Adds the gradient with respect to the point to the gradients with respect to the vertices,
    /// `[V]`.
    pub fn pull_back(&self, gradient: DVec3, by_vertices: &mut [DVec3]) {
        for (&corner, weight) in self.corners.iter().zip(self.weights) {
            by_vertices[corner as usize] += gradient * weight;
        }
    }
}

/// Rendering of a surface: silhouette and visible face of each pixel.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use cape_fit::{PinholeCamera, silhouette::render};
/// use glam::DVec3;
///
/// // A square with a side of 50 pixels, and the surface point at the pixel beside the centre.
/// let camera = PinholeCamera::new(100, 100, Some(100.0))?;
/// let (vertices, faces) = square(1.0);
/// let rendering = render(&vertices, &faces, &camera)?;
/// assert!(rendering.mask().area().abs_diff(2500) < 110);
/// let point = rendering.point(50 * 100 + 50, &vertices, &faces).ok_or("not covered")?;
/// assert!((point.at(&vertices) - DVec3::new(0.01, -0.01, -2.0)).length() < 1e-9);
/// assert!(rendering.point(0, &vertices, &faces).is_none());
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct Rendering {
    mask: Mask,
    visible: Vec<Option<u32>>,
    pixels: Vec<DVec2>,
}

/// Renders a mesh: vertices in metres, `[V]`, triangles `[F]`.
///
/// # Errors
/// If a face index is out of range.
pub fn render(vertices: &[DVec3], faces: &[[u32; 3]], camera: &PinholeCamera) -> Result<Rendering> {
    let pixels: Vec<DVec2> = vertices.iter().map(|&vertex| camera.project(vertex)).collect();
    let points: Vec<[f64; 3]> =
        vertices.iter().zip(&pixels).map(|(vertex, p)| [p.x, p.y, -vertex.z]).collect();
    let visible = visible_faces(&points, faces, camera.width(), camera.height())?;
    let covered = visible.iter().map(Option::is_some).collect();
    Ok(Rendering { mask: Mask::new(camera.width(), camera.height(), covered)?, visible, pixels })
}

impl Rendering {
    /// Silhouette.
    pub fn mask(&self) -> &Mask {
        &self.mask
    }

    /// Surface point at the centre of a pixel; `None` if the pixel is not covered.
    pub fn point(
        &self,
        pixel: usize,
        vertices: &[DVec3],
        faces: &[[u32; 3]],
    ) -> Option<SurfacePoint> {
        let corners = faces[self.visible[pixel]? as usize];
        let width = self.mask.width() as usize;
        let centre = DVec2::new((pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5);
        let [a, b, c] = corners.map(|corner| self.pixels[corner as usize] - centre);
        // Perspective-correct barycentric weights.
        let areas = [b.perp_dot(c), c.perp_dot(a), a.perp_dot(b)];
        let weights: [f64; 3] =
            std::array::from_fn(|i| areas[i] / depth(vertices[corners[i] as usize]));
        let sum: f64 = weights.iter().sum();
        (sum.abs() > 1e-12).then(|| SurfacePoint { corners, weights: weights.map(|w| w / sum) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::BODY;

    #[test]
    fn surface_points_are_at_their_pixels() {
        let body = &*BODY;
        let camera = PinholeCamera::new(120, 90, None).unwrap();
        let rows = body.v_template.rows().into_iter();
        let vertices: Vec<DVec3> = rows.map(|v| DVec3::new(v[0], v[1] + 0.3, v[2] - 2.5)).collect();
        let rendering = render(&vertices, &body.faces, &camera).unwrap();
        let mut count = 0;
        for (pixel, &covered) in rendering.mask().covered().iter().enumerate() {
            let point = rendering.point(pixel, &vertices, &body.faces);
            assert!(point.is_none() || covered);
            if let Some(point) = point {
                let at = camera.project(point.at(&vertices));
                let centre = DVec2::new((pixel % 120) as f64 + 0.5, (pixel / 120) as f64 + 0.5);
                assert!(at.distance(centre) < 0.01, "{at} {centre}");
                count += 1;
            }
        }
        assert!(count > 600, "{count}");
        assert!(render(&vertices, &[[0, 1, 99999]], &camera).is_err());
    }

    #[test]
    fn pictures_of_the_same_camera_agree() {
        let camera = PinholeCamera::new(200, 160, Some(230.0)).unwrap();
        let place = |v: [f64; 3]| DVec3::new(v[0] + 0.2, v[1] + 0.3, v[2] - 3.0);
        let rows = BODY.v_template.rows().into_iter();
        let vertices: Vec<DVec3> = rows.map(|v| place([v[0], v[1], v[2]])).collect();
        let mesh = cape_core::Mesh {
            vertices: vertices.iter().map(|v| v.as_vec3().to_array()).collect(),
            faces: BODY.faces.clone(),
        };
        let picture =
            cape_render::silhouette(&mesh, &camera.to_render([0.1, 10.0]), 200, 160).unwrap();
        let rendering = render(&vertices, &BODY.faces, &camera).unwrap();
        let white = picture.pixels().iter().map(|pixel| pixel[0] > 127).collect();
        let drawn = Mask::new(200, 160, white).unwrap();
        let overlap = rendering.mask().intersection_over_union(&drawn).unwrap();
        assert!(overlap > 0.995, "{overlap}");
    }
}
