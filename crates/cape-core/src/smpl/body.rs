//! The body as differentiable tensor operations.
//!
//! Vertices are stored as planes `[n, 3, V]` internally: blend shapes and skinning are then one
//! matrix product each, and per-vertex operations run over contiguous memory.

use std::sync::Arc;

use burn::tensor::{DType, Device, FloatDType, Int, Tensor, TensorData};
use ndarray::{Array2, Axis};

use super::{
    SmplModel,
    cpu::CpuBody,
    host::{SINGULAR, singular},
    rodrigues::{identity, rodrigues},
};
use crate::{Error, Result, devices};

/// Joint rotations θ relative to the parents.
#[derive(Debug, Clone)]
pub enum Pose {
    /// Axis-angle vectors, radians, `[n, 3·J]`.
    AxisAngle(Tensor<2>),
    /// Rotation matrices, `[n, J, 3, 3]`.
    Rotations(Tensor<4>),
}

/// Parameters of a batch of `n` bodies.
#[derive(Debug, Clone)]
pub struct SmplInput {
    /// Shape coefficients β, `[n, b]`; missing ones are zero.
    pub betas: Tensor<2>,
    /// Joint rotations θ.
    pub pose: Pose,
    /// Translation, metres, `[n, 3]`.
    pub transl: Tensor<2>,
    /// Clothing displacement `S_clo` in canonical space, metres, `[n, V, 3]`.
    pub displacement: Option<Tensor<3>>,
}

/// Batch of `n` posed bodies.
#[derive(Debug, Clone)]
pub struct SmplOutput {
    /// Vertices, metres, `[n, V, 3]`.
    pub vertices: Tensor<3>,
    /// Joints, metres, `[n, J, 3]`.
    pub joints: Tensor<3>,
}

/// Gradients with respect to the parameters of a batch of `n` bodies.
#[derive(Debug, Clone)]
pub struct SmplGradient {
    /// Gradient with respect to the shape coefficients, `[n, b]`.
    pub betas: Tensor<2>,
    /// Gradient with respect to the axis-angles, per radian, `[n, 3·J]`.
    pub pose: Tensor<2>,
    /// Gradient with respect to the translation, per metre, `[n, 3]`.
    pub transl: Tensor<2>,
    /// Gradient with respect to the displacement, per metre, `[n, V, 3]`; `None` where the input has
    /// none.
    pub displacement: Option<Tensor<3>>,
}

/// Joints of one depth of the kinematic tree.
#[derive(Debug, Clone)]
struct JointLevel {
    joints: Tensor<1, Int>,
    /// Index of each joint's parent among the joints of the previous depth.
    parents: Tensor<1, Int>,
}

/// SMPL body on a device (CAPE eq. 1–2), differentiable in all its inputs.
///
/// Inputs must be on the device of the body, with autodiff if it has it, and are converted to its
/// precision. On the CPU in `f32` without autodiff, [`forward`](Self::forward) is one fused pass
/// instead of a series of tensor operations.
///
/// ```
/// use burn::tensor::{Device, Tensor};
/// use cape_core::smpl::{Pose, Smpl, SmplInput};
/// use cape_synth::synthetic_body;
///
/// let device = Device::default();
/// let smpl = Smpl::new(&synthetic_body(), &device)?;
/// let bodies = smpl.forward(SmplInput {
///     betas: Tensor::zeros([2, 10], &device),
///     pose: Pose::AxisAngle(Tensor::zeros([2, 72], &device)),
///     transl: Tensor::from_floats([[0., 0., 0.], [0., 0., 3.]], &device),
///     displacement: None,
/// })?;
/// assert_eq!(bodies.vertices.dims(), [2, 6890, 3]);
/// assert_eq!(bodies.joints.dims(), [2, 24, 3]);
/// // The second body is translated by 3 m.
/// let moved = bodies.joints.clone().slice([1..2]) - bodies.joints.slice([0..1]);
/// let z: f32 = moved.slice([0..1, 0..24, 2..3]).mean().into_scalar();
/// assert!((z - 3.0).abs() < 1e-5);
/// # Ok::<(), cape_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Smpl {
    vertices: usize,
    joints: usize,
    /// Template `T̄`, planes, `[1, 3·V]`.
    template: Tensor<2>,
    /// Shape directions, planes, `[B, 3·V]`.
    shape_directions: Tensor<2>,
    /// Pose directions, planes, `[9·(J − 1), 3·V]`.
    pose_directions: Tensor<2>,
    /// Joints of the template, `[1, 3·J]`, and their shape directions, `[B, 3·J]`.
    template_joints: Tensor<2>,
    joint_directions: Tensor<2>,
    /// Transposed regressor, `[V, J]`.
    regressor: Tensor<2>,
    /// Transposed blend weights, `[J, V]`.
    weights: Tensor<2>,
    /// Depths of the kinematic tree below the root.
    depths: Vec<JointLevel>,
    /// Parent of each joint (the root its own), and index of each joint in the order of depths.
    parents: Tensor<1, Int>,
    order: Tensor<1, Int>,
    /// Fused forward pass on the CPU.
    pub(super) cpu: Option<Arc<CpuBody>>,
}

