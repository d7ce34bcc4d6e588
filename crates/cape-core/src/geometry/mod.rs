//! Triangle surfaces in `f64`, with closest-point and ray queries.

mod box_tree;
pub mod primitives;
mod surface;
mod surface_index;
#[cfg(test)]
mod tests;

pub use box_tree::{BoxTree, bounds};
pub use surface::{SurfaceMesh, corner_angle, face_normals, points};
pub use surface_index::{
    ClosestPoint, RayHit, SurfaceIndex, closest_on_triangle, ray_triangle_distance,
};
