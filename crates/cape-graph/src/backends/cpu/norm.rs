//! Group normalisation with ReLU, one example at a time.

use super::{
    simd,
    split::{LANES, Split, vertex_sums},
};

/// Extents of a group normalisation.
#[derive(Clone, Copy)]
pub(in crate::backends) struct Norm {
    /// Number of vertices.
    pub vertices: usize,
    /// Number of channels of the features.
    pub channels: usize,
    /// Number of constant channels, which follow those of the features.
    pub constant: usize,
    /// Number of groups of consecutive channels, normalised over (channels in group × vertices).
    pub groups: usize,
    /// Added to the variance.
    pub epsilon: f32,
}

/// Statistics of an example, repeated for every channel of a group, `[channels + constant]`.
pub(super) struct Statistics {
    mean: Vec<f32>,
    inverse_deviation: Vec<f32>,
}

/// Scale and shift after normalisation, `[channels + constant]`.
#[derive(Clone, Copy)]
pub(super) struct Affine<'a> {
    pub gamma: &'a [f32],
    pub beta: &'a [f32],
}

/// Sums over the vertices for every channel, `g` being the gradient before the ReLU and `unit` the
/// normalised input: the contributions of an example to the gradients of shift and scale.
pub(super) struct Sums {
    /// `Σ g`.
    pub beta: Vec<f64>,
    /// `Σ g · unit`.
    pub gamma: Vec<f64>,
}

/// Means over each group, repeated for every channel, `[channels + constant]`.
pub(super) struct Means {
    /// Mean of `gamma · g`.
    first: Vec<f32>,
    /// Mean of `gamma · g · unit`.
    second: Vec<f32>,
}

impl Sums {
    /// Gradients of scale and shift, `[channels]` each: sums over the examples, in order.
    pub(super) fn total(examples: &[Self], channels: usize) -> (Vec<f32>, Vec<f32>) {
        let total = |of: fn(&Self) -> &Vec<f64>| {
            let sum = |c: usize| examples.iter().map(|sums| of(sums)[c]).sum::<f64>() as f32;
            (0..channels).map(sum).collect()
        };
        (total(|sums| &sums.gamma), total(|sums| &sums.beta))
    }
}

impl Norm {
    /// Number of channels with the constant ones.
    pub(super) fn all_channels(&self) -> usize {
        self.channels + self.constant
    }

    /// Number of channels of a group.
    fn width(&self) -> usize {
        self.all_channels() / self.groups
    }

    /// Repeats a value for each group, computed from the range of its channels.
    fn per_group(&self, of: impl Fn(std::ops::Range<usize>) -> f64) -> Vec<f32> {
        let width = self.width();
        (0..self.groups)
            .flat_map(|group| {
                std::iter::repeat_n(of(group * width..(group + 1) * width) as f32, width)
            })
            .collect()
    }

    /// Statistics of one example in one pass. Differences from the first vertex are summed: it is so
    /// close to the mean that no digits cancel.
    pub(super) fn statistics(&self, x: &[f32], constant: &[f32], split: Split) -> Statistics {
        let channels = self.channels;
        let pivot = &x[..channels];
        let [mut sums, mut second] = vertex_sums(
            self.vertices,
            channels,
            split,
            #[inline(always)]
            |[first, second]: &mut [[f32; LANES]; 2], v, c, width| {
                let x = &x[v * channels + c..][..width];
                let pivot = &pivot[c..][..width];
                for i in 0..width {
                    let distance = x[i] - pivot[i];
                    first[i] += distance;
                    second[i] += distance * distance;
                }
            },
        );
        sums.resize(self.all_channels(), 0.0);
        second.resize(self.all_channels(), 0.0);
        let pivot: Vec<f64> = pivot.iter().chain(constant).map(|&x| f64::from(x)).collect();

        let vertices = self.vertices as f64;
        let count = vertices * self.width() as f64;
        let mean_of = |span: std::ops::Range<usize>| {
            span.map(|c| sums[c] + vertices * pivot[c]).sum::<f64>() / count
        };
        let mean = self.per_group(mean_of);
        let inverse_deviation = self.per_group(|span| {
            let mean = mean_of(span.clone());
            let squares = span.map(|c| {
                let offset = pivot[c] - mean;
                second[c] + 2.0 * offset * sums[c] + vertices * offset * offset
            });
            let variance = (squares.sum::<f64>() / count).max(0.0);
            1.0 / (variance + f64::from(self.epsilon)).sqrt()
        });
        Statistics { mean, inverse_deviation }
    }

