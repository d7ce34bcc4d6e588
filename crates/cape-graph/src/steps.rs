//! Steps of optimisers and the sums of squares of their gradients, each in one pass.

use burn::{
    backend::{Backend, Dispatch, ExtensionType, Slice, tensor::FloatTensor},
    tensor::{Shape, Tensor},
};

use crate::ops::GraphBackend;

/// Gradient descent with momentum: velocity `v ← momentum · v + scale · g`, value `x ← x − rate · v`.
///
/// ```
/// use burn::tensor::{Device, Tensor};
/// use cape_graph::{MomentumStep, momentum_step};
///
/// let device = Device::default();
/// let [x, g, v] = [3.0, 2.0, 1.0].map(|value| Tensor::<1>::full([1], value, &device));
/// let step = MomentumStep { scale: 0.5, momentum: 0.9, rate: 0.1 };
/// let (x, v) = momentum_step(x, g, v, step);
/// // 0.9 · 1 + 0.5 · 2 = 1.9, and 3 − 0.1 · 1.9 = 2.81.
/// let [x, v] = [x, v].map(|tensor| tensor.into_scalar::<f32>());
/// assert!((v - 1.9).abs() < 1e-6 && (x - 2.81).abs() < 1e-6);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MomentumStep {
    /// Factor on the gradient.
    pub scale: f64,
    /// Decay of the velocity.
    pub momentum: f64,
    /// Learning rate.
    pub rate: f64,
}

/// Step of Adam: moments `m ← β₁ m + (1 − β₁) s g` and `v ← β₂ v + (1 − β₂) (s g)²`, value
/// `x ← x − rate · (m / c₁) / (√(v / c₂) + ε)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AdamStep {
    /// Factor `s` on the gradient.
    pub scale: f64,
    /// Decays `β₁`, `β₂` of the moments.
    pub decays: [f64; 2],
    /// Divisors `c₁`, `c₂` of the moments: `1 − βᵗ` in step `t` (bias correction).
    pub corrections: [f64; 2],
    /// `ε`, added to the deviation.
    pub epsilon: f64,
    /// Learning rate.
    pub rate: f64,
}

/// Value and moments of Adam, each `[numbers]`.
#[derive(Debug, Clone, ExtensionType)]
pub struct AdamState<B: Backend> {
    /// Value.
    pub value: FloatTensor<B>,
    /// First moment.
    pub first: FloatTensor<B>,
    /// Second moment.
    pub second: FloatTensor<B>,
}

/// Value and velocity after a step of gradient descent with momentum, each `[numbers]`.
///
/// # Panics
/// If the vectors differ in length.
pub fn momentum_step(
    value: Tensor<1>,
    gradient: Tensor<1>,
    velocity: Tensor<1>,
    step: MomentumStep,
) -> (Tensor<1>, Tensor<1>) {
    check("momentum_step", &value, [&gradient, &velocity]);
    let [value, gradient, velocity] = [value, gradient, velocity].map(Tensor::into_dispatch);
    let (value, velocity) = Dispatch::momentum_step(value, gradient, velocity, step);
    (Tensor::from_dispatch(value), Tensor::from_dispatch(velocity))
}

/// Value, first and second moment after a step of Adam, each `[numbers]`.
///
/// # Panics
/// If the vectors differ in length.
pub fn adam_step(
    gradient: Tensor<1>,
    [value, first, second]: [Tensor<1>; 3],
    step: AdamStep,
) -> [Tensor<1>; 3] {
    check("adam_step", &value, [&gradient, &first]);
    check("adam_step", &value, [&second]);
    let [value, first, second] = [value, first, second].map(Tensor::into_dispatch);
    let state = AdamState { value, first, second };
    let AdamState { value, first, second } =
        Dispatch::adam_step(gradient.into_dispatch(), state, step);
    [value, first, second].map(Tensor::from_dispatch)
}

/// Sum of the squares of each vector, `[vectors]`.
///
/// ```
/// use burn::tensor::{Device, Tensor};
/// use cape_graph::sums_of_squares;
///
/// let device = Device::default();
/// let vectors = [Tensor::from_floats([3.0, 4.0], &device), Tensor::from_floats([2.0], &device)];
/// let sums: Vec<f32> = sums_of_squares(vectors.to_vec(), &device).into_data().try_into_vec().unwrap();
/// assert_eq!(sums, [25.0, 4.0]);
/// ```
pub fn sums_of_squares(vectors: Vec<Tensor<1>>, device: &burn::tensor::Device) -> Tensor<1> {
    let sums = Tensor::<1>::zeros([vectors.len()], device).into_dispatch();
    let sums = vectors.into_iter().enumerate().fold(sums, |sums, (slot, vector)| {
        Dispatch::sum_of_squares(vector.into_dispatch(), sums, slot)
    });
    Tensor::from_dispatch(sums)
}

fn check<const N: usize>(operation: &str, value: &Tensor<1>, others: [&Tensor<1>; N]) {
    for other in others {
        assert_eq!(other.dims(), value.dims(), "{operation}: lengths of the vectors");
    }
}

pub(crate) fn composed_momentum<B: Backend>(
    value: FloatTensor<B>,
    gradient: FloatTensor<B>,
    velocity: FloatTensor<B>,
    step: MomentumStep,
) -> (FloatTensor<B>, FloatTensor<B>) {
    let MomentumStep { scale, momentum, rate } = step;
    let velocity = B::float_add(
        B::float_mul_scalar(velocity, momentum.into()),
        B::float_mul_scalar(gradient, scale.into()),
    );
    let change = B::float_mul_scalar(velocity.clone(), rate.into());
    (B::float_sub(value, change), velocity)
}

pub(crate) fn composed_adam<B: Backend>(
    gradient: FloatTensor<B>,
    state: AdamState<B>,
    step: AdamStep,
) -> AdamState<B> {
    let AdamStep { scale, decays, corrections, epsilon, rate } = step;
    let decayed = |moment: FloatTensor<B>, decay: f64, new: FloatTensor<B>| {
        B::float_add(
            B::float_mul_scalar(moment, decay.into()),
            B::float_mul_scalar(new, (1.0 - decay).into()),
        )
    };
    let gradient = B::float_mul_scalar(gradient, scale.into());
    let first = decayed(state.first, decays[0], gradient.clone());
    let second = decayed(state.second, decays[1], B::float_mul(gradient.clone(), gradient));
    let deviation = B::float_sqrt(B::float_div_scalar(second.clone(), corrections[1].into()));
    let deviation = B::float_add_scalar(deviation, epsilon.into());
    let unbiased = B::float_div_scalar(first.clone(), corrections[0].into());
    let change = B::float_mul_scalar(B::float_div(unbiased, deviation), rate.into());
    AdamState { value: B::float_sub(state.value, change), first, second }
}

pub(crate) fn composed_sum_of_squares<B: Backend>(
    x: FloatTensor<B>,
    sums: FloatTensor<B>,
    slot: usize,
) -> FloatTensor<B> {
    let sum = B::float_sum(B::float_mul(x.clone(), x));
    let sum = B::float_reshape(sum, Shape::from(vec![1]));
    B::float_slice_assign(sums, &[Slice::from(slot..slot + 1)], sum)
}
