//! CAPE's clothed body on a device: encode, decode, dress and pose.

use std::{ops::Range, path::Path, sync::Arc};

use burn::{
    module::Module,
    tensor::{Device, Int, Tensor, TensorData},
};
use cape_core::{
    ClothedSmpl, ClothingMask, Mesh, Outfit, OutfitVocabulary, Pose, Smpl, SmplInput, SmplModel,
    joints::{CLOTHING_JOINTS, JOINTS, POSE_FEATURE, pose_features},
    tensors::{from_array2, to_host},
};
use cape_data::{DisplacementStatistics, PackedSet, Split};
use cape_graph::MeshPyramid;
use cape_model::{Generator, Graphs, Posterior};
use ndarray::{Array2, Array3, s};

use crate::{
    BodySpec, Error, Normaliser, Result, RunConfig, batches, graphs::MeshGraphs, normal, to_device,
};

/// Conditions of the network (CAPE §4.1) on a device.
#[derive(Debug, Clone)]
pub struct Condition {
    /// Rotation matrices of the joints that move clothing, `[n, 126]`.
    pub pose_feature: Tensor<2>,
    /// One-hot outfit (the paper's clothing type), `[n, outfits]`.
    pub outfit: Tensor<2>,
}

/// CAPE's clothed body `M(β, θ, z, c)` (eq. 3–4): generator, mesh graphs, SMPL body, normalisation
/// and clothing mask on one device.
///
/// Methods on tensors ([`decode`](Self::decode), [`posterior`](Self::posterior)) are differentiable
/// on a device with autodiff ([`to_autodiff`](Self::to_autodiff)); methods on [`BodySpec`]s batch by
/// themselves and return arrays or meshes. A [`Run`](crate::Run) is one with its directory.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/../cape-train/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use burn::tensor::Device;
/// use cape_core::Outfit;
/// use cape_infer::{BodySpec, ClothedModel, Run};
///
/// let directory = trained()?;
/// let run = Run::open(&directory.path().join("run"), &Device::default())?;
/// let model: &ClothedModel = run.model();
/// let body = BodySpec { betas: vec![1.0, -0.5], pose: [0.0; 72], outfit: Outfit::LONG_LONG };
/// let bodies = [body.clone(), body];
///
/// // On arrays: codes to displacements, to meshes, and back to codes.
/// let codes = model.sample_codes(2, 7);
/// let displacement = model.decode_displacements(&codes, &bodies)?;
/// assert_eq!(displacement.dim(), (2, 6890, 3));
/// assert_eq!(model.dress(&codes, &bodies)?, model.pose_clothed(&displacement, &bodies)?);
/// assert_eq!(model.encode(&displacement, &bodies)?.dim(), codes.dim());
///
/// // On tensors, differentiable.
/// let model = model.to_autodiff()?;
/// let condition = model.condition(&bodies)?;
/// let code = burn::tensor::Tensor::<2>::zeros([2, model.latent()], model.device()).require_grad();
/// let gradients = model.decode(code.clone(), &condition).sum().backward();
/// assert_eq!(code.grad(&gradients).ok_or("no gradient")?.dims(), [2, model.latent()]);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct ClothedModel {
    config: RunConfig,
    generator: Generator,
    mesh_graphs: Arc<MeshGraphs>,
    graphs: Graphs,
    body: Arc<SmplModel>,
    smpl: ClothedSmpl,
    statistics: Arc<DisplacementStatistics>,
    normaliser: Normaliser,
    mask: ClothingMask,
    clothing: Vec<usize>,
    /// Joints of the pose feature, `[14]`.
    clothing_joints: Tensor<1, Int>,
    device: Device,
}

/// Parts of a [`ClothedModel`] on the host.
#[derive(Debug, Clone)]
pub struct ClothedModelParts {
    /// Configuration of the networks.
    pub config: RunConfig,
    /// The body that displacements are added to.
    pub body: SmplModel,
    /// Vertices that clothing may displace.
    pub mask: ClothingMask,
    /// Mean and standard deviation of displacements.
    pub statistics: DisplacementStatistics,
}

/// A clothed body on the host.
#[derive(Debug, Clone, PartialEq)]
pub struct ClothedBody {
    /// The posed surface, metres.
    pub mesh: Mesh,
    /// Displacements at all vertices in the rest pose, metres, `[V, 3]`; those at clothing vertices
    /// apply.
    pub displacement: Array2<f32>,
}

