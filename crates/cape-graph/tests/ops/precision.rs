//! Convolutions in bfloat16 beside the same in single precision.

use burn::tensor::Tensor;
use cape_graph::{ConvGraph, Epilogue, GroupNorm, Precision, cheb_conv, norm_conv};

use crate::{
    fused::selection,
    support::{Op, cpu_devices, random, run, sparse},
};

/// Norm of the difference relative to that of the values in single precision. The factors of a product
/// have 8 bits of mantissa: each is off by 0.1 % on the average of its magnitude, at most by 0.4 %.
fn difference(found: &[f32], single: &[f32]) -> f64 {
    let square =
        |values: &mut dyn Iterator<Item = f32>| values.map(|x| f64::from(x * x)).sum::<f64>();
    let apart = square(&mut found.iter().zip(single).map(|(a, b)| a - b));
    (apart / square(&mut single.iter().copied())).sqrt()
}

#[test]
fn values_and_gradients_are_near_those_in_single_precision() {
    let (batch, vertices, input, output, order) = (2, 301, 64, 96, 2);
    let matrix = sparse(41, vertices, vertices, 6, true);
    let inputs = [
        random(42, batch * vertices * input),
        random(43, input * order * output),
        random(44, input),
        random(45, input),
        random(46, order * output),
    ];
    for (name, device) in cpu_devices() {
        let outcomes = [Precision::F32, Precision::Bf16].map(|precision| {
            let graph = ConvGraph::new(&matrix, None, &device).with_precision(precision);
            let pooled = ConvGraph::new(&matrix, Some(&selection(vertices)), &device);
            let pooled = pooled.with_precision(precision);
            let shape = [batch, vertices, input];
            let weight = |x: &Tensor<1>| x.clone().reshape([input * order, output]);
            let conv: Op = &|x| {
                let terms = x[4].clone().reshape([1, order, output]).expand([batch, order, output]);
                // No activation, whose gates would open or close near zero.
                let epilogue = Epilogue { constant_terms: Some(terms), slope: None };
                cheb_conv(x[0].clone().reshape(shape), weight(&x[1]), &graph, order, epilogue)
            };
            let pooled: Op = &|x| {
                let (gamma, beta) = (x[2].clone(), x[3].clone());
                let norm = GroupNorm { gamma, beta, groups: 8, epsilon: 1e-3 };
                norm_conv(
                    x[0].clone().reshape(shape),
                    None,
                    norm,
                    weight(&x[1]),
                    &pooled,
                    order,
                    None,
                )
            };
            [conv, pooled].map(|op| run(&device, &inputs, &[true; 5], op))
        });
        let [single, half] = outcomes;
        for (op, (single, half)) in ["cheb_conv", "norm_conv"].iter().zip(single.iter().zip(&half))
        {
            let off = difference(&half.output, &single.output);
            assert!(off < 4e-3, "{name}: {op} is off by {off:.1e}");
            if Precision::Bf16.instructions().is_some() {
                assert!(off > 1e-4, "{name}: {op} is in single precision, off by {off:.1e}");
            } else {
                assert_eq!(single, half, "{name}: {op}");
            }
            for (i, (half, single)) in half.gradients.iter().zip(&single.gradients).enumerate() {
                let (Some(half), Some(single)) = (half, single) else {
                    assert_eq!(half, single, "{name}: gradient {i} of {op}");
                    continue;
                };
                let off = difference(half, single);
                assert!(off < 4e-3, "{name}: gradient {i} of {op} is off by {off:.1e}");
            }
        }
    }
}
