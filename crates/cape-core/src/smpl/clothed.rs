use burn::tensor::{Tensor, TensorData};

use super::{
    ClothingMask,
    body::{Smpl, SmplInput, SmplOutput},
};
use crate::{Error, Result};

/// Where a dressed body's joints come from.
///
/// See [`ClothedSmpl`] for an example.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum JointSource {
    /// `J(β)` of the body under the clothes (CAPE eq. 4).
    #[default]
    Body,
    /// Regressed from the clothed template, as the authors' release does by writing
    /// `minimal shape + displacement` into the template: joints move with the clothes by a few
    /// millimetres.
    ClothedTemplate,
}

/// A body with an additive clothing term: `T_clo = T(β, θ) + S_clo(z, θ, c)`, then posed
/// (CAPE eq. 3–4).
///
/// ```
/// use burn::tensor::{Device, Tensor};
/// use cape_core::{ClothedSmpl, ClothingMask, JointSource, Pose, Smpl, SmplInput};
/// use cape_synth::synthetic_body;
///
/// let (body, device) = (synthetic_body(), Device::default());
/// let dressed = ClothedSmpl::new(Smpl::new(&body, &device)?)
///     .with_joints(JointSource::Body)
///     .with_mask(&ClothingMask::from_weights(&body)?)?;
/// let input = |clothes| SmplInput {
///     betas: Tensor::zeros([1, 10], &device),
///     pose: Pose::AxisAngle(Tensor::zeros([1, 72], &device)),
///     transl: Tensor::zeros([1, 3], &device),
///     displacement: clothes,
/// };
/// let bare = dressed.forward(input(None))?;
/// let worn = dressed.forward(input(Some(Tensor::ones([1, 6890, 3], &device) * 0.01)))?;
/// // Clothes move no joints, and vertices by no more than they are thick.
/// let joints: f32 = (worn.joints - bare.joints).abs().max().into_scalar();
/// assert_eq!(joints, 0.0);
/// let vertices: f32 = (worn.vertices - bare.vertices).abs().max().into_scalar();
/// assert!((vertices - 0.01).abs() < 1e-5);
/// # Ok::<(), cape_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct ClothedSmpl {
    smpl: Smpl,
    joints: JointSource,
    /// 1 on clothing vertices and 0 elsewhere, `[1, V, 1]`.
    mask: Option<Tensor<3>>,
}

impl ClothedSmpl {
    /// Dresses `smpl`: joints from the body, displacements applied everywhere.
    pub fn new(smpl: Smpl) -> Self {
        Self { smpl, joints: JointSource::Body, mask: None }
    }

    /// Chooses where joints come from.
    #[must_use]
    pub fn with_joints(mut self, joints: JointSource) -> Self {
        self.joints = joints;
        self
    }

    /// Applies displacements on clothing vertices only.
    pub fn with_mask(mut self, mask: &ClothingMask) -> Result<Self> {
        let (covered, v) = (mask.covered(), self.smpl.vertices());
        if covered.len() != v {
            let found = covered.len();
            return Err(Error::Argument(format!("mask of {found} vertices, expected {v}")));
        }
        let values: Vec<f32> = covered.iter().map(|&covered| f32::from(covered)).collect();
        let values = TensorData::new(values, [1, v, 1]);
        self.mask = Some(self.smpl.convert(Tensor::from_data(values, &self.smpl.device())));
        Ok(self)
    }

    /// The body under the clothes.
    pub fn body(&self) -> &Smpl {
        &self.smpl
    }

    /// The posed, dressed body; bare where the input has no displacement.
    pub fn forward(&self, mut input: SmplInput) -> Result<SmplOutput> {
        let v = self.smpl.vertices();
        if let Some(displacement) = &input.displacement {
            let [n, ..] = input.betas.dims();
            let found = displacement.dims();
            if found != [n, v, 3] {
                let message = format!("displacement: shape {found:?}, expected {:?}", [n, v, 3]);
                return Err(Error::Argument(message));
            }
        }
        if let Some(mask) = &self.mask {
            input.displacement =
                input.displacement.map(|clothes| self.smpl.convert(clothes) * mask.clone());
        }
        let joints = match (self.joints, &input.displacement) {
            (JointSource::ClothedTemplate, Some(displacement)) => {
                // Regression is linear: the body's joints, moved by the clothes.
                let moved = self.smpl.regress_joints(displacement.clone())?;
                Some(self.smpl.rest_joints(input.betas.clone())? + moved)
            }
            _ => None,
        };
        self.smpl.forward_about(input, joints)
    }
}
