//! Weights by name: read from a module, written to a module, and kept in safetensors files.
//!
//! burn-store 0.22 is not used because it reads and writes modules only, whereas optimiser moments,
//! averages and imported variables are maps of arrays, and because it would change the bytes of
//! weight files (metadata of the producer).

use std::{
    collections::{BTreeMap, HashMap},
    io::Write,
    path::Path,
};

use burn::{
    module::{Module, ModuleMapper, ModuleVisitor, Param},
    tensor::{Device, Gradients, Tensor, TensorData},
};
use cape_core::tensors::to_host;
use safetensors::{Dtype, SafeTensors, tensor::TensorView};

use crate::{Error, Result};

/// Array on the host.
#[derive(Debug, Clone, PartialEq)]
pub struct HostArray {
    /// Extents.
    pub shape: Vec<usize>,
    /// Values in row-major order.
    pub values: Vec<f32>,
}

/// Arrays of parameters by path in the module, such as `generator.encoder.mean.weight`.
///
/// ```
/// use burn::tensor::Device;
/// use cape_model::{Initialiser, weights::{self, HostArray}};
///
/// let mut init = Initialiser::new(1, 0.1, &Device::default());
/// let layer = init.linear(2, 3);
/// let saved = weights::collect(&layer);
/// assert_eq!(saved["bias"], HostArray { shape: vec![3], values: vec![0.0; 3] });
///
/// let directory = tempfile::tempdir()?;
/// let path = directory.path().join("layer.safetensors");
/// weights::save(&saved, &path)?;
/// let other = weights::apply(init.linear(2, 3), &weights::load(&path)?)?;
/// assert_eq!(weights::collect(&other), saved);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub type Weights = BTreeMap<String, HostArray>;

/// Path of the parameter being visited; the names of enum variants are not part of it.
#[derive(Debug, Default)]
struct ParamPath(Vec<Option<String>>);

impl ParamPath {
    fn enter(&mut self, name: &str, container: &str) {
        self.0.push((!container.starts_with("Enum:")).then(|| name.to_owned()));
    }

    fn exit(&mut self) {
        self.0.pop();
    }

    fn join(&self) -> String {
        self.0.iter().flatten().map(String::as_str).collect::<Vec<_>>().join(".")
    }
}

/// A float parameter of a module, visited by [`for_each_parameter`] or [`map_parameters`].
///
/// ```
/// use burn::tensor::Device;
/// use cape_model::{Initialiser, weights::{collect, for_each_parameter, map_parameters}};
///
/// let layer = Initialiser::new(1, 0.1, &Device::default()).linear(2, 3);
/// let mut numbers = 0;
/// for_each_parameter(&layer, |parameter| {
///     assert!(["weight", "bias"].contains(&parameter.path));
///     numbers += parameter.shape.iter().product::<usize>();
///     assert!(parameter.read().iter().all(|x| x.is_finite()));
/// });
/// assert_eq!(numbers, 2 * 3 + 3);
///
/// let layer = map_parameters(layer, |parameter| {
///     (parameter.path == "bias").then(|| parameter.value() + 1.0)
/// });
/// assert_eq!(collect(&layer)["bias"].values, [1.0; 3]);
/// ```
pub struct ParamRef<'a> {
    /// Path in the module, such as `encoder.mean.weight`.
    pub path: &'a str,
    /// Extents of the tensor.
    pub shape: &'a [usize],
    tensor: &'a dyn FlatTensor,
}

impl ParamRef<'_> {
    /// The device of the parameter.
    pub fn device(&self) -> Device {
        self.tensor.device()
    }

    /// Values in row-major order without autodiff, `[numbers]`.
    pub fn value(&self) -> Tensor<1> {
        self.tensor.value()
    }

    /// Values in row-major order, copied to the host.
    pub fn read(&self) -> Vec<f32> {
        to_host(self.tensor.value())
    }

    /// Gradient in row-major order without autodiff, `[numbers]`; `None` if `gradients` has none of
    /// this parameter.
    pub fn gradient(&self, gradients: &Gradients) -> Option<Tensor<1>> {
        self.tensor.gradient(gradients)
    }

    /// Replaces the gradient of this parameter by `value`, in row-major order and without autodiff,
    /// `[numbers]`.
    pub fn replace_gradient(&self, gradients: &mut Gradients, value: Tensor<1>) {
        self.tensor.replace_gradient(gradients, value);
    }
}

/// A tensor of any rank as a vector.
trait FlatTensor {
    fn device(&self) -> Device;
    fn value(&self) -> Tensor<1>;
    fn gradient(&self, gradients: &Gradients) -> Option<Tensor<1>>;
    fn replace_gradient(&self, gradients: &mut Gradients, value: Tensor<1>);
}

impl<const D: usize> FlatTensor for Tensor<D> {
    fn device(&self) -> Device {
        Tensor::device(self)
    }

    fn value(&self) -> Tensor<1> {
        self.clone().inner().reshape([-1])
    }

    fn gradient(&self, gradients: &Gradients) -> Option<Tensor<1>> {
        self.grad(gradients).map(|gradient| gradient.reshape([-1]))
    }

    fn replace_gradient(&self, gradients: &mut Gradients, value: Tensor<1>) {
        self.grad_replace(gradients, value.reshape(self.dims()));
    }
}

/// Calls `f` with every float parameter of a module.
pub fn for_each_parameter<M: Module>(module: &M, f: impl FnMut(&ParamRef)) {
    module.visit(&mut ParamWalk { path: ParamPath::default(), f });
}

