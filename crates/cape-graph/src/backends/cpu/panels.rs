use rayon::prelude::*;

use super::{
    bf16::{self, Instructions},
    kernel::panel_width,
};
use crate::{Precision, buffer::Buffer};

/// Matrix packed for [`product`](super::kernel::product) into panels of columns, `[depth, width]`
/// each, the last one padded with zeros; or in bfloat16 as the right matrix of [`bf16`].
pub(super) struct Panels {
    data: Buffer,
    depth: usize,
    columns: usize,
    width: usize,
    by: Option<Instructions>,
}

/// Minimal number of panels for one thread: packing fewer takes less time than waking another.
const AT_LEAST: usize = 8;

/// View of a matrix with the strides of rows and columns.
#[derive(Clone, Copy)]
pub(super) struct View<'a> {
    /// Values.
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
    pub(super) fn pack(matrix: View, precision: Precision) -> Self {
        let View { data, rows, columns, row_stride, column_stride } = matrix;
        if let Some(by) = bf16::select(precision, [rows, columns]) {
            let data = bf16::pack_panels(by, matrix);
            return Self { data, depth: rows, columns, width: 0, by: Some(by) };
        }
        let width = panel_width();
        let mut packed = Buffer::take(columns.div_ceil(width) * width * rows);
        let panels = packed.par_chunks_mut((width * rows).max(1)).with_min_len(AT_LEAST);
        panels.enumerate().for_each(|(panel, packed)| {
            let start = panel * width;
            let wide = width.min(columns - start);
            if wide < width {
                packed.fill(0.0);
            }
            if column_stride == 1 {
                for (row, packed) in packed.chunks_exact_mut(width).enumerate() {
                    let from = row * row_stride + start;
                    packed[..wide].copy_from_slice(&data[from..from + wide]);
                }
            } else {
                // The values of a column are close together: eight at a time fill the cache
                // lines of the panel.
                for (block, packed) in packed.chunks_mut(width * 8).enumerate() {
                    for column in 0..wide {
                        let from = (start + column) * column_stride + block * 8 * row_stride;
                        let column = packed[column..].iter_mut().step_by(width);
                        for (i, packed) in column.enumerate() {
                            *packed = data[from + i * row_stride];
                        }
                    }
                }
            }
        });
        Self { data: packed, depth: rows, columns, width, by: None }
    }

    pub(super) fn depth(&self) -> usize {
        self.depth
    }

    pub(super) fn columns(&self) -> usize {
        self.columns
    }

    /// The matrix in bfloat16, and the instructions to multiply it with, if it was packed so.
    pub(super) fn bf16(&self) -> Option<(&[f32], Instructions)> {
        self.by.map(|by| (&*self.data, by))
    }

    /// `[depth, width]`, of a matrix that is not in bfloat16.
    pub(super) fn panel(&self, i: usize) -> &[f32] {
        &self.data[i * self.depth * self.width..][..self.depth * self.width]
    }
}
