//! A run's directory, and a trained model opened from it.

use std::{
    fs,
    io::Write,
    path::{Path, PathBuf},
};

use burn::{
    module::Module,
    tensor::{Device, Tensor, TensorData},
};
use cape_core::{
    BodyPose, ClothedSmpl, Outfit, Smpl, SmplModel,
    joints::pose_features,
    smpl::ClothingMask,
    tensors::{host, tensor2},
};
use cape_graph::{DevicePyramid, MeshPyramid, SparseMatrix, Surface};
use cape_model::{Cape, Generator, Graphs, weights};
use ndarray::{Array2, Array3};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use rand_distr::StandardNormal;
use serde::{Deserialize, Serialize};
use sprs::TriMat;

use crate::{Error, Result, RunConfig, checkpoint};
use cape_data::{
    DisplacementStatistics, HostBatch, PackedSet, Split,
    raw::{BODY_FILE, CLOTHING_FILE},
};

const CONFIG: &str = "config.toml";
const DATA: &str = "data.json";
const STATISTICS: &str = "stats.npz";

/// Examples decoded at a time.
const DECODE_BATCH: usize = 16;

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
    /// Of the run in `root`.
    pub fn new(root: &Path) -> Self {
        Self { root: root.to_owned() }
    }

    /// The directory itself.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The configuration.
    pub fn config(&self) -> PathBuf {
        self.root.join(CONFIG)
    }

    /// What the run is trained on.
    pub fn data(&self) -> PathBuf {
        self.root.join(DATA)
    }

    /// Mean and deviation of the training displacements.
    pub fn statistics(&self) -> PathBuf {
        self.root.join(STATISTICS)
    }

    /// The body.
    pub fn body(&self) -> PathBuf {
        self.root.join(BODY_FILE)
    }

    /// The clothing vertices.
    pub fn clothing(&self) -> PathBuf {
        self.root.join(CLOTHING_FILE)
    }

    /// The checkpoints.
    pub fn checkpoints(&self) -> PathBuf {
        self.root.join("checkpoints")
    }

    /// One JSON object a line: losses and validation errors.
    pub fn metrics(&self) -> PathBuf {
        self.root.join("metrics.jsonl")
    }

    /// TensorBoard's event files.
    pub fn events(&self) -> PathBuf {
        self.root.join("tensorboard")
    }

    /// A density of codes that was fitted after training, by its kind.
    pub fn prior(&self, kind: &str) -> PathBuf {
        self.root.join(format!("prior-{kind}.npz"))
    }

    /// The last evaluation.
    pub fn evaluation(&self) -> PathBuf {
        self.root.join("eval.json")
    }
}

/// The training data a run belongs to.
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
    /// Where they were when the run was created: a hint, not relied upon.
    pub path: PathBuf,
    /// Training frames.
    pub frames: usize,
    /// Vertices of a frame.
    pub vertices: usize,
}

