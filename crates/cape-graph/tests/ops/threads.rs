//! Results do not depend on the number of threads.

use burn::tensor::Device;
use cape_graph::{
    ConvGraph, Epilogue, GroupNorm, Precision, bias_leaky_relu, cheb_conv, cheb_features,
    group_norm_relu, norm_conv, sparse_matmul,
};

use crate::{
    fused::selection,
    support::{Op, Outcome, cpu_devices, random, run, sparse},
};

#[test]
fn results_are_the_same_bytes_for_any_number_of_threads() {
    for (name, device, precision) in cases() {
        for (batch, vertices, input, output) in [
            (1, 701, 33, 64),
            (2, 1301, 64, 64),
            (3, 65, 3, 16),
            (11, 301, 16, 7),
            (1, 53, 544, 64),
        ] {
            let order = 3;
            let matrix = sparse(41, vertices, vertices, 6, true);
            let graph = ConvGraph::new(&matrix, None, &device).with_precision(precision);
            let pooled = ConvGraph::new(&matrix, Some(&selection(vertices)), &device);
            let pooled = pooled.with_precision(precision);
            let a = graph.laplacian();
            let inputs = [
                random(42, batch * vertices * input),
                random(43, input * order * output),
                random(44, input),
                random(45, input),
            ];
            let shape = [batch, vertices, input];
            let operations: [(&str, &[usize], Op); 7] = [
                ("sparse_matmul", &[0], &|x| sparse_matmul(x[0].clone().reshape(shape), &a)),
                ("cheb_features", &[0], &|x| cheb_features(x[0].clone().reshape(shape), &a, order)),
                ("cheb_conv", &[0, 1], &|x| {
                    let weight = x[1].clone().reshape([input * order, output]);
                    cheb_conv(
                        x[0].clone().reshape(shape),
                        weight,
                        &graph,
                        order,
                        Epilogue::default(),
                    )
                }),
                ("cheb_conv, pooled", &[0, 1, 3], &|x| {
                    let weight = x[1].clone().reshape([input * order, output]);
                    let terms = x[2].clone().slice(0..1).expand([batch, order, output]);
                    let epilogue = Epilogue { constant_terms: Some(terms), slope: Some(0.2) };
                    cheb_conv(x[0].clone().reshape(shape), weight, &pooled, order, epilogue)
                }),
                ("norm_conv", &[0, 1, 2, 3], &|x| {
                    let weight = x[1].clone().reshape([input * order, output]);
                    let (gamma, beta) = (x[2].clone(), x[3].clone());
                    let norm = GroupNorm { gamma, beta, groups: 1, epsilon: 1e-3 };
                    norm_conv(x[0].clone().reshape(shape), None, norm, weight, &pooled, order, None)
                }),
                ("bias_leaky_relu", &[0, 2], &|x| {
                    bias_leaky_relu(x[0].clone().reshape(shape), x[1].clone(), 0.2)
                }),
                ("group_norm_relu", &[0, 2, 3], &|x| {
                    let (gamma, beta) = (x[1].clone(), x[2].clone());
                    let norm = GroupNorm { gamma, beta, groups: 1, epsilon: 1e-3 };
                    group_norm_relu(x[0].clone().reshape(shape), norm)
                }),
            ];
            for (operation, used, op) in operations {
                let inputs: Vec<_> = used.iter().map(|&i| inputs[i].clone()).collect();
                let outcomes: Vec<Outcome> = [1, 2, 3]
                    .map(|threads| {
                        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
                        let tracked = vec![true; inputs.len()];
                        pool.unwrap().install(|| run(&device, &inputs, &tracked, op))
                    })
                    .into();
                for (i, other) in outcomes.iter().enumerate().skip(1) {
                    assert!(
                        &outcomes[0] == other,
                        "{name}, {precision:?}: {operation} of {shape:?} differs between 1 and {} threads",
                        i + 1
                    );
                }
            }
        }
    }
}

fn cases() -> Vec<(String, Device, Precision)> {
    let both = |(name, device): (String, Device)| {
        [Precision::F32, Precision::Bf16].map(|precision| (name.clone(), device.clone(), precision))
    };
    cpu_devices().into_iter().flat_map(both).collect()
}
