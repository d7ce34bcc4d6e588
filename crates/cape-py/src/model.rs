//! Trained clothing models.

use std::{path::PathBuf, sync::OnceLock};

use burn::tensor::{DType, TensorData};
use cape_core::{Outfit, Pose, parse_device};
use cape_infer::{BodySpec, ClothedModel, Condition, GarmentColours, Run};
use ndarray::{Array, Array2, Dimension};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3};
use pyo3::prelude::*;

use crate::{
    arrays::{Extent, Floats, array, gradient, tensor},
    error::{argument, core, infer},
    smpl::{DEVICE, SmplModel},
};

/// Numbers of a pose of SMPL.
const POSE: usize = 72;
/// Most codes that are drawn at a time.
const MOST_CODES: usize = 1 << 20;

/// Trained clothing model: latent codes to displacements and back.
#[pyclass(frozen, module = "cape._cape")]
pub(crate) struct Model {
    run: Run,
    colours: GarmentColours,
    differentiable: OnceLock<ClothedModel>,
}

#[pymethods]
impl Model {
    /// Open the directory of a run or a model file.
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        py.detach(|| {
            let device = parse_device(DEVICE).map_err(core)?;
            Ok(Self::new(Run::open(path, &device).map_err(infer)?))
        })
    }

    /// Return the built-in model.
    #[staticmethod]
    fn pretrained(py: Python<'_>) -> PyResult<Self> {
        py.detach(|| {
            let device = parse_device(DEVICE).map_err(core)?;
            Ok(Self::new(cape_weights::pretrained(&device).map_err(infer)?))
        })
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
    fn body(&self, py: Python<'_>) -> SmplModel {
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
        if !(1..=MOST_CODES).contains(&n) {
            return Err(argument(format!("n {n}: expected 1 to {MOST_CODES}")));
        }
        if !(temperature.is_finite() && temperature >= 0.0) {
            return Err(argument(format!("temperature {temperature}: expected at least 0")));
        }
        let codes = py.detach(|| {
            PyResult::Ok(match self.run.prior().map_err(infer)? {
                Some(prior) => prior.sample(outfit, n, temperature, seed),
                None => self.run.sample_codes(n, seed) * temperature as f32,
            })
        })?;
        Ok(codes.into_pyarray(py))
    }

    /// Move codes `[n, latent]` of an outfit to their places among the codes of another.
    fn transport<'py>(
        &self,
        py: Python<'py>,
        codes: &Bound<'py, PyAny>,
        outfit: &str,
        to: &str,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let (outfit, to) = (self.outfit(outfit)?, self.outfit(to)?);
        let shape = [Extent::Rows, Extent::Exactly(self.run.latent())];
        let codes = host(Floats { name: "codes", array: codes }.finite(shape)?)?;
        let moved = py.detach(|| match self.run.prior()? {
            Some(prior) => prior.transport_codes(&codes, outfit, to),
            None => Ok(codes),
        });
        Ok(moved.map_err(infer)?.into_pyarray(py))
    }

    /// Decode codes `[n, latent]` for poses `[n, 72]`, radians, and outfits: displacements in the rest
    /// pose, metres, `[n, V, 3]`.
    fn decode<'py>(
        &self,
        py: Python<'py>,
        codes: &Bound<'py, PyAny>,
        pose: &Bound<'py, PyAny>,
        outfits: Vec<String>,
    ) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let wearers = self.wearers(pose, &outfits)?;
        let codes = self.codes(codes, wearers.len())?;
        let decoded =
            py.detach(|| self.run.decode_displacements(&host(codes)?, &wearers).map_err(infer))?;
        Ok(decoded.into_pyarray(py))
    }

    /// Encode displacements `[n, V, 3]`, metres, worn in poses `[n, 72]` and outfits: codes
    /// `[n, latent]`.
    fn encode<'py>(
        &self,
        py: Python<'py>,
        displacement: &Bound<'py, PyAny>,
        pose: &Bound<'py, PyAny>,
        outfits: Vec<String>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let wearers = self.wearers(pose, &outfits)?;
        let name = "displacement";
        let shape = self.points(wearers.len());
        let displacement = Floats { name, array: displacement }.finite(shape)?;
        let codes = py.detach(|| self.run.encode(&host(displacement)?, &wearers).map_err(infer))?;
        Ok(codes.into_pyarray(py))
    }

    /// Pull a gradient with respect to displacements `[n, V, 3]` back to the codes `[n, latent]` and
    /// poses `[n, 72]` that they are decoded from.
    fn pull_back<'py>(
        &self,
        py: Python<'py>,
        codes: &Bound<'py, PyAny>,
        pose: &Bound<'py, PyAny>,
        outfits: Vec<String>,
        displacement: &Bound<'py, PyAny>,
    ) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
        let outfits = self.outfit_list(&outfits)?;
        let n = outfits.len();
        let codes = self.codes(codes, n)?;
        let pose = Floats { name: "pose", array: pose }
            .finite([Extent::Exactly(n), Extent::Exactly(POSE)])?;
        let name = "gradient of displacement";
        let displacement = Floats { name, array: displacement }.any(self.points(n))?;
        let (codes, pose) = py.detach(|| {
            let model = self.differentiable()?;
            let track = |data| tensor::<2>(data, model.device(), DType::F32).require_grad();
            let (codes, pose) = (track(codes), track(pose));
            let body = model.smpl().body();
            let rotations = body.rotations(Pose::AxisAngle(pose.clone())).map_err(core)?;
            let condition = Condition {
                pose_feature: model.pose_feature(rotations),
                outfit: model.outfit_labels(outfits).map_err(infer)?,
            };
            let decoded = model.decode(codes.clone(), &condition);
            let pulled = decoded * tensor(displacement, model.device(), DType::F32);
            let gradients = pulled.sum().backward();
            PyResult::Ok((gradient(&codes, &gradients), gradient(&pose, &gradients)))
        })?;
        Ok((array(py, codes)?, array(py, pose)?))
    }

    /// Colours of skin, shirt and trousers of displacements `[V, 3]`, metres, in an outfit: sRGB from
    /// 0 to 1, `[V, 3]`.
    fn colours<'py>(
        &self,
        py: Python<'py>,
        displacement: &Bound<'py, PyAny>,
        outfit: &str,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let outfit = self.outfit(outfit)?;
        let [_, vertices, axes] = self.points(1);
        let name = "displacement";
        let displacement = Floats { name, array: displacement }.finite([vertices, axes])?;
        let colours = py.detach(|| {
            let displacement: Array2<f32> = host(displacement)?;
            let colours = self.colours.of(displacement.view(), outfit);
            shaped(colours.as_flattened().to_vec(), displacement.raw_dim())
        })?;
        Ok(colours.into_pyarray(py))
    }
}