/// Replaces the values of every float parameter for which `f` returns a vector of as many numbers,
/// in row-major order and without autodiff; parameters that required gradients still do.
pub fn map_parameters<M: Module>(module: M, f: impl FnMut(&ParamRef) -> Option<Tensor<1>>) -> M {
    module.map(&mut ParamWalk { path: ParamPath::default(), f })
}

/// Walk over the float parameters of a module with their paths.
struct ParamWalk<F> {
    path: ParamPath,
    f: F,
}

impl<F> ParamWalk<F> {
    fn call<const D: usize, R>(
        &mut self,
        param: &Param<Tensor<D>>,
        call: impl FnOnce(&mut F, &ParamRef) -> R,
    ) -> R {
        let (tensor, path) = (param.val(), self.path.join());
        call(&mut self.f, &ParamRef { path: &path, shape: &tensor.dims(), tensor: &tensor })
    }
}

impl<F: FnMut(&ParamRef)> ModuleVisitor for ParamWalk<F> {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        self.call(param, |f, parameter| f(parameter));
    }

    fn enter_module(&mut self, name: &str, container: &str) {
        self.path.enter(name, container);
    }

    fn exit_module(&mut self, _: &str, _: &str) {
        self.path.exit();
    }
}

impl<F: FnMut(&ParamRef) -> Option<Tensor<1>>> ModuleMapper for ParamWalk<F> {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let Some(values) = self.call(&param, |f, parameter| f(parameter)) else { return param };
        param.map(|old| {
            let values = values.reshape(old.dims());
            let new = if old.is_autodiff() { Tensor::from_inner(values) } else { values };
            if old.is_require_grad() { new.require_grad() } else { new }
        })
    }

    fn enter_module(&mut self, name: &str, container: &str) {
        self.path.enter(name, container);
    }

    fn exit_module(&mut self, _: &str, _: &str) {
        self.path.exit();
    }
}

/// Copies every parameter of a module to the host.
pub fn collect<M: Module>(module: &M) -> Weights {
    let mut weights = Weights::new();
    for_each_parameter(module, |parameter| {
        let array = HostArray { shape: parameter.shape.to_vec(), values: parameter.read() };
        weights.insert(parameter.path.to_owned(), array);
    });
    weights
}

/// Writes `weights` into the parameters of a module of the same structure.
///
/// # Errors
/// If `weights` lacks a parameter, has one of another shape, or one that the module does not have;
/// it is named, and the module is dropped unchanged.
pub fn apply<M: Module>(module: M, weights: &Weights) -> Result<M> {
    let mut expected = HashMap::new();
    for_each_parameter(&module, |parameter| {
        expected.insert(parameter.path.to_owned(), parameter.shape.to_vec());
    });
    let error = |name: &str, message: String| Err(Error::Weight { name: name.into(), message });
    for (name, shape) in &expected {
        match weights.get(name) {
            None => return error(name, format!("missing; expected shape {shape:?}")),
            Some(found) if &found.shape != shape => {
                return error(name, format!("has shape {:?}, expected {shape:?}", found.shape));
            }
            Some(_) => {}
        }
    }
    if let Some(name) = weights.keys().find(|name| !expected.contains_key(*name)) {
        return error(name, "no such parameter in a model of this configuration".into());
    }

    Ok(map_parameters(module, |parameter| {
        let values = weights[parameter.path].values.clone();
        let data = TensorData::new(values, [parameter.shape.iter().product::<usize>()]);
        Some(Tensor::from_data(data, &parameter.device().inner()))
    }))
}

/// Writes weights as a safetensors file of f32, atomically.
pub fn save(weights: &Weights, path: impl AsRef<Path>) -> Result<()> {
    let path = path.as_ref();
    let bytes: Vec<(&String, Vec<usize>, Vec<u8>)> = weights
        .iter()
        .map(|(name, array)| {
            let bytes = array.values.iter().flat_map(|value| value.to_le_bytes()).collect();
            (name, array.shape.clone(), bytes)
        })
        .collect();
    let file = |error: safetensors::SafeTensorError| Error::File {
        path: path.to_owned(),
        message: error.to_string(),
    };
    let views = bytes
        .iter()
        .map(|(name, shape, bytes)| {
            Ok((name.as_str(), TensorView::new(Dtype::F32, shape.clone(), bytes).map_err(file)?))
        })
        .collect::<Result<Vec<_>>>()?;
    let content = safetensors::serialize(views, None).map_err(file)?;
    Ok(cape_core::write_atomically(path, |file| file.write_all(&content))?)
}

/// Reads weights from a safetensors file of f32.
pub fn load(path: impl AsRef<Path>) -> Result<Weights> {
    let path = path.as_ref();
    let file = |message: String| Error::File { path: path.to_owned(), message };
    let content =
        std::fs::read(path).map_err(|source| Error::Io { path: path.to_owned(), source })?;
    let start = &content[..content.len().min(4096)];
    if let Some(found) = cape_core::unexpected_content(start, content.len() as u64) {
        return Err(file(found.to_owned()));
    }
    let tensors = SafeTensors::deserialize(&content)
        .map_err(|error| file(format!("not a complete safetensors file: {error}")))?;
    tensors
        .tensors()
        .into_iter()
        .map(|(name, view)| {
            if view.dtype() != Dtype::F32 {
                return Err(file(format!("`{name}` is {:?}, expected F32", view.dtype())));
            }
            let values = view
                .data()
                .chunks_exact(4)
                .map(|bytes| f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
                .collect();
            Ok((name, HostArray { shape: view.shape().to_vec(), values }))
        })
        .collect()
}