impl Smpl {
    /// Uploads a body in `f32`.
    ///
    /// # Errors
    /// If [`SmplModel::validate`] fails.
    pub fn new(model: &SmplModel, device: &Device) -> Result<Self> {
        Self::with_precision(model, device, FloatDType::F32)
    }

    /// Uploads a body in `precision`. In `F64`, unposing is accurate for nearly singular blended
    /// transforms too.
    ///
    /// # Errors
    /// If [`SmplModel::validate`] fails or the device does not support the precision.
    pub fn with_precision(
        model: &SmplModel,
        device: &Device,
        precision: FloatDType,
    ) -> Result<Self> {
        model.validate()?;
        let dtype = DType::from(precision);
        if !device.supports_dtype(dtype) {
            return Err(Error::Argument(format!("the device does not support {dtype:?}")));
        }
        let fused = dtype == DType::F32 && !device.is_autodiff() && devices().contains(device);
        let device = &(device, dtype);
        let (v, j, b) = (model.vertices(), model.joints(), model.betas());
        // [V, 3, K] → [K, 3, V] → [K, 3·V]
        let planes = |array: &ndarray::Array3<f64>| {
            let k = array.dim().2;
            upload(array.t().iter(), [k, 3 * v], device)
        };
        let mut joint_directions = Vec::with_capacity(b * 3 * j);
        for direction in model.shapedirs.axis_iter(Axis(2)) {
            joint_directions.extend(model.joint_regressor.dot(&direction));
        }
        let template_joints: Array2<f64> = model.joint_regressor.dot(&model.v_template);
        let (depths, order) = depths(&model.parents, device.0);
        let parents: Vec<usize> = model.parents.iter().map(|parent| parent.unwrap_or(0)).collect();
        Ok(Self {
            vertices: v,
            joints: j,
            template: upload(model.v_template.t().iter(), [1, 3 * v], device),
            shape_directions: planes(&model.shapedirs),
            pose_directions: planes(&model.posedirs),
            template_joints: upload(template_joints.iter(), [1, 3 * j], device),
            joint_directions: upload(joint_directions.iter(), [b, 3 * j], device),
            regressor: upload(model.joint_regressor.t().iter(), [v, j], device),
            weights: upload(model.weights.t().iter(), [j, v], device),
            depths,
            parents: indices(&parents, device.0),
            order,
            cpu: fused.then(|| Arc::new(CpuBody::new(model))),
        })
    }

    /// Number of vertices `V`.
    pub fn vertices(&self) -> usize {
        self.vertices
    }

    /// Number of joints `J`.
    pub fn joints(&self) -> usize {
        self.joints
    }

    /// Number of shape directions `B`.
    pub fn betas(&self) -> usize {
        self.shape_directions.dims()[0]
    }

    /// Casts `tensor` to the precision of the body.
    pub(super) fn convert<const D: usize>(&self, tensor: Tensor<D>) -> Tensor<D> {
        tensor.cast(self.template.dtype())
    }

    /// Device of the body.
    pub fn device(&self) -> Device {
        self.template.device()
    }

    /// Unclothed rest shapes `T̄ + B_S(β)`, metres: `[n, b]` → `[n, V, 3]`.
    pub fn rest_shape(&self, betas: Tensor<2>) -> Result<Tensor<3>> {
        Ok(self.rest_shape_planes(betas)?.swap_dims(1, 2))
    }

    /// Rest joints `J(β)`, metres: `[n, b]` → `[n, J, 3]`.
    pub fn rest_joints(&self, betas: Tensor<2>) -> Result<Tensor<3>> {
        let [n, b] = self.check_betas(&betas)?;
        let moved = match b {
            0 => self.template_joints.clone().repeat_dim(0, n),
            _ => {
                self.convert(betas).matmul(head(&self.joint_directions, b))
                    + self.template_joints.clone()
            }
        };
        Ok(moved.reshape([n, self.joints, 3]))
    }

