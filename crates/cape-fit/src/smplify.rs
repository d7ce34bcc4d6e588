//! Unclothed bodies fitted to keypoints: SMPLify (Bogo et al. 2016) without its interpenetration
//! term, as in CAPE §6.3.

use std::f64::consts::{FRAC_PI_2, PI};

use cape_core::SmplModel;
use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::{
    BodyParameters, Error, FitProblem, Keypoints, LbfgsOptions, PinholeCamera, PosePrior, Result,
    Skeleton,
    body_energy::{BodyEnergy, BodyTerms, BodyWeights},
    depth_ambiguity::{BONE_FLIPS, LIMBS, mirror_limb_depths, mirror_trunk_lean},
    initial::{InitialPlacement, place},
    keypoints::KeypointDetection,
    parameters::{POSE_AT, solve},
};

/// Configuration of the unclothed fit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SmplifyConfig {
    /// Number of shape coefficients to fit, at most those of the body.
    pub betas: usize,
    /// Least confidence of a keypoint.
    pub confidence: f64,
    /// Standard deviation of the detector at the distance of the person, metres.
    pub deviation: f64,
    /// Geman–McClure scale σ (outlier threshold) at the distance of the person, metres.
    pub robust_scale: f64,
    /// Weights of the terms in each stage of the optimisation; the priors decrease from stage to
    /// stage.
    pub stages: Vec<BodyWeights>,
    /// Initial yaw angles of the body, radians, 0 facing the camera; the fit of lowest energy is
    /// kept.
    pub facing: Vec<f64>,
    /// Options of the optimiser in each stage.
    pub optimiser: LbfgsOptions,
    /// Largest mean joint error of a reliable fit, metres.
    pub accepted: f64,
}

impl Default for SmplifyConfig {
    fn default() -> Self {
        let stage = |prior: f64| BodyWeights { pose: prior, shape: 0.5 * prior, ..<_>::default() };
        Self {
            betas: 10,
            confidence: 0.1,
            deviation: 0.02,
            robust_scale: 0.3,
            stages: [100.0, 20.0, 4.0, 1.0].map(stage).to_vec(),
            facing: vec![0.0, PI, FRAC_PI_2, -FRAC_PI_2],
            optimiser: LbfgsOptions { gain: 1e-6, ..LbfgsOptions::default() },
            accepted: 0.1,
        }
    }
}

impl SmplifyConfig {
    pub(crate) fn check(&self) -> Result<()> {
        let positive = [("deviation", self.deviation), ("robust_scale", self.robust_scale)];
        for (field, value) in positive {
            if !(value > 0.0 && value.is_finite()) {
                return Err(Error::argument(format!(
                    "configuration: `{field}` {value}, expected above 0"
                )));
            }
        }
        let facing = !self.facing.is_empty() && self.facing.iter().all(|yaw| yaw.is_finite());
        if self.stages.is_empty() || !facing {
            return Err(Error::argument(
                "configuration: `stages` and `facing`: expected at least one finite entry each",
            ));
        }
        self.stages.iter().try_for_each(BodyWeights::check)
    }
}

/// Unclothed body fitted to keypoints.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BodyFit {
    /// Body.
    pub parameters: BodyParameters,
    /// Body fitted from the start with the trunk mirrored in depth.
    pub leaning: BodyParameters,
    /// Terms of the energy.
    pub terms: BodyTerms,
    /// Energy after each optimiser step, one curve for each stage.
    pub curves: Vec<Vec<f64>>,
    /// Mean distance of the projected joints from their detections, pixels.
    pub joint_error: f64,
    /// Width of a pixel at the distance of the person, metres.
    pub pixel: f64,
    /// Initial yaw angle, radians.
    pub facing: f64,
    /// Problem of the fit, if it is unreliable.
    pub problem: Option<FitProblem>,
}

/// Fitter of unclothed bodies of one body model.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use cape_synth::synthetic_body;
/// use cape_fit::{PinholeCamera, PosePrior, Smplify, SmplifyConfig};
///
/// // Start from the true body, with two shape coefficients.
/// let model = synthetic_body();
/// let camera = PinholeCamera::new(512, 512, None)?;
/// let (truth, keypoints) = seen(&model, &camera)?;
/// let config = SmplifyConfig { betas: 2, ..SmplifyConfig::default() };
/// let smplify = Smplify::new(&model, PosePrior::synthetic()?, config)?;
/// let fit = smplify.fit(&camera, &keypoints, Some(&truth))?;
/// assert_eq!(fit.parameters.betas.len(), 2);
/// // Joints are within 5 cm of their detections.
/// assert!(fit.joint_error * fit.pixel < 0.05);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct Smplify {
    skeleton: Skeleton,
    prior: PosePrior,
    config: SmplifyConfig,
}

