//! Garment sizes as ratios to the wearer's measurements (§5.3 of the paper).

use cape_core::{SmplModel, geometry::points, joints::JOINTS};
use ndarray::Array2;

use crate::{Error, Result};

/// Measurements of a body in its rest pose by which garment sizes are compared, metres.
///
/// ```
/// use cape_layer::BodyMeasurements;
/// use cape_synth::synthetic_body;
///
/// // A body that is a tenth larger has a tenth larger measurements.
/// let body = synthetic_body();
/// let shape = body.rest_shape(&[])?;
/// let [plain, large] =
///     [BodyMeasurements::new(&body, &shape)?, BodyMeasurements::new(&body, &(1.1 * &shape))?];
/// assert!((large.neck_to_knee / plain.neck_to_knee - 1.1).abs() < 1e-9);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BodyMeasurements {
    /// Height of the neck above the left knee.
    pub neck_to_knee: f64,
    /// Width and depth of the trunk at the height of the hip joints, together.
    pub hips: f64,
    /// Distance of the left shoulder from the left elbow, and of the elbow from the wrist, together.
    pub arm: f64,
}

/// SMPL's joints of the measurements.
const HIP: usize = 1;
const KNEE: usize = 4;
const NECK: usize = 12;
const ARM: [usize; 3] = [16, 18, 20];

/// Half height of the slice of the trunk that is measured, metres.
const SLICE: f64 = 0.02;

/// A measurement of a body.
type Measure = fn(&BodyMeasurements) -> f64;

/// Garment sizes, their names as ratios to the wearer, and the measurements that they are ratios to.
const SIZES: [(&str, &str, Measure); 4] = [
    ("length", "length_ratio", |body| body.neck_to_knee),
    ("width", "width_ratio", |body| body.hips),
    ("sleeve", "sleeve_ratio", |body| body.arm),
    ("size", "size_ratio", |body| body.neck_to_knee),
];

impl BodyMeasurements {
    /// Measures a body with the unclothed rest shape `[V, 3]`, metres.
    ///
    /// # Errors
    /// If the shape is of another body, or the body has fewer joints than SMPL's.
    pub fn new(model: &SmplModel, shape: &Array2<f64>) -> Result<Self> {
        let joints = points(model.rest_joints(shape)?.view());
        if joints.len() <= ARM[2] {
            return Err(Error::argument(format!(
                "measurements of a body: {} joints, expected SMPL's {JOINTS}",
                joints.len()
            )));
        }
        let at = joints[HIP].y;
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for point in points(shape.view()).into_iter().filter(|point| (point.y - at).abs() < SLICE) {
            for (side, x) in [point.x, point.z].into_iter().enumerate() {
                (low[side], high[side]) = (low[side].min(x), high[side].max(x));
            }
        }
        let [shoulder, elbow, wrist] = ARM.map(|joint| joints[joint]);
        Ok(Self {
            neck_to_knee: joints[NECK].y - joints[KNEE].y,
            hips: high[0] - low[0] + high[1] - low[1],
            arm: shoulder.distance(elbow) + elbow.distance(wrist),
        })
    }

    /// Factor that makes the ratio to this body, named `ratio`, of a size relative to the body `cut_for`;
    /// `None` if this is no such name.
    pub(crate) fn factor(&self, ratio: &str, cut_for: &Self) -> Option<f64> {
        let (_, _, measure) = SIZES.into_iter().find(|&(_, name, _)| name == ratio)?;
        Some(measure(cut_for) / measure(self))
    }
}

/// Name of a garment size as a ratio to the wearer; `None` for other parameters.
pub(crate) fn ratio_name(size: &str) -> Option<&'static str> {
    SIZES.into_iter().find(|&(name, ..)| name == size).map(|(_, ratio, _)| ratio)
}

/// Name of the garment size of a ratio to the wearer; `None` for other parameters.
pub(crate) fn size_name(ratio: &str) -> Option<&'static str> {
    SIZES.into_iter().find(|&(_, name, _)| name == ratio).map(|(size, ..)| size)
}

#[cfg(test)]
mod tests {
    use cape_synth::synthetic_body;

    use super::*;

    #[test]
    fn the_ratio_of_a_garment_is_less_to_a_larger_wearer() {
        let model = synthetic_body();
        let shape = model.rest_shape(&[]).unwrap();
        let plain = BodyMeasurements::new(&model, &shape).unwrap();
        // About half of an adult's stature, the girth of hips, and the length of an arm.
        assert!((0.6..1.1).contains(&plain.neck_to_knee), "{plain:?}");
        assert!((0.4..0.9).contains(&plain.hips) && (0.4..0.7).contains(&plain.arm), "{plain:?}");
        let large = BodyMeasurements::new(&model, &(1.25 * &shape)).unwrap();
        for name in ["length", "width", "sleeve", "size"] {
            let ratio = ratio_name(name).unwrap();
            assert_eq!(size_name(ratio), Some(name));
            // The slice at the hips is of other vertices.
            let factor = large.factor(ratio, &plain).unwrap();
            assert!((factor - 0.8).abs() < 0.02, "{name}: {factor}");
        }
        assert_eq!((ratio_name("friction"), large.factor("length", &plain)), (None, None));
    }
}
