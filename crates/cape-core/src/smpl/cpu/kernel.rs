//! Blend shapes and skinning of a range of vertices: generic SIMD code, compiled for each instruction
//! set and dispatched at run time.

use std::ops::Range;

use pulp::{Simd, WithSimd};

use super::tiles::{TILE, TileRow, Tiles};

/// Bodies processed together, so that their coefficients and transforms stay in the L2 cache; a
/// multiple of every number in [`group_widths`].
const GROUP: usize = 48;

/// Numbers of bodies whose sums fit into the registers together.
fn group_widths() -> &'static [usize] {
    struct GroupWidths;
    impl WithSimd for GroupWidths {
        type Output = &'static [usize];
        #[inline(always)]
        fn with_simd<S: Simd>(self, _: S) -> Self::Output {
            match S::F32_LANES {
                16 => &[12, 8],
                8 | 4 => &[6, 4],
                _ => &[1],
            }
        }
    }
    pulp::Arch::new().dispatch(GroupWidths)
}

/// Coordinates x, y, z of the vertices of a tile.
pub(super) type Points = [TileRow; 3];

/// Rows `[R | t]` of a joint's transform of rest positions.
pub(super) type Transform = [[f32; 4]; 3];

/// Coefficients of the directions with a nonzero coefficient in any body of the batch.
pub(super) struct Coefficients {
    /// Runs of these directions, ascending.
    runs: Vec<Range<usize>>,
    /// Number of these directions.
    used: usize,
    /// Coefficients, zero-padded, `[⌈n / side⌉, used, side]`.
    packed: Vec<f32>,
    /// Number of bodies computed together.
    side: usize,
}

impl Coefficients {
    /// Packs coefficients `rows`, `[n, K]`.
    pub(super) fn pack(rows: &[f32], directions: usize) -> Self {
        let n = rows.len() / directions;
        let least_padding =
            group_widths().iter().copied().min_by_key(|side| n.next_multiple_of(*side));
        let side = if n == 1 { 1 } else { least_padding.unwrap_or(1) };
        let mut nonzero = vec![false; directions];
        for row in rows.chunks_exact(directions) {
            for (nonzero, &coefficient) in nonzero.iter_mut().zip(row) {
                *nonzero |= coefficient != 0.0;
            }
        }
        let used: Vec<usize> = (0..directions).filter(|&k| nonzero[k]).collect();
        let mut packed = vec![0.0; n.div_ceil(side) * used.len() * side];
        let blocks = packed.chunks_exact_mut((used.len() * side).max(1));
        for (block, rows) in blocks.zip(rows.chunks(side * directions)) {
            for (at, row) in rows.chunks_exact(directions).enumerate() {
                for (slot, &k) in block[at..].iter_mut().step_by(side).zip(&used) {
                    *slot = row[k];
                }
            }
        }
        let runs = used.chunk_by(|a, b| a + 1 == *b).map(|run| run[0]..run[run.len() - 1] + 1);
        Self { runs: runs.collect(), used: used.len(), packed, side }
    }

    /// Runs of the directions with a nonzero coefficient, ascending.
    pub(super) fn runs(&self) -> &[Range<usize>] {
        &self.runs
    }

    /// Coefficients of the `SIDE` bodies of a block, zero beyond the batch, `[used, SIDE]`.
    #[inline(always)]
    pub(super) fn block<const SIDE: usize>(&self, block: usize) -> &[[f32; SIDE]] {
        let length = self.used * SIDE;
        self.packed[block * length..][..length].as_chunks::<SIDE>().0
    }
}

/// Range of vertices of all bodies in a batch of `n`.
pub(super) struct VertexRange<'a> {
    pub tiles: &'a Tiles,
    /// First tile of the range.
    pub first: usize,
    pub coefficients: &'a Coefficients,
    /// Joint transforms, `[n, J]`.
    pub transforms: &'a [Transform],
    /// Translations of the posed bodies, metres, `[n, 3]`.
    pub transl: &'a [f32],
    /// Displacements of the rest vertices, metres, `[n, V, 3]`.
    pub displacement: Option<&'a [f32]>,
    /// Output of each body, `[n]` of `[vertices of the range, 3]`.
    pub out: Vec<&'a mut [f32]>,
}

/// Work on `SIDE` bodies together, with `WIDE` SIMD vectors per tile row.
pub(super) trait BodyGroups {
    type Output;

