//! A run's directory, and a trained model opened from it.

use std::{
    fs,
    io::Write,
    ops::Deref,
    path::{Path, PathBuf},
    sync::Arc,
};

use burn::{module::Module, tensor::Device};
use cape_core::{Outfit, SmplModel, smpl::ClothingMask};
use cape_data::{
    DisplacementStatistics, PackedSet, Split,
    raw::{BODY_FILE, CLOTHING_FILE},
};
use cape_model::{Cape, weights};
use ndarray::Array2;
use serde::{Deserialize, Serialize};

use crate::{
    ClothedModel, ClothedModelParts, Error, ModelFile, Result, RunConfig, checkpoint,
    graphs::MeshGraphs, prior::Prior,
};

const CONFIG: &str = "config.toml";
const DATA: &str = "data.json";
const STATISTICS: &str = "stats.npz";
/// Kind of density that training ends with.
pub const MIXTURE: &str = "gmm";

/// Paths inside a run's directory.
///
/// ```
/// use cape_infer::RunPaths;
///
/// let paths = RunPaths::new("runs/first".as_ref());
/// assert_eq!(paths.root().join("checkpoints"), paths.checkpoints());
/// assert!(paths.metrics().ends_with("metrics.jsonl"));
/// ```
#[derive(Debug, Clone)]
pub struct RunPaths {
    root: PathBuf,
}

impl RunPaths {
    /// Paths of the run in `root`.
    pub fn new(root: &Path) -> Self {
        Self { root: root.to_owned() }
    }

    /// The run's directory.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Configuration, `config.toml`.
    pub fn config(&self) -> PathBuf {
        self.root.join(CONFIG)
    }

    /// Identity of the training data, `data.json`.
    pub fn data(&self) -> PathBuf {
        self.root.join(DATA)
    }

    /// Mean and standard deviation of the training displacements, `stats.npz`.
    pub fn statistics(&self) -> PathBuf {
        self.root.join(STATISTICS)
    }

    /// The unclothed body.
    pub fn body(&self) -> PathBuf {
        self.root.join(BODY_FILE)
    }

    /// Indices of the clothing vertices.
    pub fn clothing(&self) -> PathBuf {
        self.root.join(CLOTHING_FILE)
    }

    /// Directory of the checkpoints.
    pub fn checkpoints(&self) -> PathBuf {
        self.root.join("checkpoints")
    }

    /// Losses and validation errors, one JSON object a line.
    pub fn metrics(&self) -> PathBuf {
        self.root.join("metrics.jsonl")
    }

    /// Directory of TensorBoard's event files.
    pub fn events(&self) -> PathBuf {
        self.root.join("tensorboard")
    }

    /// Density of latent codes of a kind: `gmm`, fitted at the end of training, or `kde`.
    pub fn prior(&self, kind: &str) -> PathBuf {
        self.root.join(format!("prior-{kind}.npz"))
    }

    /// Report of the last evaluation.
    pub fn evaluation(&self) -> PathBuf {
        self.root.join("eval.json")
    }
}

/// Identity of the training data of a run.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/../cape-train/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use cape_infer::{DataIdentity, RunPaths};
///
/// // A run on a packed set of four training frames.
/// let directory = trained()?;
/// let paths = RunPaths::new(&directory.path().join("run"));
/// let data: DataIdentity = serde_json::from_slice(&std::fs::read(paths.data())?)?;
/// assert_eq!((data.frames, data.vertices), (4, 6890));
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DataIdentity {
    /// Directory of the packed set when the run was created; a hint only.
    pub path: PathBuf,
    /// Number of training frames.
    pub frames: usize,
    /// Number of vertices of a frame.
    pub vertices: usize,
}

/// Body and clothing vertices of a packed set: the given ones, else the set's own; without a file of
/// clothing vertices, they are derived from the body's blend weights.
pub fn body_and_clothing(
    data: &Path,
    set: &PackedSet,
    body: Option<&SmplModel>,
    clothing: Option<&Path>,
) -> Result<(SmplModel, ClothingMask)> {
    let own = data.join(BODY_FILE);
    let model = match body {
        Some(body) => body.clone(),
        None if own.exists() => SmplModel::load(&own)?,
        None => {
            return Err(Error::argument(format!(
                "{}: not found: the packed set has no body of its own: give the body that it is of \
                 (--body)",
                own.display()
            )));
        }
    };
    if model.vertices() != set.vertices() {
        let differs =
            format!("{} vertices, but the data have {}", model.vertices(), set.vertices());
        return Err(match body {
            Some(_) => Error::argument(format!("the given body has {differs}")),
            None => Error::field(&own, "v_template", differs),
        });
    }
    let clothing_path = clothing.map_or_else(|| data.join(CLOTHING_FILE), Path::to_owned);
    let mask = if clothing.is_some() || clothing_path.exists() {
        ClothingMask::load(&clothing_path, model.vertices())?
    } else {
        ClothingMask::from_weights(&model)?
    };
    Ok((model, mask))
}

