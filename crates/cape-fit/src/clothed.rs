//! Clothed bodies from keypoints and a silhouette (CAPE §6.3 and appendix B, eq. 10–11).

use cape_core::Outfit;
use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::{
    BodyFit, BodyParameters, BodyTerms, BodyWeights, DressedBody, Error, Keypoints, LbfgsOptions,
    Mask, PinholeCamera, Result, Smplify,
    body_energy::check_weight,
    keypoints::KeypointDetection,
    parameters::{BETAS_AT, solve},
    silhouette::{SilhouetteEnergy, SilhouetteMatch, SilhouetteTerms, render},
};

/// Fewest pixels of a scale's longer side.
const SMALLEST: u32 = 16;

/// One scale of the comparison of silhouettes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SilhouetteLevel {
    /// Most pixels of the longer side.
    pub side: u32,
    /// How often surface and silhouette are matched anew.
    pub rounds: usize,
    /// Steps of the optimiser between.
    pub steps: usize,
}

/// How clothed bodies are fitted.
///
/// The default weights are those of a negative logarithm of a density (deviations of a detector, a
/// mixture of poses, unit normal shapes and codes), with λ_S from a search over 8 to 12 held-out
/// frames of the synthetic set for the lowest error at clothing vertices: it takes 36 % off the
/// squared error of the bare body at 5e4 and at 1.5e5, 33 % at 2e4. A third of λ_θ or λ_z changes
/// that by at most 3 %; three times λ_θ costs 8 %.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ClothedConfig {
    /// λ_S of the silhouettes' mean distance, per metre.
    pub silhouette: f64,
    /// Width of soft edges, pixels of a scale, by which silhouettes are compared on all scales but
    /// the first, if not by distances.
    pub soft: Option<f64>,
    /// λ_z of the code's squared length.
    pub code: f64,
    /// Weights of the bare body's terms.
    pub body: BodyWeights,
    /// Scales, coarse to fine.
    pub levels: Vec<SilhouetteLevel>,
    /// Intersection over union of the silhouettes below which the body is tried again with its trunk
    /// mirrored in depth, which joints alone hardly tell from one that leans the other way.
    pub doubtful: f64,
    /// Intersection over union of the silhouettes below which the fit is said to have failed.
    pub accepted: f64,
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
            accepted: 0.85,
        }
    }
}

impl ClothedConfig {
    pub(crate) fn check(&self) -> Result<()> {
        self.body.check()?;
        check_weight("silhouette", self.silhouette)?;
        check_weight("code", self.code)?;
        if self.levels.is_empty() || self.levels.iter().any(|level| level.side < SMALLEST) {
            return Err(Error::argument(format!(
                "configuration: `levels`: expected at least one, of {SMALLEST} pixels or more"
            )));
        }
        Ok(())
    }
}

/// The terms of the energy (CAPE eq. 10), unweighted.
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
    /// Those of the bare body.
    pub body: BodyTerms,
    /// `E_S`.
    pub silhouette: SilhouetteTerms,
    /// `‖z‖²`.
    pub code: f64,
}

impl ClothedTerms {
    /// `E_J + λ_S E_S + λ_θ E_θ + λ_β E_β + λ_a E_a + λ_z ‖z‖²`.
    pub fn weighted(&self, config: &ClothedConfig) -> f64 {
        self.body.weighted(&config.body)
            + config.silhouette * self.silhouette.total()
            + config.code * self.code
    }
}

/// A clothed body that explains keypoints and a silhouette.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ClothedFit {
    /// The body under the clothes.
    pub parameters: BodyParameters,
    /// The clothes, `[latent]`.
    pub code: Vec<f64>,
    /// What is worn.
    pub outfit: Outfit,
    /// Terms of the energy.
    pub terms: ClothedTerms,
    /// Energy after every step between two matchings.
    pub curves: Vec<Vec<f64>>,
    /// Of rendered and given silhouette at full size.
    pub intersection_over_union: f64,
    /// Mean distance of the joints from where they were seen, pixels.
    pub joint_error: f64,
    /// How often the clothed body was evaluated.
    pub evaluations: usize,
    /// Why the fit cannot be trusted, if it cannot.
    pub problem: Option<String>,
}

