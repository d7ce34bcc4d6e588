use burn::backend::{
    Autodiff, TensorMetadata,
    autodiff::{
        checkpoint::{base::Checkpointer, strategy::CheckpointStrategy},
        grads::Gradients,
        ops::{Backward, NodeGuard, Ops, OpsKind, unary},
    },
    tensor::FloatTensor,
};

use crate::ops::{
    ChebConvInputs, ChebConvSaved, DeviceGraph, GraphBackend, GroupNormInputs, NormConvInputs,
    OptionalTensor, RequestedGradients, SparseOperand,
};

/// Registers each gradient that exists with its parent, if that is tracked.
macro_rules! register {
    ($parents:expr, $gradients:expr, $grads:expr) => {
        for (parent, gradient) in $parents.into_iter().zip($gradients) {
            if let (Some(parent), Some(gradient)) = (parent, gradient) {
                $grads.register::<B>(parent.id, gradient);
            }
        }
    };
}

/// Node of an optional input; if it is absent, that of a constant, which is never tracked.
fn optional_node<B: GraphBackend, C: CheckpointStrategy>(
    input: &OptionalTensor<Autodiff<B, C>>,
    constant: &FloatTensor<Autodiff<B, C>>,
) -> NodeGuard {
    input.as_ref().unwrap_or(constant).node()
}

impl<B: GraphBackend, C: CheckpointStrategy> OptionalTensor<Autodiff<B, C>> {
    fn into_primitive(self) -> OptionalTensor<B> {
        match self {
            Self::Some(tensor) => OptionalTensor::Some(tensor.into_primitive()),
            Self::None => OptionalTensor::None,
        }
    }
}

impl<B: GraphBackend, C: CheckpointStrategy> SparseOperand<Autodiff<B, C>> {
    fn into_primitive(self) -> SparseOperand<B> {
        let Self { structure, values, matrix, transpose } = self;
        SparseOperand { structure, values: values.into_primitive(), matrix, transpose }
    }
}

impl<B: GraphBackend, C: CheckpointStrategy> DeviceGraph<Autodiff<B, C>> {
    fn into_primitive(self) -> DeviceGraph<B> {
        let Self { structure, values, host, precision } = self;
        DeviceGraph { structure, values: values.into_primitive(), host, precision }
    }
}

impl<B: GraphBackend, C: CheckpointStrategy> GroupNormInputs<Autodiff<B, C>> {
    fn into_primitive(self) -> GroupNormInputs<B> {
        let Self { x, gamma, beta, groups, epsilon } = self;
        GroupNormInputs {
            x: x.into_primitive(),
            gamma: gamma.into_primitive(),
            beta: beta.into_primitive(),
            groups,
            epsilon,
        }
    }
}

