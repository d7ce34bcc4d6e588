//! Operations as plain loops in double precision.

use sprs::CsMat;

use crate::support::probe;

/// Central differences of `Σ probe · op(inputs)` with respect to every value of every input.
pub(crate) fn gradients(
    inputs: &[Vec<f64>],
    op: &dyn Fn(&[Vec<f64>]) -> Vec<f64>,
) -> Vec<Vec<f64>> {
    const STEP: f64 = 1e-6;
    let probe = probe(op(inputs).len());
    let loss = |inputs: &[Vec<f64>]| -> f64 {
        op(inputs).iter().zip(&probe).map(|(output, probe)| output * probe).sum()
    };
    let mut inputs = inputs.to_vec();
    let mut gradients = Vec::new();
    for i in 0..inputs.len() {
        let mut gradient = Vec::new();
        for j in 0..inputs[i].len() {
            let value = inputs[i][j];
            let mut at = |offset: f64| {
                inputs[i][j] = value + offset;
                loss(&inputs)
            };
            let difference = at(STEP) - at(-STEP);
            inputs[i][j] = value;
            gradient.push(difference / (2.0 * STEP));
        }
        gradients.push(gradient);
    }
    gradients
}

/// `A x[b]` for every example.
pub(crate) fn sparse_matmul(x: &[f64], a: &CsMat<f64>, channels: usize) -> Vec<f64> {
    let batch = x.len() / (a.cols() * channels);
    let mut y = vec![0.0; batch * a.rows() * channels];
    for example in 0..batch {
        for (&value, (row, col)) in a {
            for c in 0..channels {
                y[(example * a.rows() + row) * channels + c] +=
                    value * x[(example * a.cols() + col) * channels + c];
            }
        }
    }
    y
}

/// `[T_0(A)x, …, T_{K−1}(A)x]`, the terms of one channel adjacent.
pub(crate) fn cheb_features(x: &[f64], a: &CsMat<f64>, channels: usize, order: usize) -> Vec<f64> {
    let mut terms = vec![x.to_vec()];
    for k in 1..order {
        let mut next = sparse_matmul(&terms[k - 1], a, channels);
        if k > 1 {
            for (next, before) in next.iter_mut().zip(&terms[k - 2]) {
                *next = 2.0 * *next - before;
            }
        }
        terms.push(next);
    }
    (0..x.len()).flat_map(|i| terms.iter().map(move |term| term[i])).collect()
}

/// `Σ_k T_k(A) x W_k`, row `channel · K + k` of the weights.
pub(crate) fn cheb_conv(
    x: &[f64],
    weight: &[f64],
    a: &CsMat<f64>,
    channels: usize,
    order: usize,
) -> Vec<f64> {
    let rows = channels * order;
    let out = weight.len() / rows;
    let features = cheb_features(x, a, channels, order);
    features
        .chunks_exact(rows)
        .flat_map(|features| {
            (0..out).map(move |o| {
                features.iter().enumerate().map(|(row, x)| x * weight[row * out + o]).sum()
            })
        })
        .collect()
}

/// `leaky_relu(x + bias)`.
pub(crate) fn bias_leaky_relu(x: &[f64], bias: &[f64], slope: f64) -> Vec<f64> {
    x.iter()
        .zip(bias.iter().cycle())
        .map(|(x, bias)| x + bias)
        .map(|sum| if sum > 0.0 { sum } else { slope * sum })
        .collect()
}

/// `relu(group_norm(x) · gamma + beta)` over groups of consecutive channels and all vertices.
pub(crate) fn group_norm_relu(
    x: &[f64],
    gamma: &[f64],
    beta: &[f64],
    vertices: usize,
    groups: usize,
    epsilon: f64,
) -> Vec<f64> {
    let channels = gamma.len();
    let width = channels / groups;
    let mut y = vec![0.0; x.len()];
    for (y, x) in y.chunks_mut(vertices * channels).zip(x.chunks(vertices * channels)) {
        for group in 0..groups {
            let inside: Vec<usize> =
                (0..x.len()).filter(|i| i % channels / width == group).collect();
            let count = inside.len() as f64;
            let mean = inside.iter().map(|&i| x[i]).sum::<f64>() / count;
            let variance = inside.iter().map(|&i| (x[i] - mean).powi(2)).sum::<f64>() / count;
            for i in inside {
                let unit = (x[i] - mean) / (variance + epsilon).sqrt();
                y[i] = (unit * gamma[i % channels] + beta[i % channels]).max(0.0);
            }
        }
    }
    y
}