/// What a clothed body is compared with at one scale.
struct ClothedProblem<'a> {
    smplify: &'a Smplify,
    dressed: &'a DressedBody,
    config: &'a ClothedConfig,
    camera: PinholeCamera,
    sightings: &'a [KeypointDetection],
    pixel: f64,
    betas: usize,
}

/// What was observed.
struct Observations<'a> {
    camera: &'a PinholeCamera,
    keypoints: &'a Keypoints,
    mask: &'a Mask,
    /// Metres that a pixel is wide at the person's distance.
    pixel: f64,
}

/// A clothed body on its way down.
#[derive(Debug, Clone)]
struct Descent {
    x: Vec<f64>,
    curves: Vec<Vec<f64>>,
    evaluations: usize,
}

impl ClothedProblem<'_> {
    /// The energy at the unknowns `[3 + 72 + betas + latent]`.
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
        let energy = self.smplify.energy(&self.camera, self.sightings, self.pixel);
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

    /// Goes down one level.
    fn descend_level(
        &self,
        way: &mut Descent,
        silhouette: &SilhouetteEnergy,
        level: &SilhouetteLevel,
    ) -> Result<()> {
        let options = LbfgsOptions { steps: level.steps, ..self.smplify.config().optimiser };
        for _ in 0..level.rounds {
            let matched = self.match_silhouette(&way.x, silhouette)?;
            let found = solve(
                &way.x,
                |_| true,
                &options,
                |x, gradient| Ok(self.evaluate(x, &matched, gradient)?.weighted(self.config)),
            )?;
            way.x = found.x;
            way.evaluations += found.evaluations;
            way.curves.push(found.curve);
        }
        Ok(())
    }
}

impl Smplify {
    /// The clothed body that explains keypoints and silhouette best (eq. 10–11), from the bare body
    /// that [`fit`](Self::fit) found, in the clothes of the code 0. Where the silhouettes then agree
    /// badly, also from the body with its trunk mirrored in depth; the lower energy is kept.
    ///
    /// # Errors
    /// If the mask is empty or of another image, or the body leaves the image.
    pub fn fit_clothed(
        &self,
        dressed: &DressedBody,
        camera: &PinholeCamera,
        keypoints: &Keypoints,
        mask: &Mask,
        start: &BodyFit,
        config: &ClothedConfig,
    ) -> Result<ClothedFit> {
        let seen = Observations { camera, keypoints, mask, pixel: start.pixel };
        let fit = self.fit_code_and_body(dressed, &seen, &start.parameters, config)?;
        if fit.intersection_over_union >= config.doubtful {
            return Ok(fit);
        }
        let evaluations = fit.evaluations;
        let energy = |fit: &ClothedFit| fit.terms.weighted(config);
        let best = match self.fit_code_and_body(dressed, &seen, &start.leaning, config) {
            Ok(other) if energy(&other) < energy(&fit) => {
                ClothedFit { evaluations: other.evaluations + evaluations, ..other }
            }
            Ok(other) => ClothedFit { evaluations: other.evaluations + evaluations, ..fit },
            Err(Error::Failed(_)) => fit,
            Err(error) => return Err(error),
        };
        Ok(best)
    }

