//! Clothed bodies fitted to keypoints and a silhouette (CAPE §6.3 and appendix B; `E_S` is eq. 10,
//! the total energy eq. 11).

use cape_core::Outfit;
use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::{
    BodyFit, BodyParameters, BodyTerms, BodyWeights, DressedBody, Error, FitProblem, Keypoints,
    LbfgsOptions, Mask, PinholeCamera, Result, Smplify,
    body_energy::check_weight,
    keypoints::KeypointDetection,
    parameters::{BETAS_AT, solve},
    silhouette::{SilhouetteEnergy, SilhouetteMatch, SilhouetteTerms, render},
};

/// Least side of a silhouette level, pixels.
const SMALLEST: u32 = 16;

/// One level of the coarse-to-fine comparison of silhouettes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SilhouetteLevel {
    /// Longer side of the image, pixels, at most.
    pub side: u32,
    /// Number of matchings of surface and silhouette.
    pub rounds: usize,
    /// Optimiser steps after each matching.
    pub steps: usize,
}

/// Configuration of the clothed fit.
///
/// The default weights are those of a negative log-likelihood (Gaussian keypoints, a mixture of
/// poses, standard normal shapes and codes). λ_S is from a search over 8 to 12 held-out frames of
/// the synthetic set for the least error at clothing vertices: it reduces the squared error of the
/// unclothed body by 36 % at 5e4 and at 1.5e5, and by 33 % at 2e4. A third of λ_θ or λ_z changes
/// that by at most 3 %; three times λ_θ costs 8 %. The paper gives no weights.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ClothedConfig {
    /// Weight λ_S of the silhouette term `E_S`, 1/m.
    pub silhouette: f64,
    /// Width of soft edges, pixels of the level, for soft silhouettes on all levels but the first;
    /// by default all levels use distances.
    pub soft: Option<f64>,
    /// Weight λ_z of the code prior `‖z‖²`.
    pub code: f64,
    /// Weights of the body terms.
    pub body: BodyWeights,
    /// Silhouette levels, coarse to fine.
    pub levels: Vec<SilhouetteLevel>,
    /// Intersection over union below which a second fit starts from the body with the trunk
    /// mirrored in depth, which keypoints alone hardly distinguish.
    pub doubtful: f64,
    /// Least share of the rendered silhouette on the mask of a reliable fit: what lies beside the mask
    /// contradicts the image.
    pub inside: f64,
    /// Least share of the mask that the rendered silhouette covers of a reliable fit. Hair, shoes and
    /// what a person carries are in masks, but not in any silhouette of SMPL.
    pub explained: f64,
}

impl Default for ClothedConfig {
    fn default() -> Self {
        Self {
            silhouette: 5e4,
            soft: None,
            code: 0.5,
            body: BodyWeights::default(),
            levels: vec![
                SilhouetteLevel { side: 128, rounds: 2, steps: 12 },
                SilhouetteLevel { side: 256, rounds: 2, steps: 10 },
                SilhouetteLevel { side: 512, rounds: 2, steps: 10 },
            ],
            doubtful: 0.91,
            inside: 0.75,
            explained: 0.5,
        }
    }
}

impl ClothedConfig {
    /// Problem of a fit with these shares of the silhouettes, if one is too small.
    fn problem(&self, inside: f64, explained: f64) -> Option<FitProblem> {
        if inside < self.inside {
            return Some(FitProblem::BesideMask { share: inside, limit: self.inside });
        }
        let limit = self.explained;
        (explained < limit).then_some(FitProblem::Unexplained { share: explained, limit })
    }

    pub(crate) fn check(&self) -> Result<()> {
        self.body.check()?;
        check_weight("silhouette", self.silhouette)?;
        check_weight("code", self.code)?;
        if self.levels.is_empty() || self.levels.iter().any(|level| level.side < SMALLEST) {
            return Err(Error::argument(format!(
                "configuration: `levels`: expected at least one, each of {SMALLEST} pixels or more"
            )));
        }
        Ok(())
    }
}

