//! Operations of the CPU backends: both pass their tensors as slices to the same kernels.

use std::ops::Deref;

use burn::{
    backend::{Backend, TensorMetadata, tensor::FloatTensor},
    tensor::Shape,
};

use super::cpu::{self, Conv, Norm, NormConv};
use crate::{
    buffer::Buffer,
    ops::{
        ChebConvGradients, ChebConvInputs, ChebConvSaved, ConvSpec, DeviceGraph,
        GroupNormGradients, GroupNormInputs, NormConvGradients, NormConvInputs, RequestedGradients,
        SparseOperand,
    },
    steps::{AdamState, AdamStep, MomentumStep},
};

/// Tensor of f32 in the memory of the host.
pub(super) trait HostTensor: TensorMetadata {
    /// Values of a contiguous tensor, row-major.
    type Values: Deref<Target = [f32]>;

    fn values(self) -> Self::Values;

    fn from_buffer(values: Buffer, shape: Shape) -> Self;

    /// Changes the values in place, or in a copy if the memory is shared.
    fn update(self, change: impl FnOnce(&mut [f32])) -> Self;
}

/// Backend with its float tensors in the memory of the host.
pub(super) trait HostBackend: Backend<FloatTensorPrimitive: HostTensor> {}

impl<B: Backend<FloatTensorPrimitive: HostTensor>> HostBackend for B {}

fn tensor<T: HostTensor, const D: usize>(values: Buffer, dims: [usize; D]) -> T {
    T::from_buffer(values, Shape::from(dims.to_vec()))
}

fn vector<T: HostTensor>(values: &[f32]) -> T {
    let mut buffer = Buffer::take(values.len());
    buffer.copy_from_slice(values);
    tensor(buffer, [values.len()])
}

fn dims<const D: usize>(x: &impl TensorMetadata) -> [usize; D] {
    let shape = x.shape();
    std::array::from_fn(|i| shape[i])
}

pub(super) fn sparse_matmul<B: HostBackend>(
    x: FloatTensor<B>,
    a: SparseOperand<B>,
) -> FloatTensor<B> {
    let ([batch, _, channels], a) = (dims(&x), a.matrix.oriented(a.transpose));
    tensor(cpu::sparse_matmul(&x.values(), a, channels), [batch, a.rows(), channels])
}

fn conv<'a, T: TensorMetadata, B: Backend>(
    x: &T,
    weight: &T,
    graph: &'a DeviceGraph<B>,
    spec: ConvSpec,
) -> Conv<'a> {
    let ([_, _, input], [_, output]) = (dims(x), dims(weight));
    let slope = spec.slope.map(|slope| slope as f32);
    Conv {
        graph: &graph.host,
        order: spec.order,
        input,
        output,
        constant_terms: 0,
        slope,
        precision: graph.precision,
    }
}

pub(super) fn cheb_conv<B: HostBackend>(inputs: ChebConvInputs<B>) -> FloatTensor<B> {
    let ChebConvInputs { x, weight, constant_terms, graph, spec } = inputs;
    let constant_terms = constant_terms.into_option();
    let count = constant_terms.as_ref().map_or(0, |terms| terms.shape()[1]);
    let conv = Conv { constant_terms: count, ..conv(&x, &weight, &graph, spec) };
    let dims = [x.shape()[0], graph.host.kept(), conv.output];
    let constant_terms = constant_terms.map(HostTensor::values);
    let constant_terms = constant_terms.as_deref().unwrap_or_default();
    tensor(cpu::cheb_conv(&x.values(), &weight.values(), constant_terms, conv), dims)
}

pub(super) fn cheb_conv_backward<B: HostBackend>(
    saved: ChebConvSaved<B>,
    grad: FloatTensor<B>,
    requested: RequestedGradients,
) -> ChebConvGradients<B> {
    let ChebConvSaved { x, weight, y, graph, spec, constant_terms } = saved;
    let conv = Conv { constant_terms, ..conv(&x, &weight, &graph, spec) };
    let (dims, weight_dims) = (dims::<3>(&x), dims::<2>(&weight));
    let y = y.into_option().map(HostTensor::values);
    let saved = cpu::Saved {
        x: &x.values(),
        weight: &weight.values(),
        y: y.as_deref().unwrap_or_default(),
    };
    let gradients = cpu::cheb_conv_backward(saved, &grad.values(), conv, requested);
    let terms_dims = [dims[0], constant_terms, conv.output];
    let terms = (constant_terms > 0).then(|| tensor(gradients.constant_terms, terms_dims));
    ChebConvGradients {
        x: gradients.x.map(|grad| tensor(grad, dims)).into(),
        weight: gradients.weight.map(|grad| tensor(grad, weight_dims)).into(),
        constant_terms: terms.into(),
    }
}

/// Extents of the normalisation of features and `constant` constant channels.
fn norm<B: Backend>(inputs: &GroupNormInputs<B>, constant: usize) -> Norm {
    let [_, vertices, channels] = dims(&inputs.x);
    let epsilon = inputs.epsilon as f32;
    Norm { vertices, channels, constant, groups: inputs.groups, epsilon }
}

