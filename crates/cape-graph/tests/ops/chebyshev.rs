use burn::tensor::{Device, Tensor};
use cape_graph::{ConvGraph, Epilogue, cheb_conv, cheb_features};

use crate::{
    host,
    sparse::{dense, dense_matmul},
    support::{
        assert_agree, assert_host, assert_partial_tracking, devices, is_cpu, random, run, sparse,
    },
};

/// Batch, vertices, channels in, channels out, order. Batches above 8 are summed in groups.
const SIZES: [(usize, usize, usize, usize, usize); 13] = [
    (1, 1, 1, 1, 2),
    (1, 9, 1, 1, 1),
    (2, 13, 3, 2, 2),
    (3, 31, 7, 16, 3),
    (5, 17, 2, 33, 4),
    (11, 21, 16, 7, 5),
    (1, 65, 33, 64, 6),
    (2, 129, 64, 3, 2),
    (19, 23, 3, 1, 3),
    (8, 15, 1, 16, 2),
    (9, 35, 64, 64, 1),
    (1, 29, 544, 16, 2),
    (9, 15, 16, 544, 3),
];

fn composed_features(x: Tensor<3>, dense: &Tensor<3>, order: usize) -> Tensor<3> {
    let [batch, vertices, channels] = x.dims();
    let mut terms = vec![x];
    for k in 1..order {
        let next = dense_matmul(terms[k - 1].clone(), dense);
        terms.push(if k == 1 { next } else { next * 2.0 - terms[k - 2].clone() });
    }
    Tensor::stack::<4>(terms, 3).reshape([batch, vertices, channels * order])
}

fn composed_conv(x: Tensor<3>, weight: Tensor<2>, dense: &Tensor<3>, order: usize) -> Tensor<3> {
    let [batch, vertices, channels] = x.dims();
    let [rows, out] = weight.dims();
    let features = composed_features(x, dense, order);
    let flat: Tensor<2> = features.reshape([batch * vertices, channels * order]);
    assert_eq!(rows, channels * order);
    flat.matmul(weight).reshape([batch, vertices, out])
}

fn plain(x: Tensor<3>, weight: Tensor<2>, graph: &ConvGraph, order: usize) -> Tensor<3> {
    cheb_conv(x, weight, graph, order, Epilogue::default())
}

/// Square matrix, not symmetric, so that a missing transposition is detected.
fn square(vertices: usize, device: &Device) -> (sprs::CsMat<f64>, ConvGraph, Tensor<3>) {
    let matrix = sparse(11, vertices, vertices, 5, vertices.is_multiple_of(2));
    let a = ConvGraph::new(&matrix, None, device);
    let full = dense(&matrix, &device.clone().autodiff());
    (matrix, a, full)
}

#[test]
fn convolution_agrees_with_dense_products() {
    for (name, device) in devices() {
        for (batch, vertices, input, output, order) in SIZES {
            if input.max(output) > 64 && !is_cpu(&name) {
                continue;
            }
            let label = format!("{name}: [{batch}, {vertices}, {input}→{output}], order {order}");
            let (_, a, full) = square(vertices, &device);
            let inputs = [random(12, batch * vertices * input), random(13, input * order * output)];
            let (shape, weights) = ([batch, vertices, input], [input * order, output]);
            let fused = run(&device, &inputs, &[true, true], &|x| {
                plain(x[0].clone().reshape(shape), x[1].clone().reshape(weights), &a, order)
            });
            let composed = run(&device, &inputs, &[true, true], &|x| {
                let (x, weight) = (x[0].clone().reshape(shape), x[1].clone().reshape(weights));
                composed_conv(x, weight, &full, order)
            });
            assert_agree(&label, &fused, &composed, 5e-6);
        }
    }
}

