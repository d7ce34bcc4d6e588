//! Rodrigues' formula on tensors.

use burn::tensor::{DType, Device, Tensor};
use glam::{DMat3, DVec3};

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

/// Gradient with respect to an axis-angle, radians, from that with respect to its rotation matrix.
pub(super) fn rotation_gradient(axis_angle: DVec3, by_rotation: &DMat3) -> DVec3 {
    // R = I + a K + b K² with K = [v]ₓ; the derivatives of a and b along v are v times `da` and `db`.
    let squared = axis_angle.length_squared();
    let angle = squared.sqrt();
    let [a, b, da, db] = if squared < SERIES_BELOW {
        // Coefficient k of a is 1 / (2k + 1)!, of b 1 / (2k + 2)!, of the derivatives 2 (k + 1) times
        // the next one; signs alternate.
        let mut sums = [0.0; 4];
        let (mut power, mut factorial) = (1.0, 1.0);
        for k in 0..8 {
            let k = f64::from(k);
            let (odd, even) = (factorial, factorial * (2.0 * k + 2.0));
            let (next_odd, next_even) =
                (even * (2.0 * k + 3.0), even * (2.0 * k + 3.0) * (2.0 * k + 4.0));
            let slope = -2.0 * (k + 1.0);
            let terms = [1.0 / odd, 1.0 / even, slope / next_odd, slope / next_even];
            sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += power * term);
            power *= -squared;
            factorial = next_odd;
        }
        sums
    } else {
        let (sine, cosine) = angle.sin_cos();
        [
            sine / angle,
            (1.0 - cosine) / squared,
            (angle * cosine - sine) / (squared * angle),
            (angle * sine - 2.0 * (1.0 - cosine)) / (squared * squared),
        ]
    };
    let turn = cross_matrix(axis_angle);
    let twice = turn * turn;
    let along = |axis: DVec3| {
        let unit = cross_matrix(axis);
        let amount = axis_angle.dot(axis);
        let derivative = turn * (da * amount)
            + unit * a
            + twice * (db * amount)
            + (unit * turn + turn * unit) * b;
        let pairs = derivative.to_cols_array().into_iter().zip(by_rotation.to_cols_array());
        pairs.map(|(a, b)| a * b).sum::<f64>()
    };
    DVec3::new(along(DVec3::X), along(DVec3::Y), along(DVec3::Z))
}

/// Matrix of the cross product with a vector from the left.
fn cross_matrix(v: DVec3) -> DMat3 {
    DMat3::from_cols(
        DVec3::new(0.0, v.z, -v.y),
        DVec3::new(-v.z, 0.0, v.x),
        DVec3::new(v.y, -v.x, 0.0),
    )
}
