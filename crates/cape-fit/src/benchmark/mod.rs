//! How well clothed bodies are found again (CAPE §6.3, tables 3 and 4): held-out clothes on bodies of
//! random shape, seen by a camera of our own, whose truth is known.

mod scene;
mod summary;

use std::time::Instant;

use cape_core::Outfit;
use cape_data::PackedSet;
use cape_infer::Run;
use glam::DVec3;
use serde::{Deserialize, Serialize};

pub use scene::Scene;
pub use summary::{BenchmarkSummary, MethodScores, OutfitSummary, ValueSummary};

use crate::{
    BodyFit, BodyParameters, ClothedConfig, ClothedFit, DressedBody, Error, Result, Smplify,
    aligned_error, silhouette::render,
};

/// What is seen.
///
/// See [`Benchmark`] for an example.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BenchmarkOptions {
    /// Held-out frames, evenly spaced in each outfit.
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
///
/// See [`BenchmarkSummary`] for an example.
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
///
/// See [`BenchmarkSummary`] for an example.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BenchmarkCase {
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
///
/// ```no_run
/// use burn::tensor::Device;
/// use cape_fit::{
///     ClothedConfig, PosePrior, Smplify, SmplifyConfig,
///     benchmark::{Benchmark, BenchmarkOptions, BenchmarkSummary},
/// };
/// use cape_data::{PackedSet, Split};
/// use cape_infer::Run;
///
/// let run = Run::open("runs/cape".as_ref(), &Device::default())?;
/// let set = PackedSet::open("data/packed".as_ref(), Split::Test)?;
/// let smplify = Smplify::new(run.body(), PosePrior::synthetic()?, SmplifyConfig::default())?;
/// let config = ClothedConfig::default();
/// let options = BenchmarkOptions { frames: 8, ..BenchmarkOptions::default() };
/// let benchmark = Benchmark::new(&run, &set, &smplify, &config, options)?;
/// let mut cases = Vec::new();
/// for frame in benchmark.frames() {
///     let scene = benchmark.scene(frame)?;
///     println!("{} pixels", scene.mask.area());
///     cases.push(benchmark.case(frame)?);
/// }
/// println!("{:.1} mm", BenchmarkSummary::from_cases(&cases, 1)?.clothed.distance_mm.mean);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
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
        let body = DressedBody::new(run, Outfit::ALL[0])?;
        let bodies = Outfit::ALL.iter().map(|&outfit| body.with_outfit(outfit)).collect();
        Ok(Self { run, set, smplify, config, options, bodies })
    }

    /// Numbers of the frames: as many of each outfit, as far as there are, evenly spaced over
    /// subjects and movements.
    pub fn frames(&self) -> Vec<usize> {
        spread(self.set.outfits(), self.options.frames)
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
    pub fn case(&self, frame: usize) -> Result<BenchmarkCase> {
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
        let bare_error = error(&self.unclothed(&bare.parameters)?, bare_seconds)?;
        let case = BenchmarkCase {
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
            Err(reason) => Ok(BenchmarkCase { problem: Some(reason), ..case }),
            Ok(fit) => Ok(BenchmarkCase {
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
    pub fn surfaces(&self, case: &BenchmarkCase) -> Result<[Vec<DVec3>; 2]> {
        let bare = self.unclothed(&case.bare_body)?;
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
    fn unclothed(&self, body: &BodyParameters) -> Result<Vec<DVec3>> {
        let posed = self.run.body().pose(&body.betas, &body.pose, body.transl, None)?;
        Ok(posed.vertices.rows().into_iter().map(|v| DVec3::new(v[0], v[1], v[2])).collect())
    }
}

/// `count` places in a list of outfits, at most all: evenly spaced in those of each outfit, and not
/// at the same places of each.
fn spread(outfits: &[Outfit], count: usize) -> Vec<usize> {
    let of_outfit = |outfit: Outfit| -> Vec<usize> {
        (0..outfits.len()).filter(|&at| outfits[at] == outfit).collect()
    };
    let mut groups: Vec<Vec<usize>> = Outfit::ALL.map(of_outfit).to_vec();
    groups.retain(|group| !group.is_empty());
    // From the smallest, so that larger ones make up for what it lacks.
    groups.sort_by_key(Vec::len);
    let kinds = groups.len();
    let (mut found, mut left) = (Vec::new(), count.min(outfits.len()));
    for (index, group) in groups.iter().enumerate() {
        let wanted = left.div_ceil(kinds - index).min(group.len());
        let place = |k: usize| (k * kinds + index) * group.len() / (wanted * kinds);
        found.extend((0..wanted).map(|k| group[place(k)]));
        left -= wanted;
    }
    found.sort_unstable();
    found
}

fn problem(bare: &BodyFit, clothed: &ClothedFit) -> Option<String> {
    bare.problem.clone().or(clothed.problem.clone())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_spread_over_outfits() {
        // Subjects one after the other, each in four outfits.
        let outfits: Vec<Outfit> = (0..96).map(|at| Outfit::ALL[at / 3 % 4]).collect();
        for count in [1, 4, 6, 24, 50, 96, 200] {
            let frames = spread(&outfits, count);
            assert_eq!(frames.len(), count.min(96));
            assert!(frames.windows(2).all(|pair| pair[0] < pair[1]), "{frames:?}");
            for outfit in Outfit::ALL {
                let worn = frames.iter().filter(|&&frame| outfits[frame] == outfit).count();
                assert!(worn.abs_diff(frames.len() / 4) <= 1, "{count} {outfit}");
            }
        }
        let captures = |frames: Vec<usize>| {
            let mut captures: Vec<usize> = frames.into_iter().map(|frame| frame / 3).collect();
            captures.dedup();
            captures.len()
        };
        assert_eq!(captures(spread(&outfits, 24)), 24);
        let mut few = vec![Outfit::ShortLong; 20];
        few[7] = Outfit::LongLong;
        assert_eq!(spread(&few, 10).len(), 10);
        assert!(spread(&few, 10).contains(&7));
        assert!(spread(&[], 3).is_empty());
    }
}
