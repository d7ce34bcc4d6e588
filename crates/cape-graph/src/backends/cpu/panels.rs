use rayon::prelude::*;

use super::kernel::panel_width;
use crate::buffer::Buffer;

/// Matrix packed for [`product`](super::kernel::product) into panels of columns, `[depth, width]`
/// each; the last panel is padded with zeros.
pub(super) struct Panels {
    data: Buffer,
    depth: usize,
    columns: usize,
    width: usize,
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
    pub(super) fn pack(matrix: View) -> Self {
        let View { data, rows, columns, row_stride, column_stride } = matrix;
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
