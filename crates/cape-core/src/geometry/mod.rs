//! Triangle surfaces in `f64`, with closest points and rays.

pub mod primitives;
mod solid;
mod surface;
#[cfg(test)]
mod tests;

pub use solid::{Closest, Hit, Solid, closest_on_triangle, ray_meets};
pub use surface::{Surface, corner_angle, face_normals, points};
