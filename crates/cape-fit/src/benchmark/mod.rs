//! How well clothed bodies are found again (CAPE §6.3, tables 3 and 4): held-out clothes on bodies of
//! random shape, seen by a camera of our own, whose truth is known.

mod scene;
mod summary;

use std::time::Instant;

use cape_core::Outfit;
use cape_train::{Run, data::PackedSet};
use glam::DVec3;
use serde::{Deserialize, Serialize};

pub use scene::Scene;
pub use summary::{OutfitSummary, Score, Spread, Summary};

use crate::{
    BodyFit, BodyParameters, ClothedConfig, ClothedFit, DressedBody, Error, Result, Smplify,
    aligned_error, silhouette::render,
};

/// What is seen.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BenchmarkOptions {
    /// Held-out frames, evenly spaced.
    pub frames: usize,
    /// Side of the pictures, pixels.
    pub side: u32,
    /// Standard deviation of keypoints, pixels.
    pub noise: f64,
    /// Share of joints that the detector misses.
    pub dropped: f64,
    /// Share of pixels beside the silhouette's edge that are taken for the other side.
    pub ragged: f64,
    /// Fixes shapes and noise.
    pub seed: u64,
}

impl Default for BenchmarkOptions {
    fn default() -> Self {
        Self { frames: 120, side: 512, noise: 0.0, dropped: 0.0, ragged: 0.0, seed: 1 }
    }
}

/// Errors after scale and translation are taken out (eq. 12–13), at clothing vertices.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FitError {
    /// Mean squared distance, m².
    pub squared: f64,
    /// Mean distance, millimetres.
    pub distance_mm: f64,
    /// Of the silhouettes.
    pub intersection_over_union: f64,
    /// What it took.
    pub seconds: f64,
}

/// One frame of the benchmark, and what was found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Case {
    /// Number of the held-out frame.
    pub frame: usize,
    /// Subject and sequence.
    pub capture: String,
    /// What is worn.
    pub outfit: Outfit,
    /// Of SMPLify alone.
    pub bare: FitError,
    /// Of CAPE's clothed body; of the bare one, where the clothed one could not be fitted at all.
    pub clothed: FitError,
    /// Why the fit cannot be trusted, if it cannot.
    pub problem: Option<String>,
    /// SMPLify's body.
    pub bare_body: BodyParameters,
    /// The body under the clothes.
    pub clothed_body: BodyParameters,
    /// The clothes, `[latent]`; none, where they could not be fitted.
    pub code: Vec<f64>,
}

/// Frames to fit, and what fits them.
#[derive(Debug)]
pub struct Benchmark<'a> {
    run: &'a Run,
    set: &'a PackedSet,
    smplify: &'a Smplify,
    config: &'a ClothedConfig,
    options: BenchmarkOptions,
    bodies: Vec<DressedBody>,
}

impl<'a> Benchmark<'a> {
    /// For held-out frames of `set` in the clothes of `run`, the outfit being known.
    ///
    /// # Errors
    /// If the set does not suit the run.
    pub fn new(
        run: &'a Run,
        set: &'a PackedSet,
        smplify: &'a Smplify,
        config: &'a ClothedConfig,
        options: BenchmarkOptions,
    ) -> Result<Self> {
        if set.vertices() != run.body().vertices() {
            return Err(Error::argument(format!(
                "frames of {} vertices, but the body has {}",
                set.vertices(),
                run.body().vertices()
            )));
        }
        let bodies = Outfit::ALL.iter().map(|&outfit| DressedBody::new(run, outfit));
        let bodies = bodies.collect::<Result<_>>()?;
        Ok(Self { run, set, smplify, config, options, bodies })
    }

    /// Numbers of the frames, evenly spaced: sets are in the order of subjects, sequences and
    /// outfits.
    pub fn frames(&self) -> Vec<usize> {
        let count = self.options.frames.min(self.set.frames());
        (0..count).map(|index| index * self.set.frames() / count).collect()
    }

    /// What is to be seen in a frame, and the truth.
    ///
    /// # Errors
    /// If the frame cannot be read.
    pub fn scene(&self, frame: usize) -> Result<Scene> {
        Scene::new(self.run, self.set, frame, &self.options)
    }

    /// Fits a frame from its silhouette, keypoints and outfit.
    ///
    /// # Errors
    /// If the frame cannot be read, or shows too little to place a body at all.
    pub fn case(&self, frame: usize) -> Result<Case> {
        let Scene { camera, keypoints, mask, truth } = &self.scene(frame)?;
        let outfit = self.set.outfits()[frame];
        let dressed = &self.bodies[outfit.index()];
        let start = Instant::now();
        let bare = self.smplify.fit(camera, keypoints, None)?;
        let bare_seconds = start.elapsed().as_secs_f64();
        let start = Instant::now();
        let fit =
            match self.smplify.fit_clothed(dressed, camera, keypoints, mask, &bare, self.config) {
                Ok(fit) => Ok(fit),
                Err(Error::Failed(reason)) => Err(reason),
                Err(error) => return Err(error),
            };
        let clothed_seconds = start.elapsed().as_secs_f64();
        let error = |vertices: &[DVec3], seconds: f64| {
            let error = aligned_error(vertices, truth, self.run.clothing())?;
            let drawn = render(vertices, dressed.faces(), camera)?;
            Ok::<_, Error>(FitError {
                squared: error.squared,
                distance_mm: 1000.0 * error.distance,
                intersection_over_union: drawn.mask().intersection_over_union(mask)?,
                seconds,
            })
        };
        let bare_error = error(&self.bare(&bare.parameters)?, bare_seconds)?;
        let case = Case {
            frame,
            capture: self.set.capture(frame),
            outfit,
            bare: bare_error,
            clothed: FitError { seconds: clothed_seconds, ..bare_error },
            problem: None,
            clothed_body: bare.parameters.clone(),
            bare_body: bare.parameters.clone(),
            code: Vec::new(),
        };
        match fit {
            Err(reason) => Ok(Case { problem: Some(reason), ..case }),
            Ok(fit) => Ok(Case {
                clothed: error(
                    dressed.surface(&fit.parameters, &fit.code)?.vertices(),
                    clothed_seconds,
                )?,
                problem: problem(&bare, &fit),
                clothed_body: fit.parameters,
                code: fit.code,
                ..case
            }),
        }
    }

    /// The surfaces that were found, bare and clothed: vertices in metres, `[V]` each.
    ///
    /// # Errors
    /// If the case is of another model.
    pub fn surfaces(&self, case: &Case) -> Result<[Vec<DVec3>; 2]> {
        let bare = self.bare(&case.bare_body)?;
        if case.code.is_empty() {
            return Ok([bare.clone(), bare]);
        }
        let dressed = &self.bodies[case.outfit.index()];
        let clothed = dressed.surface(&case.clothed_body, &case.code)?;
        Ok([bare, clothed.vertices().to_vec()])
    }

    /// Triangles of all surfaces.
    pub fn faces(&self) -> &[[u32; 3]] {
        &self.run.body().faces
    }

    /// Unclothed vertices, metres.
    fn bare(&self, body: &BodyParameters) -> Result<Vec<DVec3>> {
        let posed = self.run.body().pose(&body.betas, &body.pose, body.transl, None)?;
        Ok(posed.vertices.rows().into_iter().map(|v| DVec3::new(v[0], v[1], v[2])).collect())
    }
}

fn problem(bare: &BodyFit, clothed: &ClothedFit) -> Option<String> {
    bare.problem.clone().or(clothed.problem.clone())
}
