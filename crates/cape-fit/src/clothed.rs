//! Clothed bodies fitted to keypoints and a silhouette (CAPE §6.3 and appendix B; `E_S` is eq. 10,
//! the total energy eq. 11).

use cape_core::Outfit;
use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::{
    BodyFit, BodyParameters, ClothedConfig, ClothedTerms, DressedBody, Error, FitProblem,
    FitWorkers, Keypoints, LbfgsOptions, Mask, PinholeCamera, Result, Smplify,
    keypoints::KeypointDetection,
    parameters::{BETAS_AT, solve},
    silhouette::{SilhouetteEnergy, SilhouetteMatch, render},
};

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

/// Agreement of a rendered silhouette and a mask, where nothing hides the person.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SilhouetteOverlap {
    /// Intersection over union, 0 to 1.
    pub(crate) intersection_over_union: f64,
    /// Share of the rendered silhouette on the mask.
    pub(crate) inside: f64,
    /// Share of the mask that the rendered silhouette covers.
    pub(crate) explained: f64,
}

impl ImageObservation<'_> {
    /// Agreement of a rendered silhouette and the mask.
    pub(crate) fn overlap(&self, mask: &Mask, rendered: &Mask) -> Result<SilhouetteOverlap> {
        let (rendered, visible) = match self.occluders {
            Some(occluders) => (&rendered.without(occluders)?, &mask.without(occluders)?),
            None => (rendered, mask),
        };
        let outside = rendered.without(visible)?.area();
        let both = (rendered.area() - outside) as f64;
        // A body that is wholly hidden contradicts nothing.
        let share = |of: &Mask| if of.area() == 0 { 1.0 } else { both / of.area() as f64 };
        Ok(SilhouetteOverlap {
            intersection_over_union: rendered.intersection_over_union(visible)?,
            inside: share(rendered),
            explained: share(visible),
        })
    }
}

/// Energy of a clothed body.
pub(crate) struct ClothedProblem<'a> {
    pub(crate) smplify: &'a Smplify,
    pub(crate) dressed: &'a DressedBody,
    pub(crate) config: &'a ClothedConfig,
    pub(crate) camera: PinholeCamera,
    pub(crate) detections: &'a [KeypointDetection],
    /// Width of a pixel at the distance of the person, metres.
    pub(crate) pixel: f64,
    pub(crate) betas: usize,
}