/// Inputs of [`cpu::norm_conv`] as contiguous values.
struct NormConvValues<T: HostTensor> {
    x: T::Values,
    constant: Option<T::Values>,
    gamma: T::Values,
    beta: T::Values,
    weight: T::Values,
}

impl<T: HostTensor> NormConvValues<T> {
    fn slices(&self) -> cpu::Inputs<'_> {
        cpu::Inputs {
            x: &self.x,
            constant: self.constant.as_deref().unwrap_or_default(),
            gamma: &self.gamma,
            beta: &self.beta,
            weight: &self.weight,
        }
    }
}

/// Extents and values.
fn norm_conv_operands<B: HostBackend>(
    norm: GroupNormInputs<B>,
    constant: Option<FloatTensor<B>>,
    weight: FloatTensor<B>,
    graph: &DeviceGraph<B>,
    order: usize,
) -> (NormConv<'_>, NormConvValues<FloatTensor<B>>) {
    let constants = constant.as_ref().map_or(0, |constant| constant.shape()[1]);
    let op = NormConv {
        norm: self::norm(&norm, constants),
        conv: conv(&norm.x, &weight, graph, ConvSpec { order, slope: None }),
    };
    let values = NormConvValues {
        x: norm.x.values(),
        constant: constant.map(HostTensor::values),
        gamma: norm.gamma.values(),
        beta: norm.beta.values(),
        weight: weight.values(),
    };
    (op, values)
}

pub(super) fn norm_conv<B: HostBackend>(inputs: NormConvInputs<B>) -> FloatTensor<B> {
    let NormConvInputs { norm, constant, weight, base, graph, order } = inputs;
    let batch = norm.x.shape()[0];
    let (op, values) = norm_conv_operands(norm, constant.into_option(), weight, &graph, order);
    if let Some(base) = base.into_option() {
        return base.update(|y| cpu::norm_conv(values.slices(), op, true, y));
    }
    let dims = [batch, graph.host.kept(), op.conv.output];
    let mut y = Buffer::take(dims.iter().product());
    cpu::norm_conv(values.slices(), op, false, &mut y);
    tensor(y, dims)
}

pub(super) fn norm_conv_backward<B: HostBackend>(
    inputs: NormConvInputs<B>,
    grad: FloatTensor<B>,
) -> NormConvGradients<B> {
    let NormConvInputs { norm, constant, weight, graph, order, .. } = inputs;
    let (dims, weight_dims) = (dims::<3>(&norm.x), dims::<2>(&weight));
    let (op, values) = norm_conv_operands(norm, constant.into_option(), weight, &graph, order);
    let gradients = cpu::norm_conv_backward(values.slices(), &grad.values(), op);
    let constants = op.norm.constant;
    let constant = (constants > 0).then(|| tensor(gradients.constant, [dims[0], constants]));
    NormConvGradients {
        norm: GroupNormGradients {
            x: tensor(gradients.x, dims),
            gamma: vector(&gradients.gamma),
            beta: vector(&gradients.beta),
        },
        constant: constant.into(),
        weight: tensor(gradients.weight, weight_dims),
    }
}

pub(super) fn bias_leaky_relu<B: HostBackend>(
    x: FloatTensor<B>,
    bias: FloatTensor<B>,
    slope: f64,
) -> FloatTensor<B> {
    let bias = bias.values();
    x.update(|x| cpu::bias_leaky_relu(x, &bias, slope as f32))
}

pub(super) fn bias_leaky_relu_backward<B: HostBackend>(
    y: FloatTensor<B>,
    grad: FloatTensor<B>,
    slope: f64,
) -> (FloatTensor<B>, FloatTensor<B>) {
    let channels = y.shape()[2];
    let (y, mut bias) = (y.values(), Vec::new());
    let grad = grad.update(|grad| {
        bias = cpu::bias_leaky_relu_backward(&y, grad, channels, slope as f32);
    });
    (grad, vector(&bias))
}

pub(super) fn group_norm_relu<B: HostBackend>(inputs: GroupNormInputs<B>) -> FloatTensor<B> {
    let (dims, norm) = (dims::<3>(&inputs.x), norm(&inputs, 0));
    let (x, gamma, beta) = (inputs.x.values(), inputs.gamma.values(), inputs.beta.values());
    tensor(cpu::group_norm_relu(&x, &gamma, &beta, norm), dims)
}

pub(super) fn group_norm_relu_backward<B: HostBackend>(
    inputs: GroupNormInputs<B>,
    grad: FloatTensor<B>,
) -> GroupNormGradients<B> {
    let (dims, norm) = (dims::<3>(&inputs.x), norm(&inputs, 0));
    let (x, gamma, beta) = (inputs.x.values(), inputs.gamma.values(), inputs.beta.values());
    let (x, gamma, beta) = cpu::group_norm_relu_backward(&x, &gamma, &beta, &grad.values(), norm);
    GroupNormGradients { x: tensor(x, dims), gamma: vector(&gamma), beta: vector(&beta) }
}

