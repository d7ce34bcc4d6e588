use burn::tensor::{Tensor, activation};
use cape_graph::{GroupNorm, bias_leaky_relu, group_norm_relu};

use crate::{
    host,
    support::{
        Op, assert_agree, assert_host, assert_partial_tracking, devices, is_cpu, random, run,
        upload, values,
    },
};

const EPSILON: f64 = 1e-3;

fn norm(gamma: &Tensor<1>, beta: &Tensor<1>, groups: usize) -> GroupNorm {
    GroupNorm { gamma: gamma.clone(), beta: beta.clone(), groups, epsilon: EPSILON }
}

fn composed_bias_leaky_relu(x: Tensor<3>, bias: Tensor<1>, slope: f64) -> Tensor<3> {
    let [_, _, channels] = x.dims();
    activation::leaky_relu(x + bias.reshape([1, 1, channels]), slope)
}

fn composed_group_norm_relu(
    x: Tensor<3>,
    gamma: Tensor<1>,
    beta: Tensor<1>,
    groups: usize,
) -> Tensor<3> {
    let shape = x.dims();
    let [batch, vertices, channels] = shape;
    let x: Tensor<4> = x.reshape([batch, vertices, groups, channels / groups]);
    let mean = x.clone().mean_dim(1).mean_dim(3);
    let centred = x - mean;
    let variance = (centred.clone() * centred.clone()).mean_dim(1).mean_dim(3);
    let unit: Tensor<3> = (centred / (variance + EPSILON).sqrt()).reshape(shape);
    activation::relu(unit * gamma.reshape([1, 1, channels]) + beta.reshape([1, 1, channels]))
}

#[test]
fn bias_leaky_relu_agrees_with_its_parts() {
    // The CPU kernel sums 4096 rows at a time.
    for (name, device) in devices() {
        for (batch, vertices, channels) in [
            (1, 1, 1),
            (1, 4099, 3),
            (3, 1, 1),
            (2, 33, 64),
            (5, 1001, 7),
            (11, 9, 16),
            (1, 17, 544),
        ] {
            if channels > 64 && !is_cpu(&name) {
                continue;
            }
            for slope in [0.2, 1e-3] {
                let inputs = [random(21, batch * vertices * channels), random(22, channels)];
                let shape = [batch, vertices, channels];
                let fused = run(&device, &inputs, &[true, true], &|x| {
                    bias_leaky_relu(x[0].clone().reshape(shape), x[1].clone(), slope)
                });
                let composed = run(&device, &inputs, &[true, true], &|x| {
                    composed_bias_leaky_relu(x[0].clone().reshape(shape), x[1].clone(), slope)
                });
                assert_agree(&format!("{name}: {shape:?}, {slope}"), &fused, &composed, 5e-6);
            }
        }
    }
}

#[test]
fn bias_leaky_relu_agrees_with_finite_differences() {
    for (name, device) in devices() {
        let inputs = [random(23, 2 * 5 * 3), random(24, 3)];
        let outcome = run(&device, &inputs, &[true, true], &|x| {
            bias_leaky_relu(x[0].clone().reshape([2, 5, 3]), x[1].clone(), 0.2)
        });
        assert_host(&name, &outcome, &inputs, &|x| host::bias_leaky_relu(&x[0], &x[1], 0.2));
    }
}

/// Inputs of `group_norm_relu`: `x` with a mean other than 0, `gamma` of both signs.
fn norm_inputs(batch: usize, vertices: usize, channels: usize) -> [Vec<f64>; 3] {
    let mut x = random(25, batch * vertices * channels);
    x.iter_mut().enumerate().for_each(|(i, x)| *x += (i % channels % 3) as f64 * 0.5);
    [x, random(26, channels), random(27, channels)]
}

#[test]
fn group_norm_relu_agrees_with_its_parts() {
    for (name, device) in devices() {
        for (batch, vertices, channels, groups) in [
            (1, 1, 2, 1),
            (2, 63, 2, 1),
            (3, 65, 3, 3),
            (1, 129, 7, 7),
            (5, 31, 16, 4),
            (11, 9, 64, 32),
            (2, 67, 33, 11),
            (1, 1027, 16, 8),
            (1, 25, 544, 32),
        ] {
            if channels > 64 && !is_cpu(&name) {
                continue;
            }
            let inputs = norm_inputs(batch, vertices, channels);
            let shape = [batch, vertices, channels];
            let fused = run(&device, &inputs, &[true; 3], &|x| {
                group_norm_relu(x[0].clone().reshape(shape), norm(&x[1], &x[2], groups))
            });
            let composed = run(&device, &inputs, &[true; 3], &|x| {
                let (gamma, beta) = (x[1].clone(), x[2].clone());
                composed_group_norm_relu(x[0].clone().reshape(shape), gamma, beta, groups)
            });
            assert_agree(&format!("{name}: {shape:?}, {groups} groups"), &fused, &composed, 2e-5);
        }
    }
}

