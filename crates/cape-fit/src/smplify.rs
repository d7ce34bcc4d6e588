//! Bare bodies from keypoints: SMPLify (Bogo et al. 2016), without its interpenetration term, as
//! CAPE uses it (§6.3).

use std::f64::consts::{FRAC_PI_2, PI};

use cape_core::SmplModel;
use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::{
    BodyParameters, Error, Keypoints, LbfgsOptions, PinholeCamera, PosePrior, Result, Skeleton,
    body_energy::{BodyEnergy, BodyTerms, BodyWeights},
    depth_ambiguity::{LIMBS, WHICH, mirror_limb_depths, mirror_trunk_lean},
    initial::{InitialPlacement, place},
    keypoints::KeypointDetection,
    parameters::{POSE_AT, solve},
};

/// How bare bodies are fitted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SmplifyConfig {
    /// Shape coefficients solved for, at most those of the body.
    pub betas: usize,
    /// Confidence from which a keypoint counts.
    pub confidence: f64,
    /// Standard deviation of the detector, metres at the person's distance.
    pub deviation: f64,
    /// Size of errors from which they are rather mistakes, metres at the person's distance.
    pub robust_scale: f64,
    /// Weights of the terms, one stage of the optimisation after the other: priors begin strong,
    /// so that the body first finds its place, and give way.
    pub stages: Vec<BodyWeights>,
    /// The directions that the body is first taken to face, radians to the left of the camera; the
    /// best of the outcomes is kept.
    pub facing: Vec<f64>,
    /// The optimiser, in every stage.
    pub optimiser: LbfgsOptions,
    /// Mean error of joints above which the fit is said to have failed, metres.
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
                    "configuration: `{field}` of {value}, expected above 0"
                )));
            }
        }
        let facing = !self.facing.is_empty() && self.facing.iter().all(|yaw| yaw.is_finite());
        if self.stages.is_empty() || !facing {
            return Err(Error::argument(
                "configuration: `stages`, `facing`: expected at least one each, finite",
            ));
        }
        self.stages.iter().try_for_each(BodyWeights::check)
    }
}

/// A bare body that explains keypoints.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BodyFit {
    /// The body.
    pub parameters: BodyParameters,
    /// What it becomes from where its trunk is mirrored in depth.
    pub leaning: BodyParameters,
    /// Terms of the energy.
    pub terms: BodyTerms,
    /// Energy after every step of every stage, by the stage's weights.
    pub curves: Vec<Vec<f64>>,
    /// Mean distance of the joints from where they were seen, pixels.
    pub joint_error: f64,
    /// Metres that a pixel is wide at the person's distance.
    pub pixel: f64,
    /// The direction that the body was first taken to face, radians.
    pub facing: f64,
    /// Why the fit cannot be trusted, if it cannot.
    pub problem: Option<String>,
}

