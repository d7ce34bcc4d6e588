//! Gradients of the posed body with respect to its parameters, tile by tile as in the forward pass.
//!
//! The order of summation is independent of the batch size and the number of threads.

use std::{array, ops::Range};

use glam::{DMat3, DVec3};
use pulp::Simd;

use super::{
    BodyBatch, CpuBody, Prepared, each_body,
    kernel::{
        BodyGroups, Coefficients, Points, Transform, blend, blend_one, run_in_groups, store,
        vectors,
    },
    points, row,
    share::share,
    tiles::{TILE, TileRow, Tiles},
};
use crate::{joints::rotation, smpl::rodrigues::rotation_gradient};

/// Ranges of tiles that are summed apart.
const PARTS: usize = 16;
/// Tiles whose directions stay in the L2 cache, and bodies whose sums do.
const TILES: usize = 6;
const GROUP: usize = 12;

/// Gradients with respect to the parameters of a batch of `n` bodies, row-major.
#[derive(Debug)]
pub(in crate::smpl) struct ParameterGradients {
    /// Gradient with respect to the shape coefficients, `[n, b]`.
    pub betas: Vec<f32>,
    /// Gradient with respect to the axis-angles, per radian, `[n, J, 3]`.
    pub pose: Vec<f32>,
    /// Gradient with respect to the translations, per metre, `[n, 3]`.
    pub transl: Vec<f32>,
    /// Gradient with respect to the displacements, per metre, `[n, V, 3]`, of a batch that has them.
    pub displacement: Option<Vec<f32>>,
}

/// Sums over vertices for one body.
#[derive(Debug)]
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
        let Prepared { coefficients, transforms, .. } = self.prepare_all(batch);
        let coefficients = Coefficients::pack(&coefficients, self.tiles.count());
        let mut displacement = batch.displacement.map(|_| vec![0.0; n * 3 * v]);
        let stride = v.div_ceil(TILE).div_ceil(PARTS) * TILE;
        let mut parts: Vec<Vec<&mut [f32]>> = Vec::new();
        parts.resize_with(v.div_ceil(stride), || Vec::with_capacity(n));
        for body in displacement.iter_mut().flat_map(|all| all.chunks_exact_mut(3 * v)) {
            for (part, slot) in parts.iter_mut().zip(body.chunks_mut(3 * stride)) {
                part.push(slot);
            }
        }
        let sums: Vec<Vec<Sums>> = share(parts, |part, out| {
            let first = part * stride;
            let range = PulledRange {
                tiles: &self.tiles,
                vertices: first..(first + stride).min(v),
                coefficients: &coefficients,
                transforms: &transforms,
                gradient: vertices,
                displacement: batch.displacement,
                out,
                bodies: n,
            };
            run_in_groups(&coefficients, range)
        });
        let bodies = each_body(vec![(); n], |body, ()| {
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
            displacement,
        };
        for (betas, pose, transl) in bodies {
            gradients.betas.extend(betas.into_iter().map(|x| x as f32));
            gradients.pose.extend(pose.iter().flat_map(|x| x.as_vec3().to_array()));
            gradients.transl.extend(transl.as_vec3().to_array());
        }
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
    coefficients: &'a Coefficients,
    /// Joint transforms, `[n, J]`.
    transforms: &'a [Transform],
    /// Gradients with respect to the posed vertices, `[n, V, 3]`.
    gradient: &'a [f32],
    /// Displacements of the rest vertices, metres, `[n, V, 3]`.
    displacement: Option<&'a [f32]>,
    /// Gradients with respect to the displacements, `[n]` of `[vertices of the range, 3]`; empty where
    /// there are none.
    out: Vec<&'a mut [f32]>,
    /// Number of bodies `n`.
    bodies: usize,
}

