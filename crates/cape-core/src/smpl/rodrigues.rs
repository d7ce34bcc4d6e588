//! Rodrigues' formula on tensors.

use burn::tensor::{DType, Device, Tensor};

/// Squared angle below which power series replace the closed forms, whose derivatives are 0 / 0 at
/// angle 0. The series and their derivatives are exact to rounding there.
const SERIES_BELOW: f64 = 0.25;

/// Rotation matrices of axis-angles: `[m, 3]` → `[m, 3, 3]`, smooth at angle 0.
///
/// `R = (1 − b θ²) I + a [v]ₓ + b v vᵀ` with `a = sin θ / θ`, `b = (1 − cos θ) / θ²`.
pub fn rodrigues(axis_angle: Tensor<2>) -> Tensor<3> {
    let [m, _] = axis_angle.dims();
    let (device, dtype) = (axis_angle.device(), axis_angle.dtype());
    let squared = axis_angle.clone().square().sum_dim(1);
    let small = squared.clone().lower_scalar(SERIES_BELOW);

    // The closed forms get angle 1 where the series are used, so that no gradient is 0 · ∞.
    let safe = squared.clone().mask_fill(small.clone(), 1.0);
    let angle = safe.clone().sqrt();
    let half_sine = (angle.clone() * 0.5).sin();
    let a = angle.clone().sin() / angle;
    let b = half_sine.square() * 2.0 / safe;
    // Σ (−θ²)ᵏ / (2k + 1)! and Σ (−θ²)ᵏ / (2k + 2)!
    let a_series = polynomial(
        &squared,
        [1.0, -1.0 / 6.0, 1.0 / 120.0, -1.0 / 5040.0, 1.0 / 362_880.0, -1.0 / 39_916_800.0],
    );
    let b_series = polynomial(
        &squared,
        [0.5, -1.0 / 24.0, 1.0 / 720.0, -1.0 / 40_320.0, 1.0 / 3_628_800.0, -1.0 / 479_001_600.0],
    );
    let a = a.mask_where(small.clone(), a_series);
    let b = b.mask_where(small, b_series);

    // v · generators = [v]ₓ, row-major.
    let generators = Tensor::<2>::from_floats(
        [
            [0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0],
            [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0],
            [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        ],
        &device,
    )
    .cast(dtype);
    let cross = axis_angle.clone().matmul(generators);
    let outer = axis_angle.clone().reshape([m, 3, 1]) * axis_angle.reshape([m, 1, 3]);
    let diagonal = -(b.clone() * squared) + 1.0;
    let rotation = diagonal * identity(&device, dtype) + a * cross + b * outer.reshape([m, 9]);
    rotation.reshape([m, 3, 3])
}

/// 3 × 3 identity matrix, row-major, `[1, 9]`.
pub(super) fn identity(device: &Device, dtype: DType) -> Tensor<2> {
    Tensor::<2>::from_floats([[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]], device).cast(dtype)
}

/// Polynomial of `x` by Horner's scheme; coefficients in ascending order.
fn polynomial(x: &Tensor<2>, coefficients: [f64; 6]) -> Tensor<2> {
    let [rest @ .., last] = coefficients;
    let highest = x.clone() * 0.0 + last;
    rest.into_iter().rev().fold(highest, |sum, coefficient| sum * x.clone() + coefficient)
}