// The `*_backward` operations keep their composed form, which is itself differentiable.
impl<B: GraphBackend, C: CheckpointStrategy> GraphBackend for Autodiff<B, C> {
    fn sparse_matmul(x: FloatTensor<Self>, a: SparseOperand<Self>) -> FloatTensor<Self> {
        #[derive(Debug)]
        struct SparseMatmul;
        impl<B: GraphBackend> Backward<B, 1> for SparseMatmul {
            type State = SparseOperand<B>;
            fn backward(
                self,
                ops: Ops<Self::State, 1>,
                grads: &mut Gradients,
                _: &mut Checkpointer,
            ) {
                let a = SparseOperand { transpose: !ops.state.transpose, ..ops.state };
                unary::<B, _>(ops.parents, ops.node, grads, |grad| B::sparse_matmul(grad, a));
            }
        }

        let (node, a) = (x.node(), a.into_primitive());
        let out = B::sparse_matmul(x.into_primitive(), a.clone());
        match SparseMatmul.prepare::<C>([node]).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(a, out),
            OpsKind::UnTracked(prep) => prep.finish(out),
        }
    }

    fn cheb_conv(inputs: ChebConvInputs<Self>) -> FloatTensor<Self> {
        #[derive(Debug)]
        struct ChebConv;
        impl<B: GraphBackend> Backward<B, 3> for ChebConv {
            type State = ChebConvSaved<B>;
            fn backward(
                self,
                ops: Ops<Self::State, 3>,
                grads: &mut Gradients,
                _: &mut Checkpointer,
            ) {
                let grad = grads.consume::<B>(&ops.node);
                let [x, weight, _] = ops.parents.each_ref().map(Option::is_some);
                let requested = RequestedGradients { x, weight };
                let gradients = B::cheb_conv_backward(ops.state, grad, requested);
                let gradients = [gradients.x, gradients.weight, gradients.constant_terms];
                register!(ops.parents, gradients.map(OptionalTensor::into_option), grads);
            }
        }

        let ChebConvInputs { x, weight, constant_terms, graph, spec } = inputs;
        let constant_node = optional_node(&constant_terms, &graph.values);
        let nodes = [x.node(), weight.node(), constant_node];
        let (x, weight) = (x.into_primitive(), weight.into_primitive());
        let (constant_terms, graph) = (constant_terms.into_primitive(), graph.into_primitive());
        let mut saved = ChebConvSaved {
            x: x.clone(),
            weight: weight.clone(),
            y: OptionalTensor::None,
            graph: graph.clone(),
            spec,
            constant_terms: constant_terms.as_ref().map_or(0, |terms| terms.shape()[1]),
        };
        let out = B::cheb_conv(ChebConvInputs { x, weight, constant_terms, graph, spec });
        match ChebConv.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => {
                // The gradient needs the output only for the sign of the activation's input.
                saved.y = spec.slope.map(|_| out.clone()).into();
                prep.finish(saved, out)
            }
            OpsKind::UnTracked(prep) => prep.finish(out),
        }
    }

    fn norm_conv(inputs: NormConvInputs<Self>) -> FloatTensor<Self> {
        #[derive(Debug)]
        struct NormConv;
        impl<B: GraphBackend> Backward<B, 6> for NormConv {
            type State = NormConvInputs<B>;
            fn backward(
                self,
                ops: Ops<Self::State, 6>,
                grads: &mut Gradients,
                _: &mut Checkpointer,
            ) {
                let grad = grads.consume::<B>(&ops.node);
                let base = grad.clone();
                let gradients = B::norm_conv_backward(ops.state, grad);
                let norm = gradients.norm;
                let gradients = [
                    Some(norm.x),
                    gradients.constant.into_option(),
                    Some(norm.gamma),
                    Some(norm.beta),
                    Some(gradients.weight),
                    Some(base),
                ];
                register!(ops.parents, gradients, grads);
            }
        }

        let NormConvInputs { norm, constant, weight, base, graph, order } = inputs;
        let nodes = [
            norm.x.node(),
            optional_node(&constant, &graph.values),
            norm.gamma.node(),
            norm.beta.node(),
            weight.node(),
            optional_node(&base, &graph.values),
        ];
        let saved = NormConvInputs {
            norm: norm.into_primitive(),
            constant: constant.into_primitive(),
            weight: weight.into_primitive(),
            base: OptionalTensor::None,
            graph: graph.into_primitive(),
            order,
        };
        let base = base.into_primitive();
        let out = B::norm_conv(NormConvInputs { base, ..saved.clone() });
        match NormConv.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(saved, out),
            OpsKind::UnTracked(prep) => prep.finish(out),
        }
    }

    fn bias_leaky_relu(
        x: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        slope: f64,
    ) -> FloatTensor<Self> {
        #[derive(Debug)]
        struct BiasLeakyRelu;
        impl<B: GraphBackend> Backward<B, 2> for BiasLeakyRelu {
            type State = (FloatTensor<B>, f64);
            fn backward(
                self,
                ops: Ops<Self::State, 2>,
                grads: &mut Gradients,
                _: &mut Checkpointer,
            ) {
                let (y, slope) = ops.state;
                let grad = grads.consume::<B>(&ops.node);
                let (x, bias) = B::bias_leaky_relu_backward(y, grad, slope);
                register!(ops.parents, [Some(x), Some(bias)], grads);
            }
        }

        let nodes = [x.node(), bias.node()];
        let out = B::bias_leaky_relu(x.into_primitive(), bias.into_primitive(), slope);
        match BiasLeakyRelu.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish((out.clone(), slope), out),
            OpsKind::UnTracked(prep) => prep.finish(out),
        }
    }

    fn group_norm_relu(inputs: GroupNormInputs<Self>) -> FloatTensor<Self> {
        #[derive(Debug)]
        struct GroupNormRelu;
        impl<B: GraphBackend> Backward<B, 3> for GroupNormRelu {
            type State = GroupNormInputs<B>;
            fn backward(
                self,
                ops: Ops<Self::State, 3>,
                grads: &mut Gradients,
                _: &mut Checkpointer,
            ) {
                let grad = grads.consume::<B>(&ops.node);
                let gradients = B::group_norm_relu_backward(ops.state, grad);
                let gradients = [gradients.x, gradients.gamma, gradients.beta];
                register!(ops.parents, gradients.map(Some), grads);
            }
        }

        let nodes = [inputs.x.node(), inputs.gamma.node(), inputs.beta.node()];
        let inputs = inputs.into_primitive();
        let out = B::group_norm_relu(inputs.clone());
        match GroupNormRelu.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(inputs, out),
            OpsKind::UnTracked(prep) => prep.finish(out),
        }
    }
}
