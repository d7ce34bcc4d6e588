//! Latent codes: the standard normal prior, paths between codes, directions by effect.

use ndarray::{Array2, Axis};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use rand_distr::StandardNormal;

use crate::{BodySpec, ClothedModel, Error, Result};

/// Standard normal numbers, `[rows, columns]`, reproducible by seed and stream.
pub fn normal(seed: u64, stream: u64, rows: usize, columns: usize) -> Array2<f32> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(stream);
    Array2::from_shape_simple_fn((rows, columns), || rng.sample(StandardNormal))
}

/// `steps` codes from `a` to `b`, both included, `[steps, latent]`: on the great circle between
/// their directions, since typical codes of many dimensions lie near a sphere, with lengths blended.
pub fn interpolate_codes(a: &[f32], b: &[f32], steps: usize) -> Array2<f32> {
    let length = |v: &[f32]| v.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>().sqrt();
    let (la, lb) = (length(a), length(b));
    let dot: f64 = a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum();
    let angle = (dot / (la * lb).max(f64::MIN_POSITIVE)).clamp(-1.0, 1.0).acos();
    let straight = la.min(lb) < 1e-6 || angle.sin() < 1e-4;
    let mut codes = Array2::zeros((steps, a.len()));
    for (step, mut row) in codes.rows_mut().into_iter().enumerate() {
        let t = step as f64 / steps.saturating_sub(1).max(1) as f64;
        let [of_a, of_b] = if straight {
            [1.0 - t, t]
        } else {
            let size = la + (lb - la) * t;
            let share = |t: f64| size * (t * angle).sin() / angle.sin();
            [share(1.0 - t) / la, share(t) / lb]
        };
        for (row, (a, b)) in row.iter_mut().zip(a.iter().zip(b)) {
            *row = (of_a * f64::from(*a) + of_b * f64::from(*b)) as f32;
        }
    }
    codes
}

/// A closed walk of `steps` codes, `[steps, latent]`, through the rows of `stops` and back to the
/// first, smooth in every number (a periodic Catmull–Rom spline).
pub fn walk_codes(stops: &Array2<f32>, steps: usize) -> Array2<f32> {
    let n = stops.nrows();
    let mut codes = Array2::zeros((steps, stops.ncols()));
    if n == 0 {
        return codes;
    }
    for (step, mut row) in codes.rows_mut().into_iter().enumerate() {
        let at = step as f64 / steps as f64 * n as f64;
        let (segment, t) = (at as usize % n, at.fract());
        let stop = |offset: usize| stops.index_axis(Axis(0), (segment + n - 1 + offset) % n);
        let points = [stop(0), stop(1), stop(2), stop(3)];
        let weights = [
            -0.5 * t + t * t - 0.5 * t.powi(3),
            1.0 - 2.5 * t * t + 1.5 * t.powi(3),
            0.5 * t + 2.0 * t * t - 1.5 * t.powi(3),
            0.5 * (t.powi(3) - t * t),
        ];
        for (point, weight) in points.iter().zip(weights) {
            row.scaled_add(weight as f32, point);
        }
    }
    codes
}

/// Latent directions sorted by how far a step of one standard deviation moves clothing vertices of
/// the mean code, with that distance, millimetres, for each direction.
///
/// # Errors
/// If the model decodes nothing finite.
pub fn directions_by_effect(
    model: &ClothedModel,
    body: &BodySpec,
) -> Result<(Vec<usize>, Vec<f64>)> {
    let latent = model.latent();
    let mut codes = Array2::zeros((2 * latent, latent));
    for direction in 0..latent {
        codes[[2 * direction, direction]] = 1.0;
        codes[[2 * direction + 1, direction]] = -1.0;
    }
    let worn = model.decode_displacements(&codes, &vec![body.clone(); 2 * latent])?;
    let effects: Vec<f64> = (0..latent)
        .map(|direction| {
            let [up, down] = [0, 1].map(|side| worn.index_axis(Axis(0), 2 * direction + side));
            let moved = model.clothing().iter().map(|&v| {
                let squares = (0..3).map(|axis| f64::from(up[[v, axis]] - down[[v, axis]]).powi(2));
                squares.sum::<f64>().sqrt()
            });
            1000.0 * moved.sum::<f64>() / (2 * model.clothing().len()).max(1) as f64
        })
        .collect();
    if effects.iter().any(|effect| !effect.is_finite()) {
        return Err(Error::argument("the model decodes displacements that are not finite"));
    }
    let mut order: Vec<usize> = (0..latent).collect();
    order.sort_by(|&a, &b| effects[b].total_cmp(&effects[a]));
    Ok((order, effects))
}

#[cfg(test)]
mod tests {
    use ndarray::array;

    use super::*;

    #[test]
    fn a_seed_stands_for_the_same_numbers_for_good() {
        let expected =
            array![[0.4387562, -1.128422, -0.4192663], [-0.52634203, 0.3544089, 1.3286909]];
        assert_eq!(normal(3, 0, 2, 3), expected);
    }

    #[test]
    fn interpolation_turns_directions_and_blends_lengths() {
        let codes = interpolate_codes(&[1.0, 0.0], &[0.0, 3.0], 3);
        let half = 2.0 * std::f32::consts::FRAC_1_SQRT_2;
        let expected = array![[1.0, 0.0], [half, half], [0.0, 3.0]];
        assert!((&codes - &expected).iter().all(|x| x.abs() < 1e-5), "{codes}");
        let straight = interpolate_codes(&[0.0, 0.0], &[2.0, 4.0], 3);
        assert_eq!(straight, array![[0.0, 0.0], [1.0, 2.0], [2.0, 4.0]]);
        let opposite = interpolate_codes(&[1.0, 0.0], &[-1.0, 0.0], 5);
        assert!(opposite.iter().all(|x| x.is_finite()));
        assert_eq!(interpolate_codes(&[1.0], &[2.0], 1), array![[1.0]]);
    }

    #[test]
    fn a_walk_passes_its_stops_and_closes_smoothly() {
        let stops = array![[0.0, 1.0], [2.0, -1.0], [1.0, 3.0]];
        let codes = walk_codes(&stops, 300);
        for stop in 0..3 {
            assert!((&codes.row(100 * stop) - &stops.row(stop)).iter().all(|x| x.abs() < 1e-5));
        }
        for step in 0..300 {
            let moved = &codes.row((step + 1) % 300) - &codes.row(step);
            assert!(moved.iter().all(|x| x.abs() < 0.1), "step {step}: {moved}");
        }
    }
}
