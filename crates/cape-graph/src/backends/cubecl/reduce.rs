//! Sums over vertices.

use std::ops::Range;

use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use super::{THREADS, dims, empty};

/// Maximal number of channels of a tile: one coalesced read.
const LANES: usize = 32;
/// Minimal number of vertices that a thread sums, unless there are fewer.
const DEPTH: usize = 16;
/// Number of workgroups that occupy a device.
const CUBES: usize = 1024;

/// Division of `[batch, vertices, channels]` among workgroups: each takes a tile of channels and a
/// chunk of the vertices of one example, each of its threads one channel and every `rows`-th vertex.
pub(super) struct Tiles {
    pub count: CubeCount,
    pub dim: CubeDim,
    /// Number of vertices of a chunk.
    pub chunk: usize,
    /// Number of chunks of an example, none of them empty.
    pub chunks: usize,
}

impl Tiles {
    pub(super) fn new(batch: usize, vertices: usize, channels: usize) -> Self {
        let lanes = channels.next_power_of_two().min(LANES);
        let rows = THREADS / lanes;
        let tiles = channels.div_ceil(lanes);
        let most = vertices.div_ceil(rows * DEPTH).max(1);
        let chunks = (CUBES / (batch * tiles).max(1)).clamp(1, most);
        let chunk = vertices.div_ceil(chunks).max(1);
        let chunks = vertices.div_ceil(chunk).max(1);
        Self {
            count: CubeCount::Static(tiles.max(1) as u32, chunks as u32, batch.max(1) as u32),
            dim: CubeDim::new_2d(lanes as u32, rows as u32),
            chunk,
            chunks,
        }
    }
}

/// Sum of `value` over the rows of a workgroup, valid in its first row.
#[cube]
pub(super) fn row_sum(value: f32, shared: &mut Shared<[f32]>) -> f32 {
    let place = UNIT_POS as usize;
    // Other threads may still be reading an earlier sum.
    sync_cube();
    shared[place] = value;
    sync_cube();
    let mut half = CUBE_DIM_Y / 2;
    while half > 0 {
        if UNIT_POS_Y < half {
            let other = shared[(UNIT_POS + half * CUBE_DIM_X) as usize];
            shared[place] += other;
        }
        sync_cube();
        half /= 2;
    }
    shared[UNIT_POS_X as usize]
}

/// `out[b, c] = Σ_k x[b, k, from + c]`, `x: [batch, count, pitch]`.
#[cube(launch)]
fn column_sums_kernel(
    x: &Tensor<f32>,
    out: &mut Tensor<f32>,
    count: usize,
    pitch: usize,
    from: usize,
) {
    let mut shared = Shared::new_slice(THREADS);
    let channels = out.shape(1);
    let channel = (CUBE_POS_X * CUBE_DIM_X + UNIT_POS_X) as usize;
    let example = CUBE_POS_Z as usize;
    let mut sum = 0.0f32;
    if channel < channels {
        let mut k = UNIT_POS_Y as usize;
        while k < count {
            sum += x[(example * count + k) * pitch + from + channel];
            k += CUBE_DIM_Y as usize;
        }
    }
    let sum = row_sum(sum, &mut shared);
    if channel < channels && UNIT_POS_Y == 0 {
        out[example * channels + channel] = sum;
    }
}

/// Sums of the channels `span` of `partial: [batch, count, channels]`, contiguous, over the chunks
/// and over each of the `outer` equal parts of the batch: `[outer, span.len()]`.
pub(super) fn column_sums(partial: CubeTensor, outer: usize, span: Range<usize>) -> CubeTensor {
    let [batch, count, pitch] = dims(&partial);
    let out = empty(&partial, &[outer, span.len()]);
    let count = batch * count / outer.max(1);
    let tiles = Tiles::new(outer, 1, span.len());
    column_sums_kernel::launch(
        &out.client,
        tiles.count,
        tiles.dim,
        partial.into_tensor_arg(),
        out.clone().into_tensor_arg(),
        count,
        pitch,
        span.start,
    );
    out
}
