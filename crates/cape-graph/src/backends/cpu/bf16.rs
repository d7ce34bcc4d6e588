//! Matrix products of bfloat16 numbers, summed in f32, by AMX or AVX-512 BF16.
//!
//! Numbers are packed in pairs that follow each other along the depth of the product, one pair in the
//! memory of an f32. The left matrix is packed in tiles, `[rows / PANEL, pairs / PANEL, PANEL, PANEL]`, the
//! right one in panels of columns, `[columns / PANEL, pairs, PANEL]`, so that every tile is contiguous; all
//! extents are padded to whole blocks.

use std::sync::OnceLock;

use super::{
    kernel::{Epilogue, Rows},
    panels::View,
};
use crate::{Precision, buffer::Buffer};

#[cfg_attr(target_arch = "x86_64", path = "bf16/x86.rs")]
#[cfg_attr(not(target_arch = "x86_64"), path = "bf16/none.rs")]
mod instructions;

/// Rows and columns of a block that is computed at once.
const BLOCK: usize = 32;
/// Rows and pairs of a tile of the left matrix, columns of a panel of the right matrix.
const PANEL: usize = 16;
/// Extent of a matrix from which it is worth padding to whole blocks.
const SMALLEST: usize = 16;

/// Instructions that multiply bfloat16 numbers, which this processor has: there are no others than those
/// that [`all`] finds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Instructions {
    /// Tiles of Advanced Matrix Extensions.
    #[cfg(target_arch = "x86_64")]
    Amx,
    /// Pairs in the vectors of AVX-512.
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

/// The fastest instructions of this processor.
fn fastest() -> Option<Instructions> {
    static FASTEST: OnceLock<Option<Instructions>> = OnceLock::new();
    *FASTEST.get_or_init(|| all().first().copied())
}

/// All instructions of this processor, fastest first.
fn all() -> Vec<Instructions> {
    instructions::all()
}

/// Name of the instructions that multiply bfloat16 numbers on this processor, if it has any.
pub(crate) fn name() -> Option<&'static str> {
    fastest().map(|instructions| match instructions {
        #[cfg(target_arch = "x86_64")]
        Instructions::Amx => "AMX",
        #[cfg(target_arch = "x86_64")]
        Instructions::Avx512 => "AVX-512 BF16",
    })
}

/// Instructions for products with matrices of these extents; `None` for products in f32.
pub(super) fn select(precision: Precision, extents: [usize; 2]) -> Option<Instructions> {
    let wanted = precision == Precision::Bf16 && extents.iter().all(|&extent| extent >= SMALLEST);
    fastest().filter(|_| wanted)
}

/// Number of pairs, with padding, of a product of this depth.
fn pairs(depth: usize) -> usize {
    depth.next_multiple_of(BLOCK) / 2
}

/// Size of the left matrix, packed, in floats.
pub(super) fn left_size(rows: usize, depth: usize) -> usize {
    rows.next_multiple_of(BLOCK) * pairs(depth)
}

/// Size of the right matrix, packed, in floats.
pub(super) fn right_size(depth: usize, columns: usize) -> usize {
    columns.next_multiple_of(BLOCK) * pairs(depth)
}

/// Packs `rows` rows as the left matrix.
pub(super) fn pack_left(by: Instructions, source: Rows, rows: usize, packed: &mut [f32]) {
    let packed = &mut packed[..left_size(rows, source.len())];
    instructions::pair_along_rows(by, source, rows, pairs(source.len()), packed);
}

/// Packs the transpose of `rows` rows as the left matrix: the depth of the product is `rows`.
pub(super) fn pack_transposed_left(
    by: Instructions,
    source: Rows,
    rows: usize,
    packed: &mut [f32],
) {
    let pairs = pairs(rows);
    assert!(packed.len() >= left_size(source.len(), rows));
    for (strip, packed) in packed.chunks_exact_mut(PANEL * pairs).enumerate() {
        let column = strip * PANEL;
        if column >= source.len() {
            break;
        }
        let (packed, _) = packed.as_chunks_mut::<PANEL>();
        let (tiles, _) = packed.as_chunks_mut::<PANEL>();
        for (i, tile) in tiles.iter_mut().enumerate() {
            let from = Place { rows, pair: i * PANEL, column };
            instructions::pair_across_rows(by, source, from, tile);
            instructions::transpose(by, tile);
        }
    }
}

/// Packs `rows` rows as the right matrix: the depth of the product is `rows`.
pub(super) fn pack_right(by: Instructions, source: Rows, rows: usize, packed: &mut [f32]) {
    let pairs = pairs(rows);
    let packed = &mut packed[..right_size(rows, source.len())];
    for (panel, packed) in packed.chunks_exact_mut(PANEL * pairs).enumerate() {
        let column = panel * PANEL;
        if column < source.len() {
            let from = Place { rows, pair: 0, column };
            instructions::pair_across_rows(by, source, from, packed.as_chunks_mut().0);
        } else {
            packed.fill(0.0);
        }
    }
}

