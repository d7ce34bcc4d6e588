//! Surfaces, rays, closest points and geodesic distances, in `f64`.

#[cfg(test)]
mod comparison;
mod geodesic;
mod solid;
mod surface;
#[cfg(test)]
pub(crate) mod tests;

pub use geodesic::{Geodesics, Metric};
pub(crate) use solid::ray_meets;
pub use solid::{Closest, Hit, Solid, closest_on_triangle};
pub use surface::Surface;
pub(crate) use surface::points;