impl ClothedModel {
    /// A model of its parts and a `generator` on `device`.
    ///
    /// # Errors
    /// If body, mask and statistics have different numbers of vertices, or the configuration does
    /// not suit the mesh.
    pub fn new(parts: ClothedModelParts, generator: Generator, device: &Device) -> Result<Self> {
        let graphs = MeshGraphs::build(&parts.config, &parts.body)?;
        let uploaded = graphs.upload(device);
        Self::with_graphs(parts, generator, (Arc::new(graphs), uploaded), device)
    }

    pub(crate) fn with_graphs(
        parts: ClothedModelParts,
        generator: Generator,
        (mesh_graphs, graphs): (Arc<MeshGraphs>, Graphs),
        device: &Device,
    ) -> Result<Self> {
        let ClothedModelParts { config, body, mask, statistics } = parts;
        statistics.expect_vertices(body.vertices())?;
        let joints: Vec<i32> = CLOTHING_JOINTS.iter().map(|&joint| joint as i32).collect();
        let joints = TensorData::new(joints, [CLOTHING_JOINTS.len()]);
        Ok(Self {
            clothing_joints: Tensor::from_data(joints, device),
            generator,
            mesh_graphs,
            graphs,
            smpl: ClothedSmpl::new(Smpl::new(&body, device)?).with_mask(&mask)?,
            normaliser: Normaliser::new(&statistics, device),
            clothing: mask.indices().collect(),
            config,
            body: Arc::new(body),
            statistics: Arc::new(statistics),
            mask,
            device: device.clone(),
        })
    }

    /// The same model on the same device with autodiff; the weights get no gradients.
    ///
    /// # Errors
    /// If the body cannot be uploaded.
    pub fn to_autodiff(&self) -> Result<Self> {
        let parts = ClothedModelParts {
            config: self.config.clone(),
            body: (*self.body).clone(),
            mask: self.mask.clone(),
            statistics: (*self.statistics).clone(),
        };
        let generator = self.generator.clone().no_grad().train();
        let device = self.device.clone().autodiff();
        let graphs = (self.mesh_graphs.clone(), self.mesh_graphs.upload(&device));
        Self::with_graphs(parts, generator, graphs, &device)
    }

    /// The same model for one subject, given by the unclothed rest shape `[V, 3]`, metres: shape
    /// coefficients are then changes of that shape.
    ///
    /// # Errors
    /// If the shape has another number of vertices.
    pub fn with_minimal_shape(&self, minimal: &Array2<f64>) -> Result<Self> {
        let body = SmplModel { v_template: minimal.clone(), ..(*self.body).clone() };
        let smpl = ClothedSmpl::new(Smpl::new(&body, &self.device)?).with_mask(&self.mask)?;
        Ok(Self { smpl, body: Arc::new(body), ..self.clone() })
    }

    /// The configuration.
    pub fn config(&self) -> &RunConfig {
        &self.config
    }

    /// The unclothed body on the host.
    pub fn body(&self) -> &SmplModel {
        &self.body
    }

    /// The body with its clothing term on the device.
    pub fn smpl(&self) -> &ClothedSmpl {
        &self.smpl
    }

    /// Vertices that clothing may displace.
    pub fn mask(&self) -> &ClothingMask {
        &self.mask
    }

    /// Indices of the vertices that clothing may displace, ascending.
    pub fn clothing(&self) -> &[usize] {
        &self.clothing
    }

    /// Mean and standard deviation of the training displacements, on the host.
    pub fn statistics(&self) -> &DisplacementStatistics {
        &self.statistics
    }

    /// The same on the device.
    pub fn normaliser(&self) -> &Normaliser {
        &self.normaliser
    }

    /// Condition nets, encoder and decoder.
    pub fn generator(&self) -> &Generator {
        &self.generator
    }

    /// The mesh graphs that they run on.
    pub fn graphs(&self) -> &Graphs {
        &self.graphs
    }

    /// The generator's mesh pyramid on the host.
    pub fn pyramid(&self) -> &MeshPyramid {
        self.mesh_graphs.generator()
    }

    /// The device of all tensors.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Length of a latent code.
    pub fn latent(&self) -> usize {
        self.config.model.latent
    }

    /// Codes from the standard normal prior, `[n, latent]`.
    pub fn sample_codes(&self, n: usize, seed: u64) -> Array2<f32> {
        normal(seed, 0, n, self.latent())
    }

