//! Posing on the CPU without gradients: blend shapes and skinning in one pass over the body, tile
//! by tile, with nothing the size of `[n, V, 3, 4]` in memory.
//!
//! Every number is summed in the same order whatever the batch and the number of threads.

mod kernel;
mod tiles;

use glam::{DAffine3, DMat3, DVec3};
use rayon::prelude::*;

use self::{
    kernel::{Coefficients, Transform, VertexRange},
    tiles::{TILE, Tiles},
};
use super::SmplModel;
use crate::joints::rotation;

/// Tiles that are computed one after the other on one thread.
const PIECE: usize = 8;
/// Bodies from which on joints are worth several threads.
const MANY: usize = 8;

/// A body laid out for posing on the CPU.
#[derive(Debug)]
pub(super) struct CpuBody {
    tiles: Tiles,
    /// Shape directions `B`.
    betas: usize,
    parents: Vec<Option<usize>>,
    /// `J(0)`, `[J]`, and how it follows β, `[B, J]`; in the model's precision.
    template_joints: Vec<DVec3>,
    joint_directions: Vec<DVec3>,
}

/// Rotations of a batch, row-major.
#[derive(Debug, Clone, Copy)]
pub(super) enum JointRotations<'a> {
    /// Radians, `[n, J, 3]`.
    AxisAngles(&'a [f32]),
    /// `[n, J, 3, 3]`.
    Rotations(&'a [f32]),
}

/// What a batch of `n` bodies is made from; row-major, shapes checked by the caller.
#[derive(Debug, Clone, Copy)]
pub(super) struct BodyBatch<'a> {
    /// `[n, b]`, `b ≤ B`.
    pub betas: &'a [f32],
    pub turns: JointRotations<'a>,
    /// Metres, `[n, 3]`.
    pub transl: &'a [f32],
    /// Metres, `[n, V, 3]`.
    pub displacement: Option<&'a [f32]>,
    /// Rest joints if they are not the body's, metres, `[n, J, 3]`.
    pub rest_joints: Option<&'a [f32]>,
}

/// One body's coefficients `[K]`, transforms `[J]` and posed joints `[J, 3]`.
type BodySlots<'a> = ((&'a mut [f32], &'a mut [Transform]), &'a mut [f32]);

impl CpuBody {
    /// Lays out a valid body.
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
        let (n, j, v) = (batch.transl.len() / 3, self.parents.len(), self.tiles.vertices());
        let k = self.tiles.count();
        let mut coefficients = vec![0.0; n * k];
        let mut transforms = vec![Transform::default(); n * j];
        let mut joints = vec![0.0; n * 3 * j];
        let prepare = |(body, ((coefficients, transforms), joints)): (usize, BodySlots)| {
            self.prepare(batch, body, coefficients, transforms, joints);
        };
        if n < MANY {
            coefficients
                .chunks_mut(k)
                .zip(transforms.chunks_mut(j))
                .zip(joints.chunks_mut(3 * j))
                .enumerate()
                .for_each(prepare);
        } else {
            coefficients
                .par_chunks_mut(k)
                .zip(transforms.par_chunks_mut(j))
                .zip(joints.par_chunks_mut(3 * j))
                .enumerate()
                .with_min_len(MANY / 2)
                .for_each(prepare);
        }
        let coefficients = Coefficients::pack(&coefficients, k);

        let mut vertices = vec![0.0; n * 3 * v];
        let piece = PIECE * TILE;
        let mut pieces: Vec<Vec<&mut [f32]>> = Vec::new();
        pieces.resize_with(v.div_ceil(piece), || Vec::with_capacity(n));
        for body in vertices.chunks_exact_mut(3 * v) {
            for (pieces, part) in pieces.iter_mut().zip(body.chunks_mut(3 * piece)) {
                pieces.push(part);
            }
        }
        pieces.into_par_iter().enumerate().with_max_len(1).for_each(|(piece, out)| {
            let work = VertexRange {
                tiles: &self.tiles,
                first: piece * PIECE,
                coefficients: &coefficients,
                transforms: &transforms,
                transl: batch.transl,
                displacement: batch.displacement,
                out,
            };
            work.run();
        });
        (vertices, joints)
    }

    /// One body's coefficients `[K]`, transforms `[J]` and posed joints `[J, 3]`.
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
        let turns = turns(batch.turns, body, self.parents.len());
        let transl = points(row(batch.transl, body, 3))[0];

        coefficients[0] = 1.0;
        coefficients[1..][..betas.len()].copy_from_slice(betas);
        let (feature, _) = coefficients[1 + self.betas..].as_chunks_mut::<9>();
        for (feature, &turn) in feature.iter_mut().zip(&turns[1..]) {
            // Column-major of the transpose is row-major.
            *feature = (turn - DMat3::IDENTITY).transpose().to_cols_array().map(|x| x as f32);
        }

        let mut globals: Vec<DAffine3> = Vec::with_capacity(turns.len());
        let (joints, _) = joints.as_chunks_mut::<3>();
        for (joint, (slot, transform)) in joints.iter_mut().zip(transforms).enumerate() {
            let global = match self.parents[joint] {
                None => DAffine3::from_mat3_translation(turns[joint], rest[joint]),
                Some(parent) => {
                    let offset = rest[joint] - rest[parent];
                    globals[parent] * DAffine3::from_mat3_translation(turns[joint], offset)
                }
            };
            globals.push(global);
            *slot = (global.translation + transl).as_vec3().to_array();
            // Acting on rest positions rather than joint-local ones.
            let shift = global.translation - global.matrix3 * rest[joint];
            let columns =
                [global.matrix3.x_axis, global.matrix3.y_axis, global.matrix3.z_axis, shift];
            for (axis, row) in transform.iter_mut().enumerate() {
                *row = columns.map(|column| column[axis] as f32);
            }
        }
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

fn row(values: &[f32], row: usize, len: usize) -> &[f32] {
    &values[row * len..][..len]
}

fn points(values: &[f32]) -> Vec<DVec3> {
    values.as_chunks::<3>().0.iter().map(|point| DVec3::from_array(point.map(f64::from))).collect()
}

/// Rotation matrices of one body, `[J]`.
fn turns(turns: JointRotations, body: usize, joints: usize) -> Vec<DMat3> {
    match turns {
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
