//! Clothed bodies as differentiable functions of shape, pose and code.

use burn::{
    module::Module,
    tensor::{Device, Int, Tensor, TensorData},
};
use cape_core::{
    ClothedSmpl, ClothingMask, Outfit, Pose, Smpl, SmplInput, SmplModel,
    joints::{CLOTHING_JOINTS, POSE_FEATURE},
};
use cape_data::DisplacementStatistics;
use cape_infer::{Run, RunConfig, build_graphs};
use cape_model::{Generator, Graphs};
use glam::DVec3;
use ndarray::Array2;

use crate::{BodyParameters, Error, Result};

/// A trained model's clothed bodies in one outfit: `M(β, θ, c, z)` (CAPE eq. 3–4), differentiable
/// in shape, pose, translation and code, also through the pose that the clothes are made for.
///
/// ```no_run
/// use burn::tensor::Device;
/// use cape_core::Outfit;
/// use cape_fit::{
///     PinholeCamera, ClothedConfig, DressedBody, Mask, PosePrior, Smplify, SmplifyConfig, read_keypoints,
/// };
/// use cape_infer::Run;
///
/// let run = Run::open("runs/cape".as_ref(), &Device::default())?;
/// let dressed = DressedBody::new(&run, Outfit::LongLong)?;
/// // The bare body behind keypoints, then the clothed one that fills the silhouette.
/// let mask = Mask::load("mask.png")?;
/// let camera = PinholeCamera::new(mask.width(), mask.height(), None)?;
/// let keypoints = read_keypoints("keypoints.json")?.choose(None)?;
/// let smplify = Smplify::new(run.body(), PosePrior::synthetic()?, SmplifyConfig::default())?;
/// let bare = smplify.fit(&camera, &keypoints, None)?;
/// let config = ClothedConfig::default();
/// let fit = smplify.fit_clothed(&dressed, &camera, &keypoints, &mask, &bare, &config)?;
/// // Its surface, and how that depends on pose, shape and code.
/// let surface = dressed.surface(&fit.parameters, &fit.code)?;
/// let gradient = surface.pull_back(&vec![glam::DVec3::Y; surface.vertices().len()])?;
/// assert_eq!(gradient.code.len(), dressed.latent());
/// // Other bodies in the same clothes.
/// let clothes = dressed.fixed_clothing(&fit.parameters, &fit.code)?;
/// dressed.surface_in(&clothes, &bare.parameters)?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct DressedBody {
    generator: Generator,
    graphs: Graphs,
    smpl: ClothedSmpl,
    /// Of displacements, metres, `[1, V, 3]`.
    mean: Tensor<3>,
    deviation: Tensor<3>,
    /// `[1, 4]`.
    label: Tensor<2>,
    clothing_joints: Tensor<1, Int>,
    faces: Vec<[u32; 3]>,
    outfit: Outfit,
    latent: usize,
    device: Device,
}

/// What a trained model's clothed bodies are made of.
#[derive(Debug, Clone, Copy)]
pub(crate) struct DressedBodyParts<'a> {
    pub(crate) generator: &'a Generator,
    pub(crate) config: &'a RunConfig,
    pub(crate) body: &'a SmplModel,
    pub(crate) clothing: &'a [usize],
    pub(crate) statistics: &'a DisplacementStatistics,
}

/// Clothes that do not change with the body: displacements, metres, `[1, V, 3]`.
///
/// See [`DressedBody`] for an example.
#[derive(Debug, Clone)]
pub struct FixedClothing(Tensor<3>);

/// A clothed body, and what it was made from.
///
/// See [`DressedBody`] for an example.
#[derive(Debug, Clone)]
pub struct DressedSurface {
    transl: Tensor<2>,
    pose: Tensor<2>,
    betas: Tensor<2>,
    code: Tensor<2>,
    output: Tensor<3>,
    vertices: Vec<DVec3>,
}

/// The gradient of a function of a clothed body.
///
/// See [`DressedBody`] for an example.
#[derive(Debug, Clone, PartialEq)]
pub struct DressedGradient {
    /// By translation, `[3]`.
    pub transl: Vec<f64>,
    /// By pose, `[72]`.
    pub pose: Vec<f64>,
    /// By shape, as many as were given.
    pub betas: Vec<f64>,
    /// By code, `[latent]`.
    pub code: Vec<f64>,
}