impl ClothedProblem<'_> {
    /// Terms at the unknowns `[3 + 72 + betas + latent]`; the weighted gradient is added to
    /// `gradient`.
    pub(crate) fn evaluate(
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
        let unseen = self.evaluate_unseen(x, gradient)?;
        Ok(ClothedTerms { silhouette, ..unseen })
    }

    /// [`evaluate`](Self::evaluate) without the silhouette term.
    pub(crate) fn evaluate_unseen(&self, x: &[f64], gradient: &mut [f64]) -> Result<ClothedTerms> {
        let code = &x[BETAS_AT + self.betas..];
        let energy = self.smplify.energy(&self.camera, self.detections, self.pixel);
        let body = energy.evaluate(x, self.betas, &self.config.body, gradient)?;
        let by_code = gradient[BETAS_AT + self.betas..].iter_mut().zip(code);
        by_code.for_each(|(g, z)| *g += 2.0 * self.config.code * z);
        let code = code.iter().map(|z| z * z).sum();
        Ok(ClothedTerms { body, code, ..ClothedTerms::default() })
    }

    pub(crate) fn match_silhouette<'s>(
        &self,
        x: &[f64],
        silhouette: &'s SilhouetteEnergy,
    ) -> Result<SilhouetteMatch<'s>> {
        let body = BodyParameters::from_vector(x, self.betas);
        let surface = self.dressed.surface(&body, &x[BETAS_AT + self.betas..])?;
        silhouette.match_surface(surface.vertices(), self.dressed.faces())
    }

    /// Optimises on consecutive silhouette levels, of which the first is `level`.
    pub(crate) fn descend(
        &self,
        mut descent: Descent,
        level: usize,
        silhouettes: &[SilhouetteEnergy],
    ) -> Result<Descent> {
        let optimiser = &self.smplify.config().optimiser;
        for (level, silhouette) in self.config.levels.iter().skip(level).zip(silhouettes) {
            let options = LbfgsOptions { steps: level.steps, ..*optimiser };
            for _ in 0..level.rounds {
                let matched = self.match_silhouette(&descent.x, silhouette)?;
                let found = solve(
                    &descent.x,
                    |_| true,
                    &options,
                    |x, gradient| Ok(self.evaluate(x, &matched, gradient)?.weighted(self.config)),
                )?;
                descent.x = found.x;
                descent.energy = found.value;
                descent.evaluations += found.evaluations;
                descent.curves.push(found.curve);
            }
        }
        Ok(descent)
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
        let Some(mask) = image.mask else {
            return self.fit_unseen_clothing(dressed, image, start, config);
        };
        let fits = ClothedFits::new(self, (image, mask), start, config)?;
        fits.finish(dressed, fits.begin(dressed)?)
    }

    /// Body of the lowest energy without the silhouette term, in the clothing of the code 0.
    fn fit_unseen_clothing(
        &self,
        dressed: &DressedBody,
        image: &ImageObservation<'_>,
        start: &BodyFit,
        config: &ClothedConfig,
    ) -> Result<ClothedFit> {
        start.parameters.check()?;
        config.check()?;
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

    /// [`fit_clothed`](Self::fit_clothed) in each of several outfits, side by side on `workers`, in
    /// order of ascending energy. Outfits are compared on the first silhouette level; only the
    /// [finalists](ClothedConfig::finalists) are fitted on all levels and returned. `progress` is
    /// called with the number of finished parts and of all.
    ///
    /// # Errors
    /// As of [`fit_clothed`](Self::fit_clothed), or if there is no outfit.
    pub fn fit_outfits(
        &self,
        outfits: &[DressedBody],
        image: &ImageObservation<'_>,
        start: &BodyFit,
        config: &ClothedConfig,
        workers: &FitWorkers,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<Vec<ClothedFit>> {
        if outfits.is_empty() {
            return Err(Error::argument("clothed fit: no outfits, expected at least one"));
        }
        let Some(mask) = image.mask else {
            let unseen = |body| self.fit_unseen_clothing(body, image, start, config);
            return outfits.iter().map(unseen).collect();
        };
        let fits = ClothedFits::new(self, (image, mask), start, config)?;
        let finalists = config.finalists.min(outfits.len());
        let mut done = 0;
        let mut progress = || {
            done += 1;
            progress(done, outfits.len() + finalists);
        };
        let begun = workers.map(outfits, |_, dressed| fits.begin(dressed), &mut progress);
        let mut begun: Vec<(&DressedBody, Descent)> =
            outfits.iter().zip(begun.into_iter().collect::<Result<Vec<_>>>()?).collect();
        begun.sort_by(|(_, a), (_, b)| a.energy.total_cmp(&b.energy));
        begun.truncate(finalists);
        let finish =
            |_, (dressed, descent): &(&DressedBody, Descent)| fits.finish(dressed, descent.clone());
        let finished = workers.map(&begun, finish, &mut progress);
        let mut finished = finished.into_iter().collect::<Result<Vec<ClothedFit>>>()?;
        let energy = |fit: &ClothedFit| fit.terms.weighted(config);
        finished.sort_by(|a, b| energy(a).total_cmp(&energy(b)));
        Ok(finished)
    }
}

/// Clothed fits of one image, in any outfit.
struct ClothedFits<'a> {
    smplify: &'a Smplify,
    image: &'a ImageObservation<'a>,
    mask: &'a Mask,
    start: &'a BodyFit,
    config: &'a ClothedConfig,
    detections: Vec<KeypointDetection>,
    /// Silhouette of each level.
    silhouettes: Vec<SilhouetteEnergy>,
}

/// State of the optimisation.
#[derive(Debug, Clone)]
pub(crate) struct Descent {
    x: Vec<f64>,
    /// Energy at `x`.
    pub(crate) energy: f64,
    curves: Vec<Vec<f64>>,
    evaluations: usize,
}

impl Descent {
    /// The body clothed by the code 0.
    pub(crate) fn start(body: &BodyParameters, dressed: &DressedBody) -> Self {
        Self {
            x: [body.to_vector(), vec![0.0; dressed.latent()]].concat(),
            energy: f64::INFINITY,
            curves: Vec::new(),
            evaluations: 0,
        }
    }
}