    fn run<S: Simd, const SIDE: usize, const WIDE: usize>(self, simd: S) -> Self::Output;
}

/// Runs work on groups of bodies as `coefficients` are packed, with the instruction set of this
/// machine.
pub(super) fn run_in_groups<T: BodyGroups>(coefficients: &Coefficients, work: T) -> T::Output {
    pulp::Arch::new().dispatch(Grouped { side: coefficients.side, work })
}

struct Grouped<T> {
    /// Number of bodies computed together.
    side: usize,
    work: T,
}

impl<T: BodyGroups> WithSimd for Grouped<T> {
    type Output = T::Output;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> T::Output {
        let work = self.work;
        match (S::F32_LANES, self.side) {
            (16, 12) => work.run::<S, 12, 1>(simd),
            (16, 8) => work.run::<S, 8, 1>(simd),
            (16, _) => work.run::<S, 1, 1>(simd),
            (8, 6) => work.run::<S, 6, 2>(simd),
            (8, 4) => work.run::<S, 4, 2>(simd),
            (8, _) => work.run::<S, 1, 2>(simd),
            (4, 6) => work.run::<S, 6, 4>(simd),
            (4, 4) => work.run::<S, 4, 4>(simd),
            (4, _) => work.run::<S, 1, 4>(simd),
            _ => work.run::<S, 1, TILE>(simd),
        }
    }
}

impl BodyGroups for VertexRange<'_> {
    type Output = ();

    /// Computes the posed vertices into `out`.
    #[inline(always)]
    fn run<S: Simd, const SIDE: usize, const WIDE: usize>(mut self, simd: S) {
        let runs = self.coefficients.runs();
        assert!(SIDE == self.coefficients.side && WIDE * S::F32_LANES == TILE);
        assert!(GROUP.is_multiple_of(SIDE));
        let n = self.out.len();
        let joints = self.transforms.len() / n.max(1);
        let vertices = self.out.first().map_or(0, |out| out.len() / 3);
        let mut rest = [Points::default(); GROUP];
        for first in (0..n).step_by(GROUP) {
            let bodies = first..n.min(first + GROUP);
            for tile in 0..vertices.div_ceil(TILE) {
                let directions =
                    [0, 1, 2].map(|axis| self.tiles.directions(self.first + tile, axis));
                let blocks = first / SIDE..bodies.end.div_ceil(SIDE);
                let coefficients = |block| self.coefficients.block::<SIDE>(block);
                if SIDE == 1 {
                    for (block, rest) in blocks.zip(&mut rest) {
                        let coefficients = coefficients(block).as_flattened();
                        blend_one::<S, WIDE>(simd, &directions, runs, coefficients, rest);
                    }
                } else {
                    // The directions of one axis of a tile stay in the L1 cache.
                    for (axis, directions) in directions.into_iter().enumerate() {
                        let rest = rest.as_chunks_mut::<SIDE>().0.iter_mut();
                        for (block, rest) in blocks.clone().zip(rest) {
                            let coefficients = coefficients(block);
                            let rest = rest.each_mut().map(|rest| &mut rest[axis]);
                            blend::<S, SIDE, WIDE>(simd, directions, runs, coefficients, rest);
                        }
                    }
                }
                let inside = tile * TILE * 3..((tile + 1) * TILE).min(vertices) * 3;
                let (bones, weights) = self.tiles.bones(self.first + tile);
                for (body, rest) in bodies.clone().zip(&mut rest) {
                    if let Some(displacement) = self.displacement {
                        let from = (body * self.tiles.vertices() + self.first * TILE) * 3;
                        let (points, _) = displacement[from..][inside.clone()].as_chunks::<3>();
                        for (axis, rest) in rest.iter_mut().enumerate() {
                            for (rest, point) in rest.0.iter_mut().zip(points) {
                                *rest += point[axis];
                            }
                        }
                    }
                    let transforms = &self.transforms[body * joints..][..joints];
                    skin::<S, WIDE>(simd, transforms, bones, weights, rest);
                    let transl = [0, 1, 2].map(|axis| self.transl[body * 3 + axis]);
                    let (out, _) = self.out[body][inside.clone()].as_chunks_mut::<3>();
                    let [TileRow(x), TileRow(y), TileRow(z)] = rest;
                    for (out, ((x, y), z)) in out.iter_mut().zip(x.iter().zip(y).zip(z)) {
                        *out = [*x + transl[0], *y + transl[1], *z + transl[2]];
                    }
                }
            }
        }
    }
}