/// The body and the clothing vertices of a packed set: those given, or else its own, or else, for
/// the clothing vertices, what the body's blend weights tell.
pub fn body_and_clothing(
    data: &Path,
    set: &PackedSet,
    body: Option<&Path>,
    clothing: Option<&Path>,
) -> Result<(SmplModel, ClothingMask)> {
    let body_path = body.map_or_else(|| data.join(BODY_FILE), Path::to_owned);
    if !body_path.exists() {
        return Err(Error::argument(format!(
            "{}: not found: the packed set has no body of its own, so give SMPL's, .pkl or .npz",
            body_path.display()
        )));
    }
    let model = SmplModel::load(&body_path)?;
    if model.vertices() != set.vertices() {
        return Err(Error::field(
            &body_path,
            "v_template",
            format!("{} vertices, but the data have {}", model.vertices(), set.vertices()),
        ));
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

/// Builds what the networks of `config` need of a mesh.
pub fn build_graphs(
    config: &RunConfig,
    mesh: impl Into<Surface>,
    device: &Device,
) -> Result<Graphs> {
    let surface = mesh.into();
    let pyramid = |factors: &[u32]| -> Result<DevicePyramid> {
        let factors: Vec<f64> = factors.iter().map(|&factor| f64::from(factor)).collect();
        let pyramid = MeshPyramid::build(surface.clone(), &factors, config.weighting)?;
        Ok(DevicePyramid::upload(&pyramid, device))
    };
    let discriminator = config.model.discriminator.as_ref();
    let edges = surface.edges();
    let mut difference = TriMat::new((edges.len(), surface.vertices.len()));
    for (row, [a, b]) in edges.into_iter().enumerate() {
        difference.add_triplet(row, a as usize, 1.0);
        difference.add_triplet(row, b as usize, -1.0);
    }
    Ok(Graphs {
        generator: pyramid(&config.model.factors)?,
        discriminator: discriminator.map(|config| pyramid(&config.factors)).transpose()?,
        edges: SparseMatrix::new(&difference.to_csr(), device),
    })
}

/// A batch of frames on a device.
#[derive(Debug, Clone)]
pub struct DeviceBatch {
    /// Normalised displacements, `[batch, vertices, 3]`.
    pub displacement: Tensor<3>,
    /// Pose features, `[batch, 126]`.
    pub pose_feature: Tensor<2>,
    /// Outfit labels, `[batch, 4]`.
    pub outfit: Tensor<2>,
}

/// Moves a batch to a device.
pub fn to_device(batch: HostBatch, device: &Device) -> DeviceBatch {
    let HostBatch { displacement, pose_feature, outfit, .. } = batch;
    let [count, vertices, _] = [displacement.dim().0, displacement.dim().1, 3];
    let (values, _) = displacement.into_raw_vec_and_offset();
    DeviceBatch {
        displacement: Tensor::from_data(TensorData::new(values, [count, vertices, 3]), device),
        pose_feature: tensor2(pose_feature, device),
        outfit: tensor2(outfit, device),
    }
}

/// Standard normal numbers, `[rows, columns]`, fixed by seed and stream.
pub fn normal(seed: u64, stream: u64, rows: usize, columns: usize) -> Array2<f32> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(stream);
    Array2::from_shape_simple_fn((rows, columns), || rng.sample(StandardNormal))
}

/// A run opened for evaluation and sampling.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/../cape-train/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use burn::tensor::Device;
/// use cape_core::Outfit;
/// use cape_infer::{AnimatedBody, Run, BodySpec};
///
/// let directory = trained()?;
/// let run = Run::open(&directory.path().join("run"), &Device::default())?;
/// let codes = run.sample_codes(2, 7);
/// let wearer = BodySpec { betas: vec![1.0, -0.5], pose: [0.0; 72], outfit: Outfit::LongLong };
/// let wearers = [wearer.clone(), wearer];
/// let clothes = run.decode_displacements(&codes, &wearers)?;
/// assert_eq!(clothes.dim(), (2, 6890, 3));
/// assert_eq!(run.dress(&codes, &wearers)?, run.pose_clothed(&clothes, &wearers)?);
/// assert_eq!(run.encode(&clothes, &wearers)?.dim(), codes.dim());
///
/// let first = codes.slice(ndarray::s![..1, ..]).to_owned();
/// let file = AnimatedBody::from_body("dressed", &first, &wearers[0]).encode(&run)?;
/// assert_eq!(&file[..4], b"glTF");
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct Run {
    paths: RunPaths,
    config: RunConfig,
    body: SmplModel,
    clothing: Vec<usize>,
    clothed: ClothedSmpl,
    statistics: DisplacementStatistics,
    checkpoint: PathBuf,
    progress: checkpoint::TrainState,
    generator: Generator,
    graphs: Graphs,
    device: Device,
}

impl Run {
    /// Opens the best checkpoint of a run, or the newest where none was validated.
    pub fn open(root: &Path, device: &Device) -> Result<Self> {
        let paths = RunPaths::new(root);
        let config = RunConfig::load(&paths.config())?;
        let checkpoint = checkpoint::best(&paths.checkpoints())?;
        let progress = checkpoint::load_progress(&checkpoint)?;
        let weights = checkpoint::load_weights(&checkpoint)?;
        let body = SmplModel::load(paths.body())?;
        let device = device.clone().inner();
        let graphs = build_graphs(&config, &body, &device)?;
        let model = Cape::new(&config.model, &graphs, 0, &device)?;
        let model = weights::apply(model, &weights).map_err(|error| {
            Error::format(&checkpoint, format!("does not suit {CONFIG}: {error}"))
        })?;
        let statistics = DisplacementStatistics::load(paths.statistics())?;
        statistics.expect_vertices(body.vertices())?;
        let mask = ClothingMask::load(paths.clothing(), body.vertices())?;
        Ok(Self {
            clothing: mask.indices().collect(),
            clothed: ClothedSmpl::new(Smpl::new(&body, &device)?).with_mask(&mask)?,
            generator: model.generator.valid(),
            paths,
            config,
            body,
            statistics,
            checkpoint,
            progress,
            graphs,
            device,
        })
    }

    /// Where things are.
    pub fn paths(&self) -> &RunPaths {
        &self.paths
    }

    /// The packed set it was trained on, where that was.
    ///
    /// # Errors
    /// If the run does not know, as an imported one, or the set is no longer there.
    pub fn data(&self) -> Result<PathBuf> {
        let path = self.paths.data();
        if !path.exists() {
            return Err(Error::argument(format!(
                "{}: does not say what it was trained on: name the packed set",
                self.paths.root().display()
            )));
        }
        let identity = read_identity(&path)?;
        let data = &identity.path;
        if data.exists() {
            return Ok(data.clone());
        }
        // Seen from a directory that the run is in, if it is the same set.
        let root = fs::canonicalize(self.paths.root()).unwrap_or_default();
        let same = |place: &PathBuf| {
            PackedSet::open(place, Split::Train).is_ok_and(|set| {
                (set.frames(), set.vertices()) == (identity.frames, identity.vertices)
            })
        };
        root.ancestors().map(|place| place.join(data)).find(same).ok_or_else(|| {
            Error::argument(format!(
                "{}: not there any more: name the packed set that {} was trained on",
                data.display(),
                self.paths.root().display()
            ))
        })
    }

    /// The run's configuration.
    pub fn config(&self) -> &RunConfig {
        &self.config
    }

    /// The body it was trained on.
    pub fn body(&self) -> &SmplModel {
        &self.body
    }

    /// Indices of the clothing vertices.
    pub fn clothing(&self) -> &[usize] {
        &self.clothing
    }

    /// The body with its clothing term on the device.
    pub fn clothed(&self) -> &ClothedSmpl {
        &self.clothed
    }

    /// Normalisation of displacements.
    pub fn statistics(&self) -> &DisplacementStatistics {
        &self.statistics
    }

    /// The checkpoint that was opened.
    pub fn checkpoint(&self) -> &Path {
        &self.checkpoint
    }

    /// Where the run was at that checkpoint.
    pub fn progress(&self) -> &checkpoint::TrainState {
        &self.progress
    }

    /// The networks.
    pub fn generator(&self) -> &Generator {
        &self.generator
    }

    /// The graphs they run on.
    pub fn graphs(&self) -> &Graphs {
        &self.graphs
    }

    /// The device they are on.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Codes from the standard normal prior, `[n, latent]`.
    pub fn sample_codes(&self, n: usize, seed: u64) -> Array2<f32> {
        normal(seed, 0, n, self.config.model.latent)
    }

    /// Decodes codes `[n, latent]` under poses `[n, 72]` (axis-angle, radians) and outfits to
    /// displacements in metres, `[n, vertices, 3]`, at all vertices.
    pub fn decode(
        &self,
        z: &Array2<f32>,
        poses: &[BodyPose],
        outfits: &[Outfit],
    ) -> Result<Array3<f32>> {
        let (n, latent) = z.dim();
        if latent != self.config.model.latent || poses.len() != n || outfits.len() != n {
            return Err(Error::argument(format!(
                "decode: codes [{n}, {latent}], {} poses and {} outfits; expected n codes of {}, n poses, n outfits",
                poses.len(),
                outfits.len(),
                self.config.model.latent
            )));
        }
        let vertices = self.body.vertices();
        let mut metres = Vec::with_capacity(n * vertices * 3);
        for start in (0..n).step_by(DECODE_BATCH) {
            let rows = start..(start + DECODE_BATCH).min(n);
            let code = z.slice(ndarray::s![rows.clone(), ..]).to_owned();
            let features = pose_features(&poses[rows.clone()])?;
            let labels = Array2::from_shape_fn((rows.len(), 4), |(row, outfit)| {
                outfits[rows.start + row].one_hot()[outfit]
            });
            let device = &self.device;
            let decoded = self.generator.decode(
                tensor2(code, device),
                tensor2(features, device),
                tensor2(labels, device),
                &self.graphs,
            );
            metres.extend(host(decoded));
        }
        self.statistics.denormalise(&mut metres);
        Array3::from_shape_vec((n, vertices, 3), metres)
            .map_err(|error| Error::argument(error.to_string()))
    }
}
