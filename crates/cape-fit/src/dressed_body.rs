//! Clothed bodies as differentiable functions of shape, pose and code.

use std::sync::Arc;

use burn::tensor::{Device, Tensor, TensorData};
use cape_core::{Outfit, Pose, SmplInput};
use cape_infer::{ClothedModel, Condition};
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
///     ClothedConfig, DressedBody, ImageObservation, Mask, PinholeCamera, PosePrior, Smplify,
///     SmplifyConfig, read_keypoints,
/// };
/// use cape_infer::Run;
///
/// let run = Run::open("runs/cape", &Device::default())?;
/// let dressed = DressedBody::new(&run, Outfit::LONG_LONG)?;
/// // The bare body behind keypoints, then the clothed one that fills the silhouette.
/// let mask = Mask::load("mask.png")?;
/// let camera = PinholeCamera::new(mask.width(), mask.height(), None)?;
/// let keypoints = read_keypoints("keypoints.json")?.choose(None)?;
/// let smplify = Smplify::new(run.body(), PosePrior::synthetic()?, SmplifyConfig::default())?;
/// let bare = smplify.fit(&camera, &keypoints, None)?;
/// let config = ClothedConfig::default();
/// let image = ImageObservation {
///     camera: &camera,
///     keypoints: &keypoints,
///     mask: Some(&mask),
///     occluders: None,
/// };
/// let fit = smplify.fit_clothed(&dressed, &image, &bare, &config)?;
/// // Its surface, and how that depends on pose, shape and code.
/// let surface = dressed.surface(&fit.parameters, &fit.code)?;
/// let gradient = surface.pull_back(&vec![glam::DVec3::Y; surface.vertices().len()])?;
/// assert_eq!(gradient.code.len(), dressed.latent());
/// // Another body in the mean clothing of the training set.
/// let clothes = dressed.mean_clothing();
/// dressed.surface_in(&clothes, &bare.parameters)?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct DressedBody {
    /// On a device with autodiff.
    model: Arc<ClothedModel>,
    /// `[1, outfits]`.
    label: Tensor<2>,
    outfit: Outfit,
}

/// Displacements that do not change with the body, metres, `[1, V, 3]`.
#[derive(Debug, Clone)]
pub struct FixedClothing(Tensor<3>);

/// Surface of a clothed body, with the parameters that it is differentiable in.
#[derive(Debug, Clone)]
pub struct DressedSurface {
    transl: Tensor<2>,
    pose: Tensor<2>,
    betas: Tensor<2>,
    code: Tensor<2>,
    output: Tensor<3>,
    vertices: Vec<DVec3>,
}

/// Gradient of a function of the vertices of a clothed body.
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
    /// Bodies of a trained model, on its device, in one outfit.
    ///
    /// # Errors
    /// If the model does not know the outfit, or cannot be uploaded to the device with autodiff.
    pub fn new(model: &ClothedModel, outfit: Outfit) -> Result<Self> {
        let model = Arc::new(model.to_autodiff()?);
        Ok(Self { label: model.outfit_labels([outfit])?, model, outfit })
    }

    /// The same bodies in another outfit; the model is shared.
    ///
    /// # Errors
    /// If the model does not know the outfit.
    pub fn with_outfit(&self, outfit: Outfit) -> Result<Self> {
        let label = self.model.outfit_labels([outfit])?;
        Ok(Self { model: self.model.clone(), label, outfit })
    }

    /// The bodies of one subject, given by its unclothed rest shape `[V, 3]`, metres: shape
    /// coefficients are then changes of that shape.
    ///
    /// # Errors
    /// As of [`new`](Self::new), or if the shape has another number of vertices.
    pub fn from_subject(
        model: &ClothedModel,
        outfit: Outfit,
        minimal: &Array2<f64>,
    ) -> Result<Self> {
        Self::new(&model.with_minimal_shape(minimal)?, outfit)
    }

    /// Length of a latent code.
    pub fn latent(&self) -> usize {
        self.model.latent()
    }

    /// Outfit, the paper's clothing type `c`.
    pub fn outfit(&self) -> Outfit {
        self.outfit
    }

    /// Triangles of the surface, `[F, 3]`.
    pub fn faces(&self) -> &[[u32; 3]] {
        &self.model.body().faces
    }

    /// Surface of the body clothed by `code`.
    ///
    /// # Errors
    /// If sizes do not suit the model.
    pub fn surface(&self, body: &BodyParameters, code: &[f64]) -> Result<DressedSurface> {
        self.expect_code(code)?;
        let code = self.leaf(code);
        self.dress(body, code, |code, rotations| self.decode(code, rotations))
    }

    /// Mean displacements of the training set, of all outfits.
    pub fn mean_clothing(&self) -> FixedClothing {
        FixedClothing(self.model.normaliser().mean())
    }

    /// Surface of the body with fixed displacements; the gradient by the code is zero.
    ///
    /// # Errors
    /// If sizes do not suit the model.
    pub fn surface_in(
        &self,
        clothes: &FixedClothing,
        body: &BodyParameters,
    ) -> Result<DressedSurface> {
        let code = self.leaf(&vec![0.0; self.latent()]);
        self.dress(body, code, |_, _| clothes.0.clone())
    }

    fn expect_code(&self, code: &[f64]) -> Result<()> {
        let latent = self.latent();
        if code.len() == latent {
            return Ok(());
        }
        Err(Error::argument(format!("a code of {} numbers, expected {latent}", code.len())))
    }

    fn leaf(&self, values: &[f64]) -> Tensor<2> {
        row(values, self.model.device()).require_grad()
    }

    /// Displacements, metres, `[1, V, 3]`, of a code under rotation matrices of the joints.
    fn decode(&self, code: Tensor<2>, rotations: Tensor<4>) -> Tensor<3> {
        let pose_feature = self.model.pose_feature(rotations);
        self.model.decode(code, &Condition { pose_feature, outfit: self.label.clone() })
    }

    fn dress(
        &self,
        body: &BodyParameters,
        code: Tensor<2>,
        clothing: impl FnOnce(Tensor<2>, Tensor<4>) -> Tensor<3>,
    ) -> Result<DressedSurface> {
        body.check()?;
        let (transl, pose) = (self.leaf(&body.transl), self.leaf(&body.pose));
        let betas = self.leaf(&body.betas);
        let rotations = self.model.smpl().body().rotations(Pose::AxisAngle(pose.clone()))?;
        let displacement = clothing(code.clone(), rotations.clone());
        let output = self.model.smpl().forward(SmplInput {
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
    /// Vertices, metres, `[V]`.
    pub fn vertices(&self) -> &[DVec3] {
        &self.vertices
    }

    /// Gradient of a function with the gradients `forces` by the vertices, `[V]`.
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
        // A leaf that the output does not depend on has no gradient.
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