impl BodyGroups for PulledRange<'_> {
    type Output = Vec<Sums>;

    /// Sums over the range for each body.
    #[inline(always)]
    fn run<S: Simd, const SIDE: usize, const WIDE: usize>(mut self, simd: S) -> Vec<Sums> {
        let n = self.bodies;
        let joints = self.transforms.len() / n.max(1);
        let new = || GroupLanes::<SIDE>::new(self.tiles.count(), joints);
        let mut groups = Vec::new();
        groups.resize_with(n.min(GROUP).div_ceil(SIDE), new);
        let mut sums = Vec::with_capacity(n);
        let mut by_rest = [[TileRow::default(); SIDE]; 3 * TILES];
        for first in (0..n).step_by(SIDE * groups.len().max(1)) {
            for lanes in &mut groups {
                lanes.clear();
            }
            for start in self.vertices.clone().step_by(TILES * TILE) {
                let tiles = (self.vertices.end - start).div_ceil(TILE).min(TILES);
                let by_rest = &mut by_rest[..3 * tiles];
                let directions = self.tiles.all_directions(start / TILE, tiles);
                for (first, lanes) in (first..n).step_by(SIDE).zip(&mut groups) {
                    for (tile, by_rest) in by_rest.as_chunks_mut::<3>().0.iter_mut().enumerate() {
                        let start = start + tile * TILE;
                        self.tile::<S, SIDE, WIDE>(simd, (start, first), lanes, by_rest);
                    }
                    project::<S, SIDE, WIDE>(simd, directions, by_rest, &mut lanes.coefficients);
                }
            }
            for (first, lanes) in (first..n).step_by(SIDE).zip(&groups) {
                for body in 0..SIDE.min(n - first) {
                    sums.push(lanes.sums::<S, WIDE>(simd, body));
                }
            }
        }
        sums
    }
}

/// Sums over vertices for `SIDE` bodies, each lane of a tile row apart.
struct GroupLanes<const SIDE: usize> {
    /// Gradients with respect to the coefficients of the directions, `[K]`.
    coefficients: Vec<[TileRow; SIDE]>,
    /// Gradients with respect to the transforms, in row-major order, `[SIDE, J]`.
    transforms: Vec<[TileRow; 12]>,
    /// Gradients with respect to the translations, `[SIDE]`.
    transl: [Points; SIDE],
}

impl<const SIDE: usize> GroupLanes<SIDE> {
    fn new(directions: usize, joints: usize) -> Self {
        Self {
            coefficients: vec![[TileRow::default(); SIDE]; directions],
            transforms: vec![[TileRow::default(); 12]; SIDE * joints],
            transl: [Points::default(); SIDE],
        }
    }

    fn clear(&mut self) {
        self.coefficients.fill([TileRow::default(); SIDE]);
        self.transforms.fill([TileRow::default(); 12]);
        self.transl = [Points::default(); SIDE];
    }

    /// Sums of one of the bodies.
    #[inline(always)]
    fn sums<S: Simd, const WIDE: usize>(&self, simd: S, body: usize) -> Sums {
        let joints = self.transforms.len() / SIDE;
        let mut sums = Sums::new(self.coefficients.len(), joints);
        for (sum, rows) in sums.coefficients.iter_mut().zip(&self.coefficients) {
            *sum = total::<S, WIDE>(simd, &rows[body]);
        }
        let transforms = &self.transforms[body * joints..][..joints];
        for (sums, rows) in sums.transforms.iter_mut().zip(transforms) {
            for (sum, row) in sums.as_flattened_mut().iter_mut().zip(rows) {
                *sum = total::<S, WIDE>(simd, row);
            }
        }
        for (sum, row) in sums.transl.iter_mut().zip(&self.transl[body]) {
            *sum = total::<S, WIDE>(simd, row);
        }
        sums
    }
}

