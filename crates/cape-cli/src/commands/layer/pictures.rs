//! Pictures of bodies and clothing.

use cape_core::Mesh;
use cape_core::geometry::SurfaceMesh;
use cape_render::{
    Bounds, Camera, Image, Material, Object, Projection, Style, View, colormap, render,
};
use ndarray::ArrayView2;

use crate::error::{Error, Result};

const SKIN: Material = Material { colour: [0.83, 0.69, 0.60], gloss: 0.05 };
const CLOTH: Material = Material { colour: [0.36, 0.50, 0.66], gloss: 0.02 };

/// A camera that frames some meshes.
pub(super) struct PictureCamera {
    camera: Camera,
    style: Style,
}

impl PictureCamera {
    pub(super) fn around<'a>(
        meshes: impl IntoIterator<Item = &'a Mesh>,
        view: View,
        height: u32,
    ) -> Result<Self> {
        let bounds = Bounds::from_meshes(meshes)
            .ok_or_else(|| Error::message("the meshes have no vertices to draw"))?;
        let size = bounds.max - bounds.min;
        let aspect = (size.x.max(size.z) / size.y.max(1e-3)).clamp(0.6, 1.2);
        let width = (height as f32 * aspect).round() as u32;
        let style = Style { width, height, ..Style::default() };
        let camera = Camera::framing(&bounds, view, Projection::default(), aspect);
        Ok(Self { camera, style })
    }

    /// Picture of clothing, optionally in vertex colours and over a body.
    pub(super) fn show(
        &self,
        body: Option<&Mesh>,
        clothing: &Mesh,
        colours: Option<&[[f32; 3]]>,
    ) -> Result<Image> {
        let clothing = Object { material: CLOTH, colours, ..Object::new(clothing) };
        let body = body.map(|body| Object { material: SKIN, ..Object::new(body) });
        let objects: Vec<Object> = body.into_iter().chain([clothing]).collect();
        Ok(render(&objects, &self.camera, &self.style)?)
    }
}

/// Clothing vertices `[n_v, 3]`, metres, as a mesh.
pub(super) fn mesh_of(vertices: ArrayView2<'_, f64>, faces: &[[u32; 3]]) -> Mesh {
    let vertices = vertices.rows().into_iter();
    let vertices = vertices.map(|v| [0, 1, 2].map(|k| v[k] as f32)).collect();
    Mesh { vertices, faces: faces.to_vec() }
}

/// Colours of values from 0 to `most`.
pub(super) fn shades(values: &[f64], most: f64) -> Vec<[f32; 3]> {
    values.iter().map(|&value| colormap((value / most) as f32)).collect()
}

/// Colours by position in the bounding box: red along x, green along y, blue along z.
pub(super) fn by_place(surface: &SurfaceMesh) -> Result<Vec<[f32; 3]>> {
    let mesh = surface.to_mesh();
    let [low, high] =
        mesh.bounding_box().ok_or_else(|| Error::message("the body has no vertices"))?;
    let share = |v: &[f32; 3]| {
        [0, 1, 2].map(|i| (v[i] - low[i]) / (high[i] - low[i]).max(f32::MIN_POSITIVE))
    };
    Ok(mesh.vertices.iter().map(share).collect())
}