impl DressedBody {
    /// The bodies of a run, on its device, wearing `outfit`.
    ///
    /// # Errors
    /// If the run's files do not suit one another.
    pub fn new(run: &Run, outfit: Outfit) -> Result<Self> {
        let parts = DressedBodyParts {
            generator: run.generator(),
            config: run.config(),
            body: run.body(),
            clothing: run.clothing(),
            statistics: run.statistics(),
        };
        Self::from_parts(&parts, outfit, run.device())
    }

    /// The bodies of one subject, given by its unclothed rest shape `[V, 3]`, metres: shape
    /// coefficients are then changes of that.
    ///
    /// # Errors
    /// As of [`new`](Self::new), or if the shape has another number of vertices.
    pub fn from_subject(run: &Run, outfit: Outfit, minimal: &Array2<f64>) -> Result<Self> {
        let body = SmplModel { v_template: minimal.clone(), ..run.body().clone() };
        let smpl = Smpl::new(&body, &run.device().clone().autodiff())?;
        let mut dressed = Self::new(run, outfit)?;
        let mask = ClothingMask::from_indices(body.vertices(), run.clothing())?;
        dressed.smpl = ClothedSmpl::new(smpl).with_mask(&mask)?;
        Ok(dressed)
    }

    pub(crate) fn from_parts(
        parts: &DressedBodyParts<'_>,
        outfit: Outfit,
        device: &Device,
    ) -> Result<Self> {
        let DressedBodyParts { generator, config, body, clothing, statistics } = *parts;
        let device = device.clone().autodiff();
        let mask = ClothingMask::from_indices(body.vertices(), clothing)?;
        let rows = |array: &Array2<f64>| {
            let values: Vec<f32> = array.iter().map(|&x| x as f32).collect();
            Tensor::from_data(TensorData::new(values, [1, body.vertices(), 3]), &device)
        };
        let joints: Vec<i32> = CLOTHING_JOINTS.iter().map(|&joint| joint as i32).collect();
        let count = joints.len();
        Ok(Self {
            generator: generator.clone().no_grad().train(),
            graphs: build_graphs(config, body, &device)?,
            smpl: ClothedSmpl::new(Smpl::new(body, &device)?).with_mask(&mask)?,
            mean: rows(statistics.mean()),
            deviation: rows(statistics.std()),
            label: row(&outfit.one_hot().map(f64::from), &device),
            clothing_joints: Tensor::from_data(TensorData::new(joints, [count]), &device),
            faces: body.faces.clone(),
            outfit,
            latent: config.model.latent,
            device,
        })
    }

    /// Numbers of a code.
    pub fn latent(&self) -> usize {
        self.latent
    }

    /// What is worn.
    pub fn outfit(&self) -> Outfit {
        self.outfit
    }

    /// Triangles of the surface.
    pub fn faces(&self) -> &[[u32; 3]] {
        &self.faces
    }

    /// The body in the clothes that `code` stands for.
    ///
    /// # Errors
    /// If sizes do not suit the model.
    pub fn surface(&self, body: &BodyParameters, code: &[f64]) -> Result<DressedSurface> {
        self.expect_code(code)?;
        let code = self.leaf(code);
        self.dress(body, code, |code, feature| self.decode(code, feature))
    }

    /// The clothes that `code` stands for in a body's pose, to be kept whatever the pose.
    ///
    /// # Errors
    /// If sizes do not suit the model.
    pub fn fixed_clothing(&self, body: &BodyParameters, code: &[f64]) -> Result<FixedClothing> {
        body.check()?;
        self.expect_code(code)?;
        let rotations = self.smpl.body().rotations(Pose::AxisAngle(self.leaf(&body.pose)))?;
        let decoded = self.decode(self.leaf(code), self.feature(rotations));
        Ok(FixedClothing(decoded.detach()))
    }

    /// The clothes that people of the training set wear on average, whatever the outfit.
    pub fn mean_clothing(&self) -> FixedClothing {
        FixedClothing(self.mean.clone())
    }

