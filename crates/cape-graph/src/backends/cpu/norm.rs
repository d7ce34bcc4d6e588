//! Group normalisation with ReLU, one example at a time.

use super::{
    simd,
    split::{LANES, Split, vertex_sums},
};

/// The extents of a group normalisation.
#[derive(Clone, Copy)]
pub(in crate::backends) struct Norm {
    /// Vertices per example.
    pub vertices: usize,
    /// Channels of the features.
    pub channels: usize,
    /// Channels after them that are the same at every vertex.
    pub constant: usize,
    /// Groups of consecutive channels, normalised over (channels in group × vertices).
    pub groups: usize,
    /// Added to the variance.
    pub epsilon: f32,
}

/// What normalises an example: one number for every channel, the constant ones last.
pub(super) struct Statistics {
    mean: Vec<f32>,
    inverse_deviation: Vec<f32>,
}

/// Scale and shift after normalisation.
#[derive(Clone, Copy)]
pub(super) struct Affine<'a> {
    pub gamma: &'a [f32],
    pub beta: &'a [f32],
}

/// Sums over vertices that the gradients are made of: `Σ g` and `Σ g · unit` for every channel,
/// `g` the gradient behind the ReLU.
pub(super) struct Sums {
    pub beta: Vec<f64>,
    pub gamma: Vec<f64>,
}

impl Sums {
    /// The gradients of scale and shift: sums over examples, in order.
    pub(super) fn total(examples: &[Self], channels: usize) -> (Vec<f32>, Vec<f32>) {
        let total = |of: fn(&Self) -> &Vec<f64>| {
            let sum = |c: usize| examples.iter().map(|sums| of(sums)[c]).sum::<f64>() as f32;
            (0..channels).map(sum).collect()
        };
        (total(|sums| &sums.gamma), total(|sums| &sums.beta))
    }
}

impl Norm {
    pub(super) fn all_channels(&self) -> usize {
        self.channels + self.constant
    }

    fn width(&self) -> usize {
        self.all_channels() / self.groups
    }

    /// Spreads a number for each group, computed from those of its channels.
    fn per_group(&self, of: impl Fn(std::ops::Range<usize>) -> f64) -> Vec<f32> {
        let width = self.width();
        (0..self.groups)
            .flat_map(|group| {
                std::iter::repeat_n(of(group * width..(group + 1) * width) as f32, width)
            })
            .collect()
    }

    /// Statistics of one example, in one pass: sums of distances from the first vertex, which is
    /// near enough to the mean that nothing cancels.
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

    /// `relu(unit · gamma + beta)` of some vertices' features.
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
                        // Not `max`, which would hide what is not a number.
                        out[c] = if affine < 0.0 { 0.0 } else { affine };
                    }
                }
            },
        );
    }

    /// `relu(unit · gamma + beta)` of the constant channels, and their units.
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

    /// Means over each group of `gamma · Σ g` and `gamma · Σ g · unit`, spread over its channels.
    pub(super) fn means(&self, sums: &Sums, affine: Affine) -> (Vec<f32>, Vec<f32>) {
        let count = (self.vertices * self.width()) as f64;
        let mean = |sums: &[f64]| {
            self.per_group(|span| {
                span.map(|c| f64::from(affine.gamma[c]) * sums[c]).sum::<f64>() / count
            })
        };
        (mean(&sums.beta), mean(&sums.gamma))
    }

    /// Turns the gradient of the output of [`apply`](Self::apply) into that of its input, for some
    /// vertices.
    pub(super) fn input_gradient(
        &self,
        x: &[f32],
        active: &[f32],
        by: &Statistics,
        affine: Affine,
        (first, second): (&[f32], &[f32]),
        grad: &mut [f32],
    ) {
        let channels = self.channels;
        simd(
            #[inline(always)]
            || {
                let (mean, inverse) = (&by.mean[..channels], &by.inverse_deviation[..channels]);
                let gamma = &affine.gamma[..channels];
                let (first, second) = (&first[..channels], &second[..channels]);
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

    /// Gradient of the constant channels, summed over vertices; `sums` includes theirs.
    pub(super) fn constant_gradient(
        &self,
        units: &[f32],
        by: &Statistics,
        affine: Affine,
        sums: &Sums,
        (first, second): (&[f32], &[f32]),
    ) -> Vec<f32> {
        let vertices = self.vertices as f64;
        let gradient = |(i, &unit): (usize, &f32)| {
            let c = self.channels + i;
            let upstream = f64::from(affine.gamma[c]) * sums.beta[c];
            let mean = f64::from(first[c]) + f64::from(unit) * f64::from(second[c]);
            (f64::from(by.inverse_deviation[c]) * (upstream - vertices * mean)) as f32
        };
        units.iter().enumerate().map(gradient).collect()
    }
}
