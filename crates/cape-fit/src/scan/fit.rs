//! Fit of clothed bodies to scans.

use cape_core::{Outfit, SmplModel};
use cape_infer::Run;
use glam::DVec3;
use ndarray::Array2;
use serde::{Deserialize, Serialize};

use super::{
    Scan, ScanDistance, ScanTerms,
    energy::{ScanEnergy, ScanTarget, distance},
    init::{ScanInit, ScanSubject, UpAxis, initial_bodies},
    stage::{ScanConfig, ScanStage, Unknowns},
};
use crate::{
    BodyParameters, BodyTerms, DressedBody, Error, FitProblem, LbfgsOptions, PosePrior, Result,
    Skeleton,
    body_energy::prior_terms,
    dressed_body::{DressedSurface, FixedClothing},
    parameters::{BETAS_AT, solve},
};

/// Unweighted terms of the energy.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct ScanFitTerms {
    /// Priors, and the joint term if joints are known.
    pub body: BodyTerms,
    /// Distance energy `E_D`, m².
    pub distance: ScanTerms,
    /// Code prior `‖z‖²`.
    pub code: f64,
}

/// Clothed body fitted to a scan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ScanFit {
    /// Body under the clothing in the frame of the scan, metres.
    pub parameters: BodyParameters,
    /// Latent code of the clothing, `[latent]`.
    pub code: Vec<f64>,
    /// Outfit.
    pub outfit: Outfit,
    /// Body before the clothing stages.
    pub before_clothes: BodyParameters,
    /// Energy of each outfit after its first clothing stage.
    pub outfits: Vec<(Outfit, f64)>,
    /// Terms of the energy.
    pub terms: ScanFitTerms,
    /// Energy after each optimiser step, one curve for each stage.
    pub curves: Vec<Vec<f64>>,
    /// Distances of the scan from the surface.
    pub distance: ScanDistance,
    /// Number of evaluations of the body.
    pub evaluations: usize,
    /// True if the normals of the scan were used as given; false if they were reversed or dropped.
    pub normals_as_given: bool,
    /// Problem of the fit, if it is unreliable.
    pub problem: Option<FitProblem>,
}

/// Progress callback: steps done and of all at most.
pub type ScanProgressFn<'a> = dyn FnMut(usize, usize) + 'a;

/// Fitter of the clothed bodies of a run to scans.
///
/// ```no_run
/// use burn::tensor::Device;
/// use cape_fit::{PosePrior, scan::{Scan, ScanConfig, ScanFitter, ScanInit, Unit, UpAxis}};
/// use cape_infer::Run;
///
/// let run = Run::open("runs/cape", &Device::default())?;
/// let prior = PosePrior::synthetic()?;
/// let start = ScanInit::default_poses(&prior);
/// let fitter = ScanFitter::new(&run, run.outfits(), None, prior, ScanConfig::default())?;
/// let scan = Scan::load("scan.ply", Unit::M)?;
/// let mut progress = |done, total| eprintln!("{done} of {total}");
/// let fit = fitter.fit(&scan, &start, UpAxis::Y, &mut progress)?;
/// println!("{:?}, {:.1} mm from the scan", fit.outfit, fit.distance.mean);
/// println!("both ways: {:?}", fit.terms.distance);
/// let vertices = fitter.surface(&fit)?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct ScanFitter {
    body: SmplModel,
    skeleton: Skeleton,
    prior: PosePrior,
    outfits: Vec<DressedBody>,
    mean_clothes: Array2<f64>,
    shape_is_known: bool,
    config: ScanConfig,
}

