//! A trained model in one file.

mod storage;
mod triangles;

use std::{
    collections::{BTreeMap, HashMap},
    io::Write,
    path::{Path, PathBuf},
    sync::Arc,
};

use burn::{module::Module, tensor::Device};
use cape_core::{
    SmplModel,
    smpl::{ClothingMask, Gender},
};
use cape_data::DisplacementStatistics;
use cape_model::{
    Cape,
    weights::{self, HostArray, Weights},
};
use cape_synth::{embedded_body, synthetic_body};
use half::f16;
use ndarray::{Array2, ArrayD, IxDyn};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};

use crate::{
    ClothedModel, ClothedModelParts, Error, Result, Run, RunConfig, checkpoint::TrainState,
    graphs::MeshGraphs, prior::Prior,
};

pub use storage::WeightStorage;

/// Value of `format` in the file's metadata.
const FORMAT: &str = "cape-model 1";
const GENERATOR: &str = "generator.";
/// Factors of the last axis of weights in bytes.
const FACTORS: &str = "factors.";
const PRIOR: &str = "prior.";
/// End of the names of matrices that are kept as triangles; files of earlier versions have all numbers.
const COVARIANCES: &str = ".covariances";
const TEMPLATE: &str = "body.template";
const MEAN: &str = "statistics.mean";
const STD: &str = "statistics.std";
const CLOTHING: &str = "clothing";
/// Largest difference of a coordinate of the template from the built-in body's, metres.
const SAME_BODY: f64 = 1e-5;
/// Name of the sculpted body.
const SCULPTED: &str = "sculpted";

/// A trained model as one safetensors file: the generator's weights, configuration, statistics, clothing
/// vertices and the mixture of latent codes. The body is a built-in one and kept by name, so that the
/// file can be passed on.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/../cape-train/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use burn::tensor::Device;
/// use cape_infer::{ModelFile, Run, WeightStorage};
///
/// let directory = trained()?;
/// let device = Device::default();
/// let run = Run::open(directory.path().join("run"), &device)?;
/// let path = directory.path().join("model.safetensors");
/// ModelFile::of_run(&run)?.save(&path, WeightStorage::Bytes)?;
/// // The file is opened as the directory is.
/// let again = Run::open(&path, &device)?;
/// assert_eq!(again.clothing(), run.clothing());
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct ModelFile {
    config: RunConfig,
    state: TrainState,
    weights: Weights,
    statistics: DisplacementStatistics,
    mask: ClothingMask,
    body: (String, SmplModel),
    prior: Option<Prior>,
    about: BTreeMap<String, String>,
}

impl ModelFile {
    /// The opened checkpoint of a run with its mixture of latent codes.
    ///
    /// # Errors
    /// If the run's body is not a built-in one, or its mixture cannot be read.
    pub fn of_run(run: &Run) -> Result<Self> {
        Ok(Self {
            config: run.config().clone(),
            state: run.progress().clone(),
            weights: weights::collect(run.generator()),
            statistics: run.statistics().clone(),
            mask: run.mask().clone(),
            body: built_in_body(run.body()).ok_or_else(|| {
                Error::argument(format!(
                    "{}: its body is not a built-in one; a model file does not contain bodies, as \
                     SMPL's may not be passed on: keep the run's directory",
                    run.name().display()
                ))
            })?,
            prior: run.prior()?,
            about: BTreeMap::new(),
        })
    }

    /// The same with an entry of the file's metadata, such as `licence` or `data`.
    #[must_use]
    pub fn with_entry(mut self, name: &str, text: &str) -> Self {
        self.about.insert(name.to_owned(), text.to_owned());
        self
    }

    /// Entries of the metadata by name.
    pub fn about(&self) -> &BTreeMap<String, String> {
        &self.about
    }

    /// Configuration of the run.
    pub fn config(&self) -> &RunConfig {
        &self.config
    }

    /// Name of the built-in body.
    pub fn body(&self) -> &str {
        &self.body.0
    }

    /// Number of weights.
    pub fn numbers(&self) -> usize {
        self.weights.values().map(|array| array.values.len()).sum()
    }