#[test]
fn convolution_agrees_with_finite_differences() {
    for (name, device) in devices() {
        for order in 1..=6 {
            for (batch, vertices, input, output) in [(1, 5, 2, 3), (3, 4, 1, 2), (11, 3, 2, 1)] {
                let (matrix, a, _) = square(vertices, &device);
                let inputs =
                    [random(14, batch * vertices * input), random(15, input * order * output)];
                let outcome = run(&device, &inputs, &[true, true], &|x| {
                    let weight = x[1].clone().reshape([input * order, output]);
                    plain(x[0].clone().reshape([batch, vertices, input]), weight, &a, order)
                });
                let label = format!("{name}: order {order}, batch {batch}");
                assert_host(&label, &outcome, &inputs, &|x| {
                    host::cheb_conv(&x[0], &x[1], &matrix, input, order)
                });
            }
        }
    }
}

#[test]
fn features_agree_with_dense_products_and_finite_differences() {
    for (name, device) in devices() {
        for (order, (batch, vertices, channels)) in
            (1..=6).zip([(1, 5, 3), (2, 4, 1), (1, 7, 2), (3, 3, 3), (11, 3, 1), (1, 6, 2)])
        {
            let (matrix, a, full) = square(vertices, &device);
            let inputs = [random(16, batch * vertices * channels)];
            let shape = [batch, vertices, channels];
            let label = format!("{name}: order {order}");
            let sparse = run(&device, &inputs, &[true], &|x| {
                cheb_features(x[0].clone().reshape(shape), &a.laplacian(), order)
            });
            let composed = run(&device, &inputs, &[true], &|x| {
                composed_features(x[0].clone().reshape(shape), &full, order)
            });
            assert_agree(&label, &sparse, &composed, 2e-6);
            assert_host(&label, &sparse, &inputs, &|x| {
                host::cheb_features(&x[0], &matrix, channels, order)
            });
        }
    }
}

#[test]
fn convolution_takes_strided_inputs() {
    let (batch, vertices, input, output, order) = (3, 11, 5, 4, 3);
    for (name, device) in devices() {
        let (_, a, full) = square(vertices, &device);
        let inputs =
            [random(17, batch * vertices * input), random(18, (input * order + 2) * (output + 3))];
        let shaped = |x: &[Tensor<1>]| {
            let weight = x[1].clone().reshape([output + 3, input * order + 2]).swap_dims(0, 1);
            (
                x[0].clone().reshape([input, vertices, batch]).swap_dims(0, 2),
                weight.slice([2..input * order + 2, 2..output + 2]),
            )
        };
        let fused = run(&device, &inputs, &[true, true], &|x| {
            let (x, weight) = shaped(x);
            // The incoming gradient is strided too.
            plain(x, weight, &a, order).swap_dims(1, 2)
        });
        let composed = run(&device, &inputs, &[true, true], &|x| {
            let (x, weight) = shaped(x);
            composed_conv(x, weight, &full, order).swap_dims(1, 2)
        });
        assert_agree(&name, &fused, &composed, 5e-6);
    }
}

#[test]
fn convolution_gives_only_the_gradients_asked_for() {
    for (name, device) in devices() {
        for (batch, order) in [(2, 1), (11, 3)] {
            let (_, a, _) = square(7, &device);
            let inputs = [random(19, batch * 7 * 3), random(20, 3 * order * 2)];
            assert_partial_tracking(&name, &device, &inputs, &|x| {
                let weight = x[1].clone().reshape([3 * order, 2]);
                plain(x[0].clone().reshape([batch, 7, 3]), weight, &a, order)
            });
        }
    }
}

#[test]
#[should_panic(expected = "cheb_conv: weight is [7, 2] but x has 3 channels and the order is 2")]
fn convolution_refuses_other_weights() {
    let (_, device) = devices().swap_remove(0);
    let (_, a, _) = square(4, &device);
    plain(Tensor::zeros([1, 4, 3], &device), Tensor::zeros([7, 2], &device), &a, 2);
}

#[test]
#[should_panic(expected = "cheb_conv: x has 5 vertices but the Laplacian is [4, 4]")]
fn convolution_refuses_other_vertices() {
    let (_, device) = devices().swap_remove(0);
    let (_, a, _) = square(4, &device);
    plain(Tensor::zeros([1, 5, 3], &device), Tensor::zeros([6, 2], &device), &a, 2);
}