/// Unweighted terms of the energy (CAPE eq. 11).
///
/// ```
/// use cape_fit::{ClothedConfig, ClothedTerms};
///
/// let terms = ClothedTerms { code: 2.0, ..ClothedTerms::default() };
/// let config = ClothedConfig { code: 0.25, ..ClothedConfig::default() };
/// assert_eq!(terms.weighted(&config), 0.5);
/// ```
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct ClothedTerms {
    /// Body terms.
    pub body: BodyTerms,
    /// Silhouette term `E_S` (CAPE eq. 10), metres.
    pub silhouette: SilhouetteTerms,
    /// Code prior `‖z‖²`.
    pub code: f64,
}

impl ClothedTerms {
    /// Energy `E_J + λ_S E_S + λ_θ E_θ + λ_β E_β + λ_a E_a + λ_z ‖z‖²` (CAPE eq. 11).
    pub fn weighted(&self, config: &ClothedConfig) -> f64 {
        self.body.weighted(&config.body)
            + config.silhouette * self.silhouette.total()
            + config.code * self.code
    }
}

/// Clothed body fitted to keypoints and a silhouette.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ClothedFit {
    /// Body under the clothing.
    pub parameters: BodyParameters,
    /// Latent code of the clothing, `[latent]`.
    pub code: Vec<f64>,
    /// Outfit.
    pub outfit: Outfit,
    /// Terms of the energy.
    pub terms: ClothedTerms,
    /// Energy after each optimiser step, one curve for each matching.
    pub curves: Vec<Vec<f64>>,
    /// Intersection over union of the rendered silhouette and the mask at full size, 0 to 1, over
    /// the pixels that are not of occluders; `None` without a mask.
    pub intersection_over_union: Option<f64>,
    /// Share of the rendered silhouette on the mask, 0 to 1, over the same pixels.
    #[serde(default)]
    pub inside: Option<f64>,
    /// Share of the mask that the rendered silhouette covers, 0 to 1, over the same pixels.
    #[serde(default)]
    pub explained: Option<f64>,
    /// Mean distance of the projected joints from their detections, pixels.
    pub joint_error: f64,
    /// Number of evaluations of the clothed body.
    pub evaluations: usize,
    /// Problem of the fit, if it is unreliable.
    pub problem: Option<FitProblem>,
}

/// Observations of a person in an image.
#[derive(Debug, Clone, Copy)]
pub struct ImageObservation<'a> {
    /// Camera.
    pub camera: &'a PinholeCamera,
    /// Keypoints of the person.
    pub keypoints: &'a Keypoints,
    /// Silhouette of the person; without it only keypoints and priors determine the fit.
    pub mask: Option<&'a Mask>,
    /// Pixels that are hidden and count neither as the person nor as background.
    pub occluders: Option<&'a Mask>,
}

/// Observations with a silhouette.
struct Silhouetted<'a> {
    image: &'a ImageObservation<'a>,
    mask: &'a Mask,
}

/// Energy of a clothed body.
struct ClothedProblem<'a> {
    smplify: &'a Smplify,
    dressed: &'a DressedBody,
    config: &'a ClothedConfig,
    camera: PinholeCamera,
    detections: &'a [KeypointDetection],
    /// Width of a pixel at the distance of the person, metres.
    pixel: f64,
    betas: usize,
}

/// State of the optimisation.
#[derive(Debug, Clone)]
struct Descent {
    x: Vec<f64>,
    curves: Vec<Vec<f64>>,
    evaluations: usize,
}

