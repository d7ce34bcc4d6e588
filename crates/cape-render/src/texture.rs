use cape_core::obj::Uv;
use glam::{Vec2, Vec3};

use crate::{Error, Image, Result, shade::to_linear};

/// Texture of a mesh: coordinates and image.
///
/// ```
/// use cape_core::{Mesh, obj::Uv};
/// use cape_render::{Image, Object, Style, Texture, View, portrait};
///
/// let square = Mesh {
///     vertices: vec![[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.]],
///     faces: vec![[0, 1, 2], [0, 2, 3]],
/// };
/// let coordinates = square.vertices.iter().map(|&[x, y, _]| [x, y]).collect();
/// let uv = Uv { coordinates, faces: square.faces.clone() };
/// let image = Image::new(2, 2, [20, 20, 220, 255])?;
/// let object = Object::new(&square).with_texture(Texture { uv: &uv, image: &image });
/// let style = Style { width: 16, height: 16, ..Style::default() };
/// let [red, _, blue, _] = portrait(object, View::Front, &style)?.get(8, 8).unwrap();
/// assert!(blue > red);
/// # Ok::<(), cape_render::Error>(())
/// ```
#[derive(Debug, Clone, Copy)]
pub struct Texture<'a> {
    /// Texture coordinates of the face corners; origin at the bottom left.
    pub uv: &'a Uv,
    /// Image, repeated in both directions.
    pub image: &'a Image,
}

impl Texture<'_> {
    /// Checks the coordinates for a mesh of `faces` faces.
    pub(crate) fn check(&self, object: usize, faces: usize) -> Result<()> {
        let points = self.uv.coordinates.len();
        if self.uv.faces.len() != faces {
            return Err(Error::Argument(format!(
                "object {object}: texture coordinates of {} faces, expected {faces}",
                self.uv.faces.len()
            )));
        }
        if self.uv.faces.iter().flatten().any(|&i| i as usize >= points)
            || self.uv.coordinates.iter().flatten().any(|x| !x.is_finite())
        {
            return Err(Error::Argument(format!(
                "object {object}: a texture coordinate is not finite, or an index out of range for \
                 {points}"
            )));
        }
        Ok(())
    }

    /// Linear colour at the barycentric coordinates `weights` of a face, bilinearly interpolated.
    pub(crate) fn at(&self, face: usize, weights: [f32; 3]) -> Vec3 {
        let corners = self.uv.faces[face].map(|i| Vec2::from(self.uv.coordinates[i as usize]));
        let point = corners[0] * weights[0] + corners[1] * weights[1] + corners[2] * weights[2];
        let size = Vec2::new(self.image.width() as f32, self.image.height() as f32);
        let place = Vec2::new(point.x, 1.0 - point.y) * size - 0.5;
        let (low, share) = (place.floor(), place - place.floor());
        let texel = |dx: i64, dy: i64| {
            let wrap =
                |at: f32, by: i64, size: u32| (at as i64 + by).rem_euclid(size.into()) as u32;
            let x = wrap(low.x, dx, self.image.width());
            let y = wrap(low.y, dy, self.image.height());
            let [r, g, b, _] = self.image.get(x, y).unwrap_or_default();
            to_linear([r, g, b].map(|c| f32::from(c) / 255.0))
        };
        let row = |dy: i64| texel(0, dy).lerp(texel(1, dy), share.x);
        row(0).lerp(row(1), share.y)
    }
}