    /// The body in clothes that stay as they are; there is no gradient by a code.
    ///
    /// # Errors
    /// If sizes do not suit the model.
    pub fn surface_in(
        &self,
        clothes: &FixedClothing,
        body: &BodyParameters,
    ) -> Result<DressedSurface> {
        let code = self.leaf(&vec![0.0; self.latent]);
        self.dress(body, code, |_, _| clothes.0.clone())
    }

    fn expect_code(&self, code: &[f64]) -> Result<()> {
        if code.len() == self.latent {
            return Ok(());
        }
        Err(Error::argument(format!("a code of {} numbers, expected {}", code.len(), self.latent)))
    }

    fn leaf(&self, values: &[f64]) -> Tensor<2> {
        row(values, &self.device).require_grad()
    }

    /// What the clothes see of the joints' rotations.
    fn feature(&self, rotations: Tensor<4>) -> Tensor<2> {
        rotations.select(1, self.clothing_joints.clone()).reshape([1, POSE_FEATURE])
    }

    /// Displacements, metres, `[1, V, 3]`.
    fn decode(&self, code: Tensor<2>, feature: Tensor<2>) -> Tensor<3> {
        let decoded = self.generator.decode(code, feature, self.label.clone(), &self.graphs);
        decoded * self.deviation.clone() + self.mean.clone()
    }

    fn dress(
        &self,
        body: &BodyParameters,
        code: Tensor<2>,
        clothes: impl FnOnce(Tensor<2>, Tensor<2>) -> Tensor<3>,
    ) -> Result<DressedSurface> {
        body.check()?;
        let (transl, pose) = (self.leaf(&body.transl), self.leaf(&body.pose));
        let betas = self.leaf(&body.betas);
        let rotations = self.smpl.body().rotations(Pose::AxisAngle(pose.clone()))?;
        let displacement = clothes(code.clone(), self.feature(rotations.clone()));
        let output = self.smpl.forward(SmplInput {
            betas: betas.clone(),
            pose: Pose::Rotations(rotations),
            transl: transl.clone(),
            displacement: Some(displacement),
        })?;
        let values = host(output.vertices.clone().inner().reshape([1, -1]));
        let vertices = values.as_chunks::<3>().0.iter().map(|&v| DVec3::from_array(v)).collect();
        Ok(DressedSurface { transl, pose, betas, code, output: output.vertices, vertices })
    }
}

impl DressedSurface {
    /// Metres, `[V]`.
    pub fn vertices(&self) -> &[DVec3] {
        &self.vertices
    }

    /// The gradient of what has the gradients `forces` by the vertices, `[V]`.
    ///
    /// # Errors
    /// If there are more or fewer forces than vertices.
    pub fn pull_back(&self, forces: &[DVec3]) -> Result<DressedGradient> {
        if forces.len() != self.vertices.len() {
            return Err(Error::argument(format!(
                "{} forces on {} vertices",
                forces.len(),
                self.vertices.len()
            )));
        }
        let values: Vec<f32> = forces.iter().flat_map(DVec3::to_array).map(|x| x as f32).collect();
        let forces = TensorData::new(values, [1, forces.len(), 3]);
        let forces = Tensor::<3>::from_data(forces, &self.output.device());
        let gradients = (self.output.clone() * forces).sum().backward();
        // What nothing depends on has no gradient.
        let by = |leaf: &Tensor<2>| match leaf.grad(&gradients) {
            Some(gradient) => host(gradient),
            None => vec![0.0; leaf.dims()[1]],
        };
        Ok(DressedGradient {
            transl: by(&self.transl),
            pose: by(&self.pose),
            betas: by(&self.betas),
            code: by(&self.code),
        })
    }
}

fn row(values: &[f64], device: &Device) -> Tensor<2> {
    let values: Vec<f32> = values.iter().map(|&x| x as f32).collect();
    let count = values.len();
    Tensor::from_data(TensorData::new(values, [1, count]), device)
}

fn host(tensor: Tensor<2>) -> Vec<f64> {
    let data = tensor.into_data().convert::<f64>();
    data.try_into_vec().unwrap_or_else(|_| unreachable!("converted to f64"))
}