impl<'a> ClothedFits<'a> {
    fn new(
        smplify: &'a Smplify,
        (image, mask): (&'a ImageObservation<'a>, &'a Mask),
        start: &'a BodyFit,
        config: &'a ClothedConfig,
    ) -> Result<Self> {
        let &ImageObservation { camera, keypoints, occluders, .. } = image;
        mask.check(camera)?;
        start.parameters.check()?;
        start.leaning.check()?;
        config.check()?;
        let detections = smplify.detections(keypoints);
        mask.expect_joints(&detections, occluders)?;
        let silhouettes = silhouette_levels(image, mask, start.pixel, config)?;
        Ok(Self { smplify, image, mask, start, config, detections, silhouettes })
    }

    fn problem(&self, dressed: &'a DressedBody) -> ClothedProblem<'_> {
        ClothedProblem {
            smplify: self.smplify,
            dressed,
            config: self.config,
            camera: *self.image.camera,
            detections: &self.detections,
            pixel: self.start.pixel,
            betas: self.start.parameters.betas.len(),
        }
    }

    /// Fits on the first level.
    fn begin(&self, dressed: &DressedBody) -> Result<Descent> {
        let start = Descent::start(&self.start.parameters, dressed);
        self.problem(dressed).descend(start, 0, &self.silhouettes[..1])
    }

    /// Fits on the other levels, and if the silhouettes then agree badly, again from the body with
    /// the trunk mirrored in depth.
    fn finish(&self, dressed: &DressedBody, begun: Descent) -> Result<ClothedFit> {
        let problem = self.problem(dressed);
        let fit = self.result(dressed, problem.descend(begun, 1, &self.silhouettes[1..])?)?;
        if fit.inside.is_none_or(|inside| inside >= self.config.doubtful) {
            return Ok(fit);
        }
        let evaluations = fit.evaluations;
        let total = |fit: &ClothedFit| fit.terms.weighted(self.config);
        let start = Descent::start(&self.start.leaning, dressed);
        let leaning = problem
            .descend(start, 0, &self.silhouettes)
            .and_then(|descent| self.result(dressed, descent));
        match leaning {
            Ok(other) if total(&other) < total(&fit) => {
                Ok(ClothedFit { evaluations: other.evaluations + evaluations, ..other })
            }
            Ok(other) => Ok(ClothedFit { evaluations: other.evaluations + evaluations, ..fit }),
            Err(Error::Failed(_)) => Ok(fit),
            Err(error) => Err(error),
        }
    }

    fn result(&self, dressed: &DressedBody, descent: Descent) -> Result<ClothedFit> {
        let problem = self.problem(dressed);
        let Descent { x, energy: _, curves, evaluations } = descent;
        let betas = problem.betas;
        let parameters = BodyParameters::from_vector(&x, betas);
        let code = x[BETAS_AT + betas..].to_vec();
        let surface = dressed.surface(&parameters, &code)?;
        let terms = match self.silhouettes.last() {
            None => ClothedTerms::default(),
            Some(silhouette) => {
                let matched = problem.match_silhouette(&x, silhouette)?;
                problem.evaluate(&x, &matched, &mut vec![0.0; x.len()])?
            }
        };
        let camera = self.image.camera;
        let rendering = render(surface.vertices(), dressed.faces(), camera)?;
        let overlap = self.image.overlap(self.mask, rendering.mask())?;
        let pixel = problem.pixel;
        let energy = self.smplify.energy(camera, &self.detections, pixel);
        let joint_error = energy.joint_error(&x, betas)?;
        Ok(ClothedFit {
            problem: self
                .smplify
                .problem(joint_error * pixel)
                .or_else(|| self.config.problem(&overlap)),
            parameters,
            code,
            outfit: dressed.outfit(),
            terms,
            curves,
            intersection_over_union: Some(overlap.intersection_over_union),
            inside: Some(overlap.inside),
            explained: Some(overlap.explained),
            joint_error,
            evaluations,
        })
    }
}

/// Silhouette energy of each level, with soft edges where they are configured.
pub(crate) fn silhouette_levels(
    &ImageObservation { camera, occluders, .. }: &ImageObservation<'_>,
    mask: &Mask,
    pixel: f64,
    config: &ClothedConfig,
) -> Result<Vec<SilhouetteEnergy>> {
    let mut silhouettes = Vec::with_capacity(config.levels.len());
    for (at, level) in config.levels.iter().enumerate() {
        let silhouette = SilhouetteEnergy::new(camera, mask, occluders, level.side, pixel)?;
        silhouettes.push(match config.soft {
            Some(softness) if at > 0 => silhouette.with_softness(softness)?,
            _ => silhouette,
        });
    }
    Ok(silhouettes)
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