    /// Conditions of bodies: their poses and outfits.
    ///
    /// # Errors
    /// If a pose is not finite, or an outfit is not among [`outfits`](Self::outfits).
    pub fn condition(&self, bodies: &[BodySpec]) -> Result<Condition> {
        let poses: Vec<_> = bodies.iter().map(|body| body.pose).collect();
        Ok(Condition {
            pose_feature: from_array2(pose_features(&poses)?, &self.device),
            outfit: self.outfit_labels(bodies.iter().map(|body| body.outfit))?,
        })
    }

    /// Outfits that the model was trained on, in the order of its labels.
    pub fn outfits(&self) -> &OutfitVocabulary {
        &self.config.model.outfits
    }

    /// The outfit of a body when none is chosen: `longlong`, or the first of the model's outfits.
    pub fn default_outfit(&self) -> Outfit {
        let outfits = self.outfits();
        outfits.index(Outfit::LONG_LONG).map_or(outfits[0], |place| outfits[place])
    }

    /// One-hot labels of outfits, `[n, outfits]`.
    ///
    /// # Errors
    /// If an outfit is not among [`outfits`](Self::outfits); the message lists them.
    pub fn outfit_labels(&self, outfits: impl IntoIterator<Item = Outfit>) -> Result<Tensor<2>> {
        let mut labels = Vec::new();
        for outfit in outfits {
            labels.extend(self.outfits().one_hot(outfit)?);
        }
        let width = self.outfits().len();
        let shape = [labels.len() / width, width];
        Ok(Tensor::from_data(TensorData::new(labels, shape), &self.device))
    }

    /// A part of the packed set in `data`, with labels of the model's outfits.
    ///
    /// # Errors
    /// If the set cannot be read, has another number of vertices, or frames in other outfits.
    pub fn open_set(&self, data: impl AsRef<Path>, part: Split) -> Result<PackedSet> {
        let set = PackedSet::open(data, part)?;
        self.statistics.expect_vertices(set.vertices())?;
        Ok(set.with_vocabulary(self.outfits())?)
    }

    /// Pose features `[n, 126]` of rotation matrices `[n, 24, 3, 3]` of the joints.
    pub fn pose_feature(&self, rotations: Tensor<4>) -> Tensor<2> {
        let n = rotations.dims()[0];
        rotations.select(1, self.clothing_joints.clone()).reshape([n, POSE_FEATURE])
    }

    /// Displacements in metres, `[n, V, 3]`, of codes `[n, latent]`: `S_clo(z, θ, c)`.
    pub fn decode(&self, codes: Tensor<2>, condition: &Condition) -> Tensor<3> {
        let Condition { pose_feature, outfit } = condition.clone();
        let normalised = self.generator.decode(codes, pose_feature, outfit, &self.graphs);
        self.normaliser.denormalise(normalised)
    }

    /// Posterior `q(z | x)` of displacements in metres, `[n, V, 3]`.
    pub fn posterior(&self, displacement: Tensor<3>, condition: &Condition) -> Posterior {
        self.posterior_of_normalised(self.normaliser.normalise(displacement), condition)
    }

    fn posterior_of_normalised(&self, normalised: Tensor<3>, condition: &Condition) -> Posterior {
        let Condition { pose_feature, outfit } = condition.clone();
        let condition = self.generator.condition.forward(pose_feature, outfit);
        self.generator.encoder.forward(normalised, condition.as_ref(), &self.graphs.generator)
    }

    /// Clothed bodies of codes `[n, latent]`, one for each of `bodies`.
    ///
    /// # Errors
    /// If sizes disagree, or numbers are not finite.
    pub fn dress(&self, codes: &Array2<f32>, bodies: &[BodySpec]) -> Result<Vec<Mesh>> {
        self.expect_codes(codes, bodies)?;
        let mut meshes = Vec::with_capacity(bodies.len());
        for rows in batches(bodies.len()) {
            let displacement = self.decode_rows(codes, bodies, rows.clone())?;
            self.pose(Some(displacement), &bodies[rows], &mut meshes)?;
        }
        Ok(meshes)
    }

