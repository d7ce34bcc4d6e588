//! Energy of SMPLify (Bogo et al. 2016): reprojection of joints and priors of pose and shape.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::{
    Error, PinholeCamera, PosePrior, Result, Skeleton,
    keypoints::KeypointDetection,
    parameters::{BETAS_AT, POSE_AT, transl},
};

/// Index in the pose and sign of the hyperextension angle of elbows and knees (term `E_a`). Elbows
/// bend about the y axis, knees about the x axis.
const BENDS: [(usize, f64); 4] =
    [(18 * 3 + 1, 1.0), (19 * 3 + 1, -1.0), (4 * 3, -1.0), (5 * 3, -1.0)];

/// Weights of the body terms.
///
/// ```
/// use cape_fit::{BodyTerms, BodyWeights};
///
/// let terms = BodyTerms { joints: 1.0, pose: 2.0, shape: 3.0, bend: 4.0 };
/// let weights = BodyWeights { joints: 1.0, pose: 0.5, shape: 1.0, bend: 0.0 };
/// assert_eq!(terms.weighted(&weights), 5.0);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BodyWeights {
    /// Weight of the reprojection term `E_J`.
    pub joints: f64,
    /// Weight λ_θ of the pose prior `E_θ`.
    pub pose: f64,
    /// Weight λ_β of the shape prior `E_β`.
    pub shape: f64,
    /// Weight λ_a of the hyperextension term `E_a`.
    pub bend: f64,
}

impl BodyWeights {
    /// An error if a weight is negative or not finite.
    pub(crate) fn check(&self) -> Result<()> {
        let Self { joints, pose, shape, bend } = *self;
        for (field, weight) in
            [("joints", joints), ("pose", pose), ("shape", shape), ("bend", bend)]
        {
            check_weight(field, weight)?;
        }
        Ok(())
    }
}

/// An error if a weight is negative or not finite.
pub(crate) fn check_weight(field: &str, weight: f64) -> Result<()> {
    if weight >= 0.0 && weight.is_finite() {
        return Ok(());
    }
    Err(Error::argument(format!("configuration: `{field}` {weight}, expected 0 or more")))
}

impl Default for BodyWeights {
    fn default() -> Self {
        Self { joints: 1.0, pose: 1.0, shape: 0.5, bend: 1.0 }
    }
}

/// Unweighted body terms.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct BodyTerms {
    /// Reprojection term `E_J`: half the robust squared errors in standard deviations of the
    /// detector.
    pub joints: f64,
    /// Pose prior `E_θ`: negative log-density, up to a constant.
    pub pose: f64,
    /// Shape prior `E_β = ‖β‖²`.
    pub shape: f64,
    /// Hyperextension term `E_a = Σ exp(angle)` over elbows and knees.
    pub bend: f64,
}

impl BodyTerms {
    /// Weighted sum `E_J + λ_θ E_θ + λ_β E_β + λ_a E_a`.
    pub fn weighted(&self, weights: &BodyWeights) -> f64 {
        weights.joints * self.joints
            + weights.pose * self.pose
            + weights.shape * self.shape
            + weights.bend * self.bend
    }
}

/// Energy of bodies given a camera and keypoint detections.
#[derive(Debug, Clone)]
pub struct BodyEnergy<'a> {
    /// Skeleton of the body.
    pub skeleton: &'a Skeleton,
    /// Pose prior.
    pub prior: &'a PosePrior,
    /// Camera.
    pub camera: PinholeCamera,
    /// Detections of the joints.
    pub detections: &'a [KeypointDetection],
    /// Width of a pixel at the distance of the person, metres: errors are in metres, so that
    /// weights do not depend on the size of the image.
    pub pixel: f64,
    /// Standard deviation of the detector at the distance of the person, metres.
    pub deviation: f64,
    /// Geman–McClure scale σ (outlier threshold) at the distance of the person, metres.
    pub robust_scale: f64,
}

impl BodyEnergy<'_> {
    /// Terms at the unknowns `[3 + 72 + betas, …]` with `betas` shape coefficients; the weighted
    /// gradient is added to `gradient`.
    ///
    /// # Errors
    /// If sizes do not fit the body.
    pub(crate) fn evaluate(
        &self,
        x: &[f64],
        betas: usize,
        weights: &BodyWeights,
        gradient: &mut [f64],
    ) -> Result<BodyTerms> {
        let (pose, betas) = (&x[POSE_AT..BETAS_AT], &x[BETAS_AT..BETAS_AT + betas]);
        let mut terms = BodyTerms::default();
        if weights.joints > 0.0 {
            let posed = self.skeleton.pose(betas, pose, transl(x))?;
            let mut forces = vec![DVec3::ZERO; posed.joints().len()];
            for detection in self.detections {
                let at = posed.joints()[detection.joint];
                let seen = glam::DVec2::new(detection.at.x, detection.at.y);
                let error = (self.camera.project(at) - seen) * self.pixel;
                let (penalty, share) = geman_mcclure(error.length_squared(), self.robust_scale);
                let weight = detection.at.confidence / (2.0 * self.deviation * self.deviation);
                terms.joints += weight * penalty;
                let pull = error * (2.0 * share * weight * weights.joints * self.pixel);
                forces[detection.joint] += self.camera.pull_back(at, pull);
            }
            let by = posed.pull_back(&forces);
            let parts = by.transl.to_array().into_iter().chain(by.pose).chain(by.betas);
            gradient.iter_mut().zip(parts).for_each(|(g, part)| *g += part);
        }
        let priors = prior_terms(self.prior, x, betas.len(), weights, gradient);
        Ok(BodyTerms { joints: terms.joints, ..priors })
    }

    /// Mean distance of the projected joints from their detections, weighted by confidence, pixels.
    ///
    /// # Errors
    /// If sizes do not fit the body.
    pub(crate) fn joint_error(&self, x: &[f64], betas: usize) -> Result<f64> {
        let (pose, betas) = (&x[POSE_AT..BETAS_AT], &x[BETAS_AT..BETAS_AT + betas]);
        let posed = self.skeleton.pose(betas, pose, transl(x))?;
        let error = |s: &KeypointDetection| {
            let at = self.camera.project(posed.joints()[s.joint]);
            s.at.confidence * (at.x - s.at.x).hypot(at.y - s.at.y)
        };
        let confidence: f64 = self.detections.iter().map(|s| s.at.confidence).sum();
        Ok(self.detections.iter().map(error).sum::<f64>() / confidence.max(1e-9))
    }
}

