//! Geodesic distances on triangle surfaces, in `f64`.

#[cfg(test)]
mod comparison;
mod geodesic;
#[cfg(test)]
mod tests;

pub use geodesic::{GeodesicMetric, Geodesics};
