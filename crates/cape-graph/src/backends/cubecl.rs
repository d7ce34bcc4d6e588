use std::sync::Arc;

use burn::backend::tensor::{FloatTensor, IntTensor};
use burn_cubecl::{CubeBackend, kernel::into_contiguous, tensor::CubeTensor};
use cubecl::prelude::*;

use crate::{ops::GraphBackend, sparse::SparsePair};

const THREADS: u32 = 256;
/// Below every runtime's limit on workgroups along one axis.
const MAX_GROUPS: u32 = 32768;

/// One thread an output element, neighbouring threads on neighbouring channels. The offsets into
/// `index` and `value` are arguments at run time, so that one compiled kernel serves every matrix.
#[cube(launch)]
fn sparse_matmul_kernel(
    x: &Tensor<f32>,
    index: &Tensor<i32>,
    value: &Tensor<f32>,
    out: &mut Tensor<f32>,
    start: usize,
    column: usize,
    first_value: usize,
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
        out[ABSOLUTE_POS] = sum;
    }
}

impl GraphBackend for CubeBackend {
    fn sparse_matmul(
        x: FloatTensor<Self>,
        index: IntTensor<Self>,
        value: FloatTensor<Self>,
        matrix: Arc<SparsePair>,
        transpose: bool,
    ) -> FloatTensor<Self> {
        let x = into_contiguous(x);
        let dims = x.meta.shape();
        let (batch, channels) = (dims[0], dims[2]);
        let rows = matrix.oriented(transpose).rows();
        let shape = burn::tensor::Shape::from(vec![batch, rows, channels]);
        let elements = shape.num_elements();
        let buffer = x.client.empty(elements * size_of::<f32>());
        let out =
            CubeTensor::new_contiguous(x.client.clone(), x.device.clone(), shape, buffer, x.dtype);
        let groups = (elements as u32).div_ceil(THREADS).max(1);
        let count = CubeCount::Static(groups.min(MAX_GROUPS), groups.div_ceil(MAX_GROUPS), 1);
        let offsets = matrix.offsets(transpose);
        sparse_matmul_kernel::launch(
            &out.client,
            count,
            CubeDim::new_1d(THREADS),
            x.into_tensor_arg(),
            index.into_tensor_arg(),
            value.into_tensor_arg(),
            out.clone().into_tensor_arg(),
            offsets.start,
            offsets.column,
            offsets.value,
        );
        out
    }
}