/// Fits bare bodies of one kind.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use cape_synth::synthetic_body;
/// use cape_fit::{PinholeCamera, PosePrior, Smplify, SmplifyConfig};
///
/// // From a body that is nearly right, with two shape coefficients.
/// let model = synthetic_body();
/// let camera = PinholeCamera::new(512, 512, None)?;
/// let (truth, keypoints) = seen(&model, &camera)?;
/// let config = SmplifyConfig { betas: 2, ..SmplifyConfig::default() };
/// let smplify = Smplify::new(&model, PosePrior::synthetic()?, config)?;
/// let fit = smplify.fit(&camera, &keypoints, Some(&truth))?;
/// assert_eq!(fit.parameters.betas.len(), 2);
/// // Joints are within 5 cm of where they were seen.
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
    /// For a body with SMPL's 24 joints.
    ///
    /// # Errors
    /// If the body has others, or the configuration is impossible.
    pub fn new(model: &SmplModel, prior: PosePrior, config: SmplifyConfig) -> Result<Self> {
        config.check()?;
        let skeleton = Skeleton::new(model)?;
        if skeleton.joints() != cape_core::joints::JOINTS {
            return Err(Error::argument(format!(
                "a body of {} joints, expected SMPL's {}",
                skeleton.joints(),
                cape_core::joints::JOINTS
            )));
        }
        Ok(Self { skeleton, prior, config })
    }

    /// The configuration.
    pub fn config(&self) -> &SmplifyConfig {
        &self.config
    }

    /// The joints that count.
    pub(crate) fn detections(&self, keypoints: &Keypoints) -> Vec<KeypointDetection> {
        keypoints.detections(self.config.confidence)
    }

    /// Why a fit whose joints are so far off, metres, cannot be trusted.
    pub(crate) fn problem(&self, joint_error: f64) -> Option<String> {
        (joint_error.is_nan() || joint_error > self.config.accepted).then(|| {
            format!(
                "joints are {:.0} mm from where they were seen on average: more than {:.0} mm",
                1000.0 * joint_error,
                1000.0 * self.config.accepted
            )
        })
    }

    /// The energy of what was seen, where a pixel is so wide.
    pub(crate) fn energy<'a>(
        &'a self,
        camera: &PinholeCamera,
        sightings: &'a [KeypointDetection],
        pixel: f64,
    ) -> BodyEnergy<'a> {
        BodyEnergy {
            skeleton: &self.skeleton,
            prior: &self.prior,
            camera: *camera,
            sightings,
            pixel,
            deviation: self.config.deviation,
            robust_scale: self.config.robust_scale,
        }
    }

    /// The body that explains the keypoints best, of those found from the poses that people often
    /// take, or from `initial`, in every orientation that the configuration names.
    ///
    /// # Errors
    /// If too few joints were seen to place a body, or `initial` is none.
    pub fn fit(
        &self,
        camera: &PinholeCamera,
        keypoints: &Keypoints,
        initial: Option<&BodyParameters>,
    ) -> Result<BodyFit> {
        let betas = self.config.betas.min(self.skeleton.betas());
        let sightings = self.detections(keypoints);
        let distance = place(camera, &self.skeleton.rest(&[]), &sightings, 0.0)?.distance;
        let pixel = distance / camera.focal();
        let energy = self.energy(camera, &sightings, pixel);
        let mut attempts = Vec::new();
        for mut start in self.starts(initial)? {
            start.betas.resize(betas, 0.0);
            start.pose[..3].fill(0.0);
            let joints = self.skeleton.pose(&start.betas, &start.pose, DVec3::ZERO)?;
            for &facing in &self.config.facing {
                let placement = place(camera, joints.joints(), &sightings, facing)?;
                attempts.push(self.attempt(&energy, &start, &placement, facing)?);
            }
        }
        let Some(mut best) = lowest(attempts) else {
            return Err(Error::Failed("no orientation of the body has a finite energy".into()));
        };
        let mirrored = self.mirrored(&energy, &best)?;
        if let Some(other) = lowest(mirrored).filter(|other| other.energy < best.energy) {
            best = other;
        }
        let last = self.config.stages.last().copied().unwrap_or_default();
        let mut other =
            Candidate { x: mirror_trunk_lean(&self.skeleton, &best.x, betas)?, ..best.clone() };
        self.descend(&energy, &mut other, &last, |_| true)?;
        let Candidate { x, curves, facing, .. } = best;
        let joint_error = energy.joint_error(&x, betas)?;
        Ok(BodyFit {
            parameters: BodyParameters::from_vector(&x, betas),
            leaning: BodyParameters::from_vector(&other.x, betas),
            terms: energy.evaluate(&x, betas, &last, &mut vec![0.0; x.len()])?,
            curves,
            joint_error,
            pixel,
            facing,
            problem: self.problem(joint_error * pixel),
        })
    }

    /// What the body becomes from where bones of its limbs are mirrored in depth.
    fn mirrored(&self, energy: &BodyEnergy<'_>, body: &Candidate) -> Result<Vec<Candidate>> {
        let weights = self.config.stages.last().copied().unwrap_or_default();
        let mut found = Vec::new();
        for limb in LIMBS {
            for which in WHICH {
                let x = mirror_limb_depths(&self.skeleton, &body.x, body.betas, limb, which)?;
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

    /// Place and orientation by the first stage's weights, then everything, stage by stage.
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

/// The body of the lowest finite energy.
fn lowest(attempts: Vec<Candidate>) -> Option<Candidate> {
    let finite = attempts.into_iter().filter(|attempt| attempt.energy.is_finite());
    finite.min_by(|a, b| a.energy.total_cmp(&b.energy))
}

/// A body on its way.
#[derive(Debug, Clone)]
struct Candidate {
    x: Vec<f64>,
    betas: usize,
    /// By the weights of the stage it has been through.
    energy: f64,
    curves: Vec<Vec<f64>>,
    facing: f64,
}