    /// Clothed bodies of codes `[n, latent]`, one for each of `bodies`, with their displacements.
    ///
    /// # Errors
    /// If sizes disagree, or numbers are not finite.
    pub fn dress_with_displacements(
        &self,
        codes: &Array2<f32>,
        bodies: &[BodySpec],
    ) -> Result<Vec<ClothedBody>> {
        self.expect_codes(codes, bodies)?;
        let (mut clothed, mut meshes) = (Vec::with_capacity(bodies.len()), Vec::new());
        for rows in batches(bodies.len()) {
            let displacement = self.decode_rows(codes, bodies, rows.clone())?;
            self.pose(Some(displacement.clone()), &bodies[rows], &mut meshes)?;
            let values = to_host(displacement);
            let rows = values.chunks_exact(3 * self.body.vertices());
            for (mesh, values) in meshes.drain(..).zip(rows) {
                let displacement =
                    Array2::from_shape_vec((self.body.vertices(), 3), values.to_vec())
                        .map_err(|error| Error::argument(error.to_string()))?;
                clothed.push(ClothedBody { mesh, displacement });
            }
        }
        Ok(clothed)
    }

    /// Displacements in metres, `[n, V, 3]`, of codes `[n, latent]` under the poses and outfits of
    /// `bodies`, at all vertices.
    ///
    /// # Errors
    /// If sizes disagree.
    pub fn decode_displacements(
        &self,
        codes: &Array2<f32>,
        bodies: &[BodySpec],
    ) -> Result<Array3<f32>> {
        self.expect_codes(codes, bodies)?;
        let (n, vertices) = (bodies.len(), self.body.vertices());
        let mut metres = Vec::with_capacity(n * vertices * 3);
        for rows in batches(n) {
            metres.extend(to_host(self.decode_rows(codes, bodies, rows)?));
        }
        Array3::from_shape_vec((n, vertices, 3), metres)
            .map_err(|error| Error::argument(error.to_string()))
    }

    /// Bodies with given displacements `[n, V, 3]` in metres, of which those at clothing vertices
    /// apply; joints follow the unclothed body.
    ///
    /// # Errors
    /// If sizes disagree, or numbers are not finite.
    pub fn pose_clothed(
        &self,
        displacement: &Array3<f32>,
        bodies: &[BodySpec],
    ) -> Result<Vec<Mesh>> {
        self.expect_displacements(displacement, bodies)?;
        let mut meshes = Vec::with_capacity(bodies.len());
        for rows in batches(bodies.len()) {
            let displacement = self.upload(displacement, rows.clone());
            self.pose(Some(displacement), &bodies[rows], &mut meshes)?;
        }
        Ok(meshes)
    }

    /// Bodies without clothing.
    ///
    /// # Errors
    /// If a body has too many shape coefficients, or numbers are not finite.
    pub fn pose_unclothed(&self, bodies: &[BodySpec]) -> Result<Vec<Mesh>> {
        let mut meshes = Vec::with_capacity(bodies.len());
        for rows in batches(bodies.len()) {
            self.pose(None, &bodies[rows], &mut meshes)?;
        }
        Ok(meshes)
    }

    /// Posterior means `[n, latent]` of displacements `[n, V, 3]` in metres under the poses and
    /// outfits of `bodies`.
    ///
    /// # Errors
    /// If sizes disagree, or numbers are not finite.
    pub fn encode(&self, displacement: &Array3<f32>, bodies: &[BodySpec]) -> Result<Array2<f32>> {
        self.expect_displacements(displacement, bodies)?;
        if displacement.iter().any(|x| !x.is_finite()) {
            return Err(Error::argument("displacements are not finite"));
        }
        let mut means = Vec::with_capacity(bodies.len() * self.latent());
        for rows in batches(bodies.len()) {
            let condition = self.condition(&bodies[rows.clone()])?;
            means.extend(to_host(self.posterior(self.upload(displacement, rows), &condition).mean));
        }
        self.code_rows(bodies.len(), means)
    }

    /// Checks that a set has the model's number of vertices and labels of its outfits, as that of
    /// [`open_set`](Self::open_set) has.
    ///
    /// # Errors
    /// If it has others.
    pub fn expect_set(&self, set: &PackedSet) -> Result<()> {
        self.statistics.expect_vertices(set.vertices())?;
        if set.vocabulary() == self.outfits() {
            return Ok(());
        }
        Err(Error::argument(format!(
            "labels of the outfits {}, but the model has {}: open the set with the model's outfits",
            set.vocabulary(),
            self.outfits()
        )))
    }