impl ScanFitter {
    /// A fitter that chooses among `outfits`, for any body shape or, with `minimal`, for the
    /// subject with that unclothed rest shape `[V, 3]`, metres.
    ///
    /// # Errors
    /// If there is no outfit, the shape has another size or is not finite, or the configuration is
    /// out of range.
    pub fn new(
        run: &Run,
        outfits: &[Outfit],
        minimal: Option<&Array2<f64>>,
        prior: PosePrior,
        config: ScanConfig,
    ) -> Result<Self> {
        config.check()?;
        if outfits.is_empty() {
            return Err(Error::argument("scan fit: no outfits, expected at least one"));
        }
        let mut body = run.body().clone();
        if let Some(minimal) = minimal {
            if minimal.dim() != body.v_template.dim() || minimal.iter().any(|x| !x.is_finite()) {
                return Err(Error::argument(format!(
                    "scan fit: minimal shape {:?}, expected finite numbers of shape {:?}",
                    minimal.shape(),
                    body.v_template.shape()
                )));
            }
            body.v_template.assign(minimal);
        }
        let first = *outfits
            .first()
            .ok_or_else(|| Error::argument("scan fit: no outfits, expected at least one"))?;
        let dressed = match minimal {
            Some(minimal) => DressedBody::from_subject(run, first, minimal)?,
            None => DressedBody::new(run, first)?,
        };
        let mut mean_clothes = Array2::zeros(body.v_template.dim());
        for &vertex in run.clothing() {
            mean_clothes.row_mut(vertex).assign(&run.statistics().mean().row(vertex));
        }
        Ok(Self {
            skeleton: Skeleton::new(&body)?,
            outfits: outfits
                .iter()
                .map(|&outfit| dressed.with_outfit(outfit))
                .collect::<Result<_>>()?,
            mean_clothes,
            shape_is_known: minimal.is_some(),
            body,
            prior,
            config,
        })
    }

    /// Body model, with the shape of the subject if it is known.
    pub fn body(&self) -> &SmplModel {
        &self.body
    }

    /// Unclothed rest shape of a fit, metres, `[V, 3]`.
    ///
    /// # Errors
    /// If the fit has too many shape coefficients.
    pub fn minimal(&self, fit: &ScanFit) -> Result<Array2<f64>> {
        Ok(self.body.rest_shape(&fit.parameters.betas)?)
    }

    /// Vertices of the unclothed body, metres, `[V]`.
    ///
    /// # Errors
    /// If sizes do not fit the body.
    pub fn unclothed(&self, body: &BodyParameters) -> Result<Vec<DVec3>> {
        self.pose_surface(body, None)
    }

    /// Vertices of the body in the mean clothing of the training set, metres, `[V]`.
    ///
    /// # Errors
    /// If sizes do not fit the body.
    pub fn with_mean_clothing(&self, body: &BodyParameters) -> Result<Vec<DVec3>> {
        self.pose_surface(body, Some(&self.mean_clothes))
    }

    fn pose_surface(
        &self,
        body: &BodyParameters,
        worn: Option<&Array2<f64>>,
    ) -> Result<Vec<DVec3>> {
        let posed = self.body.pose(&body.betas, &body.pose, body.transl, worn)?;
        Ok(posed.vertices.rows().into_iter().map(|v| DVec3::new(v[0], v[1], v[2])).collect())
    }

    /// Vertices of the clothed surface of a fit, metres, `[V]`.
    ///
    /// # Errors
    /// If the fit is of another outfit or model.
    pub fn surface(&self, fit: &ScanFit) -> Result<Vec<DVec3>> {
        let dressed = self.outfits.iter().find(|dressed| dressed.outfit() == fit.outfit);
        let dressed = dressed.ok_or_else(|| {
            Error::argument("scan fit: the outfit of the fit is not among those of the fitter")
        })?;
        Ok(dressed.surface(&fit.parameters, &fit.code)?.vertices().to_vec())
    }

