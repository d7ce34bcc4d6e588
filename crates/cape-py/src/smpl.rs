//! SMPL bodies.

use std::{path::PathBuf, sync::OnceLock};

use burn::tensor::{DType, Device, FloatDType, TensorData};
use cape_core::{Pose, Smpl, SmplInput, SmplOutput, parse_device, smpl::Gender};
use ndarray::Array2;
use numpy::{IntoPyArray, PyArray2, PyArray3};
use pyo3::prelude::*;

use crate::{
    arrays::{Extent, Floats, array, gradient, tensor},
    error::core,
};

/// Device of all computations.
pub(crate) const DEVICE: &str = "flex";

/// SMPL body; the arrays have the names and shapes of SMPL's files. It is prepared for posing when it
/// is posed.
#[pyclass(frozen, module = "cape._cape")]
pub(crate) struct SmplModel {
    model: cape_core::SmplModel,
    single: OnceLock<Smpl>,
    double: OnceLock<Smpl>,
    /// In double precision, with autodiff.
    differentiable: OnceLock<Smpl>,
}

/// Parameters of bodies on the host.
struct Parameters {
    betas: TensorData,
    pose: TensorData,
    transl: TensorData,
    displacement: Option<TensorData>,
    dtype: DType,
}

/// Shape, pose, translation and displacement of bodies, or gradients with respect to them.
type ParameterArrays<'py> =
    (Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>, Option<Bound<'py, PyAny>>);

#[pymethods]
impl SmplModel {
    /// Read a body from a pickle or `.npz` file; pickles are not run.
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        py.detach(|| Ok(Self::new(cape_core::SmplModel::load(path).map_err(core)?)))
    }

    /// Return the built-in human body of a gender.
    #[staticmethod]
    fn embedded(py: Python<'_>, gender: &str) -> PyResult<Self> {
        let gender: Gender = gender.parse().map_err(core)?;
        py.detach(|| Ok(Self::new(cape_synth::embedded_body(gender).map_err(core)?)))
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
    /// `displacement [n, V, 3]` (metres, rest pose) to vertices and joints, in the precision of `betas`.
    #[pyo3(signature = (betas, pose, transl, displacement=None))]
    fn forward<'py>(
        &self,
        py: Python<'py>,
        betas: &Bound<'py, PyAny>,
        pose: &Bound<'py, PyAny>,
        transl: &Bound<'py, PyAny>,
        displacement: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
        let given = self.parameters(betas, pose, transl, displacement)?;
        let (vertices, joints) = py.detach(|| {
            let body = self.body(given.dtype)?;
            let device = body.device();
            let output = body.forward(given.upload(&device)).map_err(core)?;
            PyResult::Ok((output.vertices.into_data(), output.joints.into_data()))
        })?;
        Ok((array(py, vertices)?, array(py, joints)?))
    }

    /// Pull gradients with respect to vertices `[n, V, 3]` and joints `[n, J, 3]` back to the
    /// parameters `betas`, `pose`, `transl` and `displacement` of [`forward`](Self::forward).
    fn pull_back<'py>(
        &self,
        py: Python<'py>,
        parameters: ParameterArrays<'py>,
        vertices: &Bound<'py, PyAny>,
        joints: &Bound<'py, PyAny>,
    ) -> PyResult<ParameterArrays<'py>> {
        let (betas, pose, transl, displacement) = parameters;
        let given = self.parameters(&betas, &pose, &transl, displacement.as_ref())?;
        let points = |name, array, count| {
            let shape = [given.rows(), Extent::Exactly(count), Extent::Exactly(3)];
            Floats { name, array }.any(shape)
        };
        let vertices = points("gradient of vertices", vertices, self.model.vertices())?;
        let joints = points("gradient of joints", joints, self.model.joints())?;
        let pulled = py.detach(|| self.gradients(given, vertices, joints))?;
        let displacement = pulled.displacement.map(|it| array(py, it)).transpose()?;
        Ok((
            array(py, pulled.betas)?,
            array(py, pulled.pose)?,
            array(py, pulled.transl)?,
            displacement,
        ))
    }

    /// Bring posed vertices `[n, V, 3]` to the rest pose, without pose blend shapes.
    fn unpose<'py>(
        &self,
        py: Python<'py>,
        vertices: &Bound<'py, PyAny>,
        betas: &Bound<'py, PyAny>,
        pose: &Bound<'py, PyAny>,
        transl: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let given = self.parameters(betas, pose, transl, None)?;
        let name = "vertices";
        let vertices = Floats { name, array: vertices }.finite(self.points(given.rows()))?;
        let rest = py.detach(|| {
            let body = self.body(given.dtype)?;
            let device = body.device();
            let vertices = tensor(vertices, &device, given.dtype);
            let SmplInput { betas, pose, transl, .. } = given.upload(&device);
            PyResult::Ok(body.unpose(vertices, betas, pose, transl).map_err(core)?.into_data())
        })?;
        array(py, rest)
    }
}