    /// Bytes of the file.
    ///
    /// # Errors
    /// If a weight is too large for half precision.
    pub fn encode(&self, storage: WeightStorage) -> Result<Vec<u8>> {
        let mut tensors: Vec<(String, Vec<usize>, Dtype, Vec<u8>)> = Vec::new();
        for (name, array) in &self.weights {
            let stored = storage::encode(name, array, storage)?;
            if let Some(factors) = stored.factors {
                let (shape, bytes) = (vec![factors.len()], single(factors.into_iter()));
                tensors.push((format!("{FACTORS}{name}"), shape, Dtype::F32, bytes));
            }
            let name = format!("{GENERATOR}{name}");
            tensors.push((name, array.shape.clone(), stored.dtype, stored.data));
        }
        let rows = |name: &str, of: &Array2<f64>| {
            let bytes = single(of.iter().map(|&x| x as f32));
            (name.to_owned(), of.shape().to_vec(), Dtype::F32, bytes)
        };
        tensors.push(rows(MEAN, self.statistics.mean()));
        tensors.push(rows(STD, self.statistics.std()));
        tensors.push(rows(TEMPLATE, &self.body.1.v_template));
        let clothing: Vec<u8> =
            self.mask.indices().flat_map(|vertex| (vertex as u32).to_le_bytes()).collect();
        tensors.push((CLOTHING.to_owned(), vec![clothing.len() / 4], Dtype::U32, clothing));
        for (name, array) in self.prior.iter().flat_map(Prior::arrays) {
            let array = match array.view().into_dimensionality() {
                Ok(matrices) if name.ends_with(COVARIANCES) => {
                    triangles::lower(matrices).into_dyn()
                }
                _ => array,
            };
            let bytes = array.iter().flat_map(|x| x.to_le_bytes()).collect();
            tensors.push((format!("{PRIOR}{name}"), array.shape().to_vec(), Dtype::F64, bytes));
        }
        let fault = |error: safetensors::SafeTensorError| Error::argument(error.to_string());
        let views = tensors
            .iter()
            .map(|(name, shape, dtype, bytes)| {
                Ok((name, TensorView::new(*dtype, shape.clone(), bytes).map_err(fault)?))
            })
            .collect::<Result<Vec<_>>>()?;
        let bytes = safetensors::serialize(views, Some(self.metadata()?)).map_err(fault)?;
        with_sorted_header(bytes).map_err(|error| Error::argument(error.to_string()))
    }

    fn metadata(&self) -> Result<HashMap<String, String>> {
        let state = serde_json::to_string(&self.state)
            .map_err(|error| Error::argument(error.to_string()))?;
        let mut metadata: HashMap<String, String> = self.about.clone().into_iter().collect();
        for (name, text) in [
            ("format", FORMAT.to_owned()),
            ("config", self.config.to_toml()?),
            ("state", state),
            ("body", self.body.0.clone()),
        ] {
            metadata.insert(name.to_owned(), text);
        }
        Ok(metadata)
    }

    /// Writes the file, atomically.
    pub fn save(&self, path: impl AsRef<Path>, storage: WeightStorage) -> Result<()> {
        let bytes = self.encode(storage)?;
        Ok(cape_core::write_atomically(path.as_ref(), |file| file.write_all(&bytes))?)
    }

    /// Reads a file.
    ///
    /// # Errors
    /// If it is no complete model file; the error names it and the field.
    pub fn load(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let bytes = std::fs::read(path).map_err(|source| Error::io(path, source))?;
        if let Some(found) =
            cape_core::unexpected_content(&bytes[..bytes.len().min(4096)], bytes.len() as u64)
        {
            return Err(Error::format(path, found));
        }
        Self::decode(path, &bytes)
    }

