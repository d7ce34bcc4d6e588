//! Principal components in a NumPy archive.

use std::path::Path;

use cape_core::npy::{Npz, NpzWriter};
use ndarray::{Array1, Ix1, Ix2, arr1};

use super::Pca;
use crate::{Error, Result};

impl Pca {
    /// Writes `mean`, `components`, `explained_variance`, `total_variance` and `residual` as a
    /// `.npz` archive, atomically.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<()> {
        let mut file = NpzWriter::create(path)?;
        file.add("mean", &self.mean)?;
        file.add("components", &self.components)?;
        file.add("explained_variance", &self.variances)?;
        file.add("total_variance", &arr1(&[self.total_variance]))?;
        file.add("residual", &arr1(&[self.residual]))?;
        file.finish()
    }

    /// Reads components written by [`save`](Self::save).
    ///
    /// # Errors
    /// If an array is missing, has another shape, or is not finite.
    pub fn load(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let mut file = Npz::open(path)?;
        let components = file.f64("components")?;
        file.expect_shape("components", components.shape(), &[None, None])?;
        let components = components
            .into_dimensionality::<Ix2>()
            .map_err(|error| Error::field(path, "components", error.to_string()))?;
        let mut vector = |name: &str, length: usize| -> Result<Array1<f64>> {
            let array = file.f64(name)?;
            file.expect_shape(name, array.shape(), &[Some(length)])?;
            array
                .into_dimensionality::<Ix1>()
                .map_err(|error| Error::field(path, name, error.to_string()))
        };
        let (latent, numbers) = components.dim();
        let read = Self {
            mean: vector("mean", numbers)?,
            variances: vector("explained_variance", latent)?,
            total_variance: vector("total_variance", 1)?[0],
            residual: vector("residual", 1)?[0],
            components,
        };
        for (field, values) in [("mean", &read.mean), ("explained_variance", &read.variances)] {
            if values.iter().any(|x| !x.is_finite()) {
                return Err(Error::field(path, field, "has a number that is not finite"));
            }
        }
        if read.components.iter().any(|x| !x.is_finite()) {
            return Err(Error::field(path, "components", "has a number that is not finite"));
        }
        Ok(read)
    }
}
