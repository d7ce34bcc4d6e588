use burn_cubecl::{kernel::into_contiguous, tensor::CubeTensor};
use cubecl::prelude::*;

use super::{dims, elementwise, empty};
use crate::sparse::SparsePair;

/// `out = A x`, or `alpha · A x + beta · base` unless `alone`: one thread an output element.
/// `start`, `column` and `first_value` are where the matrix lies in `index` and `value`.
#[cube(launch)]
#[allow(clippy::too_many_arguments)]
fn product_kernel(
    x: &Tensor<f32>,
    base: &Tensor<f32>,
    index: &Tensor<i32>,
    value: &Tensor<f32>,
    out: &mut Tensor<f32>,
    start: usize,
    column: usize,
    first_value: usize,
    alpha: f32,
    beta: f32,
    #[comptime] alone: bool,
) {
    if ABSOLUTE_POS < out.len() {
        let channels = out.shape(2);
        let rows = out.shape(1);
        let vertices = x.shape(1);
        let channel = ABSOLUTE_POS % channels;
        let row = (ABSOLUTE_POS / channels) % rows;
        let example = ABSOLUTE_POS / (channels * rows);
        let from = index[start + row] as usize;
        let to = index[start + row + 1] as usize;
        let mut sum = 0.0f32;
        for entry in from..to {
            let vertex = index[column + entry] as usize;
            sum +=
                value[first_value + entry] * x[(example * vertices + vertex) * channels + channel];
        }
        if alone {
            out[ABSOLUTE_POS] = sum;
        } else {
            out[ABSOLUTE_POS] = alpha * sum + beta * base[ABSOLUTE_POS];
        }
    }
}

/// A product with a sparse matrix on a device.
pub(super) struct Product<'a> {
    pub index: CubeTensor,
    pub value: CubeTensor,
    pub matrix: &'a SparsePair,
    pub transpose: bool,
}

impl Product<'_> {
    /// `A x`, or `alpha · A x + beta · base`; `x: [batch, columns, channels]`,
    /// `base: [batch, rows, channels]`.
    pub(super) fn of(self, x: CubeTensor, add: Option<(CubeTensor, f32, f32)>) -> CubeTensor {
        let x = into_contiguous(x);
        let [batch, _, channels] = dims(&x);
        let out = empty(&x, &[batch, self.matrix.oriented(self.transpose).rows(), channels]);
        let alone = add.is_none();
        let (base, alpha, beta) = match add {
            Some((base, alpha, beta)) => (into_contiguous(base), alpha, beta),
            None => (x.clone(), 1.0, 0.0),
        };
        let offsets = self.matrix.offsets(self.transpose);
        let (count, dim) = elementwise(&out);
        product_kernel::launch(
            &out.client,
            count,
            dim,
            x.into_tensor_arg(),
            base.into_tensor_arg(),
            self.index.into_tensor_arg(),
            self.value.into_tensor_arg(),
            out.clone().into_tensor_arg(),
            offsets.start,
            offsets.column,
            offsets.value,
            alpha,
            beta,
            alone,
        );
        out
    }
}
