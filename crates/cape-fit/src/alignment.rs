//! Alignment by scale and translation for evaluation (CAPE eq. 12).
//!
//! A single image does not determine size and distance of a body: an estimate is compared with the
//! ground truth after the scale and translation that bring it closest, in closed form for each
//! frame, which the paper estimates over the clothing vertices.

use glam::DVec3;
use ndarray::ArrayView2;
use serde::{Deserialize, Serialize};

use crate::{Error, Result};

/// Rows of an array `[n, 3]` as points.
pub(crate) fn points(rows: ArrayView2<f64>) -> Vec<DVec3> {
    rows.rows().into_iter().map(|row| DVec3::new(row[0], row[1], row[2])).collect()
}

/// Similarity transform without rotation, `x ↦ s x + t` (CAPE eq. 12).
///
/// ```
/// use cape_fit::Alignment;
/// use glam::DVec3;
///
/// // Scaled by 2 and moved by 1 m.
/// let estimate = [DVec3::ZERO, DVec3::X, DVec3::Y];
/// let truth = estimate.map(|point| 2.0 * point + DVec3::Z);
/// let alignment = Alignment::between(&estimate, &truth)?;
/// assert!((alignment.scale - 2.0).abs() < 1e-9);
/// assert!((alignment.apply(DVec3::X) - truth[1]).length() < 1e-9);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Alignment {
    /// Scale `s`; negative if the points are mirrored.
    pub scale: f64,
    /// Translation `t`, metres, `[3]`.
    pub translation: [f64; 3],
}

impl Alignment {
    /// Scale and translation that minimise `Σ ‖s a_i + t − b_i‖²` over points `a_i` of the estimate
    /// and `b_i` of the ground truth, metres; the scale is 1 if all points of the estimate
    /// coincide.
    ///
    /// # Errors
    /// If there are no points or the numbers differ.
    pub fn between(estimate: &[DVec3], truth: &[DVec3]) -> Result<Self> {
        if estimate.is_empty() || estimate.len() != truth.len() {
            return Err(Error::argument(format!(
                "alignment: {} estimated and {} true points, expected equal numbers, at least 1",
                estimate.len(),
                truth.len()
            )));
        }
        let count = estimate.len() as f64;
        let middle = |points: &[DVec3]| points.iter().sum::<DVec3>() / count;
        let (a, b) = (middle(estimate), middle(truth));
        let (mut along, mut spread) = (0.0, 0.0);
        for (p, q) in estimate.iter().zip(truth) {
            along += (*p - a).dot(*q - b);
            spread += (*p - a).length_squared();
        }
        let scale = if spread > 0.0 { along / spread } else { 1.0 };
        Ok(Self { scale, translation: (b - a * scale).to_array() })
    }

    /// Transforms a point, metres.
    pub fn apply(&self, point: DVec3) -> DVec3 {
        point * self.scale + DVec3::from_array(self.translation)
    }
}

/// Error of an estimate after its alignment with the ground truth.
///
/// ```
/// use cape_fit::aligned_error;
/// use glam::DVec3;
///
/// // Scale and translation are no errors, and what the other vertices do does not matter.
/// let estimate = [DVec3::ZERO, DVec3::X, DVec3::Y];
/// let mut truth = estimate.map(|point| 2.0 * point + DVec3::Z);
/// truth[1] = DVec3::NEG_X;
/// let error = aligned_error(&estimate, &truth, &[0, 2])?;
/// assert!(error.squared < 1e-15 && error.distance < 1e-7);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AlignedError {
    /// Mean squared distance, m².
    pub squared: f64,
    /// Mean distance, metres.
    pub distance: f64,
}

/// Errors at the vertex indices `vertices`, the clothing vertices `C`, after their alignment (CAPE eq.
/// 12 and 13).
///
/// # Errors
/// If the numbers of points differ, or `vertices` is empty or an index is out of range.
pub fn aligned_error(
    estimate: &[DVec3],
    truth: &[DVec3],
    vertices: &[usize],
) -> Result<AlignedError> {
    if estimate.len() != truth.len() {
        return Err(Error::argument(format!(
            "alignment: {} estimated and {} true points, expected equal numbers",
            estimate.len(),
            truth.len()
        )));
    }
    if let Some(vertex) = vertices.iter().find(|&&vertex| vertex >= truth.len()) {
        return Err(Error::argument(format!("alignment: vertex {vertex} of {}", truth.len())));
    }
    if vertices.is_empty() {
        return Err(Error::argument("alignment: no vertices to compare, expected at least one"));
    }
    let chosen = |points: &[DVec3]| -> Vec<DVec3> { vertices.iter().map(|&v| points[v]).collect() };
    let (estimate, truth) = (chosen(estimate), chosen(truth));
    let alignment = Alignment::between(&estimate, &truth)?;
    let count = vertices.len() as f64;
    let off = || estimate.iter().zip(&truth).map(|(a, b)| alignment.apply(*a).distance(*b));
    Ok(AlignedError {
        squared: off().map(|distance| distance * distance).sum::<f64>() / count,
        distance: off().sum::<f64>() / count,
    })
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use proptest::prelude::*;

    use super::*;
    use cape_core::optimise::{LbfgsOptions, minimise};

    fn points(numbers: &[f64]) -> Vec<DVec3> {
        numbers.as_chunks::<3>().0.iter().map(|&p| DVec3::from_array(p)).collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        #[test]
        fn the_closed_form_is_what_an_optimiser_finds(
            a in prop::collection::vec(-1.0f64..1.0, 15),
            b in prop::collection::vec(-1.0f64..1.0, 15),
        ) {
            let (a, b) = (points(&a), points(&b));
            let found = Alignment::between(&a, &b).unwrap();
            let options = LbfgsOptions { gain: 0.0, gradient: 1e-10, ..Default::default() };
            let expected = minimise(vec![1.0, 0.0, 0.0, 0.0], &options, |x, g| {
                g.fill(0.0);
                let mut sum = 0.0;
                for (p, q) in a.iter().zip(&b) {
                    let off = *p * x[0] + DVec3::from_slice(&x[1..]) - *q;
                    sum += off.length_squared();
                    g[0] += 2.0 * off.dot(*p);
                    (0..3).for_each(|i| g[1 + i] += 2.0 * off[i]);
                }
                Ok::<_, Infallible>(sum)
            })
            .unwrap();
            prop_assert!((found.scale - expected.x[0]).abs() < 1e-6);
            for i in 0..3 {
                prop_assert!((found.translation[i] - expected.x[1 + i]).abs() < 1e-6);
            }
        }

        #[test]
        fn scaled_and_moved_points_come_back(
            a in prop::collection::vec(-1.0f64..1.0, 12), scale in 0.2f64..4.0, x in -5.0f64..5.0,
        ) {
            let a = points(&a);
            let b: Vec<DVec3> = a.iter().map(|p| (*p - DVec3::splat(x)) / scale).collect();
            let error = aligned_error(&b, &a, &[0, 2]).unwrap();
            prop_assert!(error.squared < 1e-20 && error.distance < 1e-10);
        }
    }

    #[test]
    fn incomparable_points_are_refused() {
        let one = [DVec3::ONE];
        assert_eq!(Alignment::between(&one, &[DVec3::ZERO]).unwrap().scale, 1.0);
        assert!(Alignment::between(&[], &[]).is_err());
        assert!(Alignment::between(&one, &[]).is_err());
        assert!(aligned_error(&one, &one, &[]).is_err());
        assert!(aligned_error(&one, &one, &[1]).is_err());
    }
}
