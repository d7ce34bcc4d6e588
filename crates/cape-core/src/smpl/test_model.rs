//! Small random body for tests.

use ndarray::{Array, Array2, Array3, Dimension, ShapeBuilder};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

use super::SmplModel;

/// Random numbers in `[-scale, scale)`.
pub(crate) fn random<D: Dimension, S: ShapeBuilder<Dim = D>>(
    shape: S,
    scale: f64,
    rng: &mut ChaCha8Rng,
) -> Array<f64, D> {
    Array::from_shape_simple_fn(shape, || rng.random_range(-scale..scale))
}

/// Random body of 12 vertices, 4 joints and 2 shape directions.
pub(crate) fn random_model() -> SmplModel {
    let rng = &mut ChaCha8Rng::seed_from_u64(7);
    let (v, j) = (12, 4);
    let mut rows = |shape: (usize, usize)| {
        let mut array: Array2<f64> = random(shape, 1.0, rng).mapv(|x: f64| x * x + 0.01);
        for mut row in array.rows_mut() {
            let sum = row.sum();
            row /= sum;
        }
        array
    };
    let (joint_regressor, weights) = (rows((j, v)), rows((v, j)));
    let shapedirs: Array3<f64> = random((v, 3, 2), 0.1, rng);
    SmplModel {
        v_template: random((v, 3), 1.0, rng),
        shapedirs,
        posedirs: random((v, 3, 9 * (j - 1)), 0.05, rng),
        joint_regressor,
        weights,
        parents: vec![None, Some(0), Some(0), Some(2)],
        faces: (0..10).map(|i| [i, i + 1, i + 2]).collect(),
    }
}
