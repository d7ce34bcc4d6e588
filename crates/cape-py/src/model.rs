//! Trained clothing models.

use std::path::PathBuf;

use burn::tensor::Device;
use cape_core::{Mesh, Outfit, parse_device};
use cape_infer::{BodySpec, Run};
use ndarray::{Array3, ArrayView2};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::prelude::*;

use crate::{
    error::{CapeError, core, infer},
    smpl::SmplModel,
};

/// Numbers of a pose of SMPL.
const POSE: usize = 72;

/// Trained clothing model: latent codes to displacements and back.
#[pyclass(frozen, module = "cape._cape")]
pub(crate) struct Model {
    run: Run,
}

#[pymethods]
impl Model {
    /// Open the directory of a run or a model file.
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        py.detach(|| Ok(Self { run: Run::open(path, &device()?).map_err(infer)? }))
    }

    /// Return the built-in model.
    #[staticmethod]
    fn pretrained(py: Python<'_>) -> PyResult<Self> {
        py.detach(|| Ok(Self { run: cape_weights::pretrained(&device()?).map_err(infer)? }))
    }

    /// Number of latent dimensions.
    #[getter]
    fn latent(&self) -> usize {
        self.run.latent()
    }

    /// Names of the outfits, in the order of their labels.
    #[getter]
    fn outfits(&self) -> Vec<String> {
        self.run.outfits().iter().map(ToString::to_string).collect()
    }

    /// Indices of the vertices that clothing covers.
    #[getter]
    fn clothing<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<i64>> {
        let indices: Vec<i64> = self.run.clothing().iter().map(|&v| v as i64).collect();
        indices.into_pyarray(py)
    }

    /// Body that the clothing is of.
    fn body(&self, py: Python<'_>) -> PyResult<SmplModel> {
        py.detach(|| SmplModel::new(self.run.body().clone()))
    }

    /// Draw `n` latent codes for an outfit from the model's mixture, or from the standard normal
    /// distribution if it has none: `[n, latent]`.
    fn sample<'py>(
        &self,
        py: Python<'py>,
        outfit: &str,
        n: usize,
        temperature: f64,
        seed: u64,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let outfit = self.outfit(outfit)?;
        if !(temperature.is_finite() && temperature >= 0.0) {
            let message = format!("temperature {temperature}: expected at least 0");
            return Err(CapeError::new_err(message));
        }
        let codes = py.detach(|| {
            PyResult::Ok(match self.run.prior().map_err(infer)? {
                Some(prior) => prior.sample(outfit, n, temperature, seed),
                None => self.run.sample_codes(n, seed) * temperature as f32,
            })
        })?;
        Ok(codes.into_pyarray(py))
    }

    /// Decode codes `[n, latent]` for poses `[n, 72]`, radians, and outfits: displacements in the rest
    /// pose, metres, `[n, V, 3]`.
    fn decode<'py>(
        &self,
        py: Python<'py>,
        codes: PyReadonlyArray2<'py, f32>,
        pose: PyReadonlyArray2<'py, f32>,
        outfits: Vec<String>,
    ) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let wearers = self.wearers(None, pose.as_array(), &outfits)?;
        let codes = codes.as_array().to_owned();
        self.expect_rows("codes", codes.nrows(), wearers.len())?;
        let decoded =
            py.detach(|| self.run.decode_displacements(&codes, &wearers).map_err(infer))?;
        Ok(decoded.into_pyarray(py))
    }

    /// Encode displacements `[n, V, 3]`, metres, worn in poses `[n, 72]` and outfits: codes
    /// `[n, latent]`.
    fn encode<'py>(
        &self,
        py: Python<'py>,
        displacement: PyReadonlyArray3<'py, f32>,
        pose: PyReadonlyArray2<'py, f32>,
        outfits: Vec<String>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let wearers = self.wearers(None, pose.as_array(), &outfits)?;
        let displacement = displacement.as_array().to_owned();
        self.expect_rows("displacement", displacement.dim().0, wearers.len())?;
        let codes = py.detach(|| self.run.encode(&displacement, &wearers).map_err(infer))?;
        Ok(codes.into_pyarray(py))
    }

    /// Pose bodies of shapes `betas [n, b]` in displacements `[n, V, 3]`: vertices, metres, `[n, V, 3]`.
    fn dress<'py>(
        &self,
        py: Python<'py>,
        displacement: PyReadonlyArray3<'py, f32>,
        betas: PyReadonlyArray2<'py, f32>,
        pose: PyReadonlyArray2<'py, f32>,
    ) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let outfits = vec![self.run.default_outfit().to_string(); pose.as_array().nrows()];
        let wearers = self.wearers(Some(betas.as_array()), pose.as_array(), &outfits)?;
        let displacement = displacement.as_array().to_owned();
        self.expect_rows("displacement", displacement.dim().0, wearers.len())?;
        let posed = py.detach(|| {
            let meshes = self.run.pose_clothed(&displacement, &wearers).map_err(infer)?;
            PyResult::Ok(stacked(&meshes, self.run.body().vertices()))
        })?;
        Ok(posed.into_pyarray(py))
    }
}

impl Model {
    fn outfit(&self, name: &str) -> PyResult<Outfit> {
        let outfit: Outfit = name.parse().map_err(core)?;
        self.run.outfits().require(outfit).map_err(core)?;
        Ok(outfit)
    }

    fn wearers(
        &self,
        betas: Option<ArrayView2<'_, f32>>,
        pose: ArrayView2<'_, f32>,
        outfits: &[String],
    ) -> PyResult<Vec<BodySpec>> {
        self.expect_rows("outfits", outfits.len(), pose.nrows())?;
        if pose.ncols() != POSE {
            let message = format!("pose: {} columns, expected {POSE}", pose.ncols());
            return Err(CapeError::new_err(message));
        }
        if let Some(betas) = betas {
            self.expect_rows("betas", betas.nrows(), pose.nrows())?;
        }
        let wearer = |(row, name): (usize, &String)| {
            let mut angles = [0.0; POSE];
            angles.iter_mut().zip(pose.row(row)).for_each(|(angle, &given)| *angle = given);
            Ok(BodySpec {
                betas: betas.map_or_else(Vec::new, |betas| betas.row(row).to_vec()),
                pose: angles,
                outfit: self.outfit(name)?,
            })
        };
        outfits.iter().enumerate().map(wearer).collect()
    }

    fn expect_rows(&self, name: &str, found: usize, expected: usize) -> PyResult<()> {
        if found == 0 || found != expected {
            let message = format!("{name}: {found} rows, expected {}", expected.max(1));
            return Err(CapeError::new_err(message));
        }
        Ok(())
    }
}

fn device() -> PyResult<Device> {
    parse_device("flex").map_err(core)
}

fn stacked(meshes: &[Mesh], vertices: usize) -> Array3<f32> {
    Array3::from_shape_fn((meshes.len(), vertices, 3), |(n, v, axis)| meshes[n].vertices[v][axis])
}
