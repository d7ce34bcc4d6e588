//! Gradients of the posed body with respect to its parameters, tile by tile as in the forward pass.
//!
//! The order of summation is independent of the batch size and the number of threads.

use std::ops::Range;

use glam::{DMat3, DVec3};
use pulp::{Simd, WithSimd};
use rayon::prelude::*;

use super::{
    BodyBatch, CpuBody, Prepared,
    kernel::{Points, Transform, blend_one, store, vectors},
    points, row,
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
    /// Gradient with respect to the shape coefficients, `[n, b]`.
    pub betas: Vec<f32>,
    /// Gradient with respect to the axis-angles, per radian, `[n, J, 3]`.
    pub pose: Vec<f32>,
    /// Gradient with respect to the translations, per metre, `[n, 3]`.
    pub transl: Vec<f32>,
    /// Gradient with respect to the displacements, per metre, `[n, V, 3]`.
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
            for part in &sums {
                sum.add(&part[body]);
            }
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

        // Gradients with respect to global transforms, rest joints and the joints' rotations.
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
    fn with_simd<S: Simd>(self, simd: S) -> Vec<Sums> {
        match S::F32_LANES {
            16 => self.sums::<S, 1>(simd),
            8 => self.sums::<S, 2>(simd),
            4 => self.sums::<S, 4>(simd),
            _ => self.sums::<S, TILE>(simd),
        }
    }
}

impl PulledRange<'_> {
    /// Sums over the range for each body, with `WIDE` SIMD vectors per tile row.
    #[inline(always)]
    fn sums<S: Simd, const WIDE: usize>(mut self, simd: S) -> Vec<Sums> {
        let n = self.out.len();
        let k = self.tiles.count();
        let joints = self.prepared.transforms.len() / n.max(1);
        let all: Vec<usize> = (0..k).collect();
        let mut sums = vec![Sums::new(k, joints); n];
        let mut lanes = vec![TileRow::default(); GROUP * k];
        for first in (0..n).step_by(GROUP) {
            lanes.fill(TileRow::default());
            for start in self.vertices.clone().step_by(TILE) {
                let group = first..(first + GROUP).min(n);
                for (body, lanes) in group.zip(lanes.chunks_exact_mut(k)) {
                    self.tile::<S, WIDE>(simd, (start, body), &all, lanes, &mut sums[body]);
                }
            }
            for (sums, lanes) in sums[first..].iter_mut().zip(lanes.chunks_exact(k)) {
                for (sum, lanes) in sums.coefficients.iter_mut().zip(lanes) {
                    *sum = f64::from(total::<S, WIDE>(simd, *vectors::<S, WIDE>(lanes)));
                }
            }
        }
        sums
    }

    /// Adds the tile of one body at vertex `start` to its sums; `lanes` are those of the coefficients
    /// `all`, `[K]`.
    #[inline(always)]
    fn tile<S: Simd, const WIDE: usize>(
        &mut self,
        simd: S,
        (start, body): (usize, usize),
        all: &[usize],
        lanes: &mut [TileRow],
        sums: &mut Sums,
    ) {
        let v = self.tiles.vertices();
        let count = TILE.min(self.vertices.end - start);
        let place = 3 * (body * v + start)..3 * (body * v + start + count);
        let directions = [0, 1, 2].map(|axis| self.tiles.directions(start / TILE, axis));
        let coefficients = row(&self.prepared.coefficients, body, all.len());
        let mut rest = Points::default();
        blend_one::<S, WIDE>(simd, &directions, all, coefficients, &mut rest);
        if let Some(displacement) = self.displacement {
            let (points, _) = displacement[place.clone()].as_chunks::<3>();
            for (axis, rest) in rest.iter_mut().enumerate() {
                for (rest, point) in rest.0.iter_mut().zip(points) {
                    *rest += point[axis];
                }
            }
        }
        let by_vertex = planes(&self.gradient[place]);
        let joints = self.prepared.transforms.len() / self.out.len();
        let transforms = &self.prepared.transforms[body * joints..][..joints];
        let bones = self.tiles.bones(start / TILE);
        let by_rest = unskin::<S, WIDE>(simd, transforms, bones, &by_vertex);
        let first = start - self.vertices.start;
        let out = &mut self.out[body][3 * first..3 * (first + count)];
        for (lane, out) in out.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            *out = [by_rest[0].0[lane], by_rest[1].0[lane], by_rest[2].0[lane]];
        }
        add_transforms::<S, WIDE>(simd, bones, &rest, &by_vertex, sums);
        project::<S, WIDE>(simd, &directions, &by_rest, lanes);
    }
}

