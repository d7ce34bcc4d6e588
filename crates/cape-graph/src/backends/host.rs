//! The CPU backends: their tensors as slices for the kernels, which are the same for each.

use std::ops::Deref;

use burn::tensor::Shape;

use super::cpu::{Conv, Norm, NormConv};
use crate::{
    buffer::Buffer,
    operator::Operator,
    ops::{ConvSpec, NormConvSpec},
};

/// An f32 tensor in the memory of the host.
pub(super) trait HostTensor: Sized {
    /// Its numbers, row-major.
    type Values: Deref<Target = [f32]>;

    fn dims(&self) -> Vec<usize>;

    fn values(self) -> Self::Values;

    fn from_buffer(values: Buffer, shape: Shape) -> Self;

    /// Changes the numbers in place, or those of a copy if others share them.
    fn update(self, change: impl FnOnce(&mut [f32])) -> Self;
}

/// A tensor of these numbers.
pub(super) fn tensor<T: HostTensor>(values: Buffer, dims: &[usize]) -> T {
    T::from_buffer(values, Shape::from(dims.to_vec()))
}

/// A vector of these numbers.
pub(super) fn vector<T: HostTensor>(values: &[f32]) -> T {
    let mut buffer = Buffer::take(values.len());
    buffer.copy_from_slice(values);
    tensor(buffer, &[values.len()])
}

pub(super) fn conv<'a, T: HostTensor>(
    x: &T,
    weight: &T,
    operator: &'a Operator,
    spec: ConvSpec,
) -> Conv<'a> {
    let ConvSpec { order, rows, slope } = spec;
    let (input, output) = (x.dims()[2], weight.dims()[1]);
    Conv { operator, order, input, output, rows, slope: slope.map(|slope| slope as f32) }
}

pub(super) fn norm<T: HostTensor>(x: &T, constant: usize, groups: usize, epsilon: f64) -> Norm {
    let (vertices, channels) = (x.dims()[1], x.dims()[2]);
    Norm { vertices, channels, constant, groups, epsilon: epsilon as f32 }
}

pub(super) fn norm_conv<'a, T: HostTensor>(
    x: &T,
    weight: &T,
    operator: &'a Operator,
    spec: NormConvSpec,
) -> NormConv<'a> {
    let NormConvSpec { order, groups, epsilon, constant, .. } = spec;
    NormConv {
        norm: norm(x, constant, groups, epsilon),
        conv: conv(x, weight, operator, ConvSpec { order, rows: 0, slope: None }),
    }
}

