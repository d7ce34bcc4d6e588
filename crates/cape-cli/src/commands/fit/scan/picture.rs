//! Scan, bare body and clothed surfaces, side by side.

use cape_core::Mesh;
use cape_fit::{
    BodyParameters,
    scan::{Scan, UpAxis, distances_to},
};
use cape_render::{
    Bounds, Camera, Image, Object, Projection, Style, Tile, View, colormap, contact_sheet,
};
use glam::{DQuat, DVec3};

use super::output::mesh;
use crate::error::{Error, Result};

/// Distance of the brightest colour, metres.
pub(super) const SCALE: f64 = 0.02;
/// Size of a point, metres.
const POINT: f64 = 0.004;
/// Largest number of points that are drawn.
const POINTS: usize = 20_000;
const SIZE: [u32; 2] = [320, 460];

/// The scan, the bare body, and surfaces coloured by distance from the scan, seen from the front left.
pub(super) fn draw(
    scan: &Scan,
    bare: &Mesh,
    surfaces: &[&[DVec3]],
    parameters: &BodyParameters,
    up: UpAxis,
) -> Result<Image> {
    // Upright, and facing +z.
    let upright = up.to_y();
    let orientation = DQuat::from_scaled_axis(DVec3::from_slice(&parameters.pose[..3]));
    let facing = upright * (orientation * DVec3::Z);
    let turn = DQuat::from_rotation_y(-facing.x.atan2(facing.z)) * upright;
    let turned = |mut mesh: Mesh| {
        for vertex in &mut mesh.vertices {
            *vertex = (turn.as_quat() * glam::Vec3::from(*vertex)).to_array();
        }
        mesh
    };
    let mut meshes =
        vec![("scan", turned(scan_mesh(scan)), None), ("bare body", turned(bare.clone()), None)];
    for (name, vertices) in ["clothed body", "displaced"].iter().zip(surfaces) {
        let colours: Vec<[f32; 3]> = distances_to(scan, vertices)
            .into_iter()
            .map(|distance| colormap((distance / SCALE) as f32))
            .collect();
        meshes.push((name, turned(mesh(vertices, &bare.faces)), Some(colours)));
    }
    let bounds = Bounds::from_meshes(meshes[1..].iter().map(|(_, mesh, _)| mesh))
        .ok_or_else(|| Error::message("internal error: no mesh to draw"))?;
    let [width, height] = SIZE;
    let aspect = width as f32 / height as f32;
    let camera = Camera::framing(&bounds, View::ThreeQuarter, Projection::default(), aspect);
    let style = Style { width, height, ..Style::default() };
    let mut tiles = Vec::new();
    for (name, mesh, colours) in &meshes {
        let object = Object::new(mesh);
        let object = match colours {
            Some(colours) => object.with_colours(colours),
            None => object,
        };
        let image = cape_render::render(&[object], &camera, &style)?;
        let label = match colours {
            Some(_) => format!("{name}, 0 to {:.0} mm", 1000.0 * SCALE),
            None => (*name).to_owned(),
        };
        tiles.push(Tile { image, label });
    }
    Ok(contact_sheet(&tiles, tiles.len(), None)?)
}

/// The scan's triangles, or a small tetrahedron for each point of a point cloud.
pub(super) fn scan_mesh(scan: &Scan) -> Mesh {
    if !scan.faces().is_empty() {
        return mesh(scan.points(), scan.faces());
    }
    let corners = [[1., 1., 1.], [1., -1., -1.], [-1., 1., -1.], [-1., -1., 1.]];
    let corners = corners.map(|corner| DVec3::from_array(corner) * (0.6 * POINT));
    let step = scan.points().len().div_ceil(POINTS).max(1);
    let points = scan.points().iter().step_by(step);
    let vertices: Vec<DVec3> = points.flat_map(|&at| corners.map(|corner| at + corner)).collect();
    let faces: Vec<[u32; 3]> = (0..vertices.len() as u32 / 4)
        .map(|point| 4 * point)
        .flat_map(|p| {
            [[p, p + 1, p + 2], [p, p + 2, p + 3], [p, p + 3, p + 1], [p + 1, p + 3, p + 2]]
        })
        .collect();
    mesh(&vertices, &faces)
}
