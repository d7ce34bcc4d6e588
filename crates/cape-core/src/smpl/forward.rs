//! Forward pass: composed tensor operations, or one fused pass on the CPU without gradients.

use burn::tensor::{DType, Tensor, TensorData};

use super::{
    Pose, Smpl, SmplGradient, SmplInput, SmplOutput,
    body::{check, failed, same_batch},
    cpu::{BodyBatch, CpuBody, JointRotations},
};
use crate::{Error, Result};

impl Smpl {
    /// Posed body, clothed if a displacement is given, `T_clo = T(β, θ) + S_clo`, with the joints of
    /// the unclothed body (CAPE eq. 2–4).
    pub fn forward(&self, input: SmplInput) -> Result<SmplOutput> {
        self.forward_with_joints(input, None)
    }

    /// [`forward`](Self::forward) with given rest joints, metres, `[n, J, 3]`.
    pub(super) fn forward_with_joints(
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

    /// [`forward_with_joints`](Self::forward_with_joints) in tensor operations.
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
        let (pose, axis_angle) = match input.pose {
            Pose::AxisAngle(angles) => (self.read(angles)?, true),
            Pose::Rotations(rotations) => (self.read(rotations)?, false),
        };
        let transl = self.read(input.transl)?;
        let displacement =
            input.displacement.map(|displacement| self.read(displacement)).transpose()?;
        let rest_joints = rest_joints.map(|joints| self.read(joints)).transpose()?;
        let pose = numbers(&pose)?;
        let (vertices, joints) = body.pose(BodyBatch {
            betas: numbers(&betas)?,
            rotations: if axis_angle {
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

    /// Gradients with respect to the parameters of bodies, from those with respect to their vertices
    /// and joints (`gradient`): the product with the transposed Jacobian of
    /// [`forward`](Self::forward), in one fused pass.
    ///
    /// # Errors
    /// If shapes disagree, the pose is not in axis-angle, or the body is not on the CPU in `f32` without
    /// autodiff: gradients are then those of autodiff.
    pub fn pull_back(&self, input: SmplInput, gradient: SmplOutput) -> Result<SmplGradient> {
        let n = self.check_input(&input)?;
        let (vertices, joints) = (gradient.vertices, gradient.joints);
        check("gradient of vertices", &vertices.dims(), &[n, self.vertices(), 3])?;
        check("gradient of joints", &joints.dims(), &[n, self.joints(), 3])?;
        let (Some(body), false) = (&self.cpu, tracked(&input, Some(&joints))) else {
            let message = "gradients: expected a body on the CPU in f32 without autodiff";
            return Err(Error::Argument(message.to_owned()));
        };
        let Pose::AxisAngle(angles) = input.pose else {
            return Err(Error::Argument("gradients: expected a pose in axis-angle".to_owned()));
        };
        let coefficients = input.betas.dims()[1];
        let betas = match coefficients {
            0 => TensorData::new(Vec::<f32>::new(), [n, 0]),
            _ => self.read(input.betas)?,
        };
        let (angles, transl) = (self.read(angles)?, self.read(input.transl)?);
        let displacement =
            input.displacement.map(|displacement| self.read(displacement)).transpose()?;
        let (vertices, joints) = (self.read(vertices)?, self.read(joints)?);
        let batch = BodyBatch {
            betas: numbers(&betas)?,
            rotations: JointRotations::AxisAngles(numbers(&angles)?),
            transl: numbers(&transl)?,
            displacement: displacement.as_ref().map(numbers).transpose()?,
            rest_joints: None,
        };
        let found =
            body.pull_back(batch, numbers(&angles)?, numbers(&vertices)?, numbers(&joints)?);
        let device = &self.device();
        let matrix = |values: Vec<f32>, width| {
            Tensor::from_data(TensorData::new(values, [n, width]), (device, DType::F32))
        };
        let shape = [n, self.vertices(), 3];
        Ok(SmplGradient {
            betas: matrix(found.betas, coefficients),
            pose: matrix(found.pose, 3 * self.joints()),
            transl: matrix(found.transl, 3),
            displacement: found.displacement.map(|values| {
                Tensor::from_data(TensorData::new(values, shape), (device, DType::F32))
            }),
        })
    }

    /// Checks all shapes and returns the batch size.
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

    /// Values of `tensor` in the precision of the body.
    fn read<const D: usize>(&self, tensor: Tensor<D>) -> Result<TensorData> {
        self.convert(tensor).try_into_data().map_err(|source| failed(&source))
    }
}

/// True if any of the tensors is on an autodiff device.
fn tracked(input: &SmplInput, rest_joints: Option<&Tensor<3>>) -> bool {
    let pose = match &input.pose {
        Pose::AxisAngle(angles) => angles.device(),
        Pose::Rotations(rotations) => rotations.device(),
    };
    let optional = input.displacement.iter().chain(rest_joints).map(Tensor::device);
    [input.betas.device(), pose, input.transl.device()]
        .into_iter()
        .chain(optional)
        .any(|device| device.is_autodiff())
}

fn numbers(data: &TensorData) -> Result<&[f32]> {
    data.as_slice().map_err(|source| failed(&source))
}
