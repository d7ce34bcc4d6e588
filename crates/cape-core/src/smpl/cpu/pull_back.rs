//! Gradients of the posed body with respect to its parameters, tile by tile as in the forward pass.
//!
//! The order of summation is independent of the batch size and the number of threads.

use std::ops::Range;

use glam::{DMat3, DVec3};
use pulp::{Simd, WithSimd};
use rayon::prelude::*;

use super::{
    BodyBatch, CpuBody, Prepared, points, row,
    tiles::{TILE, TileRow, Tiles},
};
use crate::{joints::rotation, smpl::rodrigues::rotation_gradient};

/// Ranges of tiles that are summed apart.
const PARTS: usize = 16;
/// Bodies whose sums stay in the L2 cache together.
const GROUP: usize = 8;

/// Gradients with respect to the parameters of a batch of `n` bodies, row-major.
#[derive(Debug)]
pub(in crate::smpl) struct ParameterGradients {
    /// Of the shape coefficients, `[n, b]`.
    pub betas: Vec<f32>,
    /// Of the axis-angles, `[n, J, 3]`.
    pub pose: Vec<f32>,
    /// Of the translations, `[n, 3]`.
    pub transl: Vec<f32>,
    /// Of the displacements, `[n, V, 3]`.
    pub displacement: Vec<f32>,
}

/// Sums over vertices for one body.
#[derive(Debug, Clone, Default)]
struct Sums {
    /// Gradients with respect to the coefficients of the directions, `[K]`.
    coefficients: Vec<f64>,
    /// Gradients with respect to the transforms of rest positions, `[J]`.
    transforms: Vec<[[f64; 4]; 3]>,
    transl: [f64; 3],
}

impl Sums {
    fn new(directions: usize, joints: usize) -> Self {
        Self {
            coefficients: vec![0.0; directions],
            transforms: vec![[[0.0; 4]; 3]; joints],
            transl: [0.0; 3],
        }
    }

    fn add(&mut self, other: &Self) {
        let pairs = self.coefficients.iter_mut().zip(&other.coefficients);
        let transforms = self.transforms.as_flattened_mut().as_flattened_mut().iter_mut();
        let pairs = pairs.chain(transforms.zip(other.transforms.as_flattened().as_flattened()));
        for (sum, term) in pairs.chain(self.transl.iter_mut().zip(&other.transl)) {
            *sum += term;
        }
    }
}

impl CpuBody {
    /// Pulls gradients with respect to posed vertices `[n, V, 3]` and joints `[n, J, 3]` back to the
    /// parameters of `batch`, whose rotations are axis-angles and whose rest joints are the body's.
    pub(in crate::smpl) fn pull_back(
        &self,
        batch: BodyBatch,
        angles: &[f32],
        vertices: &[f32],
        joints: &[f32],
    ) -> ParameterGradients {
        let (n, j, v) = (batch.transl.len() / 3, self.parents.len(), self.tiles.vertices());
        let prepared = self.prepare_all(batch);
        let mut displacement = vec![0.0; n * 3 * v];
        let stride = v.div_ceil(TILE).div_ceil(PARTS) * TILE;
        let mut parts: Vec<Vec<&mut [f32]>> = Vec::new();
        parts.resize_with(v.div_ceil(stride), || Vec::with_capacity(n));
        for body in displacement.chunks_exact_mut(3 * v) {
            for (part, slot) in parts.iter_mut().zip(body.chunks_mut(3 * stride)) {
                part.push(slot);
            }
        }
        let sums: Vec<Vec<Sums>> = parts
            .into_par_iter()
            .enumerate()
            .with_max_len(1)
            .map(|(part, out)| {
                let first = part * stride;
                let range = PulledRange {
                    tiles: &self.tiles,
                    vertices: first..(first + stride).min(v),
                    prepared: &prepared,
                    gradient: vertices,
                    displacement: batch.displacement,
                    out,
                };
                pulp::Arch::new().dispatch(range)
            })
            .collect();
        let bodies = (0..n).map(|body| {
            let mut sum = Sums::new(self.tiles.count(), j);
            sums.iter().for_each(|part| sum.add(&part[body]));
            let betas = row(batch.betas, body, batch.betas.len() / n);
            let angles = row(angles, body, 3 * j);
            self.through_joints(betas, angles, &sum, row(joints, body, 3 * j))
        });
        let mut gradients = ParameterGradients {
            betas: Vec::with_capacity(batch.betas.len()),
            pose: Vec::with_capacity(angles.len()),
            transl: Vec::with_capacity(3 * n),
            displacement: Vec::new(),
        };
        for (betas, pose, transl) in bodies {
            gradients.betas.extend(betas.into_iter().map(|x| x as f32));
            gradients.pose.extend(pose.iter().flat_map(|x| x.as_vec3().to_array()));
            gradients.transl.extend(transl.as_vec3().to_array());
        }
        gradients.displacement = displacement;
        gradients
    }