    /// Reads the `bytes` of a file; errors call it `name`.
    ///
    /// # Errors
    /// As [`load`](Self::load).
    pub fn decode(name: impl AsRef<Path>, bytes: &[u8]) -> Result<Self> {
        let file = Contents::read(name.as_ref(), bytes)?;
        let found = file.entry("format")?;
        if found != FORMAT {
            let message = format!("`{found}`, expected `{FORMAT}`: made by another version");
            return Err(file.fault("format", message));
        }
        let config = RunConfig::from_toml(file.name, &file.entry("config")?)?;
        let state = serde_json::from_str(&file.entry("state")?)
            .map_err(|error| file.fault("state", error.to_string()))?;
        let body = file.body()?;
        let vertices = body.1.vertices();
        let clothing: Vec<usize> =
            file.numbers(CLOTHING)?.into_iter().map(|index| index as usize).collect();
        let mut weights = Weights::new();
        for name in file.names(GENERATOR) {
            let array = HostArray { shape: file.shape(&name)?, values: file.weight(&name)? };
            weights.insert(name[GENERATOR.len()..].to_owned(), array);
        }
        let mut arrays = BTreeMap::new();
        for name in file.names(PRIOR) {
            let array = ArrayD::from_shape_vec(IxDyn(&file.shape(&name)?), file.numbers(&name)?)
                .map_err(|error| file.fault(&name, error.to_string()))?;
            let array = match array.view().into_dimensionality() {
                Ok(packed) if name.ends_with(COVARIANCES) => triangles::symmetric(packed)
                    .ok_or_else(|| file.fault(&name, "no triangles of square matrices"))?
                    .into_dyn(),
                _ => array,
            };
            arrays.insert(name[PRIOR.len()..].to_owned(), array);
        }
        let prior =
            if arrays.is_empty() { None } else { Some(Prior::from_arrays(file.name, arrays)?) };
        let metadata = file.metadata.iter();
        let own = ["format", "config", "state", "body"];
        Ok(Self {
            statistics: DisplacementStatistics::new(file.rows(MEAN)?, file.rows(STD)?, 0)
                .map_err(|error| file.fault(STD, error.to_string()))?,
            mask: ClothingMask::from_indices(vertices, &clothing)
                .map_err(|error| file.fault(CLOTHING, error.to_string()))?,
            about: metadata
                .filter(|(name, _)| !own.contains(&name.as_str()))
                .map(|(name, text)| (name.clone(), text.clone()))
                .collect(),
            config,
            state,
            weights,
            body,
            prior,
        })
    }

    /// The model on a device; `name` stands for it in messages, and is the path of its file if it has
    /// one.
    ///
    /// # Errors
    /// If the weights do not suit the configuration.
    pub fn open(self, name: impl Into<PathBuf>, device: &Device) -> Result<Run> {
        let name = name.into();
        let device = device.clone().inner();
        let mut config = self.config.clone();
        config.model.discriminator = None;
        let mesh_graphs = MeshGraphs::build(&config, &self.body.1)?;
        let graphs = mesh_graphs.upload(&device);
        let generator = Cape::new(&config.model, &graphs, 0, &device)?.generator;
        let generator = weights::apply(generator, &self.weights).map_err(|error| {
            Error::format(&name, format!("weights do not suit the configuration: {error}"))
        })?;
        let parts = ClothedModelParts {
            config: self.config,
            mask: self.mask,
            body: self.body.1,
            statistics: self.statistics,
        };
        let graphs = (Arc::new(mesh_graphs), graphs);
        let model = ClothedModel::with_graphs(parts, generator.valid(), graphs, &device)?;
        Run::of_file(name, model, self.state, self.prior)
    }
}

/// The built-in body that `body` is, with its name.
fn built_in_body(body: &SmplModel) -> Option<(String, SmplModel)> {
    let humans = [Gender::Neutral, Gender::Female, Gender::Male].into_iter();
    let humans =
        humans.filter_map(|gender| Some((gender.to_string(), embedded_body(gender).ok()?)));
    let same = |(_, other): &(String, SmplModel)| {
        other.faces == body.faces
            && is_close(&other.v_template, &body.v_template)
            && is_close(&other.weights, &body.weights)
    };
    humans.chain(std::iter::once_with(|| (SCULPTED.to_owned(), synthetic_body()))).find(same)
}

fn is_close(a: &Array2<f64>, b: &Array2<f64>) -> bool {
    a.dim() == b.dim() && a.iter().zip(b).all(|(a, b)| (a - b).abs() <= SAME_BODY)
}

/// The file with the entries of its header in order, which the metadata are not when safetensors writes
/// them: one model makes one file.
fn with_sorted_header(mut file: Vec<u8>) -> serde_json::Result<Vec<u8>> {
    if let Some((length, rest)) = file.split_first_chunk_mut::<8>() {
        let length = u64::from_le_bytes(*length) as usize;
        let header = &mut rest[..length];
        let entries: BTreeMap<String, BTreeMap<String, serde_json::Value>> =
            serde_json::from_slice(header)?;
        // The same entries have the same length but for the spaces at the end.
        header.fill(b' ');
        serde_json::to_writer(header, &entries)?;
    }
    Ok(file)
}