    /// Fits a clothed body to a scan of a person whose head is towards `up`.
    ///
    /// # Errors
    /// If `start` has no usable pose, or the person in the scan is upright along another axis.
    pub fn fit(
        &self,
        scan: &Scan,
        start: &ScanInit,
        up: UpAxis,
        progress: &mut ScanProgressFn<'_>,
    ) -> Result<ScanFit> {
        let config = &self.config;
        let mut target = ScanTarget::new(scan, config.samples(), config.seed);
        let betas = if self.shape_is_known { 0 } else { config.betas.min(self.body.betas()) };
        let kind = ScanSubject {
            body: &self.body,
            skeleton: &self.skeleton,
            prior: &self.prior,
            betas,
            clothes: &self.mean_clothes,
        };
        let (bare, clothed): (Vec<ScanStage>, Vec<ScanStage>) =
            config.stages.iter().partition(|stage| stage.unknowns != Unknowns::Clothes);
        let [count, placings] = start.count(config.starts);
        let mut counter = StepCounter::new(&bare, &clothed, count, self.outfits.len(), progress);
        counter.total += placings;
        let bodies =
            initial_bodies(&kind, &target, start, up, config.starts, &mut || counter.advance(1))?;
        let first = &self.outfits[0];
        let clothes = first.mean_clothing();
        let surface = first.surface_in(&clothes, &pad_betas(&bodies[0]))?;
        let normals_as_given = target.orient(surface.vertices(), first.faces());

        let problem = |dressed, clothes| ScanProblem {
            fitter: self,
            dressed,
            clothes,
            target: &target,
            start,
            betas,
        };

        let in_mean = problem(first, Some(&clothes));
        let mut best: Option<Candidate> = None;
        let (tried, refined) = bare.split_at(bare.len().min(1));
        for body in &bodies {
            let x = [body.to_vector(), vec![0.0; first.latent()]].concat();
            let attempt = in_mean.descend(Candidate::at(x), tried, &mut counter)?;
            if best.as_ref().is_none_or(|best| attempt.value < best.value) {
                best = Some(attempt);
            }
        }
        let best = best.ok_or_else(|| Error::Failed("scan fit: no initial body".into()))?;
        let bare = in_mean.descend(best, refined, &mut counter)?;

        let (tried, refined) = clothed.split_at(1);
        let (mut best, mut outfits): (Option<(Candidate, &DressedBody)>, _) = (None, Vec::new());
        for dressed in &self.outfits {
            let attempt = problem(dressed, None).descend(bare.clone(), tried, &mut counter)?;
            outfits.push((dressed.outfit(), attempt.value));
            if best.as_ref().is_none_or(|(other, _)| attempt.value < other.value) {
                best = Some((attempt, dressed));
            }
        }
        let (attempt, dressed) = best.ok_or_else(|| Error::Failed("scan fit: no outfit".into()))?;
        let problem = problem(dressed, None);
        let found = problem.descend(attempt, refined, &mut counter)?;
        let evaluations = counter.evaluations;
        let mut fit = problem.outcome(&found, clothed[clothed.len() - 1])?;
        fit.before_clothes = BodyParameters::from_vector(&bare.x, betas);
        (fit.outfits, fit.evaluations, fit.normals_as_given) =
            (outfits, evaluations, normals_as_given);
        Ok(fit)
    }
}

/// The body with at least one shape coefficient: devices do not support empty tensors.
fn pad_betas(body: &BodyParameters) -> BodyParameters {
    let mut body = body.clone();
    if body.betas.is_empty() {
        body.betas.push(0.0);
    }
    body
}

/// State of the optimisation: unknowns `[3 + 72 + betas + latent]`.
#[derive(Debug, Clone)]
struct Candidate {
    x: Vec<f64>,
    value: f64,
    curves: Vec<Vec<f64>>,
}

impl Candidate {
    fn at(x: Vec<f64>) -> Self {
        Self { x, value: 0.0, curves: Vec::new() }
    }
}

/// Progress of the optimisation steps.
struct StepCounter<'p, 'a> {
    done: usize,
    total: usize,
    evaluations: usize,
    progress: &'p mut ScanProgressFn<'a>,
}

impl<'p, 'a> StepCounter<'p, 'a> {
    fn new(
        bare: &[ScanStage],
        clothed: &[ScanStage],
        starts: usize,
        outfits: usize,
        progress: &'p mut ScanProgressFn<'a>,
    ) -> Self {
        let steps = |stages: &[ScanStage], times: usize| -> usize {
            let each = stages.iter().enumerate();
            each.map(|(index, stage)| stage.steps * if index == 0 { times } else { 1 }).sum()
        };
        let total = steps(bare, starts) + steps(clothed, outfits);
        Self { done: 0, total, evaluations: 0, progress }
    }

    fn advance(&mut self, steps: usize) {
        self.done += steps;
        (self.progress)(self.done.min(self.total), self.total);
    }

    /// Counts an evaluation within a stage, about one for each step.
    fn count_evaluation(&mut self, within: usize) {
        self.evaluations += 1;
        (self.progress)((self.done + within).min(self.total), self.total);
    }
}

/// Energy of a body in the scan.
#[derive(Clone, Copy)]
struct ScanProblem<'a> {
    fitter: &'a ScanFitter,
    dressed: &'a DressedBody,
    /// Fixed clothing; `None` if the code is an unknown.
    clothes: Option<&'a FixedClothing>,
    target: &'a ScanTarget<'a>,
    start: &'a ScanInit,
    betas: usize,
}

