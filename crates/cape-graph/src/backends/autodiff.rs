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

use crate::{ops::GraphBackend, sparse::SparsePair};

// The `*_backward` operations keep their composed form here, which is itself differentiable.
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
        index: IntTensor<Self>,
        value: FloatTensor<Self>,
        matrix: Arc<SparsePair>,
        order: usize,
    ) -> FloatTensor<Self> {
        #[derive(Debug)]
        struct ChebConv;
        impl<B: GraphBackend> Backward<B, 2> for ChebConv {
            type State = (
                FloatTensor<B>,
                FloatTensor<B>,
                IntTensor<B>,
                FloatTensor<B>,
                Arc<SparsePair>,
                usize,
            );
            fn backward(
                self,
                ops: Ops<Self::State, 2>,
                grads: &mut Gradients,
                _: &mut Checkpointer,
            ) {
                let (x, weight, index, value, matrix, order) = ops.state;
                let [x_node, weight_node] = ops.parents;
                let grad = grads.consume::<B>(&ops.node);
                let want_x = x_node.is_some();
                let (grad_x, grad_weight) =
                    B::cheb_conv_backward(x, weight, grad, index, value, matrix, order, want_x);
                if let Some(node) = x_node {
                    grads.register::<B>(node.id, grad_x);
                }
                if let Some(node) = weight_node {
                    grads.register::<B>(node.id, grad_weight);
                }
            }
        }

        let nodes = [x.node(), weight.node()];
        let (x, weight, value) =
            (x.into_primitive(), weight.into_primitive(), value.into_primitive());
        let out = B::cheb_conv(
            x.clone(),
            weight.clone(),
            index.clone(),
            value.clone(),
            matrix.clone(),
            order,
        );
        match ChebConv.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish((x, weight, index, value, matrix, order), out),
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
                let [x_node, bias_node] = ops.parents;
                let grad = grads.consume::<B>(&ops.node);
                let (grad_x, grad_bias) = B::bias_leaky_relu_backward(y, grad, slope);
                if let Some(node) = x_node {
                    grads.register::<B>(node.id, grad_x);
                }
                if let Some(node) = bias_node {
                    grads.register::<B>(node.id, grad_bias);
                }
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
                let gradients = [grad_x, grad_gamma, grad_beta];
                for (node, grad) in ops.parents.into_iter().zip(gradients) {
                    if let Some(node) = node {
                        grads.register::<B>(node.id, grad);
                    }
                }
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