impl ClothedProblem<'_> {
    /// Terms at the unknowns `[3 + 72 + betas + latent]`; the weighted gradient is added to
    /// `gradient`.
    fn evaluate(
        &self,
        x: &[f64],
        matched: &SilhouetteMatch,
        gradient: &mut [f64],
    ) -> Result<ClothedTerms> {
        let body = BodyParameters::from_vector(x, self.betas);
        let code = &x[BETAS_AT + self.betas..];
        let surface = self.dressed.surface(&body, code)?;
        let mut forces = vec![DVec3::ZERO; surface.vertices().len()];
        let silhouette = matched.evaluate(surface.vertices(), self.config.silhouette, &mut forces);
        let by = surface.pull_back(&forces)?;
        let parts = by.transl.iter().chain(&by.pose).chain(&by.betas).chain(&by.code);
        gradient.iter_mut().zip(parts).for_each(|(g, part)| *g += part);
        let energy = self.smplify.energy(&self.camera, self.detections, self.pixel);
        let body = energy.evaluate(x, self.betas, &self.config.body, gradient)?;
        let by_code = gradient[BETAS_AT + self.betas..].iter_mut().zip(code);
        by_code.for_each(|(g, z)| *g += 2.0 * self.config.code * z);
        Ok(ClothedTerms { body, silhouette, code: code.iter().map(|z| z * z).sum() })
    }

    fn match_silhouette<'s>(
        &self,
        x: &[f64],
        silhouette: &'s SilhouetteEnergy,
    ) -> Result<SilhouetteMatch<'s>> {
        let body = BodyParameters::from_vector(x, self.betas);
        let surface = self.dressed.surface(&body, &x[BETAS_AT + self.betas..])?;
        silhouette.match_surface(surface.vertices(), self.dressed.faces())
    }

    /// Optimises on one silhouette level.
    fn descend_level(
        &self,
        descent: &mut Descent,
        silhouette: &SilhouetteEnergy,
        level: &SilhouetteLevel,
    ) -> Result<()> {
        let options = LbfgsOptions { steps: level.steps, ..self.smplify.config().optimiser };
        for _ in 0..level.rounds {
            let matched = self.match_silhouette(&descent.x, silhouette)?;
            let found = solve(
                &descent.x,
                |_| true,
                &options,
                |x, gradient| Ok(self.evaluate(x, &matched, gradient)?.weighted(self.config)),
            )?;
            descent.x = found.x;
            descent.evaluations += found.evaluations;
            descent.curves.push(found.curve);
        }
        Ok(())
    }
}

impl Smplify {
    /// Fits a clothed body to keypoints and silhouette by minimising the total energy (CAPE eq.
    /// 11), from the unclothed body `start` of [`fit`](Self::fit) with the code 0. If the
    /// silhouettes then agree badly, a second fit starts from the body with the trunk mirrored in
    /// depth; the one of lower energy is kept. Without a mask the silhouette term is left out, and
    /// the code is that of its prior, 0.
    ///
    /// # Errors
    /// If the mask is empty or of another image, or the body leaves the image.
    pub fn fit_clothed(
        &self,
        dressed: &DressedBody,
        image: &ImageObservation<'_>,
        start: &BodyFit,
        config: &ClothedConfig,
    ) -> Result<ClothedFit> {
        start.parameters.check()?;
        config.check()?;
        let Some(mask) = image.mask else {
            return self.fit_unseen_clothing(dressed, image, start, config);
        };
        let image = &Silhouetted { image, mask };
        let fit =
            self.fit_code_and_body(dressed, image, (&start.parameters, start.pixel), config)?;
        if fit.intersection_over_union.is_none_or(|overlap| overlap >= config.doubtful) {
            return Ok(fit);
        }
        let evaluations = fit.evaluations;
        let total = |fit: &ClothedFit| fit.terms.weighted(config);
        let best =
            match self.fit_code_and_body(dressed, image, (&start.leaning, start.pixel), config) {
                Ok(other) if total(&other) < total(&fit) => {
                    ClothedFit { evaluations: other.evaluations + evaluations, ..other }
                }
                Ok(other) => ClothedFit { evaluations: other.evaluations + evaluations, ..fit },
                Err(Error::Failed(_)) => fit,
                Err(error) => return Err(error),
            };
        Ok(best)
    }