impl ScanProblem<'_> {
    fn surface(&self, x: &[f64]) -> Result<DressedSurface> {
        let body = pad_betas(&BodyParameters::from_vector(x, self.betas));
        match self.clothes {
            Some(clothes) => self.dressed.surface_in(clothes, &body),
            None => self.dressed.surface(&body, &x[BETAS_AT + self.betas..]),
        }
    }

    fn distances(&self, x: &[f64], stage: &ScanStage) -> Result<ScanEnergy<'_>> {
        let surface = self.surface(x)?;
        let (faces, back) = (self.dressed.faces(), self.fitter.config.back);
        let vertices = surface.vertices();
        Ok(ScanEnergy::new(self.target, vertices, faces, stage.samples, stage.robust_scale, back))
    }

    fn evaluate(
        &self,
        x: &[f64],
        distances: &ScanEnergy<'_>,
        scale: f64,
        gradient: &mut [f64],
    ) -> Result<ScanFitTerms> {
        let config = &self.fitter.config;
        let surface = self.surface(x)?;
        let mut forces = vec![DVec3::ZERO; surface.vertices().len()];
        let distance = distances.evaluate(surface.vertices(), scale, &mut forces);
        let by = surface.pull_back(&forces)?;
        let betas = by.betas.into_iter().take(self.betas);
        let parts = by.transl.into_iter().chain(by.pose).chain(betas).chain(by.code);
        gradient.iter_mut().zip(parts).for_each(|(g, part)| *g += part);
        let weights = &config.body;
        let mut body = prior_terms(&self.fitter.prior, x, self.betas, weights, gradient);
        if let ScanInit::Joints(joints) = self.start {
            let (skeleton, deviation) = (&self.fitter.skeleton, config.joint_deviation);
            body.joints =
                joints.energy(skeleton, x, self.betas, deviation, weights.joints, gradient)?;
        }
        let code = &x[BETAS_AT + self.betas..];
        let by_code = gradient[BETAS_AT + self.betas..].iter_mut().zip(code);
        by_code.for_each(|(g, z)| *g += 2.0 * config.code * z);
        Ok(ScanFitTerms { body, distance, code: code.iter().map(|z| z * z).sum() })
    }

    /// Optimises stage by stage.
    fn descend(
        &self,
        mut attempt: Candidate,
        stages: &[ScanStage],
        counter: &mut StepCounter<'_, '_>,
    ) -> Result<Candidate> {
        let config = &self.fitter.config;
        for stage in stages {
            let distances = self.distances(&attempt.x, stage)?;
            let free = |at: usize| match stage.unknowns {
                Unknowns::Pose => at < BETAS_AT,
                Unknowns::Shape => at < BETAS_AT + self.betas,
                Unknowns::Clothes => true,
            };
            let options = LbfgsOptions { steps: stage.steps, gain: 1e-5, ..<_>::default() };
            let mut within = 0;
            let found = solve(&attempt.x, free, &options, |x, gradient| {
                within += 1;
                counter.count_evaluation(within.min(stage.steps));
                let terms = self.evaluate(x, &distances, stage.distance, gradient)?;
                Ok(terms.body.weighted(&config.body)
                    + stage.distance * distances.total(&terms.distance)
                    + config.code * terms.code)
            })?;
            counter.advance(stage.steps);
            (attempt.x, attempt.value) = (found.x, found.value);
            attempt.curves.push(found.curve);
        }
        Ok(attempt)
    }

    fn outcome(&self, found: &Candidate, last: ScanStage) -> Result<ScanFit> {
        let config = &self.fitter.config;
        let distances = self.distances(&found.x, &last)?;
        let terms = self.evaluate(&found.x, &distances, 0.0, &mut vec![0.0; found.x.len()])?;
        let surface = self.surface(&found.x)?;
        let distance = distance(self.target, surface.vertices(), self.dressed.faces());
        let parameters = BodyParameters::from_vector(&found.x, self.betas);
        Ok(ScanFit {
            before_clothes: parameters.clone(),
            parameters,
            code: found.x[BETAS_AT + self.betas..].to_vec(),
            outfit: self.dressed.outfit(),
            outfits: Vec::new(),
            terms,
            curves: found.curves.clone(),
            distance,
            evaluations: 0,
            normals_as_given: true,
            problem: problem(&distance, config),
        })
    }
}

fn problem(distance: &ScanDistance, config: &ScanConfig) -> Option<FitProblem> {
    let [median, most] = [config.accepted, config.accepted_most].map(|metres| 1000.0 * metres);
    if distance.median.is_nan() || distance.median > median {
        return Some(FitProblem::ScanDistance { median_mm: distance.median, limit_mm: median });
    }
    (distance.most > most)
        .then_some(FitProblem::ScanOutliers { percentile_95_mm: distance.most, limit_mm: most })
}

#[cfg(test)]
#[path = "fit_tests.rs"]
mod tests;