    /// Rest joints regressed from rest vertices, metres: `[n, V, 3]` → `[n, J, 3]`.
    pub fn regress_joints(&self, rest: Tensor<3>) -> Result<Tensor<3>> {
        let n = self.check_vertices("rest vertices", &rest)?;
        let rows = self.convert(rest).swap_dims(1, 2).reshape([n * 3, self.vertices]);
        Ok(rows.matmul(self.regressor.clone()).reshape([n, 3, self.joints]).swap_dims(1, 2))
    }

    /// Rotation matrices `[n, J, 3, 3]` of a pose.
    pub fn rotations(&self, pose: Pose) -> Result<Tensor<4>> {
        let rotations = match pose {
            Pose::Rotations(rotations) => self.convert(rotations),
            Pose::AxisAngle(angles) => {
                let [n, numbers] = angles.dims();
                check("pose", &[n, numbers], &[n, 3 * self.joints])?;
                rodrigues(self.convert(angles).reshape([n * self.joints, 3])).reshape([
                    n,
                    self.joints,
                    3,
                    3,
                ])
            }
        };
        let [n, ..] = rotations.dims();
        check("pose rotations", &rotations.dims(), &[n, self.joints, 3, 3])?;
        Ok(rotations)
    }

    /// Pose blend shapes `B_P(θ)`, metres: rotations `[n, J, 3, 3]` → `[n, V, 3]`.
    pub fn pose_offsets(&self, rotations: Tensor<4>) -> Result<Tensor<3>> {
        let rotations = self.rotations(Pose::Rotations(rotations))?;
        Ok(self.pose_planes(rotations).swap_dims(1, 2))
    }

    /// Unposed bodies `T(β, θ)` (CAPE eq. 1), metres, `[n, V, 3]`.
    pub fn unposed_template(&self, betas: Tensor<2>, pose: Pose) -> Result<Tensor<3>> {
        let rotations = self.rotations(pose)?;
        let shape = self.rest_shape_planes(betas)?;
        same_batch("pose", rotations.dims()[0], shape.dims()[0])?;
        Ok((shape + self.pose_planes(rotations)).swap_dims(1, 2))
    }

    /// Linear blend skinning `W` of rest vertices `[n, V, 3]` (pose blend shapes included) by rest
    /// joints `[n, J, 3]`, rotations `[n, J, 3, 3]` and translations `[n, 3]`; lengths in metres.
    pub fn skin(
        &self,
        rest: Tensor<3>,
        rest_joints: Tensor<3>,
        rotations: Tensor<4>,
        transl: Tensor<2>,
    ) -> Result<SmplOutput> {
        self.check_skinning(&rest, &rest_joints, &rotations, &transl)?;
        let [n, v, _] = rest.dims();
        let rest = self.convert(rest).swap_dims(1, 2);
        let (joints, turn, shift) = self.blended(rest_joints, rotations);
        let transl = self.convert(transl).reshape([n, 3, 1]);
        let turned = (turn * rest.reshape([n, 1, 3, v])).sum_dim(2).reshape([n, 3, v]);
        let vertices = (turned + shift + transl.clone()).swap_dims(1, 2);
        Ok(SmplOutput { vertices, joints: joints + transl.swap_dims(1, 2) })
    }

    /// Inverse of [`skin`](Self::skin): posed vertices `[n, V, 3]` → rest vertices, pose blend shapes
    /// included.
    ///
    /// # Errors
    /// If shapes disagree or the blended transform of a vertex is singular.
    pub fn inverse_skin(
        &self,
        posed: Tensor<3>,
        rest_joints: Tensor<3>,
        rotations: Tensor<4>,
        transl: Tensor<2>,
    ) -> Result<Tensor<3>> {
        let n = self.check_skinning(&posed, &rest_joints, &rotations, &transl)?;
        let (_, turn, shift) = self.blended(rest_joints, rotations);
        let transl = self.convert(transl).reshape([n, 3, 1]);
        let moved = self.convert(posed).swap_dims(1, 2) - transl - shift;
        // Rows r of the blended matrix; its inverse has the columns (r1×r2, r2×r0, r0×r1) / det.
        let row = |i| turn.clone().narrow(1, i, 1).reshape([n, 3, self.vertices]);
        let (r0, r1, r2) = (row(0), row(1), row(2));
        let c0 = cross(&r1, &r2);
        let determinant = (r0.clone() * c0.clone()).sum_dim(1);
        self.check_regular(&determinant)?;
        let weighted = |column: Tensor<3>, i| column * moved.clone().narrow(1, i, 1);
        let rest = weighted(c0, 0) + weighted(cross(&r2, &r0), 1) + weighted(cross(&r0, &r1), 2);
        Ok((rest / determinant).swap_dims(1, 2))
    }

