use rayon::prelude::*;

use super::kernel::panel_width;
use crate::buffer::Buffer;

/// A matrix packed for [`product`](super::kernel::product): panels of columns, each of its rows
/// contiguous, the last panel filled with zeros.
pub(super) struct Panels {
    data: Buffer,
    depth: usize,
    columns: usize,
    width: usize,
}

/// Panels packed side by side, so that what is read of a row is contiguous.
const TOGETHER: usize = 8;

/// A matrix in a slice, with the distances between rows and between columns.
#[derive(Clone, Copy)]
pub(super) struct View<'a> {
    /// Its numbers.
    pub data: &'a [f32],
    /// Number of rows.
    pub rows: usize,
    /// Number of columns.
    pub columns: usize,
    /// Distance between rows.
    pub row_stride: usize,
    /// Distance between columns.
    pub column_stride: usize,
}

impl View<'_> {
    pub(super) fn transposed(self) -> Self {
        Self {
            rows: self.columns,
            columns: self.rows,
            row_stride: self.column_stride,
            column_stride: self.row_stride,
            ..self
        }
    }
}

impl Panels {
    /// Packs `matrix`, on several threads.
    pub(super) fn pack(matrix: View) -> Self {
        let View { data, rows, columns, row_stride, column_stride } = matrix;
        let width = panel_width();
        let mut packed = Buffer::take(columns.div_ceil(width) * width * rows);
        let size = (width * rows).max(1);
        packed.par_chunks_mut(TOGETHER * size).enumerate().for_each(|(group, packed)| {
            let start = group * TOGETHER * width;
            let wide = (TOGETHER * width).min(columns - start);
            if !wide.is_multiple_of(width) {
                packed[wide / width * size..].fill(0.0);
            }
            if column_stride == 1 {
                for row in 0..rows {
                    let from = &data[row * row_stride + start..][..wide];
                    for (piece, panel) in from.chunks(width).zip(packed.chunks_exact_mut(size)) {
                        panel[row * width..][..piece.len()].copy_from_slice(piece);
                    }
                }
            } else {
                for (panel, packed) in packed.chunks_exact_mut(size).enumerate() {
                    let start = start + panel * width;
                    pack_columns(matrix, start, width.min(columns - start), width, packed);
                }
            }
        });
        Self { data: packed, depth: rows, columns, width }
    }

    pub(super) fn depth(&self) -> usize {
        self.depth
    }

    pub(super) fn columns(&self) -> usize {
        self.columns
    }

    /// `[depth, width]`.
    pub(super) fn panel(&self, i: usize) -> &[f32] {
        &self.data[i * self.depth * self.width..][..self.depth * self.width]
    }
}

/// Packs columns `start..start + wide` whose numbers are close together, unlike those of a row:
/// eight rows at a time fill the cache lines of the panel.
fn pack_columns(matrix: View, start: usize, wide: usize, width: usize, packed: &mut [f32]) {
    for (block, packed) in packed.chunks_mut(width * 8).enumerate() {
        for column in 0..wide {
            let from = (start + column) * matrix.column_stride + block * 8 * matrix.row_stride;
            for (i, packed) in packed[column..].iter_mut().step_by(width).enumerate() {
                *packed = matrix.data[from + i * matrix.row_stride];
            }
        }
    }
}
