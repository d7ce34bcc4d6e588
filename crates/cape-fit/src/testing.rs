//! Helpers of the tests.

use std::sync::LazyLock;

use cape_core::SmplModel;
use cape_synth::synthetic_body;

/// The synthetic body.
pub(crate) static BODY: LazyLock<SmplModel> = LazyLock::new(synthetic_body);

/// Asserts that `gradient` is the gradient of `value` at `x` by central differences, to `tolerance`
/// of the largest component.
pub(crate) fn assert_gradient(
    x: &[f64],
    gradient: &[f64],
    tolerance: f64,
    mut value: impl FnMut(&[f64]) -> f64,
) {
    assert_eq!(x.len(), gradient.len());
    let step = 1e-5;
    let mut moved = x.to_vec();
    let expected: Vec<f64> = (0..x.len())
        .map(|at| {
            let mut at_distance = |change: f64| {
                moved[at] = x[at] + change;
                let value = value(&moved);
                moved[at] = x[at];
                value
            };
            (at_distance(step) - at_distance(-step)) / (2.0 * step)
        })
        .collect();
    let scale = expected.iter().fold(1e-3f64, |most, g| most.max(g.abs()));
    for (at, (found, expected)) in gradient.iter().zip(&expected).enumerate() {
        assert!(
            (found - expected).abs() <= tolerance * scale,
            "component {at}: {found}, differences say {expected} (largest {scale})"
        );
    }
}