    /// Inverse of [`forward`](Self::forward): maps posed, possibly clothed vertices `[n, V, 3]` to the
    /// canonical space of the rest shape, `T̄ + B_S(β) + S_clo` (pose blend shapes removed), so that
    /// `unpose(…) − rest_shape(β)` is the clothing displacement.
    pub fn unpose(
        &self,
        vertices: Tensor<3>,
        betas: Tensor<2>,
        pose: Pose,
        transl: Tensor<2>,
    ) -> Result<Tensor<3>> {
        let rest_joints = self.rest_joints(betas)?;
        let rotations = self.rotations(pose)?;
        let rest = self.inverse_skin(vertices, rest_joints, rotations.clone(), transl)?;
        Ok(rest - self.pose_planes(rotations).swap_dims(1, 2))
    }

    pub(super) fn rest_shape_planes(&self, betas: Tensor<2>) -> Result<Tensor<3>> {
        let [n, b] = self.check_betas(&betas)?;
        let shape = match b {
            0 => self.template.clone().repeat_dim(0, n),
            _ => {
                self.convert(betas).matmul(head(&self.shape_directions, b)) + self.template.clone()
            }
        };
        Ok(shape.reshape([n, 3, self.vertices]))
    }

    pub(super) fn pose_planes(&self, rotations: Tensor<4>) -> Tensor<3> {
        let [n, j, ..] = rotations.dims();
        let turned = rotations.narrow(1, 1, j - 1);
        let feature =
            turned.reshape([n * (j - 1), 9]) - identity(&self.device(), self.template.dtype());
        let offsets = feature.reshape([n, 9 * (j - 1)]).matmul(self.pose_directions.clone());
        offsets.reshape([n, 3, self.vertices])
    }

    /// Posed joints `[n, J, 3]`, and the blended transforms of the vertices: matrices `[n, 3, 3, V]`
    /// and translations `[n, 3, V]`.
    fn blended(
        &self,
        rest_joints: Tensor<3>,
        rotations: Tensor<4>,
    ) -> (Tensor<3>, Tensor<4>, Tensor<3>) {
        let [n, j, _] = rest_joints.dims();
        let rest = self.convert(rest_joints).reshape([n, j, 3, 1]);
        let global = self.global_transforms(rest.clone(), self.convert(rotations));
        let turn = global.clone().narrow(3, 0, 3);
        let at = global.narrow(3, 3, 1);
        // Relative to rest positions instead of joint-local ones.
        let shift = at.clone() - turn.clone().matmul(rest);
        let over_vertices = |per_joint: Tensor<4>, numbers: usize| {
            let rows = per_joint.reshape([n, j, numbers]).swap_dims(1, 2).reshape([n * numbers, j]);
            rows.matmul(self.weights.clone())
        };
        let v = self.vertices;
        (
            at.reshape([n, j, 3]),
            over_vertices(turn, 9).reshape([n, 3, 3, v]),
            over_vertices(shift, 3).reshape([n, 3, v]),
        )
    }

    /// Global transforms of the joint frames, `[n, J, 3, 4]`, depth by depth.
    fn global_transforms(&self, rest: Tensor<4>, rotations: Tensor<4>) -> Tensor<4> {
        let offsets = rest.clone() - rest.clone().select(1, self.parents.clone());
        let local = Tensor::cat(vec![rotations.clone(), offsets], 3);
        let root = Tensor::cat(vec![rotations.narrow(1, 0, 1), rest.narrow(1, 0, 1)], 3);
        let mut global = vec![root];
        for JointLevel { joints, parents } in &self.depths {
            let Some(above) = global.last() else { break };
            let parent = above.clone().select(1, parents.clone());
            let child = local.clone().select(1, joints.clone());
            let moved = parent.clone().narrow(3, 0, 3).matmul(child);
            let turn = moved.clone().narrow(3, 0, 3);
            let at = moved.narrow(3, 3, 1) + parent.narrow(3, 3, 1);
            global.push(Tensor::cat(vec![turn, at], 3));
        }
        Tensor::cat(global, 1).select(1, self.order.clone())
    }

