// Burn deprecates its ndarray backend in favour of flex; it is kept while Burn ships it.
#![allow(deprecated)]

use std::sync::Arc;

use burn::backend::{
    NdArray, TensorMetadata,
    tensor::{FloatTensor, IntTensor},
};
use burn::tensor::{Shape, TensorData};
use burn_ndarray::NdArrayTensor;

use super::cpu::{self, Conv, NormShape};
use crate::{ops::GraphBackend, sparse::SparsePair};

/// The values in row-major order.
fn values(tensor: NdArrayTensor) -> Vec<f32> {
    let NdArrayTensor::F32(storage) = tensor else {
        unreachable!("checked to be f32");
    };
    let array = storage.into_shared();
    if array.is_standard_layout() {
        let (values, offset) = array.into_owned().into_raw_vec_and_offset();
        if offset.unwrap_or(0) == 0 { values } else { values[offset.unwrap_or(0)..].to_vec() }
    } else {
        array.iter().copied().collect()
    }
}

fn tensor(values: Vec<f32>, shape: impl Into<Shape>) -> NdArrayTensor {
    NdArrayTensor::from_data(TensorData::new(values, shape.into()))
}

fn dims(tensor: &NdArrayTensor) -> [usize; 3] {
    let shape = tensor.shape();
    [shape[0], shape[1], shape[2]]
}

fn conv<'a>(
    x: &NdArrayTensor,
    weight: &NdArrayTensor,
    laplacian: &'a SparsePair,
    order: usize,
) -> Conv<'a> {
    let [_, vertices, input] = dims(x);
    Conv { laplacian, order, vertices, input, output: weight.shape()[1] }
}

fn norm_shape(x: &NdArrayTensor, groups: usize, epsilon: f64) -> NormShape {
    let [_, vertices, channels] = dims(x);
    NormShape { vertices, channels, groups, epsilon: epsilon as f32 }
}

impl GraphBackend for NdArray {
    fn sparse_matmul(
        x: FloatTensor<Self>,
        _index: IntTensor<Self>,
        _value: FloatTensor<Self>,
        matrix: Arc<SparsePair>,
        transpose: bool,
    ) -> FloatTensor<Self> {
        let [batch, _, channels] = dims(&x);
        let a = matrix.oriented(transpose);
        tensor(cpu::sparse_matmul(&values(x), a, channels), [batch, a.rows(), channels])
    }

    fn cheb_conv(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        _index: IntTensor<Self>,
        _value: FloatTensor<Self>,
        matrix: Arc<SparsePair>,
        order: usize,
    ) -> FloatTensor<Self> {
        let conv = conv(&x, &weight, &matrix, order);
        let shape = [dims(&x)[0], conv.vertices, conv.output];
        tensor(cpu::cheb_conv(&values(x), &values(weight), conv), shape)
    }

    fn cheb_conv_backward(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        _index: IntTensor<Self>,
        _value: FloatTensor<Self>,
        matrix: Arc<SparsePair>,
        order: usize,
        want_x: bool,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        let conv = conv(&x, &weight, &matrix, order);
        let (x_shape, weight_shape) = (x.shape(), weight.shape());
        let (x, weight, grad) = (values(x), values(weight), values(grad));
        let (grad_x, grad_weight) = cpu::cheb_conv_backward(&x, &weight, &grad, conv, want_x);
        let grad_x = if want_x { grad_x } else { x };
        (tensor(grad_x, x_shape), tensor(grad_weight, weight_shape))
    }

    fn bias_leaky_relu(
        x: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        slope: f64,
    ) -> FloatTensor<Self> {
        let shape = x.shape();
        let mut y = values(x);
        cpu::bias_leaky_relu(&mut y, &values(bias), slope as f32);
        tensor(y, shape)
    }

    fn bias_leaky_relu_backward(
        y: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        slope: f64,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        let shape = y.shape();
        let channels = shape[2];
        let mut grad = values(grad);
        let bias = cpu::bias_leaky_relu_backward(&values(y), &mut grad, channels, slope as f32);
        (tensor(grad, shape), tensor(bias, [channels]))
    }

    fn group_norm_relu(
        x: FloatTensor<Self>,
        gamma: FloatTensor<Self>,
        beta: FloatTensor<Self>,
        groups: usize,
        epsilon: f64,
    ) -> FloatTensor<Self> {
        let (shape, norm) = (x.shape(), norm_shape(&x, groups, epsilon));
        let y = cpu::group_norm_relu(&values(x), &values(gamma), &values(beta), norm);
        tensor(y, shape)
    }

    fn group_norm_relu_backward(
        x: FloatTensor<Self>,
        gamma: FloatTensor<Self>,
        beta: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        groups: usize,
        epsilon: f64,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>) {
        let (shape, norm) = (x.shape(), norm_shape(&x, groups, epsilon));
        let (x, grad) = (values(x), values(grad));
        let (gamma, beta) = (values(gamma), values(beta));
        let (grad_x, grad_gamma, grad_beta) =
            cpu::group_norm_relu_backward(&x, &gamma, &beta, &grad, norm);
        (
            tensor(grad_x, shape),
            tensor(grad_gamma, [norm.channels]),
            tensor(grad_beta, [norm.channels]),
        )
    }
}