impl SmplModel {
    pub(crate) fn new(model: cape_core::SmplModel) -> Self {
        let [single, double, differentiable] = [const { OnceLock::new() }; 3];
        Self { model, single, double, differentiable }
    }

    fn body(&self, dtype: DType) -> PyResult<&Smpl> {
        let device = parse_device(DEVICE).map_err(core)?;
        match dtype {
            DType::F64 => self.prepared(&self.double, &device, FloatDType::F64),
            _ => self.prepared(&self.single, &device, FloatDType::F32),
        }
    }

    /// Body in `place`, prepared by the first call.
    fn prepared<'a>(
        &self,
        place: &'a OnceLock<Smpl>,
        device: &Device,
        precision: FloatDType,
    ) -> PyResult<&'a Smpl> {
        if let Some(body) = place.get() {
            return Ok(body);
        }
        let body = Smpl::with_precision(&self.model, device, precision).map_err(core)?;
        Ok(place.get_or_init(|| body))
    }

    fn parameters(
        &self,
        betas: &Bound<'_, PyAny>,
        pose: &Bound<'_, PyAny>,
        transl: &Bound<'_, PyAny>,
        displacement: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Parameters> {
        let floats = |name, array| Floats { name, array };
        let dtype = floats("betas", betas).dtype()?;
        let betas =
            floats("betas", betas).finite([Extent::Rows, Extent::UpTo(self.model.betas())])?;
        let rows = Extent::Exactly(betas.shape()[0]);
        let angles = Extent::Exactly(3 * self.model.joints());
        let pose = floats("pose", pose).finite([rows, angles])?;
        let transl = floats("transl", transl).finite([rows, Extent::Exactly(3)])?;
        let displacement = displacement
            .map(|it| floats("displacement", it).finite(self.points(rows)))
            .transpose()?;
        Ok(Parameters { betas, pose, transl, displacement, dtype })
    }

    fn points(&self, rows: Extent) -> [Extent; 3] {
        [rows, Extent::Exactly(self.model.vertices()), Extent::Exactly(3)]
    }

    fn gradients(
        &self,
        given: Parameters,
        vertices: TensorData,
        joints: TensorData,
    ) -> PyResult<Parameters> {
        let dtype = given.dtype;
        if dtype != DType::F64 {
            let body = self.body(dtype)?;
            let device = body.device();
            let gradient = SmplOutput {
                vertices: tensor(vertices, &device, dtype),
                joints: tensor(joints, &device, dtype),
            };
            let found = body.pull_back(given.upload(&device), gradient).map_err(core)?;
            return Ok(Parameters {
                betas: found.betas.into_data(),
                pose: found.pose.into_data(),
                transl: found.transl.into_data(),
                displacement: found.displacement.map(|it| it.into_data()),
                dtype,
            });
        }
        let device = parse_device(DEVICE).map_err(core)?.autodiff();
        let body = self.prepared(&self.differentiable, &device, FloatDType::F64)?;
        let track = |data: TensorData| tensor::<2>(data, &device, dtype).require_grad();
        let (betas, pose, transl) = (track(given.betas), track(given.pose), track(given.transl));
        let displacement =
            given.displacement.map(|it| tensor::<3>(it, &device, dtype).require_grad());
        let input = SmplInput {
            betas: betas.clone(),
            pose: Pose::AxisAngle(pose.clone()),
            transl: transl.clone(),
            displacement: displacement.clone(),
        };
        let output = body.forward(input).map_err(core)?;
        let pulled = (output.vertices * tensor(vertices, &device, dtype)).sum()
            + (output.joints * tensor(joints, &device, dtype)).sum();
        let gradients = pulled.backward();
        Ok(Parameters {
            betas: gradient(&betas, &gradients),
            pose: gradient(&pose, &gradients),
            transl: gradient(&transl, &gradients),
            displacement: displacement.map(|it| gradient(&it, &gradients)),
            dtype,
        })
    }
}

impl Parameters {
    fn rows(&self) -> Extent {
        Extent::Exactly(self.betas.shape()[0])
    }

    fn upload(self, device: &Device) -> SmplInput {
        SmplInput {
            betas: tensor(self.betas, device, self.dtype),
            pose: Pose::AxisAngle(tensor(self.pose, device, self.dtype)),
            transl: tensor(self.transl, device, self.dtype),
            displacement: self.displacement.map(|it| tensor(it, device, self.dtype)),
        }
    }
}