/// Gradient with respect to the rest positions of a tile, from that with respect to the posed ones:
/// the transposed blend of `transforms` `[J]` of the joints `bones` with their weights.
#[inline(always)]
fn unskin<S: Simd, const WIDE: usize>(
    simd: S,
    transforms: &[Transform],
    (bones, weights): (&[u32], &[TileRow]),
    by_vertex: &Points,
) -> Points {
    let mut by_rest = Points::default();
    for (column, by_rest) in by_rest.iter_mut().enumerate() {
        let mut sum = [simd.splat_f32s(0.0); WIDE];
        for (axis, by_vertex) in by_vertex.iter().enumerate() {
            let mut blended = [simd.splat_f32s(0.0); WIDE];
            for (&bone, weight) in bones.iter().zip(weights) {
                let number = simd.splat_f32s(transforms[bone as usize][axis][column]);
                for (blended, &weight) in blended.iter_mut().zip(vectors::<S, WIDE>(weight)) {
                    *blended = simd.mul_add_e_f32s(number, weight, *blended);
                }
            }
            let pairs = blended.into_iter().zip(vectors::<S, WIDE>(by_vertex));
            for (sum, (blended, &by_vertex)) in sum.iter_mut().zip(pairs) {
                *sum = simd.mul_add_e_f32s(blended, by_vertex, *sum);
            }
        }
        store::<S, WIDE>(sum, by_rest);
    }
    by_rest
}

/// Adds the gradients with respect to the transforms of the joints `bones`, and to the translation.
#[inline(always)]
fn add_transforms<S: Simd, const WIDE: usize>(
    simd: S,
    (bones, weights): (&[u32], &[TileRow]),
    rest: &Points,
    by_vertex: &Points,
    sums: &mut Sums,
) {
    let ones = TileRow([1.0; TILE]);
    for (axis, by_vertex) in by_vertex.iter().enumerate() {
        let by_vertex = *vectors::<S, WIDE>(by_vertex);
        sums.transl[axis] += f64::from(total::<S, WIDE>(simd, by_vertex));
        for (column, rest) in rest.iter().chain([&ones]).enumerate() {
            let mut product = *vectors::<S, WIDE>(rest);
            for (product, by_vertex) in product.iter_mut().zip(by_vertex) {
                *product = simd.mul_f32s(*product, by_vertex);
            }
            for (&bone, weight) in bones.iter().zip(weights) {
                let mut weighted = *vectors::<S, WIDE>(weight);
                for (weighted, &product) in weighted.iter_mut().zip(&product) {
                    *weighted = simd.mul_f32s(*weighted, product);
                }
                let sum = f64::from(total::<S, WIDE>(simd, weighted));
                sums.transforms[bone as usize][axis][column] += sum;
            }
        }
    }
}

/// Adds the products of the directions `[K]` of a tile with the gradient of its rest positions to
/// `lanes` `[K]`.
#[inline(always)]
fn project<S: Simd, const WIDE: usize>(
    simd: S,
    directions: &[&[TileRow]; 3],
    by_rest: &Points,
    lanes: &mut [TileRow],
) {
    let by_rest: [[S::f32s; WIDE]; 3] = [0, 1, 2].map(|axis| *vectors::<S, WIDE>(&by_rest[axis]));
    for (k, lanes) in lanes.iter_mut().enumerate() {
        let mut sums = *vectors::<S, WIDE>(lanes);
        for (direction, by_rest) in directions.iter().zip(&by_rest) {
            let pairs = vectors::<S, WIDE>(&direction[k]).iter().zip(by_rest);
            for (sum, (&direction, &by_rest)) in sums.iter_mut().zip(pairs) {
                *sum = simd.mul_add_e_f32s(direction, by_rest, *sum);
            }
        }
        store::<S, WIDE>(sums, lanes);
    }
}

/// Sum of the lanes of a tile row.
#[inline(always)]
fn total<S: Simd, const WIDE: usize>(simd: S, row: [S::f32s; WIDE]) -> f32 {
    let sum = row.into_iter().fold(simd.splat_f32s(0.0), |sum, part| simd.add_f32s(sum, part));
    simd.reduce_sum_f32s(sum)
}

/// Points `[count, 3]` as planes, zero beyond them.
#[inline(always)]
fn planes(points: &[f32]) -> Points {
    let mut planes = Points::default();
    for (lane, point) in points.as_chunks::<3>().0.iter().enumerate() {
        for (plane, &coordinate) in planes.iter_mut().zip(point) {
            plane.0[lane] = coordinate;
        }
    }
    planes
}
