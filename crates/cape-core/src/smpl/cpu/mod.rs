//! Fused forward pass on the CPU without gradients: blend shapes and skinning, tile by tile, without
//! an intermediate array of size `[n, V, 3, 4]`.
//!
//! The order of summation is independent of the batch size and the number of threads.

mod kernel;
mod pull_back;
mod share;
mod tiles;

use glam::{DAffine3, DMat3, DVec3};

use self::{
    kernel::{Coefficients, Transform, VertexRange, run_in_groups},
    share::share,
    tiles::{TILE, Tiles},
};
use super::SmplModel;
use crate::joints::rotation;

/// Tiles per parallel task.
const TILES_PER_TASK: usize = 8;
/// Smallest batch whose joints are computed in parallel.
const PARALLEL_BATCH: usize = 8;

/// Body packed for the fused forward pass.
#[derive(Debug)]
pub(super) struct CpuBody {
    tiles: Tiles,
    /// Number of shape directions `B`.
    betas: usize,
    parents: Vec<Option<usize>>,
    /// Joints of the template, `[J]`, and their shape directions, `[B, J]`, in `f64`.
    template_joints: Vec<DVec3>,
    joint_directions: Vec<DVec3>,
}

/// Joint rotations of a batch, row-major.
#[derive(Debug, Clone, Copy)]
pub(super) enum JointRotations<'a> {
    /// Axis-angle vectors, radians, `[n, J, 3]`.
    AxisAngles(&'a [f32]),
    /// Rotation matrices, `[n, J, 3, 3]`.
    Rotations(&'a [f32]),
}

/// Parameters of a batch of `n` bodies, row-major; the caller has checked the shapes.
#[derive(Debug, Clone, Copy)]
pub(super) struct BodyBatch<'a> {
    /// Shape coefficients, `[n, b]`, `b ≤ B`.
    pub betas: &'a [f32],
    pub rotations: JointRotations<'a>,
    /// Translations, metres, `[n, 3]`.
    pub transl: &'a [f32],
    /// Clothing displacements, metres, `[n, V, 3]`.
    pub displacement: Option<&'a [f32]>,
    /// Rest joints that replace those of the body, metres, `[n, J, 3]`.
    pub rest_joints: Option<&'a [f32]>,
}

/// Output slices of one body: coefficients `[K]`, transforms `[J]`, posed joints `[J, 3]`.
type BodySlots<'a> = ((&'a mut [f32], &'a mut [Transform]), &'a mut [f32]);

/// Bodies of a batch before their vertices.
struct Prepared {
    /// Coefficients of the directions, `[n, K]`.
    coefficients: Vec<f32>,
    /// Transforms of rest positions, `[n, J]`.
    transforms: Vec<Transform>,
    /// Posed joints, metres, `[n, J, 3]`.
    joints: Vec<f32>,
}

impl CpuBody {
    /// Packs a valid body.
    pub(super) fn new(model: &SmplModel) -> Self {
        let joints = |vertices: ndarray::ArrayView2<f64>| {
            let joints = model.joint_regressor.dot(&vertices);
            let points: Vec<_> =
                joints.rows().into_iter().map(|r| DVec3::new(r[0], r[1], r[2])).collect();
            points
        };
        let directions = model.shapedirs.axis_iter(ndarray::Axis(2));
        Self {
            tiles: Tiles::new(model),
            betas: model.betas(),
            parents: model.parents.clone(),
            template_joints: joints(model.v_template.view()),
            joint_directions: directions.flat_map(joints).collect(),
        }
    }

    /// Posed vertices `[n, V, 3]` and joints `[n, J, 3]`, metres.
    pub(super) fn pose(&self, batch: BodyBatch) -> (Vec<f32>, Vec<f32>) {
        let (n, v) = (batch.transl.len() / 3, self.tiles.vertices());
        let Prepared { coefficients, transforms, joints } = self.prepare_all(batch);
        let coefficients = Coefficients::pack(&coefficients, self.tiles.count());

        let mut vertices = vec![0.0; n * 3 * v];
        let stride = TILES_PER_TASK * TILE;
        let mut tasks: Vec<Vec<&mut [f32]>> = Vec::new();
        tasks.resize_with(v.div_ceil(stride), || Vec::with_capacity(n));
        for body in vertices.chunks_exact_mut(3 * v) {
            for (task, part) in tasks.iter_mut().zip(body.chunks_mut(3 * stride)) {
                task.push(part);
            }
        }
        share(tasks, |task, out| {
            let range = VertexRange {
                tiles: &self.tiles,
                first: task * TILES_PER_TASK,
                coefficients: &coefficients,
                transforms: &transforms,
                transl: batch.transl,
                displacement: batch.displacement,
                out,
            };
            run_in_groups(&coefficients, range);
        });
        (vertices, joints)
    }