    fn fit_code_and_body(
        &self,
        dressed: &DressedBody,
        seen: &Observations<'_>,
        start: &BodyParameters,
        config: &ClothedConfig,
    ) -> Result<ClothedFit> {
        let &Observations { camera, keypoints, mask, pixel } = seen;
        mask.check(camera)?;
        start.check()?;
        config.check()?;
        let sightings = self.detections(keypoints);
        mask.expect_joints(&sightings)?;
        let betas = start.betas.len();
        let scene = ClothedProblem {
            smplify: self,
            dressed,
            config,
            camera: *camera,
            sightings: &sightings,
            pixel,
            betas,
        };
        let mut way = Descent {
            x: [start.to_vector(), vec![0.0; dressed.latent()]].concat(),
            curves: Vec::new(),
            evaluations: 0,
        };
        let mut last = None;
        for level in &config.levels {
            let silhouette = SilhouetteEnergy::new(camera, mask, level.side, pixel)?;
            let silhouette = match config.soft {
                Some(softness) if last.is_some() => silhouette.with_softness(softness)?,
                _ => silhouette,
            };
            scene.descend_level(&mut way, &silhouette, level)?;
            last = Some(silhouette);
        }
        let Descent { x, curves, evaluations } = way;
        let parameters = BodyParameters::from_vector(&x, betas);
        let code = x[BETAS_AT + betas..].to_vec();
        let surface = dressed.surface(&parameters, &code)?;
        let terms = match &last {
            None => ClothedTerms::default(),
            Some(silhouette) => {
                let matched = scene.match_silhouette(&x, silhouette)?;
                scene.evaluate(&x, &matched, &mut vec![0.0; x.len()])?
            }
        };
        let rendering = render(surface.vertices(), dressed.faces(), camera)?;
        let intersection_over_union = rendering.mask().intersection_over_union(mask)?;
        let joint_error = self.energy(camera, &sightings, pixel).joint_error(&x, betas)?;
        Ok(ClothedFit {
            problem: self.problem(joint_error * pixel).or_else(|| {
                (intersection_over_union < config.accepted).then(|| {
                    format!(
                        "the silhouettes' intersection over union is {intersection_over_union:.3}: \
                         less than {}",
                        config.accepted
                    )
                })
            }),
            parameters,
            code,
            outfit: dressed.outfit(),
            terms,
            curves,
            intersection_over_union,
            joint_error,
            evaluations,
        })
    }

    /// [`fit_clothed`](Self::fit_clothed) in each of several outfits, the one of the lowest energy
    /// first.
    ///
    /// # Errors
    /// As of [`fit_clothed`](Self::fit_clothed), or if there is no outfit.
    pub fn fit_outfits(
        &self,
        outfits: &[DressedBody],
        camera: &PinholeCamera,
        keypoints: &Keypoints,
        mask: &Mask,
        start: &BodyFit,
        config: &ClothedConfig,
    ) -> Result<Vec<ClothedFit>> {
        if outfits.is_empty() {
            return Err(Error::argument("no outfit to fit"));
        }
        let fit = |dressed| self.fit_clothed(dressed, camera, keypoints, mask, start, config);
        let mut fits: Vec<ClothedFit> = outfits.iter().map(fit).collect::<Result<_>>()?;
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

    /// All terms together, over translation, pose, shape and code, with the surface matched once.
    #[test]
    fn gradients_of_the_energy_agree_with_finite_differences() {
        let dressed = dressed(Outfit::LongShort);
        let camera = PinholeCamera::new(192, 192, None).unwrap();
        let (body, code) = truth();
        let keypoints = seen(&camera, &body);
        let surface = dressed.surface(&body, &code).unwrap();
        let mask = render(surface.vertices(), dressed.faces(), &camera).unwrap().mask().clone();
        let prior = PosePrior::synthetic().unwrap();
        let smplify = Smplify::new(&BODY, prior, SmplifyConfig::default()).unwrap();
        let config = ClothedConfig { silhouette: 2e4, code: 3.0, ..ClothedConfig::default() };
        let sightings = smplify.detections(&keypoints);
        let pixel = 3.2 / camera.focal();
        let betas = body.betas.len();
        let scene = ClothedProblem {
            smplify: &smplify,
            dressed: &dressed,
            config: &config,
            camera,
            sightings: &sightings,
            pixel,
            betas,
        };
        let silhouette = SilhouetteEnergy::new(&camera, &mask, 192, pixel).unwrap();
        let mut x = [body.to_vector(), code].concat();
        // Not at the minimum, nor where any term has a kink.
        for (at, value) in x.iter_mut().enumerate() {
            *value += 0.03 * (1.7 * at as f64 + 0.4).sin();
        }
        let matched = scene.match_silhouette(&x, &silhouette).unwrap();
        let mut found = vec![0.0; x.len()];
        let terms = scene.evaluate(&x, &matched, &mut found).unwrap();
        let parts = [terms.body.joints, terms.silhouette.rendered, terms.silhouette.image];
        assert!(parts.iter().all(|&part| part > 0.0) && terms.code > 0.0, "{terms:?}");
        let value = |at: usize, change: f64| {
            let mut x = x.clone();
            x[at] += change;
            let terms = scene.evaluate(&x, &matched, &mut vec![0.0; x.len()]).unwrap();
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