impl Model {
    fn new(run: Run) -> Self {
        let colours = GarmentColours::new(run.body(), run.mask());
        Self { run, colours, differentiable: OnceLock::new() }
    }

    fn differentiable(&self) -> PyResult<&ClothedModel> {
        if let Some(model) = self.differentiable.get() {
            return Ok(model);
        }
        let model = self.run.to_autodiff().map_err(infer)?;
        Ok(self.differentiable.get_or_init(|| model))
    }

    fn outfit(&self, name: &str) -> PyResult<Outfit> {
        let outfit: Outfit = name.parse().map_err(core)?;
        self.run.outfits().require(outfit).map_err(core)?;
        Ok(outfit)
    }

    fn outfit_list(&self, names: &[String]) -> PyResult<Vec<Outfit>> {
        if names.is_empty() {
            return Err(argument("outfits: none, expected one for each body".to_owned()));
        }
        names.iter().map(|name| self.outfit(name)).collect()
    }

    fn wearers(&self, pose: &Bound<'_, PyAny>, outfits: &[String]) -> PyResult<Vec<BodySpec>> {
        let outfits = self.outfit_list(outfits)?;
        let shape = [Extent::Exactly(outfits.len()), Extent::Exactly(POSE)];
        let pose: Array2<f32> = host(Floats { name: "pose", array: pose }.finite(shape)?)?;
        let wearer = |(outfit, row): (Outfit, ndarray::ArrayView1<'_, f32>)| {
            let mut angles = [0.0; POSE];
            angles.iter_mut().zip(row).for_each(|(angle, &given)| *angle = given);
            BodySpec { betas: Vec::new(), pose: angles, outfit }
        };
        Ok(outfits.into_iter().zip(pose.rows()).map(wearer).collect())
    }

    fn codes(&self, codes: &Bound<'_, PyAny>, n: usize) -> PyResult<TensorData> {
        let shape = [Extent::Exactly(n), Extent::Exactly(self.run.latent())];
        Floats { name: "codes", array: codes }.finite(shape)
    }

    fn points(&self, n: usize) -> [Extent; 3] {
        [Extent::Exactly(n), Extent::Exactly(self.run.body().vertices()), Extent::Exactly(3)]
    }
}

/// Host array in single precision.
fn host<D: Dimension>(data: TensorData) -> PyResult<Array<f32, D>> {
    let data = data.convert::<f32>();
    let shape: Vec<usize> = data.shape().iter().copied().collect();
    let values = data.try_into_vec::<f32>().map_err(|error| argument(format!("{error:?}")))?;
    let array =
        Array::from_shape_vec(shape, values).map_err(|error| argument(error.to_string()))?;
    array.into_dimensionality().map_err(|error| argument(error.to_string()))
}

fn shaped(values: Vec<f32>, shape: ndarray::Ix2) -> PyResult<Array2<f32>> {
    Array::from_shape_vec(shape, values).map_err(|error| argument(error.to_string()))
}