/// Tile row as SIMD vectors.
#[inline(always)]
pub(super) fn vectors<S: Simd, const WIDE: usize>(line: &TileRow) -> &[S::f32s; WIDE] {
    &S::as_simd_f32s(&line.0).0.as_chunks().0[0]
}

#[inline(always)]
pub(super) fn store<S: Simd, const WIDE: usize>(values: [S::f32s; WIDE], line: &mut TileRow) {
    S::as_mut_simd_f32s(&mut line.0).0.copy_from_slice(&values);
}

/// One coordinate of the rest positions of `SIDE` bodies: `directions` `[K]` weighted by
/// `coefficients` of those of `runs` and summed.
#[inline(always)]
pub(super) fn blend<S: Simd, const SIDE: usize, const WIDE: usize>(
    simd: S,
    directions: &[TileRow],
    runs: &[Range<usize>],
    coefficients: &[[f32; SIDE]],
    rest: [&mut TileRow; SIDE],
) {
    let mut sums = [[simd.splat_f32s(0.0); WIDE]; SIDE];
    let mut left = coefficients;
    for run in runs {
        let (now, later) = left.split_at(run.len());
        left = later;
        for (direction, coefficients) in directions[run.clone()].iter().zip(now) {
            let direction = vectors::<S, WIDE>(direction);
            for (sums, &coefficient) in sums.iter_mut().zip(coefficients) {
                let coefficient = simd.splat_f32s(coefficient);
                for (sum, &direction) in sums.iter_mut().zip(direction) {
                    *sum = simd.mul_add_e_f32s(coefficient, direction, *sum);
                }
            }
        }
    }
    for (rest, sums) in rest.into_iter().zip(sums) {
        store::<S, WIDE>(sums, rest);
    }
}

/// [`blend`] of all axes of one body, in one pass over `directions`.
#[inline(always)]
pub(super) fn blend_one<S: Simd, const WIDE: usize>(
    simd: S,
    directions: &[&[TileRow]; 3],
    runs: &[Range<usize>],
    coefficients: &[f32],
    rest: &mut Points,
) {
    let mut sums = [[simd.splat_f32s(0.0); WIDE]; 3];
    let mut left = coefficients;
    for run in runs {
        let (now, later) = left.split_at(run.len());
        left = later;
        let [x, y, z] = directions.map(|directions| &directions[run.clone()]);
        for (((x, y), z), &coefficient) in x.iter().zip(y).zip(z).zip(now) {
            let coefficient = simd.splat_f32s(coefficient);
            for (sums, direction) in sums.iter_mut().zip([x, y, z]) {
                for (sum, &direction) in sums.iter_mut().zip(vectors::<S, WIDE>(direction)) {
                    *sum = simd.mul_add_e_f32s(coefficient, direction, *sum);
                }
            }
        }
    }
    for (rest, sums) in rest.iter_mut().zip(sums) {
        store::<S, WIDE>(sums, rest);
    }
}

/// Linear blend skinning of a tile of one body by `transforms` `[J]` of the joints `bones` with
/// `weights`.
#[inline(always)]
fn skin<S: Simd, const WIDE: usize>(
    simd: S,
    transforms: &[Transform],
    bones: &[u32],
    weights: &[TileRow],
    points: &mut Points,
) {
    let rest: [[S::f32s; WIDE]; 3] = [0, 1, 2].map(|axis| *vectors::<S, WIDE>(&points[axis]));
    for (axis, moved) in points.iter_mut().enumerate() {
        let mut blended = [[simd.splat_f32s(0.0); WIDE]; 4];
        for (&bone, weights) in bones.iter().zip(weights) {
            let row = &transforms[bone as usize][axis];
            let weights = vectors::<S, WIDE>(weights);
            for (blended, &number) in blended.iter_mut().zip(row) {
                let number = simd.splat_f32s(number);
                for (blended, &weight) in blended.iter_mut().zip(weights) {
                    *blended = simd.mul_add_e_f32s(number, weight, *blended);
                }
            }
        }
        let [x, y, z, shift] = blended;
        let mut sum = shift;
        for (blended, rest) in [x, y, z].iter().zip(&rest) {
            for ((sum, &blended), &rest) in sum.iter_mut().zip(blended).zip(rest) {
                *sum = simd.mul_add_e_f32s(blended, rest, *sum);
            }
        }
        store::<S, WIDE>(sum, moved);
    }
}
