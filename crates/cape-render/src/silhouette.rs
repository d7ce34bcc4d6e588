use cape_core::Mesh;
use glam::Vec3;

use crate::{
    Camera, Error, Image, Result,
    raster::{EMPTY, Point, rasterise},
};

/// Silhouette of `mesh`: white pixels, whose centre is covered, on black.
///
/// # Errors
/// If the image has no pixels, a vertex is not finite, or a vertex index is out of range.
pub fn silhouette(mesh: &Mesh, camera: &Camera, width: u32, height: u32) -> Result<Image> {
    let count = mesh.vertices.len();
    if mesh.faces.iter().flatten().any(|&i| i as usize >= count)
        || mesh.vertices.iter().flatten().any(|x| !x.is_finite())
    {
        return Err(Error::Argument(
            "silhouette: expected finite vertices, and faces with vertex indices in range".into(),
        ));
    }
    let mut image = Image::new(width, height, [0, 0, 0, 255])?;
    let (columns, rows) = (width as usize, height as usize);
    let project = |&v: &[f32; 3]| {
        Point::project((camera.clip * Vec3::from(v).extend(1.0)).to_array(), columns, rows)
    };
    let points: Vec<Point> = mesh.vertices.iter().map(project).collect();
    let visible = rasterise(&points, &mesh.faces, columns, rows);
    for (pixel, face) in image.pixels_mut().iter_mut().zip(visible.face) {
        if face != EMPTY {
            *pixel = [255; 4];
        }
    }
    Ok(image)
}