    /// Posterior means `[n, latent]` of `frames` of a packed set, see [`open_set`](Self::open_set).
    ///
    /// # Errors
    /// If the set has another number of vertices or other outfits, or a frame does not exist.
    pub fn encode_frames(&self, set: &PackedSet, frames: &[usize]) -> Result<Array2<f32>> {
        self.expect_set(set)?;
        if let Some(frame) = frames.iter().find(|&&frame| frame >= set.frames()) {
            return Err(Error::argument(format!(
                "frame {frame}: the set has {} frames, counted from 0",
                set.frames()
            )));
        }
        let mut means = Vec::with_capacity(frames.len() * self.latent());
        for rows in batches(frames.len()) {
            let batch = to_device(set.batch(&frames[rows], Some(&self.statistics))?, &self.device);
            let condition = Condition { pose_feature: batch.pose_feature, outfit: batch.outfit };
            let posterior = self.posterior_of_normalised(batch.displacement, &condition);
            means.extend(to_host(posterior.mean));
        }
        self.code_rows(frames.len(), means)
    }

    /// Displacements in metres, `[rows, V, 3]`, of some rows of codes `[n, latent]` and bodies.
    fn decode_rows(
        &self,
        codes: &Array2<f32>,
        bodies: &[BodySpec],
        rows: Range<usize>,
    ) -> Result<Tensor<3>> {
        let condition = self.condition(&bodies[rows.clone()])?;
        let codes = from_array2(codes.slice(s![rows, ..]).to_owned(), &self.device);
        Ok(self.decode(codes, &condition))
    }

    /// Appends the meshes of `bodies`, at most a batch, with displacements `[n, V, 3]` in metres.
    fn pose(
        &self,
        displacement: Option<Tensor<3>>,
        bodies: &[BodySpec],
        meshes: &mut Vec<Mesh>,
    ) -> Result<()> {
        let (n, most) = (bodies.len(), self.body.betas());
        let mut betas = Vec::with_capacity(n * most);
        for body in bodies {
            let given = &body.betas;
            if given.len() > most || given.iter().any(|beta| !beta.is_finite()) {
                return Err(Error::argument(format!(
                    "betas: {} numbers, expected at most {most}, all finite",
                    given.len()
                )));
            }
            betas.extend(given.iter().copied().chain(std::iter::repeat(0.0)).take(most));
        }
        let rows = |values: Vec<f32>, width: usize| {
            Tensor::<2>::from_data(TensorData::new(values, [n, width]), &self.device)
        };
        let poses: Vec<f32> = bodies.iter().flat_map(|body| body.pose).collect();
        let output = self.smpl.forward(SmplInput {
            betas: rows(betas, most),
            pose: Pose::AxisAngle(rows(poses, 3 * JOINTS)),
            transl: rows(vec![0.0; 3 * n], 3),
            displacement,
        })?;
        let values = to_host(output.vertices);
        if values.iter().any(|x| !x.is_finite()) {
            return Err(Error::argument("posed vertices are not finite"));
        }
        let vertices = values.as_chunks::<3>().0.chunks_exact(self.body.vertices());
        meshes.extend(
            vertices.map(|v| Mesh { vertices: v.to_vec(), faces: self.body.faces.clone() }),
        );
        Ok(())
    }

    fn upload(&self, displacement: &Array3<f32>, rows: Range<usize>) -> Tensor<3> {
        let shape = [rows.len(), self.body.vertices(), 3];
        let values: Vec<f32> = displacement.slice(s![rows, .., ..]).iter().copied().collect();
        Tensor::from_data(TensorData::new(values, shape), &self.device)
    }

    fn code_rows(&self, n: usize, values: Vec<f32>) -> Result<Array2<f32>> {
        Array2::from_shape_vec((n, self.latent()), values)
            .map_err(|error| Error::argument(error.to_string()))
    }

    fn expect_codes(&self, codes: &Array2<f32>, bodies: &[BodySpec]) -> Result<()> {
        let expected = (bodies.len(), self.latent());
        if codes.dim() == expected {
            return Ok(());
        }
        Err(Error::argument(format!(
            "codes {:?}, expected {expected:?}: one of {} numbers for each body",
            codes.dim(),
            self.latent()
        )))
    }

    fn expect_displacements(&self, found: &Array3<f32>, bodies: &[BodySpec]) -> Result<()> {
        let expected = (bodies.len(), self.body.vertices(), 3);
        if found.dim() == expected {
            return Ok(());
        }
        Err(Error::argument(format!("displacements {:?}, expected {expected:?}", found.dim())))
    }
}