/// Prior terms (all but `E_J`) at the unknowns `[3 + 72 + betas, …]`; the weighted gradient is
/// added to `gradient`.
pub(crate) fn prior_terms(
    prior: &PosePrior,
    x: &[f64],
    betas: usize,
    weights: &BodyWeights,
    gradient: &mut [f64],
) -> BodyTerms {
    let (pose, betas) = (&x[POSE_AT..BETAS_AT], &x[BETAS_AT..BETAS_AT + betas]);
    let by_pose = &mut gradient[POSE_AT + 3..BETAS_AT];
    let mut terms =
        BodyTerms { pose: prior.energy(&pose[3..], weights.pose, by_pose), ..<_>::default() };
    for (at, beta) in betas.iter().enumerate() {
        terms.shape += beta * beta;
        gradient[BETAS_AT + at] += 2.0 * weights.shape * beta;
    }
    for (at, sign) in BENDS {
        let penalty = (sign * pose[at]).exp();
        terms.bend += penalty;
        gradient[POSE_AT + at] += weights.bend * sign * penalty;
    }
    terms
}

/// Geman–McClure penalty `ρ = σ² e² / (σ² + e²)` of a squared error `e²`, and its derivative with
/// respect to `e²`.
pub(crate) fn geman_mcclure(square: f64, sigma: f64) -> (f64, f64) {
    let s = sigma * sigma;
    let share = s / (s + square);
    (share * square, share * share)
}

#[cfg(test)]
mod tests {
    use cape_core::joints::JOINT_NAMES;
    use cape_synth::{Motion, MotionStyle};
    use ndarray::{Array1, Array2, Array3};
    use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

    use super::*;
    use crate::{
        keypoints::Keypoint,
        pose_prior::BODY_POSE,
        testing::{BODY, assert_gradient},
    };

    #[test]
    fn gradients_agree_with_finite_differences() {
        let skeleton = Skeleton::new(&BODY).unwrap();
        let prior = PosePrior::new(
            Array1::ones(1),
            Array2::from_elem((1, BODY_POSE), 0.1),
            Array3::from_shape_fn(
                (1, BODY_POSE, BODY_POSE),
                |(_, i, j)| {
                    if i == j { 0.3 } else { 0.001 }
                },
            ),
        )
        .unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        let detections: Vec<KeypointDetection> = (0..24)
            .map(|joint| KeypointDetection {
                joint,
                at: Keypoint {
                    x: rng.random_range(100.0..400.0),
                    y: rng.random_range(100.0..400.0),
                    confidence: rng.random_range(0.1..1.0),
                },
            })
            .collect();
        let energy = BodyEnergy {
            skeleton: &skeleton,
            prior: &prior,
            camera: PinholeCamera::new(512, 512, None).unwrap(),
            detections: &detections,
            pixel: 0.004,
            deviation: 0.02,
            robust_scale: 0.3,
        };
        let mut x: Vec<f64> = (0..3 + 72 + 10).map(|_| rng.random_range(-0.5..0.5)).collect();
        x[2] -= 3.0;
        let weights = BodyWeights { joints: 0.7, pose: 1.3, shape: 2.0, bend: 4.0 };
        let value = |x: &[f64], gradient: &mut [f64]| {
            energy.evaluate(x, 10, &weights, gradient).unwrap().weighted(&weights)
        };
        let mut gradient = vec![0.0; x.len()];
        value(&x, &mut gradient);
        assert_gradient(&x, &gradient, 1e-6, |x| value(x, &mut vec![0.0; x.len()]));
    }

    #[test]
    fn bends_are_penalised_the_unnatural_way() {
        let joints: Vec<&str> = BENDS.iter().map(|&(at, _)| JOINT_NAMES[at / 3]).collect();
        assert_eq!(joints, ["l_elbow", "r_elbow", "l_knee", "r_knee"]);
        let mut lowest = [0.0f64; 4];
        for motion in Motion::CAPTURED {
            for frame in 0..40 {
                let pose = motion.pose(&MotionStyle::default(), 0.1 * f64::from(frame));
                for (lowest, (at, sign)) in lowest.iter_mut().zip(BENDS) {
                    *lowest = lowest.min(sign * pose[at]);
                    assert!(sign * pose[at] < 0.05, "{motion} {}", JOINT_NAMES[at / 3]);
                }
            }
        }
        assert!(lowest.iter().all(|&most| most < -0.8), "{lowest:?}");
    }

    #[test]
    fn far_errors_lose_their_pull() {
        let (near, _) = geman_mcclure(0.01, 10.0);
        assert!((near - 0.01).abs() < 1e-5);
        let (far, share) = geman_mcclure(1e8, 10.0);
        assert!((far - 100.0).abs() < 1e-3 && share < 1e-8);
    }
}