#[test]
fn group_norm_relu_agrees_with_finite_differences() {
    for (name, device) in devices() {
        for (batch, vertices, channels, groups) in [(1, 5, 2, 1), (2, 3, 6, 3), (3, 4, 3, 3)] {
            let inputs = norm_inputs(batch, vertices, channels);
            let outcome = run(&device, &inputs, &[true; 3], &|x| {
                let features = x[0].clone().reshape([batch, vertices, channels]);
                group_norm_relu(features, norm(&x[1], &x[2], groups))
            });
            assert_host(&format!("{name}: {groups} groups"), &outcome, &inputs, &|x| {
                host::group_norm_relu(&x[0], &x[1], &x[2], vertices, groups, EPSILON)
            });
        }
    }
}

#[test]
fn group_norm_relu_of_a_constant_is_beta() {
    for (name, device) in devices() {
        let x = Tensor::full([1, 7, 4], 3.0, &device);
        let beta = [0.5, -0.5, 0.25, 0.0];
        let (gamma, beta) = (upload(&[2.0; 4], [4], &device), upload(&beta, [4], &device));
        let y = group_norm_relu(x, GroupNorm { epsilon: 1e-5, ..norm(&gamma, &beta, 2) });
        for row in values(y).chunks_exact(4) {
            assert_eq!(row, [0.5, 0.0, 0.25, 0.0], "{name}");
        }
    }
}

#[test]
fn activations_take_strided_inputs() {
    let (batch, vertices, channels) = (3, 11, 6);
    let shaped = |x: &Tensor<1>| {
        x.clone()
            .reshape([vertices + 2, channels + 3, batch])
            .swap_dims(0, 2)
            .swap_dims(1, 2)
            .slice([0..batch, 2..vertices + 2, 3..channels + 3])
    };
    let parameter = |x: &Tensor<1>| {
        let x: Tensor<2> = x.clone().reshape([channels, 2]);
        x.slice([0..channels, 1..2]).reshape([channels])
    };
    let inputs = [
        random(28, batch * (vertices + 2) * (channels + 3)),
        random(29, 2 * channels),
        random(30, 2 * channels),
    ];
    let pairs: [(&str, Op, Op); 2] = [
        (
            "bias_leaky_relu",
            &|x| bias_leaky_relu(shaped(&x[0]), parameter(&x[1]), 0.2).swap_dims(0, 1),
            &|x| composed_bias_leaky_relu(shaped(&x[0]), parameter(&x[1]), 0.2).swap_dims(0, 1),
        ),
        (
            "group_norm_relu",
            &|x| {
                let norm = norm(&parameter(&x[1]), &parameter(&x[2]), 3);
                group_norm_relu(shaped(&x[0]), norm).swap_dims(0, 1)
            },
            &|x| {
                let (gamma, beta) = (parameter(&x[1]), parameter(&x[2]));
                composed_group_norm_relu(shaped(&x[0]), gamma, beta, 3).swap_dims(0, 1)
            },
        ),
    ];
    for (name, device) in devices() {
        for (op, fused, composed) in pairs {
            let fused = run(&device, &inputs, &[true; 3], fused);
            let composed = run(&device, &inputs, &[true; 3], composed);
            assert_agree(&format!("{name}: {op}"), &fused, &composed, 2e-5);
        }
    }
}

#[test]
fn activations_leave_their_inputs_alone() {
    for (name, device) in devices() {
        let before = random(31, 2 * 5 * 3);
        let x: Tensor<3> = upload(&before, [2, 5, 3], &device);
        let bias = upload(&random(32, 3), [3], &device);
        bias_leaky_relu(x.clone(), bias.clone(), 0.2);
        group_norm_relu(x.clone(), norm(&bias, &bias, 3));
        let after: Vec<f64> = values(x).into_iter().map(f64::from).collect();
        assert_eq!(after, before, "{name}");
    }
}

#[test]
fn activations_give_only_the_gradients_asked_for() {
    for (name, device) in devices() {
        let inputs = norm_inputs(2, 5, 4);
        let shape = [2, 5, 4];
        assert_partial_tracking(&name, &device, &inputs[..2], &|x| {
            bias_leaky_relu(x[0].clone().reshape(shape), x[1].clone(), 0.2)
        });
        assert_partial_tracking(&name, &device, &inputs, &|x| {
            group_norm_relu(x[0].clone().reshape(shape), norm(&x[1], &x[2], 2))
        });
    }
}

#[test]
#[should_panic(expected = "group_norm_relu: 3 groups do not divide 4 channels")]
fn group_norm_relu_refuses_other_groups() {
    let (_, device) = devices().swap_remove(0);
    let parameter = Tensor::ones([4], &device);
    group_norm_relu(Tensor::zeros([1, 2, 4], &device), norm(&parameter, &parameter, 3));
}

#[test]
#[should_panic(expected = "bias_leaky_relu: slope must be positive, not 0")]
fn bias_leaky_relu_refuses_a_flat_slope() {
    let (_, device) = devices().swap_remove(0);
    bias_leaky_relu(Tensor::zeros([1, 2, 4], &device), Tensor::zeros([4], &device), 0.0);
}
