//! Association of clothing vertices with body vertices in one frame (Yang et al. 2018, §3.1).
//!
//! Rays from the body find [`SparseCorrespondences`]; each pair votes for the neighbourhoods of its
//! two vertices, weighted by geodesic distance (eq. 2), and the most probable `n_f` body vertices
//! of each clothing vertex are its [`Association`]. [`EdgeChangeStudy`] measures seams:
//! neighbouring clothing vertices that follow different limbs.

mod dense;
mod edge_change;
mod sparse;
#[cfg(test)]
mod tests;

pub use dense::{Association, Completion};
pub use edge_change::{EdgeChange, EdgeChangeStudy, UnposedClothing};
pub use sparse::{Correspondence, RayStatistics, SparseCorrespondences};

use crate::{Error, Result, geometry::GeodesicMetric};
use cape_core::geometry::SurfaceMesh;

/// Options of the association.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AssociateOptions {
    /// Length of the rays, metres; 15 cm in the paper.
    pub reach: f64,
    /// Standard deviation σ of the votes (eq. 2), metres; 1 cm in the paper.
    pub sigma: f64,
    /// Geodesic distance on either mesh up to which a pair votes, metres; 3 cm in the paper.
    pub support: f64,
    /// Number of body vertices for each clothing vertex, `n_f`.
    pub neighbours: usize,
    /// Metric of the geodesic distances.
    pub metric: GeodesicMetric,
}

impl Default for AssociateOptions {
    fn default() -> Self {
        Self {
            reach: 0.15,
            sigma: 0.01,
            support: 0.03,
            neighbours: 4,
            metric: GeodesicMetric::default(),
        }
    }
}

impl AssociateOptions {
    /// Associates the vertices of `clothing` with those of `body`, both of one frame, in metres.
    ///
    /// # Errors
    /// If an option is out of range, no ray hits the clothing, or the body's faces are reversed.
    pub fn associate(&self, body: &SurfaceMesh, clothing: &SurfaceMesh) -> Result<Association> {
        self.check(body)?;
        let pairs = SparseCorrespondences::find(body, clothing, self.reach)?;
        Ok(Association::spread(body, clothing, pairs, self))
    }

    fn check(&self, body: &SurfaceMesh) -> Result<()> {
        for (name, value) in
            [("reach", self.reach), ("sigma", self.sigma), ("support", self.support)]
        {
            if !(value.is_finite() && value > 0.0) {
                return Err(Error::argument(format!(
                    "association: {name} {value} m, expected above 0"
                )));
            }
        }
        let most = body.vertices.len();
        if self.neighbours == 0 || self.neighbours > most {
            return Err(Error::argument(format!(
                "association: {} body vertices for each clothing vertex, expected 1 to {most}",
                self.neighbours
            )));
        }
        Ok(())
    }
}