impl PulledRange<'_> {
    /// Gradients with respect to the rest positions of the tile at vertex `start`, for the bodies from
    /// `first` on; adds those with respect to transforms and translations to the sums.
    #[inline(always)]
    fn tile<S: Simd, const SIDE: usize, const WIDE: usize>(
        &mut self,
        simd: S,
        (start, first): (usize, usize),
        lanes: &mut GroupLanes<SIDE>,
        by_rest: &mut [[TileRow; SIDE]; 3],
    ) {
        let (n, v) = (self.bodies, self.tiles.vertices());
        let joints = self.transforms.len() / n;
        let count = TILE.min(self.vertices.end - start);
        let directions = [0, 1, 2].map(|axis| self.tiles.directions(start / TILE, axis));
        let bones = self.tiles.bones(start / TILE);
        let mut rest = [Points::default(); SIDE];
        let coefficients = self.coefficients.block::<SIDE>(first / SIDE);
        let runs = self.coefficients.runs();
        if SIDE == 1 {
            let coefficients = coefficients.as_flattened();
            blend_one::<S, WIDE>(simd, &directions, runs, coefficients, &mut rest[0]);
        } else {
            for (axis, directions) in directions.into_iter().enumerate() {
                let rest = rest.each_mut().map(|rest| &mut rest[axis]);
                blend::<S, SIDE, WIDE>(simd, directions, runs, coefficients, rest);
            }
        }
        for (slot, (body, rest)) in (first..n).zip(&mut rest).enumerate() {
            let place = 3 * (body * v + start)..3 * (body * v + start + count);
            if let Some(displacement) = self.displacement {
                let (points, _) = displacement[place.clone()].as_chunks::<3>();
                for (axis, rest) in rest.iter_mut().enumerate() {
                    for (rest, point) in rest.0.iter_mut().zip(points) {
                        *rest += point[axis];
                    }
                }
            }
            let by_vertex = planes(&self.gradient[place]);
            let transforms = &self.transforms[body * joints..][..joints];
            let pulled = unskin::<S, WIDE>(simd, transforms, bones, &by_vertex);
            if let Some(out) = self.out.get_mut(body) {
                let from = start - self.vertices.start;
                let out = &mut out[3 * from..3 * (from + count)];
                for (lane, out) in out.as_chunks_mut::<3>().0.iter_mut().enumerate() {
                    *out = [pulled[0].0[lane], pulled[1].0[lane], pulled[2].0[lane]];
                }
            }
            for (by_rest, pulled) in by_rest.iter_mut().zip(pulled) {
                by_rest[slot] = pulled;
            }
            for (sum, by_vertex) in lanes.transl[slot].iter_mut().zip(&by_vertex) {
                for (sum, &by_vertex) in sum.0.iter_mut().zip(&by_vertex.0) {
                    *sum += by_vertex;
                }
            }
            let transforms = &mut lanes.transforms[slot * joints..][..joints];
            add_transforms::<S, WIDE>(simd, bones, rest, &by_vertex, transforms);
        }
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

/// Adds the gradients with respect to the transforms of the joints `bones` to those of all joints,
/// `[J]`.
#[inline(always)]
fn add_transforms<S: Simd, const WIDE: usize>(
    simd: S,
    (bones, weights): (&[u32], &[TileRow]),
    rest: &Points,
    by_vertex: &Points,
    transforms: &mut [[TileRow; 12]],
) {
    let mut products = [[simd.splat_f32s(0.0); WIDE]; 12];
    for (products, by_vertex) in products.as_chunks_mut::<4>().0.iter_mut().zip(by_vertex) {
        let by_vertex = vectors::<S, WIDE>(by_vertex);
        for (products, rest) in products.iter_mut().zip(rest) {
            let rest = vectors::<S, WIDE>(rest);
            for (product, (&rest, &by_vertex)) in
                products.iter_mut().zip(rest.iter().zip(by_vertex))
            {
                *product = simd.mul_f32s(rest, by_vertex);
            }
        }
        products[3] = *by_vertex;
    }
    for (&bone, weight) in bones.iter().zip(weights) {
        let weight = vectors::<S, WIDE>(weight);
        for (sums, products) in transforms[bone as usize].iter_mut().zip(&products) {
            let mut sum = *vectors::<S, WIDE>(sums);
            for (sum, (&product, &weight)) in sum.iter_mut().zip(products.iter().zip(weight)) {
                *sum = simd.mul_add_e_f32s(product, weight, *sum);
            }
            store::<S, WIDE>(sum, sums);
        }
    }
}

/// Adds the products of `directions` `[tiles, 3, K]` with the gradients of the rest positions of `SIDE`
/// bodies, `[tiles, 3, SIDE]`, to `sums` `[K]`.
#[inline(always)]
fn project<S: Simd, const SIDE: usize, const WIDE: usize>(
    simd: S,
    directions: &[TileRow],
    by_rest: &[[TileRow; SIDE]],
    sums: &mut [[TileRow; SIDE]],
) {
    // As many sums as the registers of the instruction set hold.
    match (SIDE, WIDE) {
        (1, _) => project_blocks::<S, SIDE, WIDE, 8, 1>(simd, directions, by_rest, sums),
        (6, _) => project_blocks::<S, SIDE, WIDE, 3, 3>(simd, directions, by_rest, sums),
        (_, 1) => project_blocks::<S, SIDE, WIDE, 4, 4>(simd, directions, by_rest, sums),
        _ => project_blocks::<S, SIDE, WIDE, 2, 4>(simd, directions, by_rest, sums),
    }
}

/// [`project`] by blocks of `COUNT` directions and `BODIES` bodies, a divisor of `SIDE`.
#[inline(always)]
fn project_blocks<
    S: Simd,
    const SIDE: usize,
    const WIDE: usize,
    const COUNT: usize,
    const BODIES: usize,
>(
    simd: S,
    directions: &[TileRow],
    by_rest: &[[TileRow; SIDE]],
    sums: &mut [[TileRow; SIDE]],
) {
    let k = sums.len();
    let (blocks, rest) = sums.as_chunks_mut::<COUNT>();
    let single = blocks.len() * COUNT..k;
    for body in (0..SIDE).step_by(BODIES) {
        let rows = || directions.chunks_exact(k).zip(by_rest);
        for (block, sums) in blocks.iter_mut().enumerate() {
            let place = (block * COUNT, body);
            project_block::<S, SIDE, WIDE, COUNT, BODIES>(simd, rows(), place, sums);
        }
        for (direction, sum) in single.clone().zip(rest.iter_mut()) {
            let sums = array::from_mut(sum);
            let place = (direction, body);
            project_block::<S, SIDE, WIDE, 1, BODIES>(simd, rows(), place, sums);
        }
    }
}

/// [`project`] for `COUNT` directions from `direction` on and `BODIES` bodies from `body` on, whose sums
/// stay in registers; the sum of a row's vectors is in the first of them.
#[inline(always)]
fn project_block<
    'a,
    S: Simd,
    const SIDE: usize,
    const WIDE: usize,
    const COUNT: usize,
    const BODIES: usize,
>(
    simd: S,
    rows: impl Iterator<Item = (&'a [TileRow], &'a [TileRow; SIDE])>,
    (direction, body): (usize, usize),
    sums: &mut [[TileRow; SIDE]; COUNT],
) {
    let mut parts = [[simd.splat_f32s(0.0); BODIES]; COUNT];
    for (directions, by_rest) in rows {
        let directions = &directions[direction..][..COUNT];
        let by_rest = &by_rest[body..][..BODIES];
        for wide in 0..WIDE {
            for at in 0..COUNT {
                let direction = vectors::<S, WIDE>(&directions[at])[wide];
                for other in 0..BODIES {
                    let by_rest = vectors::<S, WIDE>(&by_rest[other])[wide];
                    parts[at][other] = simd.mul_add_e_f32s(direction, by_rest, parts[at][other]);
                }
            }
        }
    }
    for (sums, parts) in sums.iter_mut().zip(parts) {
        for (sum, part) in sums[body..][..BODIES].iter_mut().zip(parts) {
            let sum = &mut S::as_mut_simd_f32s(&mut sum.0).0[0];
            *sum = simd.add_f32s(*sum, part);
        }
    }
}

/// Sum of the lanes of a tile row.
#[inline(always)]
fn total<S: Simd, const WIDE: usize>(simd: S, row: &TileRow) -> f64 {
    let mut sum = simd.splat_f32s(0.0);
    for &part in vectors::<S, WIDE>(row) {
        sum = simd.add_f32s(sum, part);
    }
    f64::from(simd.reduce_sum_f32s(sum))
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