    /// `relu(unit · gamma + beta)` of the features of some vertices.
    pub(super) fn apply(&self, x: &[f32], by: &Statistics, affine: Affine, out: &mut [f32]) {
        let channels = self.channels;
        simd(
            #[inline(always)]
            || {
                let (mean, inverse) = (&by.mean[..channels], &by.inverse_deviation[..channels]);
                let (gamma, beta) = (&affine.gamma[..channels], &affine.beta[..channels]);
                for (out, x) in out.chunks_exact_mut(channels).zip(x.chunks_exact(channels)) {
                    for c in 0..channels {
                        let unit = (x[c] - mean[c]) * inverse[c];
                        let affine = unit * gamma[c] + beta[c];
                        // Not `max`, which would turn NaN into 0.
                        out[c] = if affine < 0.0 { 0.0 } else { affine };
                    }
                }
            },
        );
    }

    /// `relu(unit · gamma + beta)` and `unit` of the constant channels.
    pub(super) fn apply_constant(
        &self,
        constant: &[f32],
        by: &Statistics,
        affine: Affine,
    ) -> (Vec<f32>, Vec<f32>) {
        let unit = |(i, x): (usize, &f32)| {
            let c = self.channels + i;
            (x - by.mean[c]) * by.inverse_deviation[c]
        };
        let units: Vec<f32> = constant.iter().enumerate().map(unit).collect();
        let active = units.iter().enumerate().map(|(i, unit)| {
            let c = self.channels + i;
            (unit * affine.gamma[c] + affine.beta[c]).max(0.0)
        });
        (active.collect(), units)
    }

    /// [`Sums`] of the features' channels, from the output of [`apply`](Self::apply) and its
    /// gradient.
    pub(super) fn sums(
        &self,
        x: &[f32],
        active: &[f32],
        grad: &[f32],
        by: &Statistics,
        split: Split,
    ) -> Sums {
        let channels = self.channels;
        let [beta, gamma] = vertex_sums(
            self.vertices,
            channels,
            split,
            #[inline(always)]
            |[beta, gamma]: &mut [[f32; LANES]; 2], v, c, width| {
                let at = v * channels + c;
                let (x, active, grad) =
                    (&x[at..][..width], &active[at..][..width], &grad[at..][..width]);
                let mean = &by.mean[c..][..width];
                let inverse = &by.inverse_deviation[c..][..width];
                for i in 0..width {
                    let unit = (x[i] - mean[i]) * inverse[i];
                    let grad = if active[i] > 0.0 { grad[i] } else { 0.0 };
                    beta[i] += grad;
                    gamma[i] += grad * unit;
                }
            },
        );
        Sums { beta, gamma }
    }

    pub(super) fn means(&self, sums: &Sums, affine: Affine) -> Means {
        let count = (self.vertices * self.width()) as f64;
        let mean = |sums: &[f64]| {
            self.per_group(|span| {
                span.map(|c| f64::from(affine.gamma[c]) * sums[c]).sum::<f64>() / count
            })
        };
        Means { first: mean(&sums.beta), second: mean(&sums.gamma) }
    }

    /// Replaces the gradient of the output of [`apply`](Self::apply) by that of its input, for some
    /// vertices.
    pub(super) fn input_gradient(
        &self,
        x: &[f32],
        active: &[f32],
        by: &Statistics,
        affine: Affine,
        means: &Means,
        grad: &mut [f32],
    ) {
        let channels = self.channels;
        simd(
            #[inline(always)]
            || {
                let (mean, inverse) = (&by.mean[..channels], &by.inverse_deviation[..channels]);
                let gamma = &affine.gamma[..channels];
                let (first, second) = (&means.first[..channels], &means.second[..channels]);
                let rows = x.chunks_exact(channels).zip(active.chunks_exact(channels));
                for (grad, (x, active)) in grad.chunks_exact_mut(channels).zip(rows) {
                    for c in 0..channels {
                        let unit = (x[c] - mean[c]) * inverse[c];
                        let upstream = if active[c] > 0.0 { grad[c] * gamma[c] } else { 0.0 };
                        grad[c] = inverse[c] * (upstream - first[c] - unit * second[c]);
                    }
                }
            },
        );
    }

    /// Gradient of the constant channels, summed over the vertices, `[constant]`; `sums` includes
    /// those of the constant channels.
    pub(super) fn constant_gradient(
        &self,
        units: &[f32],
        by: &Statistics,
        affine: Affine,
        sums: &Sums,
        means: &Means,
    ) -> Vec<f32> {
        let vertices = self.vertices as f64;
        let gradient = |(i, &unit): (usize, &f32)| {
            let c = self.channels + i;
            let upstream = f64::from(affine.gamma[c]) * sums.beta[c];
            let mean = f64::from(means.first[c]) + f64::from(unit) * f64::from(means.second[c]);
            (f64::from(by.inverse_deviation[c]) * (upstream - vertices * mean)) as f32
        };
        units.iter().enumerate().map(gradient).collect()
    }
}
