//! SMPL bodies.

use std::path::PathBuf;

use burn::tensor::{Device, Tensor, TensorData};
use cape_core::{Pose, Smpl, SmplInput, parse_device, smpl::Gender};
use ndarray::{Array2, Array3};
use numpy::{IntoPyArray, PyArray2, PyArray3, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::prelude::*;

use crate::error::{CapeError, core};

/// SMPL body; the arrays have the names and shapes of SMPL's files.
#[pyclass(frozen, module = "cape._cape")]
pub(crate) struct SmplModel {
    model: cape_core::SmplModel,
    body: Smpl,
    device: Device,
}

/// Posed vertices `[n, V, 3]` and joints `[n, J, 3]`, metres.
type PosedArrays<'py> = (Bound<'py, PyArray3<f32>>, Bound<'py, PyArray3<f32>>);

#[pymethods]
impl SmplModel {
    /// Read a body from a pickle or `.npz` file; pickles are not run.
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        py.detach(|| Self::new(cape_core::SmplModel::load(path).map_err(core)?))
    }

    /// Return the built-in human body of a gender.
    #[staticmethod]
    fn embedded(py: Python<'_>, gender: &str) -> PyResult<Self> {
        let gender: Gender = gender.parse().map_err(core)?;
        py.detach(|| Self::new(cape_synth::embedded_body(gender).map_err(core)?))
    }

    /// Write the body as `.npz` in SMPL's layout.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        py.detach(|| self.model.save(path).map_err(core))
    }

    /// Template vertices, metres, `[V, 3]`.
    #[getter]
    fn v_template<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        self.model.v_template.clone().into_pyarray(py)
    }

    /// Shape directions, metres, `[V, 3, b]`.
    #[getter]
    fn shapedirs<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray3<f64>> {
        self.model.shapedirs.clone().into_pyarray(py)
    }

    /// Pose directions, metres, `[V, 3, 9 (J - 1)]`.
    #[getter]
    fn posedirs<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray3<f64>> {
        self.model.posedirs.clone().into_pyarray(py)
    }

    /// Joint regressor, `[J, V]`.
    #[getter]
    fn joint_regressor<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        self.model.joint_regressor.clone().into_pyarray(py)
    }

    /// Blend weights, `[V, J]`.
    #[getter]
    fn weights<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        self.model.weights.clone().into_pyarray(py)
    }

    /// Vertex indices of the triangles, `[F, 3]`.
    #[getter]
    fn faces<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<u32>> {
        Array2::from_shape_fn((self.model.faces.len(), 3), |(f, k)| self.model.faces[f][k])
            .into_pyarray(py)
    }

    /// Parent of each joint, -1 for the root, `[J]`.
    #[getter]
    fn parents(&self) -> Vec<i64> {
        self.model.parents.iter().map(|parent| parent.map_or(-1, |p| p as i64)).collect()
    }

    /// Pose bodies: `betas [n, b]`, `pose [n, 3 J]` (radians), `transl [n, 3]` and, if given,
    /// `displacement [n, V, 3]` (metres, rest pose) to vertices and joints.
    #[pyo3(signature = (betas, pose, transl, displacement=None))]
    fn forward<'py>(
        &self,
        py: Python<'py>,
        betas: PyReadonlyArray2<'py, f32>,
        pose: PyReadonlyArray2<'py, f32>,
        transl: PyReadonlyArray2<'py, f32>,
        displacement: Option<PyReadonlyArray3<'py, f32>>,
    ) -> PyResult<PosedArrays<'py>> {
        let input = SmplInput {
            betas: self.matrix("betas", &betas)?,
            pose: Pose::AxisAngle(self.matrix("pose", &pose)?),
            transl: self.matrix("transl", &transl)?,
            displacement: displacement.map(|it| self.points("displacement", &it)).transpose()?,
        };
        let (vertices, joints) = py.detach(|| {
            let output = self.body.forward(input).map_err(core)?;
            PyResult::Ok((host(output.vertices)?, host(output.joints)?))
        })?;
        Ok((vertices.into_pyarray(py), joints.into_pyarray(py)))
    }

    /// Bring posed vertices `[n, V, 3]` to the rest pose, without pose blend shapes.
    fn unpose<'py>(
        &self,
        py: Python<'py>,
        vertices: PyReadonlyArray3<'py, f32>,
        betas: PyReadonlyArray2<'py, f32>,
        pose: PyReadonlyArray2<'py, f32>,
        transl: PyReadonlyArray2<'py, f32>,
    ) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let vertices = self.points("vertices", &vertices)?;
        let betas = self.matrix("betas", &betas)?;
        let pose = Pose::AxisAngle(self.matrix("pose", &pose)?);
        let transl = self.matrix("transl", &transl)?;
        let rest =
            py.detach(|| host(self.body.unpose(vertices, betas, pose, transl).map_err(core)?))?;
        Ok(rest.into_pyarray(py))
    }
}

impl SmplModel {
    pub(crate) fn new(model: cape_core::SmplModel) -> PyResult<Self> {
        let device = parse_device("flex").map_err(core)?;
        let body = Smpl::new(&model, &device).map_err(core)?;
        Ok(Self { model, body, device })
    }

    fn matrix(&self, name: &str, array: &PyReadonlyArray2<'_, f32>) -> PyResult<Tensor<2>> {
        let view = array.as_array();
        expect_rows(name, view.nrows())?;
        let values: Vec<f32> = view.iter().copied().collect();
        Ok(Tensor::from_data(TensorData::new(values, [view.nrows(), view.ncols()]), &self.device))
    }

    fn points(&self, name: &str, array: &PyReadonlyArray3<'_, f32>) -> PyResult<Tensor<3>> {
        let view = array.as_array();
        let (n, vertices, width) = view.dim();
        expect_rows(name, n)?;
        if (vertices, width) != (self.model.vertices(), 3) {
            let expected = self.model.vertices();
            return Err(CapeError::new_err(format!(
                "{name}: shape [{n}, {vertices}, {width}], expected [{n}, {expected}, 3]"
            )));
        }
        let values: Vec<f32> = view.iter().copied().collect();
        Ok(Tensor::from_data(TensorData::new(values, [n, vertices, width]), &self.device))
    }
}

fn expect_rows(name: &str, rows: usize) -> PyResult<()> {
    if rows == 0 {
        return Err(CapeError::new_err(format!("{name}: no rows, expected one for each body")));
    }
    Ok(())
}

fn host(tensor: Tensor<3>) -> PyResult<Array3<f32>> {
    let [n, rows, width] = tensor.dims();
    let failed = |error: String| CapeError::new_err(format!("result: {error}"));
    let values = tensor.try_into_vec_as::<f32>().map_err(|error| failed(error.to_string()))?;
    Array3::from_shape_vec((n, rows, width), values).map_err(|error| failed(error.to_string()))
}