fn single(values: impl Iterator<Item = f32>) -> Vec<u8> {
    values.flat_map(f32::to_le_bytes).collect()
}

/// Tensors and metadata of a file.
struct Contents<'a> {
    name: &'a Path,
    tensors: SafeTensors<'a>,
    metadata: HashMap<String, String>,
}

impl<'a> Contents<'a> {
    fn read(name: &'a Path, bytes: &'a [u8]) -> Result<Self> {
        let fault = |error| Error::format(name, format!("no complete model file: {error}"));
        let tensors = SafeTensors::deserialize(bytes).map_err(fault)?;
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(fault)?;
        Ok(Self { name, tensors, metadata: header.metadata().clone().unwrap_or_default() })
    }

    fn fault(&self, field: &str, message: impl Into<String>) -> Error {
        Error::field(self.name, field, message)
    }

    fn entry(&self, field: &str) -> Result<String> {
        self.metadata.get(field).cloned().ok_or_else(|| {
            self.fault(
                field,
                "missing in the metadata: expected a model file of `cape model pack`, or a run's \
                 directory",
            )
        })
    }

    fn names(&self, prefix: &str) -> Vec<String> {
        let mut names: Vec<String> = self.tensors.names().iter().map(ToString::to_string).collect();
        names.retain(|name| name.starts_with(prefix));
        names.sort();
        names
    }

    fn tensor(&self, name: &str) -> Result<TensorView<'_>> {
        self.tensors.tensor(name).map_err(|error| self.fault(name, error.to_string()))
    }

    fn shape(&self, name: &str) -> Result<Vec<usize>> {
        Ok(self.tensor(name)?.shape().to_vec())
    }

    fn numbers(&self, name: &str) -> Result<Vec<f64>> {
        let tensor = self.tensor(name)?;
        let data = tensor.data();
        let values = match tensor.dtype() {
            Dtype::F16 => {
                data.as_chunks().0.iter().map(|&b| f64::from(f16::from_le_bytes(b))).collect()
            }
            Dtype::F32 => {
                data.as_chunks().0.iter().map(|&b| f64::from(f32::from_le_bytes(b))).collect()
            }
            Dtype::F64 => data.as_chunks().0.iter().map(|&b| f64::from_le_bytes(b)).collect(),
            Dtype::U32 => {
                data.as_chunks().0.iter().map(|&b| f64::from(u32::from_le_bytes(b))).collect()
            }
            other => {
                return Err(self.fault(name, format!("{other:?}, expected F16, F32, F64 or U32")));
            }
        };
        Ok(values)
    }

    /// Values of the weight `name`, of any storage.
    fn weight(&self, name: &str) -> Result<Vec<f32>> {
        let tensor = self.tensor(name)?;
        if tensor.dtype() != Dtype::I8 {
            return Ok(self.numbers(name)?.into_iter().map(|x| x as f32).collect());
        }
        let factors = format!("{FACTORS}{}", &name[GENERATOR.len()..]);
        storage::decode(tensor.shape(), tensor.data(), &self.numbers(&factors)?).ok_or_else(|| {
            let shape = tensor.shape();
            self.fault(
                &factors,
                format!("expected one for each index of the last axis of {shape:?}"),
            )
        })
    }

    fn rows(&self, name: &str) -> Result<Array2<f64>> {
        let shape = self.shape(name)?;
        let &[rows, columns] = &shape[..] else {
            return Err(self.fault(name, format!("shape {shape:?}, expected [V, 3]")));
        };
        Array2::from_shape_vec((rows, columns), self.numbers(name)?)
            .map_err(|error| self.fault(name, error.to_string()))
    }

    /// The built-in body, which must be that of the training.
    fn body(&self) -> Result<(String, SmplModel)> {
        let name = self.entry("body")?;
        let body = if name == SCULPTED {
            synthetic_body()
        } else {
            let gender: Gender = name
                .parse()
                .map_err(|_| self.fault("body", format!("`{name}` is no built-in body")))?;
            embedded_body(gender)?
        };
        if !is_close(&self.rows(TEMPLATE)?, &body.v_template) {
            return Err(self.fault(
                TEMPLATE,
                format!("not that of the built-in body `{name}`: made by another version"),
            ));
        }
        Ok((name, body))
    }
}