    /// Computes what the vertices of a batch are made of.
    fn prepare_all(&self, batch: BodyBatch) -> Prepared {
        let (n, j) = (batch.transl.len() / 3, self.parents.len());
        let k = self.tiles.count();
        let mut coefficients = vec![0.0; n * k];
        let mut transforms = vec![Transform::default(); n * j];
        let mut joints = vec![0.0; n * 3 * j];
        let slots = coefficients.chunks_mut(k).zip(transforms.chunks_mut(j));
        let slots = slots.zip(joints.chunks_mut(3 * j));
        each_body(slots.collect(), |body, ((coefficients, transforms), joints): BodySlots| {
            self.prepare(batch, body, coefficients, transforms, joints);
        });
        Prepared { coefficients, transforms, joints }
    }

    /// Computes the coefficients `[K]`, transforms `[J]` and posed joints `[J, 3]` of one body.
    fn prepare(
        &self,
        batch: BodyBatch,
        body: usize,
        coefficients: &mut [f32],
        transforms: &mut [Transform],
        joints: &mut [f32],
    ) {
        let n = batch.transl.len() / 3;
        let betas = row(batch.betas, body, batch.betas.len() / n);
        let rest = match batch.rest_joints {
            Some(joints) => points(row(joints, body, 3 * self.parents.len())),
            None => self.rest_joints(betas),
        };
        let rotations = joint_rotations(batch.rotations, body, self.parents.len());
        let transl = points(row(batch.transl, body, 3))[0];

        coefficients[0] = 1.0;
        coefficients[1..][..betas.len()].copy_from_slice(betas);
        let (feature, _) = coefficients[1 + self.betas..].as_chunks_mut::<9>();
        for (feature, &rotation) in feature.iter_mut().zip(&rotations[1..]) {
            // Column-major of the transpose is row-major.
            *feature = (rotation - DMat3::IDENTITY).transpose().to_cols_array().map(|x| x as f32);
        }

        let globals = self.globals(&rotations, &rest);
        let (joints, _) = joints.as_chunks_mut::<3>();
        for (joint, (slot, transform)) in joints.iter_mut().zip(transforms).enumerate() {
            let global = globals[joint];
            *slot = (global.translation + transl).as_vec3().to_array();
            // Relative to rest positions instead of joint-local ones.
            let shift = global.translation - global.matrix3 * rest[joint];
            let columns =
                [global.matrix3.x_axis, global.matrix3.y_axis, global.matrix3.z_axis, shift];
            for (axis, row) in transform.iter_mut().enumerate() {
                *row = columns.map(|column| column[axis] as f32);
            }
        }
    }

    /// Global transforms of the joint frames, `[J]`.
    fn globals(&self, rotations: &[DMat3], rest: &[DVec3]) -> Vec<DAffine3> {
        let mut globals: Vec<DAffine3> = Vec::with_capacity(rotations.len());
        for (joint, parent) in self.parents.iter().enumerate() {
            globals.push(match *parent {
                None => DAffine3::from_mat3_translation(rotations[joint], rest[joint]),
                Some(parent) => {
                    let offset = rest[joint] - rest[parent];
                    globals[parent] * DAffine3::from_mat3_translation(rotations[joint], offset)
                }
            });
        }
        globals
    }

    fn rest_joints(&self, betas: &[f32]) -> Vec<DVec3> {
        let mut joints = self.template_joints.clone();
        let directions = self.joint_directions.chunks_exact(joints.len());
        for (&beta, direction) in betas.iter().zip(directions) {
            for (joint, &direction) in joints.iter_mut().zip(direction) {
                *joint += f64::from(beta) * direction;
            }
        }
        joints
    }
}

/// [`share`] for bodies, in small batches on the calling thread alone.
fn each_body<T: Send, R: Send>(bodies: Vec<T>, work: impl Fn(usize, T) -> R + Sync) -> Vec<R> {
    if bodies.len() < PARALLEL_BATCH {
        return bodies.into_iter().enumerate().map(|(body, slot)| work(body, slot)).collect();
    }
    share(bodies, work)
}

fn row(values: &[f32], row: usize, len: usize) -> &[f32] {
    &values[row * len..][..len]
}

fn points(values: &[f32]) -> Vec<DVec3> {
    values.as_chunks::<3>().0.iter().map(|point| DVec3::from_array(point.map(f64::from))).collect()
}

/// Rotation matrices of one body, `[J]`.
fn joint_rotations(rotations: JointRotations, body: usize, joints: usize) -> Vec<DMat3> {
    match rotations {
        JointRotations::AxisAngles(angles) => {
            let (angles, _) = row(angles, body, 3 * joints).as_chunks::<3>();
            angles.iter().map(|angle| rotation(angle.map(f64::from))).collect()
        }
        JointRotations::Rotations(rotations) => {
            let (rotations, _) = row(rotations, body, 9 * joints).as_chunks::<9>();
            let rotation = |r: &[f32; 9]| DMat3::from_cols_array(&r.map(f64::from)).transpose();
            rotations.iter().map(rotation).collect()
        }
    }
}
