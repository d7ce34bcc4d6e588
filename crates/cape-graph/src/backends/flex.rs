use std::sync::Arc;

use burn::backend::{
    Flex,
    tensor::{FloatTensor, IntTensor},
};
use burn::tensor::{Shape, TensorData};
use burn_flex::FlexTensor;

use super::cpu::{self, Conv, NormShape};
use crate::{ops::GraphBackend, sparse::SparsePair};

fn slice(tensor: &FlexTensor) -> &[f32] {
    tensor.as_slice::<f32>().unwrap_or_else(|| unreachable!("made contiguous, checked to be f32"))
}

fn tensor(values: Vec<f32>, shape: impl Into<Shape>) -> FlexTensor {
    FlexTensor::from_data(TensorData::new(values, shape.into()))
}

fn dims(tensor: &FlexTensor) -> [usize; 3] {
    let shape = tensor.layout().shape();
    [shape[0], shape[1], shape[2]]
}

fn conv<'a>(
    x: &FlexTensor,
    weight: &FlexTensor,
    laplacian: &'a SparsePair,
    order: usize,
) -> Conv<'a> {
    let [_, vertices, input] = dims(x);
    Conv { laplacian, order, vertices, input, output: weight.layout().shape()[1] }
}

fn norm_shape(x: &FlexTensor, groups: usize, epsilon: f64) -> NormShape {
    let [_, vertices, channels] = dims(x);
    NormShape { vertices, channels, groups, epsilon: epsilon as f32 }
}

impl GraphBackend for Flex {
    fn sparse_matmul(
        x: FloatTensor<Self>,
        _index: IntTensor<Self>,
        _value: FloatTensor<Self>,
        matrix: Arc<SparsePair>,
        transpose: bool,
    ) -> FloatTensor<Self> {
        let x = x.to_contiguous();
        let [batch, _, channels] = dims(&x);
        let a = matrix.oriented(transpose);
        tensor(cpu::sparse_matmul(slice(&x), a, channels), [batch, a.rows(), channels])
    }

    fn cheb_conv(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        _index: IntTensor<Self>,
        _value: FloatTensor<Self>,
        matrix: Arc<SparsePair>,
        order: usize,
    ) -> FloatTensor<Self> {
        let (x, weight) = (x.to_contiguous(), weight.to_contiguous());
        let conv = conv(&x, &weight, &matrix, order);
        let shape = [dims(&x)[0], conv.vertices, conv.output];
        tensor(cpu::cheb_conv(slice(&x), slice(&weight), conv), shape)
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
        let (x, weight, grad) = (x.to_contiguous(), weight.to_contiguous(), grad.to_contiguous());
        let conv = conv(&x, &weight, &matrix, order);
        let (grad_x, grad_weight) =
            cpu::cheb_conv_backward(slice(&x), slice(&weight), slice(&grad), conv, want_x);
        let grad_weight = tensor(grad_weight, weight.layout().shape().clone());
        let grad_x = if want_x { tensor(grad_x, x.layout().shape().clone()) } else { x };
        (grad_x, grad_weight)
    }

    fn bias_leaky_relu(
        x: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        slope: f64,
    ) -> FloatTensor<Self> {
        let (mut x, bias) = (x.to_contiguous(), bias.to_contiguous());
        cpu::bias_leaky_relu(storage(&mut x), slice(&bias), slope as f32);
        x
    }

    fn bias_leaky_relu_backward(
        y: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        slope: f64,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        let (y, mut grad) = (y.to_contiguous(), grad.to_contiguous());
        let channels = dims(&y)[2];
        let bias =
            cpu::bias_leaky_relu_backward(slice(&y), storage(&mut grad), channels, slope as f32);
        (grad, tensor(bias, [channels]))
    }

    fn group_norm_relu(
        x: FloatTensor<Self>,
        gamma: FloatTensor<Self>,
        beta: FloatTensor<Self>,
        groups: usize,
        epsilon: f64,
    ) -> FloatTensor<Self> {
        let (x, gamma, beta) = (x.to_contiguous(), gamma.to_contiguous(), beta.to_contiguous());
        let shape = norm_shape(&x, groups, epsilon);
        let y = cpu::group_norm_relu(slice(&x), slice(&gamma), slice(&beta), shape);
        tensor(y, x.layout().shape().clone())
    }

    fn group_norm_relu_backward(
        x: FloatTensor<Self>,
        gamma: FloatTensor<Self>,
        beta: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        groups: usize,
        epsilon: f64,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>) {
        let (x, grad) = (x.to_contiguous(), grad.to_contiguous());
        let (gamma, beta) = (gamma.to_contiguous(), beta.to_contiguous());
        let shape = norm_shape(&x, groups, epsilon);
        let (grad_x, grad_gamma, grad_beta) = cpu::group_norm_relu_backward(
            slice(&x),
            slice(&gamma),
            slice(&beta),
            slice(&grad),
            shape,
        );
        (
            tensor(grad_x, x.layout().shape().clone()),
            tensor(grad_gamma, [shape.channels]),
            tensor(grad_beta, [shape.channels]),
        )
    }
}

/// The values of a contiguous tensor, copied first if they are shared.
fn storage(tensor: &mut FlexTensor) -> &mut [f32] {
    let (start, end) = tensor
        .layout()
        .contiguous_offsets()
        .unwrap_or_else(|| unreachable!("made contiguous before"));
    &mut tensor.storage_mut::<f32>()[start..end]
}