/// Implements the operations for a backend whose tensors are [`HostTensor`]s.
macro_rules! host_backend {
    ($backend:ty) => {
        impl crate::ops::GraphBackend for $backend {
            fn sparse_matmul(
                x: FloatTensor<Self>,
                _index: IntTensor<Self>,
                _value: FloatTensor<Self>,
                matrix: Arc<SparsePair>,
                transpose: bool,
            ) -> FloatTensor<Self> {
                let dims = HostTensor::dims(&x);
                let a = matrix.oriented(transpose);
                let y = cpu::sparse_matmul(&x.values(), a, dims[2]);
                host::tensor(y, &[dims[0], a.rows(), dims[2]])
            }

            fn cheb_conv(
                x: FloatTensor<Self>,
                weight: FloatTensor<Self>,
                rows: FloatTensor<Self>,
                _index: IntTensor<Self>,
                _value: FloatTensor<Self>,
                operator: Arc<Operator>,
                spec: ConvSpec,
            ) -> FloatTensor<Self> {
                let conv = host::conv(&x, &weight, &operator, spec);
                let dims = [HostTensor::dims(&x)[0], operator.kept(), conv.output];
                let y = cpu::cheb_conv(&x.values(), &weight.values(), &rows.values(), conv);
                host::tensor(y, &dims)
            }

            fn cheb_conv_backward(
                x: FloatTensor<Self>,
                weight: FloatTensor<Self>,
                y: FloatTensor<Self>,
                grad: FloatTensor<Self>,
                _index: IntTensor<Self>,
                _value: FloatTensor<Self>,
                operator: Arc<Operator>,
                spec: ConvSpec,
                want_x: bool,
                want_weight: bool,
            ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>) {
                let conv = host::conv(&x, &weight, &operator, spec);
                let (dims, weight_dims) = (HostTensor::dims(&x), HostTensor::dims(&weight));
                let rows = [dims[0], spec.rows, conv.output];
                let gradients = cpu::cheb_conv_backward(
                    &x.clone().values(),
                    &weight.clone().values(),
                    &y.values(),
                    &grad.values(),
                    conv,
                    want_x,
                    want_weight,
                );
                (
                    gradients.x.map_or(x, |grad| host::tensor(grad, &dims)),
                    if want_weight { host::tensor(gradients.weight, &weight_dims) } else { weight },
                    host::tensor(gradients.rows, &rows),
                )
            }

            fn norm_conv(
                x: FloatTensor<Self>,
                constant: FloatTensor<Self>,
                gamma: FloatTensor<Self>,
                beta: FloatTensor<Self>,
                weight: FloatTensor<Self>,
                base: FloatTensor<Self>,
                _index: IntTensor<Self>,
                _value: FloatTensor<Self>,
                operator: Arc<Operator>,
                spec: NormConvSpec,
            ) -> FloatTensor<Self> {
                let op = host::norm_conv(&x, &weight, &operator, spec);
                let dims = [HostTensor::dims(&x)[0], operator.kept(), op.conv.output];
                let inputs = cpu::Inputs {
                    x: &x.values(),
                    constant: &constant.values(),
                    gamma: &gamma.values(),
                    beta: &beta.values(),
                    weight: &weight.values(),
                };
                if spec.add {
                    return base.update(|y| cpu::norm_conv(inputs, op, true, y));
                }
                let mut y = Buffer::take(dims.iter().product());
                cpu::norm_conv(inputs, op, false, &mut y);
                host::tensor(y, &dims)
            }

            fn norm_conv_backward(
                x: FloatTensor<Self>,
                constant: FloatTensor<Self>,
                gamma: FloatTensor<Self>,
                beta: FloatTensor<Self>,
                weight: FloatTensor<Self>,
                grad: FloatTensor<Self>,
                _index: IntTensor<Self>,
                _value: FloatTensor<Self>,
                operator: Arc<Operator>,
                spec: NormConvSpec,
            ) -> (
                FloatTensor<Self>,
                FloatTensor<Self>,
                FloatTensor<Self>,
                FloatTensor<Self>,
                FloatTensor<Self>,
            ) {
                let op = host::norm_conv(&x, &weight, &operator, spec);
                let (dims, weight_dims) = (HostTensor::dims(&x), HostTensor::dims(&weight));
                let inputs = cpu::Inputs {
                    x: &x.values(),
                    constant: &constant.values(),
                    gamma: &gamma.values(),
                    beta: &beta.values(),
                    weight: &weight.values(),
                };
                let gradients = cpu::norm_conv_backward(inputs, &grad.values(), op);
                (
                    host::tensor(gradients.x, &dims),
                    host::tensor(gradients.constant, &[dims[0], spec.constant]),
                    host::vector(&gradients.gamma),
                    host::vector(&gradients.beta),
                    host::tensor(gradients.weight, &weight_dims),
                )
            }

            fn bias_leaky_relu(
                x: FloatTensor<Self>,
                bias: FloatTensor<Self>,
                slope: f64,
            ) -> FloatTensor<Self> {
                let bias = bias.values();
                x.update(|x| cpu::bias_leaky_relu(x, &bias, slope as f32))
            }

            fn bias_leaky_relu_backward(
                y: FloatTensor<Self>,
                grad: FloatTensor<Self>,
                slope: f64,
            ) -> (FloatTensor<Self>, FloatTensor<Self>) {
                let channels = HostTensor::dims(&y)[2];
                let (y, mut bias) = (y.values(), Vec::new());
                let grad = grad.update(|grad| {
                    bias = cpu::bias_leaky_relu_backward(&y, grad, channels, slope as f32);
                });
                (grad, host::vector(&bias))
            }

            fn group_norm_relu(
                x: FloatTensor<Self>,
                gamma: FloatTensor<Self>,
                beta: FloatTensor<Self>,
                groups: usize,
                epsilon: f64,
            ) -> FloatTensor<Self> {
                let (dims, norm) = (HostTensor::dims(&x), host::norm(&x, 0, groups, epsilon));
                let (x, gamma, beta) = (x.values(), gamma.values(), beta.values());
                host::tensor(cpu::group_norm_relu(&x, &gamma, &beta, norm), &dims)
            }

            fn group_norm_relu_backward(
                x: FloatTensor<Self>,
                gamma: FloatTensor<Self>,
                beta: FloatTensor<Self>,
                grad: FloatTensor<Self>,
                groups: usize,
                epsilon: f64,
            ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>) {
                let (dims, norm) = (HostTensor::dims(&x), host::norm(&x, 0, groups, epsilon));
                let (x, gamma) = (x.values(), gamma.values());
                let (grad_x, grad_gamma, grad_beta) =
                    cpu::group_norm_relu_backward(&x, &gamma, &beta.values(), &grad.values(), norm);
                (host::tensor(grad_x, &dims), host::vector(&grad_gamma), host::vector(&grad_beta))
            }
        }
    };
}

pub(super) use host_backend;
