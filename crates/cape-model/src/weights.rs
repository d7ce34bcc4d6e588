//! Named weights: out of a module, into a module, and to safetensors files.

use std::{
    collections::{BTreeMap, HashMap},
    io::Write,
    path::Path,
};

use burn::{
    module::{Module, ModuleMapper, ModuleVisitor, Param},
    tensor::{Device, Tensor, TensorData},
};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};

use crate::{Error, Result};

/// A tensor on the host.
///
/// See [`Weights`] for an example.
#[derive(Debug, Clone, PartialEq)]
pub struct HostArray {
    /// Extents, row-major.
    pub shape: Vec<usize>,
    /// Values.
    pub values: Vec<f32>,
}

/// Parameters by their path in the module, such as `generator.encoder.mean.weight`.
///
/// ```
/// use burn::tensor::Device;
/// use cape_model::{Initialiser, layers::Linear, weights::{self, HostArray}};
///
/// let mut init = Initialiser::new(1, 0.1, &Device::default());
/// let layer = Linear::new(2, 3, &mut init);
/// let saved = weights::collect(&layer);
/// assert_eq!(saved["bias"], HostArray { shape: vec![3], values: vec![0.0; 3] });
///
/// let directory = tempfile::tempdir()?;
/// let path = directory.path().join("layer.safetensors");
/// weights::save(&saved, &path)?;
/// let other = weights::apply(Linear::new(2, 3, &mut init), &weights::load(&path)?)?;
/// assert_eq!(weights::collect(&other), saved);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub type Weights = BTreeMap<String, HostArray>;

/// Path of the parameter being visited; the names of enum variants are not part of it.
///
/// ```
/// use cape_model::weights::ParamPath;
///
/// let mut path = ParamPath::default();
/// path.enter("decoder", "Struct:Decoder");
/// path.enter("blocks", "Vec");
/// path.enter("0", "Enum:DecoderLayer");
/// path.enter("bias", "Struct:ConvLayer");
/// assert_eq!(path.path(), "decoder.blocks.bias");
/// path.exit();
/// assert_eq!(path.path(), "decoder.blocks");
/// ```
#[derive(Debug, Default)]
pub struct ParamPath(Vec<Option<String>>);

impl ParamPath {
    /// For a visitor's or mapper's `enter_module`.
    pub fn enter(&mut self, name: &str, container: &str) {
        self.0.push((!container.starts_with("Enum:")).then(|| name.to_owned()));
    }

    /// For a visitor's or mapper's `exit_module`.
    pub fn exit(&mut self) {
        self.0.pop();
    }

    /// Where the parameter being visited is.
    pub fn path(&self) -> String {
        self.0.iter().flatten().map(String::as_str).collect::<Vec<_>>().join(".")
    }
}

/// Calls `f` with the path and the value of every float parameter.
pub fn for_each_parameter<M: Module>(module: &M, f: impl FnMut(&str, ParamRef)) {
    struct ReadVisitor<F> {
        path: ParamPath,
        f: F,
    }
    impl<F: FnMut(&str, ParamRef)> ModuleVisitor for ReadVisitor<F> {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            let tensor = param.val();
            let shape = tensor.dims().to_vec();
            let read = || values(tensor.clone());
            (self.f)(
                &self.path.path(),
                ParamRef { shape: &shape, device: tensor.device(), read: &read },
            );
        }
        fn enter_module(&mut self, name: &str, container: &str) {
            self.path.enter(name, container);
        }
        fn exit_module(&mut self, _: &str, _: &str) {
            self.path.exit();
        }
    }
    module.visit(&mut ReadVisitor { path: ParamPath::default(), f });
}

/// A parameter seen by [`for_each_parameter`].
///
/// ```
/// use burn::tensor::Device;
/// use cape_model::{Initialiser, layers::Linear, weights::for_each_parameter};
///
/// let layer = Linear::new(2, 3, &mut Initialiser::new(1, 0.1, &Device::default()));
/// let mut numbers = 0;
/// for_each_parameter(&layer, |path, parameter| {
///     assert!(["weight", "bias"].contains(&path));
///     numbers += parameter.shape.iter().product::<usize>();
///     assert!(parameter.read().iter().all(|x| x.is_finite()));
/// });
/// assert_eq!(numbers, 2 * 3 + 3);
/// ```
pub struct ParamRef<'a> {
    /// Its extents.
    pub shape: &'a [usize],
    device: Device,
    read: &'a dyn Fn() -> Vec<f32>,
}

impl ParamRef<'_> {
    /// The device it is on.
    pub fn device(&self) -> Device {
        self.device.clone()
    }

    /// Copies the values to the host.
    pub fn read(&self) -> Vec<f32> {
        (self.read)()
    }
}

fn values<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    let data = tensor.detach().into_data().convert::<f32>();
    data.try_into_vec().unwrap_or_else(|_| unreachable!("converted to f32"))
}

/// Copies every parameter of a module to the host.
pub fn collect<M: Module>(module: &M) -> Weights {
    let mut weights = Weights::new();
    for_each_parameter(module, |path, parameter| {
        let array = HostArray { shape: parameter.shape.to_vec(), values: parameter.read() };
        weights.insert(path.to_owned(), array);
    });
    weights
}

/// Puts `weights` into a module of the same structure.
///
/// # Errors
/// If a parameter is missing, left over, or of another shape; nothing is changed then.
pub fn apply<M: Module>(module: M, weights: &Weights) -> Result<M> {
    let mut expected = HashMap::new();
    for_each_parameter(&module, |path, parameter| {
        expected.insert(path.to_owned(), parameter.shape.to_vec());
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
        return error(name, "is not a parameter of this configuration".into());
    }

    Ok(module.map(&mut WriteMapper { path: ParamPath::default(), weights }))
}

struct WriteMapper<'a> {
    path: ParamPath,
    weights: &'a Weights,
}
impl ModuleMapper for WriteMapper<'_> {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let array = &self.weights[&self.path.path()];
        let data = TensorData::new(array.values.clone(), array.shape.clone());
        param.map(|old| {
            let trained = old.is_require_grad();
            let new = Tensor::from_data(data, &old.device());
            if trained { new.require_grad() } else { new }
        })
    }
    fn enter_module(&mut self, name: &str, container: &str) {
        self.path.enter(name, container);
    }
    fn exit_module(&mut self, _: &str, _: &str) {
        self.path.exit();
    }
}

/// Writes weights as safetensors, to a temporary file first.
pub fn save(weights: &Weights, path: &Path) -> Result<()> {
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

/// Reads weights from safetensors of f32.
pub fn load(path: &Path) -> Result<Weights> {
    let file = |message: String| Error::File { path: path.to_owned(), message };
    let content =
        std::fs::read(path).map_err(|source| Error::Io { path: path.to_owned(), source })?;
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