    /// Body of the lowest energy without the silhouette term, in the clothing of the code 0.
    fn fit_unseen_clothing(
        &self,
        dressed: &DressedBody,
        image: &ImageObservation<'_>,
        start: &BodyFit,
        config: &ClothedConfig,
    ) -> Result<ClothedFit> {
        let detections = self.detections(image.keypoints);
        let betas = start.parameters.betas.len();
        let energy = self.energy(image.camera, &detections, start.pixel);
        let start = start.parameters.to_vector();
        let evaluate =
            |x: &[f64], gradient: &mut [f64]| energy.evaluate(x, betas, &config.body, gradient);
        let found = solve(
            &start,
            |_| true,
            &self.config().optimiser,
            |x, gradient| Ok(evaluate(x, gradient)?.weighted(&config.body)),
        )?;
        let joint_error = energy.joint_error(&found.x, betas)?;
        let body = evaluate(&found.x, &mut vec![0.0; found.x.len()])?;
        Ok(ClothedFit {
            parameters: BodyParameters::from_vector(&found.x, betas),
            code: vec![0.0; dressed.latent()],
            outfit: dressed.outfit(),
            terms: ClothedTerms { body, ..ClothedTerms::default() },
            curves: vec![found.curve],
            intersection_over_union: None,
            inside: None,
            explained: None,
            joint_error,
            evaluations: found.evaluations,
            problem: self.problem(joint_error * energy.pixel),
        })
    }

    fn fit_code_and_body(
        &self,
        dressed: &DressedBody,
        image: &Silhouetted<'_>,
        (start, pixel): (&BodyParameters, f64),
        config: &ClothedConfig,
    ) -> Result<ClothedFit> {
        let &Silhouetted { image: &ImageObservation { camera, keypoints, occluders, .. }, mask } =
            image;
        mask.check(camera)?;
        let detections = self.detections(keypoints);
        mask.expect_joints(&detections, occluders)?;
        let betas = start.betas.len();
        let energy = ClothedProblem {
            smplify: self,
            dressed,
            config,
            camera: *camera,
            detections: &detections,
            pixel,
            betas,
        };
        let mut descent = Descent {
            x: [start.to_vector(), vec![0.0; dressed.latent()]].concat(),
            curves: Vec::new(),
            evaluations: 0,
        };
        let mut last = None;
        for level in &config.levels {
            let silhouette = SilhouetteEnergy::new(camera, mask, occluders, level.side, pixel)?;
            let silhouette = match config.soft {
                Some(softness) if last.is_some() => silhouette.with_softness(softness)?,
                _ => silhouette,
            };
            energy.descend_level(&mut descent, &silhouette, level)?;
            last = Some(silhouette);
        }
        let Descent { x, curves, evaluations } = descent;
        let parameters = BodyParameters::from_vector(&x, betas);
        let code = x[BETAS_AT + betas..].to_vec();
        let surface = dressed.surface(&parameters, &code)?;
        let terms = match &last {
            None => ClothedTerms::default(),
            Some(silhouette) => {
                let matched = energy.match_silhouette(&x, silhouette)?;
                energy.evaluate(&x, &matched, &mut vec![0.0; x.len()])?
            }
        };
        let rendering = render(surface.vertices(), dressed.faces(), camera)?;
        let (rendered, visible) = match occluders {
            Some(occluders) => (&rendering.mask().without(occluders)?, &mask.without(occluders)?),
            None => (rendering.mask(), mask),
        };
        let outside = rendered.without(visible)?.area();
        let both = (rendered.area() - outside) as f64;
        // A body that is wholly hidden contradicts nothing.
        let share = |of: &Mask| if of.area() == 0 { 1.0 } else { both / of.area() as f64 };
        let (inside, explained) = (share(rendered), share(visible));
        let joint_error = self.energy(camera, &detections, pixel).joint_error(&x, betas)?;
        Ok(ClothedFit {
            problem: self
                .problem(joint_error * pixel)
                .or_else(|| config.problem(inside, explained)),
            parameters,
            code,
            outfit: dressed.outfit(),
            terms,
            curves,
            intersection_over_union: Some(rendered.intersection_over_union(visible)?),
            inside: Some(inside),
            explained: Some(explained),
            joint_error,
            evaluations,
        })
    }