impl Smplify {
    /// A fitter of a body model with SMPL's 24 joints.
    ///
    /// # Errors
    /// If the body has another number of joints, or the configuration is out of range.
    pub fn new(model: &SmplModel, prior: PosePrior, config: SmplifyConfig) -> Result<Self> {
        config.check()?;
        let skeleton = Skeleton::new(model)?;
        if skeleton.joints() != cape_core::joints::JOINTS {
            return Err(Error::argument(format!(
                "SMPLify: a body of {} joints, expected SMPL's {}",
                skeleton.joints(),
                cape_core::joints::JOINTS
            )));
        }
        Ok(Self { skeleton, prior, config })
    }

    /// Configuration.
    pub fn config(&self) -> &SmplifyConfig {
        &self.config
    }

    /// Detections with enough confidence.
    pub(crate) fn detections(&self, keypoints: &Keypoints) -> Vec<KeypointDetection> {
        keypoints.detections(self.config.confidence)
    }

    /// Problem of a fit with the mean joint error `joint_error`, metres, if it is too large.
    pub(crate) fn problem(&self, joint_error: f64) -> Option<FitProblem> {
        let limit = self.config.accepted;
        (joint_error.is_nan() || joint_error > limit).then_some(FitProblem::JointError {
            error_mm: 1000.0 * joint_error,
            limit_mm: 1000.0 * limit,
        })
    }