    /// Gradients with respect to shape coefficients, axis-angles and translation of one body.
    fn through_joints(
        &self,
        betas: &[f32],
        angles: &[f32],
        sums: &Sums,
        joints: &[f32],
    ) -> (Vec<f64>, Vec<DVec3>, DVec3) {
        let j = self.parents.len();
        let rest = self.rest_joints(betas);
        let angles = points(angles);
        let turns: Vec<DMat3> = angles.iter().map(|angle| rotation(angle.to_array())).collect();
        let globals = self.globals(&turns, &rest);
        let by_joint = points(joints);

        // Of the global transforms, of the rest joints, and of the joints' rotations.
        let mut by_turn = vec![DMat3::ZERO; j];
        let mut by_place = vec![DVec3::ZERO; j];
        let mut by_rest = vec![DVec3::ZERO; j];
        let mut by_rotation = vec![DMat3::ZERO; j];
        for (joint, sum) in sums.transforms.iter().enumerate() {
            let column = |k: usize| DVec3::new(sum[0][k], sum[1][k], sum[2][k]);
            let shift = column(3);
            by_turn[joint] =
                DMat3::from_cols(column(0), column(1), column(2)) - outer(shift, rest[joint]);
            by_place[joint] = shift + by_joint[joint];
            by_rest[joint] = -(globals[joint].matrix3.transpose() * shift);
        }
        for joint in (0..j).rev() {
            let (turn, place) = (by_turn[joint], by_place[joint]);
            let Some(parent) = self.parents[joint] else {
                by_rotation[joint] = turn;
                by_rest[joint] += place;
                continue;
            };
            let above = globals[parent].matrix3.transpose();
            let offset = rest[joint] - rest[parent];
            by_rotation[joint] = above * turn;
            by_turn[parent] += turn * turns[joint].transpose() + outer(place, offset);
            by_place[parent] += place;
            let by_offset = above * place;
            by_rest[joint] += by_offset;
            by_rest[parent] -= by_offset;
        }
        let (features, _) = sums.coefficients[1 + self.betas..].as_chunks::<9>();
        for (by_rotation, &feature) in by_rotation[1..].iter_mut().zip(features) {
            *by_rotation += DMat3::from_cols_array(&feature).transpose();
        }
        let pose = angles.iter().zip(&by_rotation);
        let pose = pose.map(|(&angle, by_rotation)| rotation_gradient(angle, by_rotation));
        let directions = self.joint_directions.chunks_exact(j);
        let betas = sums.coefficients[1..][..betas.len()].iter().zip(directions);
        let betas = betas.map(|(&sum, direction)| {
            direction.iter().zip(&by_rest).fold(sum, |sum, (a, b)| sum + a.dot(*b))
        });
        let transl = DVec3::from_array(sums.transl) + by_joint.iter().sum::<DVec3>();
        (betas.collect(), pose.collect(), transl)
    }
}

/// `a bᵀ`.
fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}

/// Range of vertices of all bodies in a batch of `n`.
struct PulledRange<'a> {
    tiles: &'a Tiles,
    vertices: Range<usize>,
    prepared: &'a Prepared,
    /// Gradients with respect to the posed vertices, `[n, V, 3]`.
    gradient: &'a [f32],
    /// Displacements of the rest vertices, metres, `[n, V, 3]`.
    displacement: Option<&'a [f32]>,
    /// Gradients with respect to the displacements, `[n]` of `[vertices of the range, 3]`.
    out: Vec<&'a mut [f32]>,
}