/// Part of a matrix whose rows are paired.
#[derive(Clone, Copy)]
struct Place {
    /// Number of rows of the matrix; zeros follow them.
    rows: usize,
    /// First pair of rows.
    pair: usize,
    /// First of up to [`PANEL`] columns.
    column: usize,
}

/// Packs the right matrix of a product.
pub(super) fn pack_panels(by: Instructions, matrix: View) -> Buffer {
    use rayon::prelude::*;

    /// Minimal number of panels for one thread: packing fewer takes less time than waking another.
    const AT_LEAST: usize = 16;

    let View { data, rows, columns, row_stride, column_stride } = matrix;
    let pairs = pairs(rows);
    let mut packed = Buffer::take(right_size(rows, columns));
    let panels = packed.par_chunks_mut(PANEL * pairs).with_min_len(AT_LEAST);
    panels.enumerate().for_each(|(panel, packed)| {
        let start = panel * PANEL;
        if start >= columns {
            packed.fill(0.0);
            return;
        }
        let wide = PANEL.min(columns - start);
        let (packed, _) = packed.as_chunks_mut::<PANEL>();
        if column_stride == 1 {
            let source = Rows::strided(data, row_stride, columns);
            let from = Place { rows, pair: 0, column: start };
            instructions::pair_across_rows(by, source, from, packed);
        } else {
            assert_eq!(row_stride, 1, "rows or columns of the matrix are contiguous");
            let (blocks, _) = packed.as_chunks_mut::<PANEL>();
            for (block, packed) in blocks.iter_mut().enumerate() {
                let first = block * 2 * PANEL;
                for (column, packed) in packed.iter_mut().enumerate() {
                    let deep = if column < wide { (2 * PANEL).min(rows - first) } else { 0 };
                    let from = (start + column.min(wide - 1)) * column_stride + first;
                    instructions::pair_along(by, &data[from..from + deep], packed);
                }
                instructions::transpose(by, packed);
            }
        }
    });
    packed
}

/// Packed matrices of a product, `[rows, depth]` and `[depth, columns]`.
#[derive(Clone, Copy)]
pub(super) struct Factors<'a> {
    /// The left matrix.
    pub left: &'a [f32],
    /// The right matrix.
    pub right: &'a [f32],
    /// Number of rows of the left matrix.
    pub rows: usize,
    /// Number of columns of the left and of rows of the right matrix.
    pub depth: usize,
    /// Number of columns of the right matrix.
    pub columns: usize,
}

impl Factors<'_> {
    /// `out = epilogue(left · right)` or, if `add`, `out = epilogue(out + left · right)`, with rows
    /// `stride` apart.
    pub(super) fn multiply(
        self,
        by: Instructions,
        add: bool,
        epilogue: Epilogue,
        out: &mut [f32],
        stride: usize,
    ) {
        let Self { left, right, rows, depth, columns } = self;
        if rows == 0 || columns == 0 {
            return;
        }
        assert!(left.len() >= left_size(rows, depth) && right.len() >= right_size(depth, columns));
        assert!(columns <= stride && out.len() >= (rows - 1) * stride + columns);
        let pairs = pairs(depth);
        let kernel = instructions::Kernel::new(by);
        let mut tile = [0.0; BLOCK * BLOCK];
        for start in (0..columns).step_by(BLOCK) {
            let wide = BLOCK.min(columns - start);
            let right = &right[start * pairs..][..BLOCK * pairs];
            let bias = epilogue.bias.map(|bias| &bias[start..][..wide]);
            for first in (0..rows).step_by(BLOCK) {
                let tall = BLOCK.min(rows - first);
                let left = &left[first * pairs..][..BLOCK * pairs];
                let out = &mut out[first * stride + start..];
                if wide == BLOCK && tall == BLOCK {
                    kernel.block(left, right, pairs, add, out, stride);
                } else {
                    kernel.block(left, right, pairs, false, &mut tile, BLOCK);
                    for (i, row) in tile.chunks_exact(BLOCK).enumerate().take(tall) {
                        let out = &mut out[i * stride..][..wide];
                        for (out, sum) in out.iter_mut().zip(row) {
                            *out = if add { *out + sum } else { *sum };
                        }
                    }
                }
                if bias.is_some() || epilogue.slope.is_some() {
                    instructions::finish(by, bias, epilogue.slope, out, stride, [tall, wide]);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests;
