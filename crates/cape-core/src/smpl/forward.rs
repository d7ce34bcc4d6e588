//! Posing: in tensor operations, or in one pass where nobody asks for gradients.

use burn::tensor::{DType, Tensor, TensorData};

use super::{
    Pose, Smpl, SmplInput, SmplOutput,
    body::{check, failed, same_batch},
    cpu::{BodyBatch, CpuBody, JointRotations},
};
use crate::Result;

impl Smpl {
    /// The posed body, clothed where a displacement is given: `T_clo = T(β, θ) + S_clo`, with
    /// joints of the body (CAPE eq. 2–4).
    pub fn forward(&self, input: SmplInput) -> Result<SmplOutput> {
        self.forward_about(input, None)
    }

    /// [`forward`](Self::forward) about other rest joints than the body's, `[n, J, 3]`.
    pub(super) fn forward_about(
        &self,
        input: SmplInput,
        rest_joints: Option<Tensor<3>>,
    ) -> Result<SmplOutput> {
        let n = self.check_input(&input)?;
        if let Some(joints) = &rest_joints {
            check("rest joints", &joints.dims(), &[n, self.joints(), 3])?;
        }
        match &self.cpu {
            Some(body) if !tracked(&input, rest_joints.as_ref()) => {
                self.forward_fused(body, input, rest_joints)
            }
            _ => self.forward_composed(input, rest_joints),
        }
    }

    /// [`forward_about`](Self::forward_about) in tensor operations.
    pub(super) fn forward_composed(
        &self,
        input: SmplInput,
        rest_joints: Option<Tensor<3>>,
    ) -> Result<SmplOutput> {
        let SmplInput { betas, pose, transl, displacement } = input;
        let rest_joints = rest_joints.map_or_else(|| self.rest_joints(betas.clone()), Ok)?;
        let rotations = self.rotations(pose)?;
        let mut rest = self.rest_shape_planes(betas)? + self.pose_planes(rotations.clone());
        if let Some(displacement) = displacement {
            rest = rest + self.convert(displacement).swap_dims(1, 2);
        }
        self.skin(rest.swap_dims(1, 2), rest_joints, rotations, transl)
    }

    fn forward_fused(
        &self,
        body: &CpuBody,
        input: SmplInput,
        rest_joints: Option<Tensor<3>>,
    ) -> Result<SmplOutput> {
        let n = input.betas.dims()[0];
        let betas = match input.betas.dims() {
            [_, 0] => TensorData::new(Vec::<f32>::new(), [n, 0]),
            _ => self.read(input.betas)?,
        };
        let (pose, by_angle) = match input.pose {
            Pose::AxisAngle(angles) => (self.read(angles)?, true),
            Pose::Rotations(rotations) => (self.read(rotations)?, false),
        };
        let transl = self.read(input.transl)?;
        let displacement = input.displacement.map(|clothes| self.read(clothes)).transpose()?;
        let rest_joints = rest_joints.map(|joints| self.read(joints)).transpose()?;
        let pose = numbers(&pose)?;
        let (vertices, joints) = body.pose(BodyBatch {
            betas: numbers(&betas)?,
            turns: if by_angle {
                JointRotations::AxisAngles(pose)
            } else {
                JointRotations::Rotations(pose)
            },
            transl: numbers(&transl)?,
            displacement: displacement.as_ref().map(numbers).transpose()?,
            rest_joints: rest_joints.as_ref().map(numbers).transpose()?,
        });
        let device = &self.device();
        let tensor = |values: Vec<f32>, points| {
            Tensor::from_data(TensorData::new(values, [n, points, 3]), (device, DType::F32))
        };
        Ok(SmplOutput {
            vertices: tensor(vertices, self.vertices()),
            joints: tensor(joints, self.joints()),
        })
    }

    /// Size of the batch.
    fn check_input(&self, input: &SmplInput) -> Result<usize> {
        let [n, _] = self.check_betas(&input.betas)?;
        let found = match &input.pose {
            Pose::AxisAngle(angles) => {
                let found = angles.dims();
                check("pose", &found, &[found[0], 3 * self.joints()])?;
                found[0]
            }
            Pose::Rotations(rotations) => {
                let found = rotations.dims();
                check("pose rotations", &found, &[found[0], self.joints(), 3, 3])?;
                found[0]
            }
        };
        same_batch("pose", found, n)?;
        if let Some(displacement) = &input.displacement {
            same_batch("displacement", self.check_vertices("displacement", displacement)?, n)?;
        }
        check("transl", &input.transl.dims(), &[n, 3])?;
        Ok(n)
    }

    /// The numbers of `tensor` in the body's precision.
    fn read<const D: usize>(&self, tensor: Tensor<D>) -> Result<TensorData> {
        self.convert(tensor).try_into_data().map_err(|source| failed(&source))
    }
}

/// Whether any of a batch's tensors can take part in a gradient.
fn tracked(input: &SmplInput, rest_joints: Option<&Tensor<3>>) -> bool {
    let pose = match &input.pose {
        Pose::AxisAngle(angles) => angles.device(),
        Pose::Rotations(rotations) => rotations.device(),
    };
    let clothes = input.displacement.iter().chain(rest_joints).map(Tensor::device);
    [input.betas.device(), pose, input.transl.device()]
        .into_iter()
        .chain(clothes)
        .any(|device| device.is_autodiff())
}

fn numbers(data: &TensorData) -> Result<&[f32]> {
    data.as_slice().map_err(|source| failed(&source))
}