/// Writes a value as indented JSON.
pub fn write_json(path: &Path, value: &impl Serialize) -> Result<()> {
    let text =
        serde_json::to_vec_pretty(value).map_err(|error| Error::format(path, error.to_string()))?;
    Ok(cape_core::write_atomically(path, |file| file.write_all(&text))?)
}

/// Reads what a run was trained on from its `data.json`.
pub fn read_identity(path: &Path) -> Result<DataIdentity> {
    let text = fs::read(path).map_err(|source| Error::io(path, source))?;
    serde_json::from_slice(&text).map_err(|error| Error::format(path, error.to_string()))
}

/// A trained model with its directory.
///
/// It dereferences to its [`ClothedModel`], which encodes, decodes, dresses and poses.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/../cape-train/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use burn::tensor::Device;
/// use cape_core::Outfit;
/// use cape_infer::{AnimatedBody, BodySpec, Run};
///
/// let directory = trained()?;
/// let run = Run::open(directory.path().join("run"), &Device::default())?;
/// let code = run.sample_codes(1, 7);
/// let body = BodySpec { betas: vec![1.0, -0.5], pose: [0.0; 72], outfit: Outfit::LONG_LONG };
/// run.dress(&code, std::slice::from_ref(&body))?[0].save(directory.path().join("dressed.obj"))?;
/// let file = AnimatedBody::from_body("dressed", &code, &body).encode(&run)?;
/// assert_eq!(&file[..4], b"glTF");
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct Run {
    source: RunSource,
    state: checkpoint::TrainState,
    model: ClothedModel,
}

/// Origin of a run.
#[derive(Debug)]
enum RunSource {
    Directory { paths: RunPaths, checkpoint: PathBuf },
    File { name: PathBuf, prior: Option<Box<Prior>> },
}

impl Deref for Run {
    type Target = ClothedModel;

    fn deref(&self) -> &ClothedModel {
        &self.model
    }
}

impl Run {
    /// Opens a [`ModelFile`], or the best checkpoint of a run's directory; the newest where none was
    /// validated.
    ///
    /// # Errors
    /// If a file of the run is missing or does not suit the others.
    pub fn open(root: impl AsRef<Path>, device: &Device) -> Result<Self> {
        if root.as_ref().is_file() {
            return ModelFile::load(&root)?.open(root.as_ref(), device);
        }
        let paths = RunPaths::new(root.as_ref());
        let config = RunConfig::load(&paths.config())?;
        let checkpoint = checkpoint::best(&paths.checkpoints())?;
        let state = checkpoint::load_progress(&checkpoint)?;
        let weights = checkpoint::load_weights(&checkpoint)?;
        let body = SmplModel::load(paths.body())?;
        let device = device.clone().inner();
        let mesh_graphs = MeshGraphs::build(&config, &body)?;
        let graphs = mesh_graphs.upload(&device);
        let networks = Cape::new(&config.model, &graphs, 0, &device)?;
        let networks = weights::apply(networks, &weights).map_err(|error| {
            Error::format(&checkpoint, format!("does not suit {CONFIG}: {error}"))
        })?;
        let parts = ClothedModelParts {
            config,
            mask: ClothingMask::load(paths.clothing(), body.vertices())?,
            body,
            statistics: DisplacementStatistics::load(paths.statistics())?,
        };
        let generator = networks.generator.valid();
        let model =
            ClothedModel::with_graphs(parts, generator, (Arc::new(mesh_graphs), graphs), &device)?;
        Ok(Self { source: RunSource::Directory { paths, checkpoint }, state, model })
    }

    /// A model from a file called `name`.
    pub(crate) fn of_file(
        name: PathBuf,
        model: ClothedModel,
        state: checkpoint::TrainState,
        prior: Option<Prior>,
    ) -> Result<Self> {
        if let Some(prior) = &prior {
            expect_latent(&name, prior, &model)?;
        }
        Ok(Self { source: RunSource::File { name, prior: prior.map(Box::new) }, state, model })
    }