    pub(super) fn check_betas(&self, betas: &Tensor<2>) -> Result<[usize; 2]> {
        let [n, b] = betas.dims();
        if b <= self.betas() {
            return Ok([n, b]);
        }
        Err(Error::Argument(format!("{b} betas, but the body has {}", self.betas())))
    }

    pub(super) fn check_vertices(&self, name: &str, vertices: &Tensor<3>) -> Result<usize> {
        let [n, ..] = vertices.dims();
        check(name, &vertices.dims(), &[n, self.vertices, 3])?;
        Ok(n)
    }

    fn check_skinning(
        &self,
        vertices: &Tensor<3>,
        rest_joints: &Tensor<3>,
        rotations: &Tensor<4>,
        transl: &Tensor<2>,
    ) -> Result<usize> {
        let n = self.check_vertices("vertices", vertices)?;
        check("rest joints", &rest_joints.dims(), &[n, self.joints, 3])?;
        check("pose rotations", &rotations.dims(), &[n, self.joints, 3, 3])?;
        check("transl", &transl.dims(), &[n, 3])?;
        Ok(n)
    }

    fn check_regular(&self, determinant: &Tensor<3>) -> Result<()> {
        let determinants: Vec<f64> =
            determinant.clone().detach().try_into_vec_as().map_err(|source| failed(&source))?;
        let is_singular = |d: &f64| d.is_nan() || d.abs() < SINGULAR;
        match determinants.iter().position(is_singular) {
            None => Ok(()),
            Some(at) => Err(singular(at % self.vertices, determinants[at])),
        }
    }
}

pub(super) fn failed(source: &impl std::fmt::Debug) -> Error {
    Error::Argument(format!("the device failed: {source:?}"))
}

fn upload<'a, const D: usize>(
    values: impl Iterator<Item = &'a f64>,
    shape: [usize; D],
    (device, dtype): &(&Device, DType),
) -> Tensor<D> {
    let values: Vec<f64> = values.copied().collect();
    Tensor::from_data(TensorData::new(values, shape), (*device, *dtype))
}

fn indices(values: &[usize], device: &Device) -> Tensor<1, Int> {
    let values: Vec<i32> = values.iter().map(|&value| value as i32).collect();
    let count = values.len();
    Tensor::from_data(TensorData::new(values, [count]), device)
}

/// Joints below the root by depth, and index of each joint in the concatenation of all depths.
fn depths(parents: &[Option<usize>], device: &Device) -> (Vec<JointLevel>, Tensor<1, Int>) {
    let mut depth_of = vec![0; parents.len()];
    for (joint, parent) in parents.iter().enumerate() {
        depth_of[joint] = parent.map_or(0, |parent| depth_of[parent] + 1);
    }
    let deepest = depth_of.iter().copied().max().unwrap_or(0);
    let mut by_depth = vec![Vec::new(); deepest + 1];
    for (joint, &depth) in depth_of.iter().enumerate() {
        by_depth[depth].push(joint);
    }
    let mut place = vec![0; parents.len()];
    for (at, &joint) in by_depth.iter().flatten().enumerate() {
        place[joint] = at;
    }
    let below_root = by_depth.windows(2).map(|pair| {
        let parent_places: Vec<usize> = pair[1]
            .iter()
            .map(|&joint| parents[joint].map_or(0, |parent| place[parent] - place[pair[0][0]]))
            .collect();
        JointLevel { joints: indices(&pair[1], device), parents: indices(&parent_places, device) }
    });
    (below_root.collect(), indices(&place, device))
}

fn head(directions: &Tensor<2>, count: usize) -> Tensor<2> {
    directions.clone().narrow(0, 0, count)
}

/// Cross product over axis 1.
fn cross(a: &Tensor<3>, b: &Tensor<3>) -> Tensor<3> {
    let plane = |t: &Tensor<3>, i| t.clone().narrow(1, i, 1);
    let component = |i: usize, j: usize| plane(a, i) * plane(b, j) - plane(a, j) * plane(b, i);
    Tensor::cat(vec![component(1, 2), component(2, 0), component(0, 1)], 1)
}

pub(super) fn check(name: &str, found: &[usize], expected: &[usize]) -> Result<()> {
    if found == expected {
        return Ok(());
    }
    Err(Error::Argument(format!("{name}: shape {found:?}, expected {expected:?}")))
}

pub(super) fn same_batch(name: &str, found: usize, expected: usize) -> Result<()> {
    if found == expected {
        return Ok(());
    }
    Err(Error::Argument(format!("{name}: batch of {found}, expected {expected} as for betas")))
}
