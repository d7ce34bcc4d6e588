//! Clothed bodies fitted to the frames of a video: one shape, one outfit and one code, and poses that
//! change smoothly.

mod path;
mod temporal;
#[cfg(test)]
mod tests;
mod vector;

use cape_core::Outfit;
use serde::{Deserialize, Serialize};

pub use temporal::TemporalConfig;

use crate::{
    BodyParameters, BodyWeights, ClothedConfig, DressedBody, Error, FitProblem, FitWorkers,
    ImageObservation, LbfgsOptions, Result, Smplify,
    clothed::{ClothedProblem, Descent, silhouette_levels},
    keypoints::KeypointDetection,
    parameters::solve_scaled,
    silhouette::{SilhouetteEnergy, SilhouetteMatch, render},
    smplify::BodyCandidates,
};
use path::smoothest_path;
use temporal::temporal_energy;
use vector::{SequenceLayout, join};

/// Number of frames by which outfits are compared.
const COMPARED: usize = 3;

/// Optimiser steps of a silhouette level for each of a single image: more unknowns need more steps.
const STEPS: usize = 2;

/// A frame of a [`SequenceFit`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SequenceFrame {
    /// Body under the clothing; between its neighbours if the frame was not observed.
    pub body: BodyParameters,
    /// True if the frame had an observation.
    pub observed: bool,
    /// Mean distance of the projected joints from their detections, pixels; 0 if not observed.
    pub joint_error: f64,
    /// Intersection over union of the rendered silhouette and the mask, 0 to 1; `None` without a mask.
    pub intersection_over_union: Option<f64>,
    /// Problem of the fit, if it is unreliable.
    pub problem: Option<FitProblem>,
}

/// Clothed body fitted to the frames of a video.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SequenceFit {
    /// Outfit.
    pub outfit: Outfit,
    /// Shape coefficients of all frames.
    pub betas: Vec<f64>,
    /// Latent code of the clothing of all frames, `[latent]`.
    pub code: Vec<f64>,
    /// Frames of the video.
    pub frames: Vec<SequenceFrame>,
    /// Energy after each optimiser step, one curve for each matching of the silhouettes.
    pub curves: Vec<Vec<f64>>,
}

/// Configuration of the fit to a video.
#[derive(Debug, Clone, Copy)]
pub struct SequenceConfig<'a> {
    /// Configuration of the clothed fit of a frame.
    pub clothed: &'a ClothedConfig,
    /// Motion of the person between frames.
    pub temporal: TemporalConfig,
}

/// Observations of the frames that have any.
struct ObservedFrame<'a> {
    frame: usize,
    image: &'a ImageObservation<'a>,
    detections: Vec<KeypointDetection>,
    /// Width of a pixel at the distance of the person, metres.
    pixel: f64,
}

/// Fit of a video in one outfit.
struct SequenceProblem<'a> {
    smplify: &'a Smplify,
    config: &'a ClothedConfig,
    temporal: &'a TemporalConfig,
    layout: SequenceLayout,
    observed: &'a [ObservedFrame<'a>],
}

