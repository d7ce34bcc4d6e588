//! Steps of optimisers against their definitions in f64.

use burn::tensor::{Device, Tensor, TensorData};
use cape_graph::{AdamStep, MomentumStep, adam_step, momentum_step, sums_of_squares};

use crate::support::{devices, random};

/// Lengths with one and with several workgroups, partial sums and tasks.
const LENGTHS: [usize; 5] = [1, 7, 300, 16_385, 70_001];

fn vector(values: &[f64], device: &Device) -> Tensor<1> {
    let values: Vec<f32> = values.iter().map(|&x| x as f32).collect();
    let len = values.len();
    Tensor::from_data(TensorData::new(values, [len]), device)
}

fn values(tensor: Tensor<1>) -> Vec<f64> {
    let values: Vec<f32> = tensor.into_data().try_into_vec().unwrap();
    values.into_iter().map(f64::from).collect()
}

fn assert_near(name: &str, found: Tensor<1>, expected: impl IntoIterator<Item = f64>) {
    let found = values(found);
    let mut count = 0;
    for (place, expected) in expected.into_iter().enumerate() {
        let error = (found[place] - expected).abs();
        assert!(error < 1e-6, "{name}: {} at {place}, expected {expected}", found[place]);
        count += 1;
    }
    assert_eq!(found.len(), count, "{name}");
}

#[test]
fn momentum_follows_its_definition() {
    let step = MomentumStep { scale: 0.3, momentum: 0.9, rate: 0.05 };
    for (name, device) in devices() {
        for len in LENGTHS {
            let [x, g, v] = [1, 2, 3].map(|seed| random(seed, len));
            let inputs = [&x, &g, &v].map(|values| vector(values, &device));
            let [value, gradient, velocity] = inputs.clone();
            let (value, velocity) = momentum_step(value, gradient, velocity, step);
            let new = |i: usize| 0.9 * v[i] + 0.3 * g[i];
            assert_near(&name, velocity, (0..len).map(new));
            assert_near(&name, value, (0..len).map(|i| x[i] - 0.05 * new(i)));
            for (input, expected) in inputs.into_iter().zip([x, g, v]) {
                assert_eq!(values(input), expected, "{name}: input");
            }
        }
    }
}

#[test]
fn adam_follows_its_definition() {
    let (decays, corrections) = ([0.9, 0.999], [0.19, 0.001999]);
    let step = AdamStep { scale: 0.7, decays, corrections, epsilon: 1e-3, rate: 0.05 };
    for (name, device) in devices() {
        for len in LENGTHS {
            let [x, g, m, v] = [1, 2, 3, 4].map(|seed| random(seed, len));
            let v: Vec<f64> = v.into_iter().map(f64::abs).collect();
            let inputs = [&x, &g, &m, &v].map(|values| vector(values, &device));
            let [value, gradient, first, second] = inputs.clone();
            let [value, first, second] = adam_step(gradient, [value, first, second], step);
            let moments = |i: usize| {
                let g = 0.7 * g[i];
                [0.9 * m[i] + 0.1 * g, 0.999 * v[i] + 0.001 * g * g]
            };
            assert_near(&name, first, (0..len).map(|i| moments(i)[0]));
            assert_near(&name, second, (0..len).map(|i| moments(i)[1]));
            let expected = |i: usize| {
                let [first, second] = moments(i);
                x[i] - 0.05 * (first / 0.19) / ((second / 0.001999).sqrt() + 1e-3)
            };
            assert_near(&name, value, (0..len).map(expected));
            for (input, expected) in inputs.into_iter().zip([x, g, m, v]) {
                assert_eq!(values(input), expected, "{name}: input");
            }
        }
    }
}

#[test]
fn sums_of_squares_are_those_of_each_vector() {
    for (name, device) in devices() {
        let vectors: Vec<Vec<f64>> = LENGTHS.iter().map(|&len| random(len as u64, len)).collect();
        let tensors = vectors.iter().map(|values| vector(values, &device)).collect();
        let found = values(sums_of_squares(tensors, &device));
        for (found, vector) in found.into_iter().zip(&vectors) {
            let expected: f64 = vector.iter().map(|x| x * x).sum();
            let error = (found - expected).abs() / expected;
            assert!(error < 1e-6, "{name}, {} values: {found}, {expected}", vector.len());
        }
    }
}