    /// Energy given detections and the width of a pixel at the distance of the person, metres.
    pub(crate) fn energy<'a>(
        &'a self,
        camera: &PinholeCamera,
        detections: &'a [KeypointDetection],
        pixel: f64,
    ) -> BodyEnergy<'a> {
        BodyEnergy {
            skeleton: &self.skeleton,
            prior: &self.prior,
            camera: *camera,
            detections,
            pixel,
            deviation: self.config.deviation,
            robust_scale: self.config.robust_scale,
        }
    }

    /// Fits the body to keypoints from the means of the pose prior, or from `initial`, in each
    /// orientation of the configuration; the fit of lowest energy is kept.
    ///
    /// # Errors
    /// If too few joints are detected to place a body, or `initial` is invalid.
    pub fn fit(
        &self,
        camera: &PinholeCamera,
        keypoints: &Keypoints,
        initial: Option<&BodyParameters>,
    ) -> Result<BodyFit> {
        let detections = self.detections(keypoints);
        let BodyCandidates { pixel, best, leaning, .. } =
            self.candidates(camera, &detections, initial)?;
        let energy = self.energy(camera, &detections, pixel);
        let Candidate { x, betas, curves, facing, .. } = best;
        let last = self.last_weights();
        let joint_error = energy.joint_error(&x, betas)?;
        Ok(BodyFit {
            parameters: BodyParameters::from_vector(&x, betas),
            leaning: BodyParameters::from_vector(&leaning.x, betas),
            terms: energy.evaluate(&x, betas, &last, &mut vec![0.0; x.len()])?,
            curves,
            joint_error,
            pixel,
            facing,
            problem: self.problem(joint_error * pixel),
        })
    }

    /// Bodies that explain detections about equally well: the fit of lowest energy, and those from
    /// other orientations and with limbs or trunk mirrored in depth.
    ///
    /// # Errors
    /// As of [`fit`](Self::fit).
    pub(crate) fn candidates(
        &self,
        camera: &PinholeCamera,
        detections: &[KeypointDetection],
        initial: Option<&BodyParameters>,
    ) -> Result<BodyCandidates> {
        let betas = self.config.betas.min(self.skeleton.betas());
        let distance = place(camera, &self.skeleton.rest(&[]), detections, 0.0)?.distance;
        let pixel = distance / camera.focal();
        let energy = self.energy(camera, detections, pixel);
        let mut attempts = Vec::new();
        for mut start in self.starts(initial)? {
            start.betas.resize(betas, 0.0);
            start.pose[..3].fill(0.0);
            let joints = self.skeleton.pose(&start.betas, &start.pose, DVec3::ZERO)?;
            for &facing in &self.config.facing {
                let placement = place(camera, joints.joints(), detections, facing)?;
                attempts.push(self.attempt(&energy, &start, &placement, facing)?);
            }
        }
        let Some(mut best) = lowest(&attempts) else {
            let message = "SMPLify: the energy is not finite in any orientation: check the \
                           keypoints and the focal length";
            return Err(Error::Failed(message.into()));
        };
        let mut others = self.mirrored(&energy, &best)?;
        if let Some(other) = lowest(&others).filter(|other| other.energy < best.energy) {
            others.push(best);
            best = other;
        }
        for &facing in &self.config.facing {
            let facing = |attempt: &&Candidate| attempt.facing == facing;
            let alike: Vec<Candidate> = attempts.iter().filter(facing).cloned().collect();
            others.extend(lowest(&alike));
        }
        let mut leaning =
            Candidate { x: mirror_trunk_lean(&self.skeleton, &best.x, betas)?, ..best.clone() };
        self.descend(&energy, &mut leaning, &self.last_weights(), |_| true)?;
        Ok(BodyCandidates { pixel, best, leaning, others })
    }

    /// Weights of the last stage.
    pub(crate) fn last_weights(&self) -> BodyWeights {
        self.config.stages.last().copied().unwrap_or_default()
    }

    /// Skeleton of the body.
    pub(crate) fn skeleton(&self) -> &Skeleton {
        &self.skeleton
    }

    /// Fits from the body with bones of one limb mirrored in depth, for all limbs and combinations
    /// of bones.
    fn mirrored(&self, energy: &BodyEnergy<'_>, body: &Candidate) -> Result<Vec<Candidate>> {
        let weights = self.last_weights();
        let mut found = Vec::new();
        for limb in LIMBS {
            for flips in BONE_FLIPS {
                let x = mirror_limb_depths(&self.skeleton, &body.x, body.betas, limb, flips)?;
                let mut attempt = Candidate { x, ..body.clone() };
                self.descend(energy, &mut attempt, &weights, |_| true)?;
                found.push(attempt);
            }
        }
        Ok(found)
    }

    fn starts(&self, initial: Option<&BodyParameters>) -> Result<Vec<BodyParameters>> {
        if let Some(initial) = initial {
            initial.check()?;
            return Ok(vec![initial.clone()]);
        }
        let standing = self.prior.means().rows().into_iter();
        standing
            .map(|pose| BodyParameters::new([&[0.0; 3], &pose.to_vec()[..]].concat(), vec![]))
            .collect()
    }

    /// Fits translation and orientation with the weights of the first stage, then all unknowns
    /// stage by stage.
    fn attempt(
        &self,
        energy: &BodyEnergy<'_>,
        start: &BodyParameters,
        placement: &InitialPlacement,
        facing: f64,
    ) -> Result<Candidate> {
        let mut body = start.clone();
        body.transl = placement.transl.to_array();
        body.pose[..3].copy_from_slice(&placement.orientation.to_array());
        let mut attempt = Candidate {
            x: body.to_vector(),
            betas: body.betas.len(),
            energy: f64::INFINITY,
            curves: Vec::new(),
            facing,
        };
        let weights = self.config.stages.first().copied().unwrap_or_default();
        self.descend(energy, &mut attempt, &weights, |at| at < POSE_AT + 3)?;
        for weights in &self.config.stages {
            self.descend(energy, &mut attempt, weights, |_| true)?;
        }
        Ok(attempt)
    }

    fn descend(
        &self,
        energy: &BodyEnergy<'_>,
        attempt: &mut Candidate,
        weights: &BodyWeights,
        free: impl Fn(usize) -> bool,
    ) -> Result<()> {
        let found = solve(&attempt.x, free, &self.config.optimiser, |x, gradient| {
            Ok(energy.evaluate(x, attempt.betas, weights, gradient)?.weighted(weights))
        })?;
        attempt.x = found.x;
        attempt.energy = found.value;
        attempt.curves.push(found.curve);
        Ok(())
    }
}

/// Candidate of the lowest finite energy.
fn lowest(attempts: &[Candidate]) -> Option<Candidate> {
    let finite = attempts.iter().filter(|attempt| attempt.energy.is_finite());
    finite.min_by(|a, b| a.energy.total_cmp(&b.energy)).cloned()
}

/// State of the optimisation.
#[derive(Debug, Clone)]
pub(crate) struct Candidate {
    /// Unknowns, `[3 + 72 + betas]`.
    pub(crate) x: Vec<f64>,
    betas: usize,
    /// Energy with the weights of the last stage.
    pub(crate) energy: f64,
    curves: Vec<Vec<f64>>,
    facing: f64,
}

/// Bodies that explain the same detections.
#[derive(Debug, Clone)]
pub(crate) struct BodyCandidates {
    /// Width of a pixel at the distance of the person, metres.
    pub(crate) pixel: f64,
    /// Fit of the lowest energy.
    pub(crate) best: Candidate,
    /// Fit from the best one with the trunk mirrored in depth.
    pub(crate) leaning: Candidate,
    /// Fits from other orientations and with mirrored limbs.
    pub(crate) others: Vec<Candidate>,
}
