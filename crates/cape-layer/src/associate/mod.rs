//! Which body vertices a clothing vertex follows (Yang et al. 2018, §3.1).
//!
//! One frame decides: rays from the body find [`sparse`](SparseCorrespondences) pairs, and pairs vote for their
//! surroundings on both meshes, which gives every clothing vertex the [`Association`]'s weights
//! over `n_f` body vertices.

mod dense;
mod sparse;
#[cfg(test)]
mod tests;

pub use dense::{Association, Completion};
pub use sparse::{Correspondence, RayStatistics, SparseCorrespondences};

use crate::{Error, Result, geometry::GeodesicMetric};
use cape_core::geometry::SurfaceMesh;

/// How clothing vertices are tied to body vertices.
///
/// See [`Association`] for an example.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AssociateOptions {
    /// Length of the rays, metres; the paper's 15 cm.
    pub reach: f64,
    /// σ of the votes, metres; the paper's 1 cm.
    pub sigma: f64,
    /// Geodesic distance up to which a pair votes, on either mesh, metres; the paper's 3 cm.
    pub support: f64,
    /// Body vertices for each clothing vertex, `n_f`.
    pub neighbours: usize,
    /// How distances over the meshes are measured.
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
    /// Ties `clothing` to `body`, in one frame and both in metres.
    ///
    /// # Errors
    /// If an option is out of its domain, no ray meets the clothing, or the body is inside out.
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
                return Err(Error::argument(format!("{name} of {value} m: expected more than 0")));
            }
        }
        let most = body.vertices.len();
        if self.neighbours == 0 || self.neighbours > most {
            return Err(Error::argument(format!(
                "{} body vertices for each clothing vertex: expected 1 to {most}",
                self.neighbours
            )));
        }
        Ok(())
    }
}
