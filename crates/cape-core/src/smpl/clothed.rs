use burn::tensor::{Tensor, TensorData};

use super::{
    ClothingMask,
    body::{Smpl, SmplInput, SmplOutput},
};
use crate::{Error, Result};

/// Rest joints of a clothed body.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum JointSource {
    /// `J(β)` of the unclothed body (CAPE eq. 4).
    #[default]
    Body,
    /// Joints regressed from the clothed template, as in the authors' release, which stores
    /// `minimal shape + displacement` as the template: clothing moves the joints by a few millimetres.
    ClothedTemplate,
}

/// SMPL body with an additive clothing term, `T_clo = T(β, θ) + S_clo(z, θ, c)`, posed by linear
/// blend skinning (CAPE eq. 3–4).
///
/// ```
/// use burn::tensor::{Device, Tensor};
/// use cape_core::{ClothedSmpl, ClothingMask, JointSource, Pose, Smpl, SmplInput};
/// use cape_synth::synthetic_body;
///
/// let (body, device) = (synthetic_body(), Device::default());
/// let clothed = ClothedSmpl::new(Smpl::new(&body, &device)?)
///     .with_joints(JointSource::Body)
///     .with_mask(&ClothingMask::from_weights(&body)?)?;
/// let input = |displacement| SmplInput {
///     betas: Tensor::zeros([1, 10], &device),
///     pose: Pose::AxisAngle(Tensor::zeros([1, 72], &device)),
///     transl: Tensor::zeros([1, 3], &device),
///     displacement,
/// };
/// let bare = clothed.forward(input(None))?;
/// let covered = clothed.forward(input(Some(Tensor::ones([1, 6890, 3], &device) * 0.01)))?;
/// // The displacement moves vertices by its length, and no joints.
/// let joints: f32 = (covered.joints - bare.joints).abs().max().into_scalar();
/// assert_eq!(joints, 0.0);
/// let vertices: f32 = (covered.vertices - bare.vertices).abs().max().into_scalar();
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
    /// Creates the clothed body: joints of the unclothed body, displacements of all vertices.
    pub fn new(smpl: Smpl) -> Self {
        Self { smpl, joints: JointSource::Body, mask: None }
    }

    /// Selects the rest joints.
    #[must_use]
    pub fn with_joints(mut self, joints: JointSource) -> Self {
        self.joints = joints;
        self
    }

    /// Restricts displacements to clothing vertices.
    pub fn with_mask(mut self, mask: &ClothingMask) -> Result<Self> {
        let (covered, v) = (mask.covered(), self.smpl.vertices());
        if covered.len() != v {
            let found = covered.len();
            return Err(Error::Argument(format!(
                "clothing mask of {found} vertices, expected {v}"
            )));
        }
        let values: Vec<f32> = covered.iter().map(|&covered| f32::from(covered)).collect();
        let values = TensorData::new(values, [1, v, 1]);
        self.mask = Some(self.smpl.convert(Tensor::from_data(values, &self.smpl.device())));
        Ok(self)
    }

    /// The unclothed body.
    pub fn body(&self) -> &Smpl {
        &self.smpl
    }

    /// Posed body, clothed if the input has a displacement.
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
            input.displacement = input
                .displacement
                .map(|displacement| self.smpl.convert(displacement) * mask.clone());
        }
        let joints = match (self.joints, &input.displacement) {
            (JointSource::ClothedTemplate, Some(displacement)) => {
                // The regressor is linear: joints of the body plus those of the displacement.
                let moved = self.smpl.regress_joints(displacement.clone())?;
                Some(self.smpl.rest_joints(input.betas.clone())? + moved)
            }
            _ => None,
        };
        self.smpl.forward_with_joints(input, joints)
    }
}