    /// True if there is a run's directory or a model file at `path`.
    pub fn is_at(path: impl AsRef<Path>) -> bool {
        let path = path.as_ref();
        path.join(CONFIG).is_file()
            || path.is_file() && path.extension().is_some_and(|end| end == "safetensors")
    }

    /// The model.
    pub fn model(&self) -> &ClothedModel {
        &self.model
    }

    /// Directory or model file of the run.
    pub fn name(&self) -> &Path {
        match &self.source {
            RunSource::Directory { paths, .. } => paths.root(),
            RunSource::File { name, .. } => name,
        }
    }

    /// Paths inside the run's directory; `None` for a model file.
    pub fn paths(&self) -> Option<&RunPaths> {
        match &self.source {
            RunSource::Directory { paths, .. } => Some(paths),
            RunSource::File { .. } => None,
        }
    }

    /// The checkpoint that was opened; `None` for a model file.
    pub fn checkpoint(&self) -> Option<&Path> {
        match &self.source {
            RunSource::Directory { checkpoint, .. } => Some(checkpoint),
            RunSource::File { .. } => None,
        }
    }

    /// Directory of the packed set that the run was trained on.
    ///
    /// # Errors
    /// If the run does not record it, like an imported one, or the set no longer exists.
    pub fn data(&self) -> Result<PathBuf> {
        let unknown = || {
            Error::argument(format!(
                "{}: the run does not record its training data: name the packed set",
                self.name().display()
            ))
        };
        let RunSource::Directory { paths, .. } = &self.source else { return Err(unknown()) };
        let path = paths.data();
        if !path.exists() {
            return Err(unknown());
        }
        let identity = read_identity(&path)?;
        let data = &identity.path;
        if data.exists() {
            return Ok(data.clone());
        }
        // Seen from a directory that the run is in, if it is the same set.
        let root = fs::canonicalize(paths.root()).unwrap_or_default();
        let same = |place: &PathBuf| {
            PackedSet::open(place, Split::Train).is_ok_and(|set| {
                (set.frames(), set.vertices()) == (identity.frames, identity.vertices)
            })
        };
        root.ancestors().map(|place| place.join(data)).find(same).ok_or_else(|| {
            Error::argument(format!(
                "{}: not found: name the packed set that {} was trained on",
                data.display(),
                paths.root().display()
            ))
        })
    }

    /// The mixture of latent codes that was fitted at the end of training; `None` for runs without.
    ///
    /// # Errors
    /// If its file cannot be read, or its codes are of another length.
    pub fn prior(&self) -> Result<Option<Prior>> {
        self.prior_of_kind(MIXTURE)
    }

    /// The density of latent codes of a kind, `gmm` or `kde`; `None` if the run has none.
    ///
    /// # Errors
    /// As [`prior`](Self::prior).
    pub fn prior_of_kind(&self, kind: &str) -> Result<Option<Prior>> {
        match &self.source {
            _ if !self.has_prior(kind) => Ok(None),
            RunSource::Directory { paths, .. } => {
                let path = paths.prior(kind);
                let prior = Prior::load(&path)?;
                expect_latent(&path, &prior, &self.model)?;
                Ok(Some(prior))
            }
            RunSource::File { prior, .. } => Ok(prior.as_deref().cloned()),
        }
    }

    /// True if the run has a density of latent codes of a kind, `gmm` or `kde`.
    pub fn has_prior(&self, kind: &str) -> bool {
        match &self.source {
            RunSource::Directory { paths, .. } => paths.prior(kind).exists(),
            RunSource::File { prior, .. } => prior.is_some() && kind == MIXTURE,
        }
    }

    /// Latent codes for an outfit, `[n, latent]`, from the run's [`prior`](Self::prior), or from the
    /// standard normal distribution if it has none.
    pub fn sample_for(&self, outfit: Outfit, n: usize, seed: u64) -> Result<Array2<f32>> {
        Ok(match self.prior()? {
            Some(prior) => prior.sample(outfit, n, 1.0, seed),
            None => self.sample_codes(n, seed),
        })
    }

    /// State of the training at that checkpoint.
    pub fn progress(&self) -> &checkpoint::TrainState {
        &self.state
    }
}

/// Returns an error if a density is of codes of another length than the model's.
fn expect_latent(path: &Path, prior: &Prior, model: &ClothedModel) -> Result<()> {
    let (found, expected) = (prior.latent(), model.latent());
    if found != expected {
        let message = format!(
            "codes of {found} numbers, but the model has {expected}: fit the density again by `cape \
             model prior`"
        );
        return Err(Error::format(path, message));
    }
    Ok(())
}
