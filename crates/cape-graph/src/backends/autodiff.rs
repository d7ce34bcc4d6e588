use std::sync::Arc;

use burn::backend::{
    Autodiff, Backend,
    autodiff::{
        checkpoint::{base::Checkpointer, strategy::CheckpointStrategy},
        grads::Gradients,
        ops::{Backward, Ops, OpsKind, unary},
    },
    tensor::{FloatTensor, IntTensor},
};

use crate::{
    operator::Operator,
    ops::{ConvSpec, GraphBackend, NormConvSpec},
    sparse::SparsePair,
};

/// Inputs that gradients are computed from.
type Kept<B, const N: usize> = [FloatTensor<B>; N];
/// A graph: structure, values, and both on the host.
type Constants<B> = (IntTensor<B>, FloatTensor<B>, Arc<Operator>);

/// Hands each gradient to its parent, if that is tracked.
macro_rules! register {
    ($parents:expr, $gradients:expr, $grads:expr) => {
        for (parent, gradient) in $parents.into_iter().zip($gradients) {
            if let Some(parent) = parent {
                $grads.register::<B>(parent.id, gradient);
            }
        }
    };
}

// The `*_backward` operations keep their composed form here, which is itself differentiable.
#[allow(clippy::redundant_closure_for_method_calls)] // the type is not public
impl<B: Backend + GraphBackend, C: CheckpointStrategy> GraphBackend for Autodiff<B, C> {
    fn sparse_matmul(
        x: FloatTensor<Self>,
        index: IntTensor<Self>,
        value: FloatTensor<Self>,
        matrix: Arc<SparsePair>,
        transpose: bool,
    ) -> FloatTensor<Self> {
        #[derive(Debug)]
        struct SparseMatmul;
        impl<B: GraphBackend> Backward<B, 1> for SparseMatmul {
            type State = (IntTensor<B>, FloatTensor<B>, Arc<SparsePair>, bool);
            fn backward(
                self,
                ops: Ops<Self::State, 1>,
                grads: &mut Gradients,
                _: &mut Checkpointer,
            ) {
                let (index, value, matrix, transpose) = ops.state;
                unary::<B, _>(ops.parents, ops.node, grads, |grad| {
                    B::sparse_matmul(grad, index, value, matrix, !transpose)
                });
            }
        }

        let node = x.node();
        let value = value.into_primitive();
        let out = B::sparse_matmul(
            x.into_primitive(),
            index.clone(),
            value.clone(),
            matrix.clone(),
            transpose,
        );
        match SparseMatmul.prepare::<C>([node]).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish((index, value, matrix, transpose), out),
            OpsKind::UnTracked(prep) => prep.finish(out),
        }
    }

    fn cheb_conv(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        rows: FloatTensor<Self>,
        index: IntTensor<Self>,
        value: FloatTensor<Self>,
        operator: Arc<Operator>,
        spec: ConvSpec,
    ) -> FloatTensor<Self> {
        #[derive(Debug)]
        struct ChebConv;
        impl<B: GraphBackend> Backward<B, 3> for ChebConv {
            type State = (Kept<B, 3>, Constants<B>, ConvSpec);
            fn backward(
                self,
                ops: Ops<Self::State, 3>,
                grads: &mut Gradients,
                _: &mut Checkpointer,
            ) {
                let ([x, weight, y], (index, value, operator), spec) = ops.state;
                let grad = grads.consume::<B>(&ops.node);
                let [want_x, want_weight, _] = ops.parents.each_ref().map(Option::is_some);
                let (x, weight, rows) = B::cheb_conv_backward(
                    x,
                    weight,
                    y,
                    grad,
                    index,
                    value,
                    operator,
                    spec,
                    want_x,
                    want_weight,
                );
                register!(ops.parents, [x, weight, rows], grads);
            }
        }

        let nodes = [x.node(), weight.node(), rows.node()];
        let (x, weight) = (x.into_primitive(), weight.into_primitive());
        let (rows, value) = (rows.into_primitive(), value.into_primitive());
        let out = B::cheb_conv(
            x.clone(),
            weight.clone(),
            rows,
            index.clone(),
            value.clone(),
            operator.clone(),
            spec,
        );
        match ChebConv.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => {
                // The gradient needs the output only to know where the activation bends.
                let y = if spec.slope.is_some() { out.clone() } else { weight.clone() };
                prep.finish(([x, weight, y], (index, value, operator), spec), out)
            }
            OpsKind::UnTracked(prep) => prep.finish(out),
        }
    }

    fn norm_conv(
        x: FloatTensor<Self>,
        constant: FloatTensor<Self>,
        gamma: FloatTensor<Self>,
        beta: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        base: FloatTensor<Self>,
        index: IntTensor<Self>,
        value: FloatTensor<Self>,
        operator: Arc<Operator>,
        spec: NormConvSpec,
    ) -> FloatTensor<Self> {
        #[derive(Debug)]
        struct NormConv;
        impl<B: GraphBackend> Backward<B, 6> for NormConv {
            type State = (Kept<B, 5>, Constants<B>, NormConvSpec);
            fn backward(
                self,
                ops: Ops<Self::State, 6>,
                grads: &mut Gradients,
                _: &mut Checkpointer,
            ) {
                let ([x, constant, gamma, beta, weight], (index, value, operator), spec) =
                    ops.state;
                let grad = grads.consume::<B>(&ops.node);
                let base = grad.clone();
                let (x, constant, gamma, beta, weight) = B::norm_conv_backward(
                    x, constant, gamma, beta, weight, grad, index, value, operator, spec,
                );
                let gradients = [x, constant, gamma, beta, weight, base];
                register!(ops.parents, gradients, grads);
            }
        }

        let inputs = [&x, &constant, &gamma, &beta, &weight, &base];
        let nodes = inputs.map(|input| input.node());
        let inputs = [x, constant, gamma, beta, weight].map(|input| input.into_primitive());
        let [x, constant, gamma, beta, weight] = inputs.clone();
        let (base, value) = (base.into_primitive(), value.into_primitive());
        let out = B::norm_conv(
            x,
            constant,
            gamma,
            beta,
            weight,
            base,
            index.clone(),
            value.clone(),
            operator.clone(),
            spec,
        );
        match NormConv.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish((inputs, (index, value, operator), spec), out),
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
                register!(ops.parents, [x, bias], grads);
            }
        }

        let nodes = [x.node(), bias.node()];
        let out = B::bias_leaky_relu(x.into_primitive(), bias.into_primitive(), slope);
        match BiasLeakyRelu.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish((out.clone(), slope), out),
            OpsKind::UnTracked(prep) => prep.finish(out),
        }
    }

    fn group_norm_relu(
        x: FloatTensor<Self>,
        gamma: FloatTensor<Self>,
        beta: FloatTensor<Self>,
        groups: usize,
        epsilon: f64,
    ) -> FloatTensor<Self> {
        #[derive(Debug)]
        struct GroupNormRelu;
        impl<B: GraphBackend> Backward<B, 3> for GroupNormRelu {
            type State = (FloatTensor<B>, FloatTensor<B>, FloatTensor<B>, usize, f64);
            fn backward(
                self,
                ops: Ops<Self::State, 3>,
                grads: &mut Gradients,
                _: &mut Checkpointer,
            ) {
                let (x, gamma, beta, groups, epsilon) = ops.state;
                let grad = grads.consume::<B>(&ops.node);
                let (grad_x, grad_gamma, grad_beta) =
                    B::group_norm_relu_backward(x, gamma, beta, grad, groups, epsilon);
                register!(ops.parents, [grad_x, grad_gamma, grad_beta], grads);
            }
        }

        let nodes = [x.node(), gamma.node(), beta.node()];
        let (x, gamma, beta) = (x.into_primitive(), gamma.into_primitive(), beta.into_primitive());
        let out = B::group_norm_relu(x.clone(), gamma.clone(), beta.clone(), groups, epsilon);
        match GroupNormRelu.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish((x, gamma, beta, groups, epsilon), out),
            OpsKind::UnTracked(prep) => prep.finish(out),
        }
    }
}