impl Smplify {
    /// Fits one shape, one of `outfits`, one code and a smooth motion to the frames of a video;
    /// frames without observation, `None`, are interpolated. The outfit is the one of the lowest
    /// energy in three of the frames. `progress` is called with the share of the work that is done.
    ///
    /// # Errors
    /// If no frame has an observation, there is no outfit, or a mask is not of its image.
    pub fn fit_sequence(
        &self,
        outfits: &[DressedBody],
        images: &[Option<ImageObservation<'_>>],
        config: SequenceConfig<'_>,
        workers: &FitWorkers,
        progress: &mut dyn FnMut(f64),
    ) -> Result<SequenceFit> {
        config.clothed.check()?;
        config.temporal.check()?;
        let detections: Vec<_> = images
            .iter()
            .map(|image| image.map_or_else(Vec::new, |image| self.detections(image.keypoints)))
            .collect();
        for (image, detections) in images.iter().zip(&detections) {
            if let Some(image) = image
                && let Some(mask) = image.mask
            {
                mask.check(image.camera)?;
                mask.expect_joints(detections, image.occluders)?;
            }
        }
        let share = 0.1 / images.len().max(1) as f64;
        let mut done = 0.0;
        let found = workers.map(
            images,
            |frame, image| {
                let image = image.as_ref();
                image.map(|i| self.candidates(i.camera, &detections[frame], None)).transpose()
            },
            &mut || {
                done += share;
                progress(done);
            },
        );
        let found = found.into_iter().collect::<Result<Vec<Option<BodyCandidates>>>>()?;
        let betas = self.config().betas.min(self.skeleton().betas());
        let bodies = smoothest_path(self.skeleton(), betas, &found, &config.temporal)?;
        let bodies = bodies.ok_or_else(|| {
            Error::Observation("video: no frame has keypoints, expected at least one".into())
        })?;
        let observed: Vec<ObservedFrame<'_>> = images
            .iter()
            .zip(detections)
            .zip(&found)
            .enumerate()
            .filter_map(|(frame, ((image, detections), found))| {
                let (image, pixel) = (image.as_ref()?, found.as_ref()?.pixel);
                Some(ObservedFrame { frame, image, detections, pixel })
            })
            .collect();

        let layout = SequenceLayout { frames: images.len(), betas, latent: 0 };
        let problem = SequenceProblem {
            smplify: self,
            config: config.clothed,
            temporal: &config.temporal,
            layout,
            observed: &observed,
        };
        let mut curves = Vec::new();
        let x = problem.fit_bodies(&bodies, &mut curves)?;
        progress(0.15);
        let dressed = problem.choose_outfit(outfits, &x, workers)?;
        progress(0.2);
        let layout = SequenceLayout { latent: dressed.latent(), ..layout };
        let problem = SequenceProblem { layout, ..problem };
        let x = [x, vec![0.0; layout.latent]].concat();
        let x = problem.fit_clothed(dressed, x, workers, &mut curves, &mut |share| {
            progress(0.2 + 0.8 * share);
        })?;
        Ok(SequenceFit {
            outfit: dressed.outfit(),
            betas: layout.betas(&x).to_vec(),
            code: layout.code(&x).to_vec(),
            frames: problem.frames(dressed, &x, workers)?,
            curves,
        })
    }
}

impl SequenceProblem<'_> {
    /// The outfit of the lowest sum of energies in frames that are spread over the video.
    fn choose_outfit<'a>(
        &self,
        outfits: &'a [DressedBody],
        x: &[f64],
        workers: &FitWorkers,
    ) -> Result<&'a DressedBody> {
        let [first, _, ..] = outfits else {
            return outfits
                .first()
                .ok_or_else(|| Error::argument("video: no outfits, expected at least one"));
        };
        let masked: Vec<&ObservedFrame<'_>> =
            self.observed.iter().filter(|seen| seen.image.mask.is_some()).collect();
        if masked.is_empty() {
            return Ok(first);
        }
        let (count, chosen) = (masked.len(), COMPARED.min(masked.len()));
        let frames: Vec<&ObservedFrame<'_>> =
            (0..chosen).map(|k| masked[(2 * k + 1) * count / (2 * chosen)]).collect();
        let jobs: Vec<(&DressedBody, &ObservedFrame<'_>)> = outfits
            .iter()
            .flat_map(|body| frames.iter().map(move |&frame| (body, frame)))
            .collect();
        let energies = workers.map(
            &jobs,
            |_, (dressed, seen)| self.energy_of_frame(dressed, seen, x),
            &mut || {},
        );
        let energies = energies.into_iter().collect::<Result<Vec<f64>>>()?;
        let sums = energies.chunks(frames.len()).map(|of_outfit| of_outfit.iter().sum::<f64>());
        let best = outfits.iter().zip(sums).min_by(|a, b| a.1.total_cmp(&b.1));
        Ok(best.map_or(first, |(dressed, _)| dressed))
    }

    /// Weights of a frame: the priors of what all frames share are divided among them.
    fn weights(&self, weights: &BodyWeights) -> BodyWeights {
        BodyWeights { shape: weights.shape / self.observed.len() as f64, ..*weights }
    }

    fn scales(&self) -> Vec<f64> {
        self.layout.scales()
    }

    /// Fits the unclothed body to all keypoints.
    fn fit_bodies(
        &self,
        bodies: &[BodyParameters],
        curves: &mut Vec<Vec<f64>>,
    ) -> Result<Vec<f64>> {
        let layout = self.layout;
        let count = bodies.len() as f64;
        let mean = (0..layout.betas)
            .map(|at| bodies.iter().map(|body| body.betas[at]).sum::<f64>() / count);
        let mut x = join(bodies, &mean.collect::<Vec<f64>>(), &[]);
        let weights = self.weights(&self.smplify.last_weights());
        let found =
            solve_scaled(&x, &self.scales(), &self.smplify.config().optimiser, |x, gradient| {
                let mut value =
                    temporal_energy(self.smplify.skeleton(), layout, self.temporal, x, gradient)?;
                for seen in self.observed {
                    let frame = layout.frame(x, seen.frame);
                    let mut of_frame = vec![0.0; frame.len()];
                    let energy =
                        self.smplify.energy(seen.image.camera, &seen.detections, seen.pixel);
                    let terms = energy.evaluate(&frame, layout.betas, &weights, &mut of_frame)?;
                    value += terms.weighted(&weights);
                    layout.add(gradient, seen.frame, &of_frame);
                }
                Ok(value)
            })?;
        x = found.x;
        curves.push(found.curve);
        Ok(x)
    }

    /// Configuration of the terms of one frame.
    fn frame_config(&self) -> ClothedConfig {
        ClothedConfig {
            body: self.weights(&self.config.body),
            code: self.config.code / self.observed.len() as f64,
            ..self.config.clone()
        }
    }

    fn of_frame<'a>(
        &'a self,
        dressed: &'a DressedBody,
        config: &'a ClothedConfig,
        seen: &'a ObservedFrame<'_>,
    ) -> ClothedProblem<'a> {
        ClothedProblem {
            smplify: self.smplify,
            dressed,
            config,
            camera: *seen.image.camera,
            detections: &seen.detections,
            pixel: seen.pixel,
            betas: self.layout.betas,
        }
    }

    /// Energy of a frame after the first silhouette level, from the unclothed bodies `x`.
    fn energy_of_frame(
        &self,
        dressed: &DressedBody,
        seen: &ObservedFrame<'_>,
        x: &[f64],
    ) -> Result<f64> {
        let problem = self.of_frame(dressed, self.config, seen);
        let start = Descent::start(&self.layout.body(x, seen.frame), dressed);
        let silhouettes = self.silhouettes(seen)?;
        let first = &silhouettes[..silhouettes.len().min(1)];
        problem.descend(start, 0, first).map(|descent| descent.energy)
    }

    /// Silhouette of each level; none without a mask.
    fn silhouettes(&self, seen: &ObservedFrame<'_>) -> Result<Vec<SilhouetteEnergy>> {
        match seen.image.mask {
            Some(mask) => silhouette_levels(seen.image, mask, seen.pixel, self.config),
            None => Ok(Vec::new()),
        }
    }

    /// Fits body and clothing to keypoints and silhouettes of all frames.
    fn fit_clothed(
        &self,
        dressed: &DressedBody,
        mut x: Vec<f64>,
        workers: &FitWorkers,
        curves: &mut Vec<Vec<f64>>,
        progress: &mut dyn FnMut(f64),
    ) -> Result<Vec<f64>> {
        let config = self.frame_config();
        let silhouettes = workers.map(self.observed, |_, seen| self.silhouettes(seen), &mut || {});
        let silhouettes = silhouettes.into_iter().collect::<Result<Vec<_>>>()?;
        let steps: usize = self.config.levels.iter().map(|l| l.rounds * l.steps).sum();
        let mut done = 0;
        for (at, level) in self.config.levels.iter().enumerate() {
            let options =
                LbfgsOptions { steps: STEPS * level.steps, ..self.smplify.config().optimiser };
            for _ in 0..level.rounds {
                let matched = workers.map(
                    self.observed,
                    |index, seen| {
                        let frame = self.layout.frame(&x, seen.frame);
                        let problem = self.of_frame(dressed, &config, seen);
                        let silhouette = silhouettes[index].get(at);
                        silhouette.map(|s| problem.match_silhouette(&frame, s)).transpose()
                    },
                    &mut || {},
                );
                let matched = matched.into_iter().collect::<Result<Vec<_>>>()?;
                let found = solve_scaled(&x, &self.scales(), &options, |x, gradient| {
                    self.evaluate((dressed, &config), x, &matched, workers, gradient)
                })?;
                x = found.x;
                curves.push(found.curve);
                done += level.steps;
                progress(done as f64 / steps.max(1) as f64);
            }
        }
        Ok(x)
    }

    /// Energy of all frames; its gradient is added to `gradient`.
    fn evaluate(
        &self,
        (dressed, config): (&DressedBody, &ClothedConfig),
        x: &[f64],
        matched: &[Option<SilhouetteMatch<'_>>],
        workers: &FitWorkers,
        gradient: &mut [f64],
    ) -> Result<f64> {
        let parts = workers.map(
            self.observed,
            |index, seen| {
                let frame = self.layout.frame(x, seen.frame);
                let mut of_frame = vec![0.0; frame.len()];
                let problem = self.of_frame(dressed, config, seen);
                let terms = match &matched[index] {
                    Some(matched) => problem.evaluate(&frame, matched, &mut of_frame)?,
                    None => problem.evaluate_unseen(&frame, &mut of_frame)?,
                };
                Ok::<_, Error>((terms.weighted(config), of_frame))
            },
            &mut || {},
        );
        let mut value =
            temporal_energy(self.smplify.skeleton(), self.layout, self.temporal, x, gradient)?;
        for (seen, part) in self.observed.iter().zip(parts) {
            let (energy, of_frame) = part?;
            value += energy;
            self.layout.add(gradient, seen.frame, &of_frame);
        }
        Ok(value)
    }

    fn frames(
        &self,
        dressed: &DressedBody,
        x: &[f64],
        workers: &FitWorkers,
    ) -> Result<Vec<SequenceFrame>> {
        let mut frames: Vec<SequenceFrame> = (0..self.layout.frames)
            .map(|frame| SequenceFrame {
                body: self.layout.body(x, frame),
                observed: false,
                joint_error: 0.0,
                intersection_over_union: None,
                problem: None,
            })
            .collect();
        let seen = workers.map(
            self.observed,
            |_, seen| {
                let camera = seen.image.camera;
                let overlap = match seen.image.mask {
                    Some(mask) => {
                        let body = self.layout.body(x, seen.frame);
                        let surface = dressed.surface(&body, self.layout.code(x))?;
                        let rendering = render(surface.vertices(), dressed.faces(), camera)?;
                        Some(seen.image.overlap(mask, rendering.mask())?)
                    }
                    None => None,
                };
                let energy = self.smplify.energy(camera, &seen.detections, seen.pixel);
                let frame = self.layout.frame(x, seen.frame);
                let joint_error = energy.joint_error(&frame, self.layout.betas)?;
                Ok::<_, Error>((joint_error, overlap))
            },
            &mut || {},
        );
        for (seen, found) in self.observed.iter().zip(seen) {
            let (joint_error, overlap) = found?;
            let silhouette = overlap.as_ref().and_then(|overlap| self.config.problem(overlap));
            let frame = &mut frames[seen.frame];
            *frame = SequenceFrame {
                observed: true,
                joint_error,
                intersection_over_union: overlap.map(|overlap| overlap.intersection_over_union),
                problem: self.smplify.problem(joint_error * seen.pixel).or(silhouette),
                body: frame.body.clone(),
            };
        }
        Ok(frames)
    }
}