    /// [`fit_clothed`](Self::fit_clothed) in each of several outfits, in order of ascending energy.
    /// `progress` is called with the number of fitted outfits and of all.
    ///
    /// # Errors
    /// As of [`fit_clothed`](Self::fit_clothed), or if there is no outfit.
    pub fn fit_outfits(
        &self,
        outfits: &[DressedBody],
        image: &ImageObservation<'_>,
        start: &BodyFit,
        config: &ClothedConfig,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<Vec<ClothedFit>> {
        if outfits.is_empty() {
            return Err(Error::argument("clothed fit: no outfits, expected at least one"));
        }
        let mut fits = Vec::with_capacity(outfits.len());
        for (index, dressed) in outfits.iter().enumerate() {
            fits.push(self.fit_clothed(dressed, image, start, config)?);
            progress(index + 1, outfits.len());
        }
        let energy = |fit: &ClothedFit| fit.terms.weighted(config);
        fits.sort_by(|a, b| energy(a).total_cmp(&energy(b)));
        Ok(fits)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        PosePrior, SmplifyConfig,
        clothed_tests::{dressed, seen, truth},
        parameters::POSE_AT,
        testing::BODY,
    };

    /// All terms, over translation, pose, shape and code, with one matching of the surface.
    #[test]
    fn gradients_of_the_energy_agree_with_finite_differences() {
        let dressed = dressed(Outfit::LONG_SHORT);
        let camera = PinholeCamera::new(192, 192, None).unwrap();
        let (body, code) = truth();
        let keypoints = seen(&camera, &body);
        let surface = dressed.surface(&body, &code).unwrap();
        let mask = render(surface.vertices(), dressed.faces(), &camera).unwrap().mask().clone();
        let prior = PosePrior::synthetic().unwrap();
        let smplify = Smplify::new(&BODY, prior, SmplifyConfig::default()).unwrap();
        let config = ClothedConfig { silhouette: 2e4, code: 3.0, ..ClothedConfig::default() };
        let detections = smplify.detections(&keypoints);
        let pixel = 3.2 / camera.focal();
        let betas = body.betas.len();
        let energy = ClothedProblem {
            smplify: &smplify,
            dressed: &dressed,
            config: &config,
            camera,
            detections: &detections,
            pixel,
            betas,
        };
        let silhouette = SilhouetteEnergy::new(&camera, &mask, None, 192, pixel).unwrap();
        let mut x = [body.to_vector(), code].concat();
        // Away from the minimum and from kinks of the terms.
        for (at, value) in x.iter_mut().enumerate() {
            *value += 0.03 * (1.7 * at as f64 + 0.4).sin();
        }
        let matched = energy.match_silhouette(&x, &silhouette).unwrap();
        let mut found = vec![0.0; x.len()];
        let terms = energy.evaluate(&x, &matched, &mut found).unwrap();
        let parts = [terms.body.joints, terms.silhouette.rendered, terms.silhouette.image];
        assert!(parts.iter().all(|&part| part > 0.0) && terms.code > 0.0, "{terms:?}");
        let value = |at: usize, change: f64| {
            let mut x = x.clone();
            x[at] += change;
            let terms = energy.evaluate(&x, &matched, &mut vec![0.0; x.len()]).unwrap();
            terms.weighted(&config)
        };
        let step = 2e-3;
        let (shape, codes) = (BETAS_AT, BETAS_AT + betas);
        for (name, all, every, tolerance) in [
            ("translation", 0..POSE_AT, 1, 0.02),
            ("pose", POSE_AT..shape, 4, 0.02),
            ("shape", shape..codes, 1, 0.02),
            ("code", codes..x.len(), 1, 0.1),
        ] {
            let scale = found[all.clone()].iter().fold(0.0f64, |most, g| most.max(g.abs()));
            for at in all.step_by(every) {
                let expected = (value(at, step) - value(at, -step)) / (2.0 * step);
                let off = (found[at] - expected).abs();
                assert!(off < tolerance * scale, "{name} {at}: {} {expected} {scale}", found[at]);
            }
        }
    }
}