pub(super) fn momentum_step<B: HostBackend>(
    value: FloatTensor<B>,
    gradient: FloatTensor<B>,
    velocity: FloatTensor<B>,
    step: MomentumStep,
) -> (FloatTensor<B>, FloatTensor<B>) {
    let (gradient, mut new_velocity) = (gradient.values(), None);
    let value = value.update(|value| {
        let update = |velocity: &mut [f32]| cpu::momentum_step(value, &gradient, velocity, step);
        new_velocity = Some(velocity.update(update));
    });
    (value, new_velocity.unwrap_or_else(|| unreachable!("the value was changed")))
}

pub(super) fn adam_step<B: HostBackend>(
    gradient: FloatTensor<B>,
    state: AdamState<B>,
    step: AdamStep,
) -> AdamState<B> {
    let AdamState { value, first, second } = state;
    let (gradient, mut moments) = (gradient.values(), None);
    let value = value.update(|value| {
        let mut new_second = None;
        let first = first.update(|first| {
            let update = |second: &mut [f32]| {
                cpu::adam_step(&gradient, [value, first, second], step);
            };
            new_second = Some(second.update(update));
        });
        moments = new_second.map(|second| (first, second));
    });
    let (first, second) = moments.unwrap_or_else(|| unreachable!("the value was changed"));
    AdamState { value, first, second }
}

pub(super) fn sum_of_squares<B: HostBackend>(
    x: FloatTensor<B>,
    sums: FloatTensor<B>,
    slot: usize,
) -> FloatTensor<B> {
    let sum = cpu::sum_of_squares(&x.values());
    sums.update(|sums| sums[slot] = sum)
}

/// Implements [`GraphBackend`](crate::ops::GraphBackend) for a [`HostBackend`].
macro_rules! host_backend {
    ($backend:ty) => {
        impl crate::ops::GraphBackend for $backend {
            fn sparse_matmul(
                x: FloatTensor<Self>,
                a: crate::ops::SparseOperand<Self>,
            ) -> FloatTensor<Self> {
                host::sparse_matmul(x, a)
            }

            fn cheb_conv(inputs: crate::ops::ChebConvInputs<Self>) -> FloatTensor<Self> {
                host::cheb_conv(inputs)
            }

            fn cheb_conv_backward(
                saved: crate::ops::ChebConvSaved<Self>,
                grad: FloatTensor<Self>,
                requested: crate::ops::RequestedGradients,
            ) -> crate::ops::ChebConvGradients<Self> {
                host::cheb_conv_backward(saved, grad, requested)
            }

            fn norm_conv(inputs: crate::ops::NormConvInputs<Self>) -> FloatTensor<Self> {
                host::norm_conv(inputs)
            }

            fn norm_conv_backward(
                inputs: crate::ops::NormConvInputs<Self>,
                grad: FloatTensor<Self>,
            ) -> crate::ops::NormConvGradients<Self> {
                host::norm_conv_backward(inputs, grad)
            }

            fn bias_leaky_relu(
                x: FloatTensor<Self>,
                bias: FloatTensor<Self>,
                slope: f64,
            ) -> FloatTensor<Self> {
                host::bias_leaky_relu::<Self>(x, bias, slope)
            }

            fn bias_leaky_relu_backward(
                y: FloatTensor<Self>,
                grad: FloatTensor<Self>,
                slope: f64,
            ) -> (FloatTensor<Self>, FloatTensor<Self>) {
                host::bias_leaky_relu_backward::<Self>(y, grad, slope)
            }

            fn group_norm_relu(inputs: crate::ops::GroupNormInputs<Self>) -> FloatTensor<Self> {
                host::group_norm_relu(inputs)
            }

            fn group_norm_relu_backward(
                inputs: crate::ops::GroupNormInputs<Self>,
                grad: FloatTensor<Self>,
            ) -> crate::ops::GroupNormGradients<Self> {
                host::group_norm_relu_backward(inputs, grad)
            }

            fn momentum_step(
                value: FloatTensor<Self>,
                gradient: FloatTensor<Self>,
                velocity: FloatTensor<Self>,
                step: crate::steps::MomentumStep,
            ) -> (FloatTensor<Self>, FloatTensor<Self>) {
                host::momentum_step::<Self>(value, gradient, velocity, step)
            }

            fn adam_step(
                gradient: FloatTensor<Self>,
                state: crate::steps::AdamState<Self>,
                step: crate::steps::AdamStep,
            ) -> crate::steps::AdamState<Self> {
                host::adam_step(gradient, state, step)
            }

            fn sum_of_squares(
                x: FloatTensor<Self>,
                sums: FloatTensor<Self>,
                slot: usize,
            ) -> FloatTensor<Self> {
                host::sum_of_squares::<Self>(x, sums, slot)
            }
        }
    };
}

pub(super) use host_backend;