impl WithSimd for PulledRange<'_> {
    type Output = Vec<Sums>;

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, _: S) -> Vec<Sums> {
        let n = self.out.len();
        let k = self.tiles.count();
        let joints = self.prepared.transforms.len() / n.max(1);
        let mut sums = vec![Sums::new(k, joints); n];
        let mut lanes = vec![TileRow::default(); GROUP * k];
        for first in (0..n).step_by(GROUP) {
            lanes.fill(TileRow::default());
            for start in self.vertices.clone().step_by(TILE) {
                let group = first..(first + GROUP).min(n);
                for (body, lanes) in group.zip(lanes.chunks_exact_mut(k)) {
                    self.tile(start, body, lanes, &mut sums[body]);
                }
            }
            for (sums, lanes) in sums[first..].iter_mut().zip(lanes.chunks_exact(k)) {
                for (sum, lane) in sums.coefficients.iter_mut().zip(lanes) {
                    *sum = f64::from(total(lane));
                }
            }
        }
        sums
    }
}

impl PulledRange<'_> {
    /// Adds a tile of one body to its sums; `lanes` are those of the coefficients, `[K]`.
    #[inline(always)]
    fn tile(&mut self, start: usize, body: usize, lanes: &mut [TileRow], sums: &mut Sums) {
        let v = self.tiles.vertices();
        let count = TILE.min(self.vertices.end - start);
        let place = 3 * (body * v + start)..3 * (body * v + start + count);
        let directions = [0, 1, 2].map(|axis| self.tiles.directions(start / TILE, axis));
        let coefficients = row(&self.prepared.coefficients, body, lanes.len());
        let mut rest = [TileRow::default(); 3];
        if let Some(displacement) = self.displacement {
            rest = planes(&displacement[place.clone()]);
        }
        for (rest, directions) in rest.iter_mut().zip(directions) {
            for (direction, &coefficient) in directions.iter().zip(coefficients) {
                add(rest, direction, coefficient);
            }
        }
        let by_vertex = planes(&self.gradient[place]);
        let joints = self.prepared.transforms.len() / self.out.len();
        let transforms = &self.prepared.transforms[body * joints..][..joints];
        let (bones, weights) = self.tiles.bones(start / TILE);

        // Blended matrices of the vertices, and by them the gradient in the rest pose.
        let mut by_rest = [TileRow::default(); 3];
        for (axis, by_vertex) in by_vertex.iter().enumerate() {
            for (column, by_rest) in by_rest.iter_mut().enumerate() {
                let mut blended = TileRow::default();
                for (&bone, weight) in bones.iter().zip(weights) {
                    add(&mut blended, weight, transforms[bone as usize][axis][column]);
                }
                for lane in 0..TILE {
                    by_rest.0[lane] += blended.0[lane] * by_vertex.0[lane];
                }
            }
        }
        let first = start - self.vertices.start;
        let out = &mut self.out[body][3 * first..3 * (first + count)];
        for (lane, out) in out.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            *out = [by_rest[0].0[lane], by_rest[1].0[lane], by_rest[2].0[lane]];
        }
        for (axis, by_vertex) in by_vertex.iter().enumerate() {
            sums.transl[axis] += f64::from(total(by_vertex));
            for column in 0..4 {
                let mut product = *by_vertex;
                if column < 3 {
                    for lane in 0..TILE {
                        product.0[lane] *= rest[column].0[lane];
                    }
                }
                for (&bone, weight) in bones.iter().zip(weights) {
                    let mut weighted = product;
                    for lane in 0..TILE {
                        weighted.0[lane] *= weight.0[lane];
                    }
                    sums.transforms[bone as usize][axis][column] += f64::from(total(&weighted));
                }
            }
        }
        for (by_rest, directions) in by_rest.iter().zip(directions) {
            for (lanes, direction) in lanes.iter_mut().zip(directions) {
                for lane in 0..TILE {
                    lanes.0[lane] += direction.0[lane] * by_rest.0[lane];
                }
            }
        }
    }
}

#[inline(always)]
fn add(sum: &mut TileRow, row: &TileRow, factor: f32) {
    for lane in 0..TILE {
        sum.0[lane] += row.0[lane] * factor;
    }
}

/// Sum of the lanes, in a fixed order.
#[inline(always)]
fn total(row: &TileRow) -> f32 {
    let mut lanes = row.0;
    let mut width = TILE;
    while width > 1 {
        width /= 2;
        for lane in 0..width {
            lanes[lane] += lanes[lane + width];
        }
    }
    lanes[0]
}

/// Points `[count, 3]` as planes, zero beyond them.
#[inline(always)]
fn planes(points: &[f32]) -> [TileRow; 3] {
    let mut planes = [TileRow::default(); 3];
    for (lane, point) in points.as_chunks::<3>().0.iter().enumerate() {
        for (plane, &coordinate) in planes.iter_mut().zip(point) {
            plane.0[lane] = coordinate;
        }
    }
    planes
}
