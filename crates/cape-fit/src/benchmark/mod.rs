//! Benchmark of image fitting on renderings with known ground truth (CAPE §6.3; table 4 of the arXiv
//! version, table 3 of the CVPR version): held-out clothing on bodies of random shape.

mod scene;
mod summary;

use std::{
    collections::{BTreeMap, BTreeSet},
    time::Instant,
};

use cape_core::Outfit;
use cape_data::PackedSet;
use cape_infer::Run;
use glam::DVec3;
use ndarray::Array2;
use serde::{Deserialize, Serialize};

pub use scene::Scene;
pub use summary::{BenchmarkSummary, MethodScores, OutfitSummary, ValueSummary};

use crate::{
    BodyParameters, ClothedConfig, DressedBody, Error, FitProblem, ImageObservation, Result,
    Smplify, aligned_error, alignment::points, silhouette::render,
};

/// Number of images of the paper's benchmark.
pub const FRAMES: usize = 120;

/// Options of the image fitting benchmark.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BenchmarkOptions {
    /// Held-out frames, evenly spaced in each outfit.
    pub frames: usize,
    /// Frames that a benchmark without this option does not take if it takes [`FRAMES`], to choose
    /// weights on.
    pub tuning: bool,
    /// Side of the images, pixels.
    pub side: u32,
    /// Standard deviation of the keypoints, pixels.
    pub noise: f64,
    /// Distance of the detector's hips and neck from the body's joints, metres: hips are outwards and
    /// upwards of SMPL's, the neck below.
    pub bias: f64,
    /// Share of joints without a detection, 0 to 1.
    pub dropped: f64,
    /// Share of pixels beside the outline of the silhouette that are flipped, 0 to 1.
    pub ragged: f64,
    /// Random seed of shapes and noise.
    pub seed: u64,
}

impl Default for BenchmarkOptions {
    fn default() -> Self {
        Self {
            frames: FRAMES,
            tuning: false,
            side: 512,
            noise: 0.0,
            bias: 0.0,
            dropped: 0.0,
            ragged: 0.0,
            seed: 1,
        }
    }
}

/// Errors at clothing vertices after alignment by scale and translation (CAPE eq. 12).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FitError {
    /// Mean squared distance, m².
    pub squared: f64,
    /// Mean distance, millimetres.
    pub distance_mm: f64,
    /// Intersection over union of the rendered and the given silhouette, 0 to 1.
    pub intersection_over_union: f64,
    /// Duration of the fit, seconds.
    pub seconds: f64,
}

/// Result of one frame of the benchmark.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BenchmarkCase {
    /// Index of the held-out frame.
    pub frame: usize,
    /// Subject and sequence, if known.
    pub capture: Option<String>,
    /// Outfit.
    pub outfit: Outfit,
    /// Error of the unclothed body of SMPLify.
    pub bare: FitError,
    /// Error of the clothed body; that of the unclothed one if the clothed fit failed.
    pub clothed: FitError,
    /// Problem of the fit, if it is unreliable.
    pub problem: Option<FitProblem>,
    /// Unclothed body of SMPLify.
    pub bare_body: BodyParameters,
    /// Body under the clothing.
    pub clothed_body: BodyParameters,
    /// Latent code of the clothing, `[latent]`; empty if the clothed fit failed.
    pub code: Vec<f64>,
}

/// Held-out frames, the fitter and its configuration.
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
/// let run = Run::open("runs/cape", &Device::default())?;
/// let set = PackedSet::open("data/packed", Split::Test)?;
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
    /// Bodies in the outfits of the set.
    bodies: BTreeMap<Outfit, DressedBody>,
    /// Minimal shapes of subjects, metres, `[V, 3]`, in place of random ones.
    shapes: BTreeMap<String, Array2<f64>>,
}

impl<'a> Benchmark<'a> {
    /// Benchmark of held-out frames of `set` with the clothing model of `run`; outfits are given.
    ///
    /// # Errors
    /// If the set has another number of vertices than the body.
    pub fn new(
        run: &'a Run,
        set: &'a PackedSet,
        smplify: &'a Smplify,
        config: &'a ClothedConfig,
        options: BenchmarkOptions,
    ) -> Result<Self> {
        if set.vertices() != run.body().vertices() {
            return Err(Error::argument(format!(
                "benchmark: frames of {} vertices, but the body has {}",
                set.vertices(),
                run.body().vertices()
            )));
        }
        let worn: BTreeSet<Outfit> = set.outfits().iter().copied().collect();
        let body = DressedBody::new(run, run.default_outfit())?;
        let dressed = |outfit| Ok::<_, Error>((outfit, body.with_outfit(outfit)?));
        let bodies = worn.into_iter().map(dressed).collect::<Result<_>>()?;
        Ok(Self { run, set, smplify, config, options, bodies, shapes: BTreeMap::new() })
    }

    /// The benchmark with subjects' own bodies, minimal shapes in metres, `[V, 3]`, by name, in place of
    /// bodies of random shape.
    ///
    /// # Errors
    /// If the set does not say whose its frames are, a subject of them is missing, or a shape has
    /// another number of vertices than the body.
    pub fn with_shapes(mut self, shapes: BTreeMap<String, Array2<f64>>) -> Result<Self> {
        let Some(origins) = self.set.origins() else {
            let message = "bodies of the subjects: no test_frames.csv in the packed set, which says whose its \
                           frames are";
            return Err(Error::argument(message));
        };
        if let Some(missing) = origins.iter().find(|o| !shapes.contains_key(&o.subject)) {
            return Err(Error::argument(format!(
                "bodies of the subjects: none of `{}`",
                missing.subject
            )));
        }
        let vertices = self.run.body().vertices();
        if let Some((name, shape)) = shapes.iter().find(|(_, s)| s.dim() != (vertices, 3)) {
            return Err(Error::argument(format!(
                "body of `{name}`: shape {:?}, expected [{vertices}, 3]",
                shape.shape()
            )));
        }
        self.shapes = shapes;
        Ok(self)
    }

    /// Indices of the frames: equal numbers of each outfit if available, evenly spaced over
    /// subjects and motions.
    pub fn frames(&self) -> Vec<usize> {
        let BenchmarkOptions { frames, tuning, .. } = self.options;
        let outfits = self.set.outfits();
        if tuning { spread_apart(outfits, frames) } else { spread(outfits, frames) }
    }

    /// Observations and ground truth of a frame.
    ///
    /// # Errors
    /// If the frame cannot be read.
    pub fn scene(&self, frame: usize) -> Result<Scene> {
        let origin = self.set.origins().and_then(|origins| origins.get(frame));
        let shape = origin.and_then(|origin| self.shapes.get(&origin.subject));
        Scene::new(self.run, self.set, frame, shape, &self.options)
    }

    /// Fits a frame from its keypoints, silhouette and outfit.
    ///
    /// # Errors
    /// If the frame cannot be read, or has too few keypoints to place a body.
    pub fn case(&self, frame: usize) -> Result<BenchmarkCase> {
        let Scene { camera, keypoints, mask, truth } = &self.scene(frame)?;
        let outfit = self.set.outfits()[frame];
        let dressed = self.dressed(outfit)?;
        let start = Instant::now();
        let bare = self.smplify.fit(camera, keypoints, None)?;
        let bare_seconds = start.elapsed().as_secs_f64();
        let start = Instant::now();
        let image = ImageObservation { camera, keypoints, mask: Some(mask), occluders: None };
        let fit = match self.smplify.fit_clothed(dressed, &image, &bare, self.config) {
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
            Err(reason) => Ok(BenchmarkCase { problem: Some(FitProblem::Failed(reason)), ..case }),
            Ok(fit) => Ok(BenchmarkCase {
                clothed: error(
                    dressed.surface(&fit.parameters, &fit.code)?.vertices(),
                    clothed_seconds,
                )?,
                problem: bare.problem.or(fit.problem),
                clothed_body: fit.parameters,
                code: fit.code,
                ..case
            }),
        }
    }

    /// Vertices of the fitted surfaces, unclothed and clothed, metres, `[V]` each.
    ///
    /// # Errors
    /// If the case is of another clothing model.
    pub fn surfaces(&self, case: &BenchmarkCase) -> Result<[Vec<DVec3>; 2]> {
        let bare = self.unclothed(&case.bare_body)?;
        if case.code.is_empty() {
            return Ok([bare.clone(), bare]);
        }
        let dressed = self.dressed(case.outfit)?;
        let clothed = dressed.surface(&case.clothed_body, &case.code)?;
        Ok([bare, clothed.vertices().to_vec()])
    }

    fn dressed(&self, outfit: Outfit) -> Result<&DressedBody> {
        self.bodies.get(&outfit).ok_or_else(|| {
            Error::argument(format!("benchmark: no frame of the set is in {outfit}"))
        })
    }

    /// Triangles of the body, `[F, 3]`.
    pub fn faces(&self) -> &[[u32; 3]] {
        &self.run.body().faces
    }

    /// Vertices of an unclothed body, metres, `[V]`.
    fn unclothed(&self, body: &BodyParameters) -> Result<Vec<DVec3>> {
        let posed = self.run.body().pose(&body.betas, &body.pose, body.transl, None)?;
        Ok(points(posed.vertices.view()))
    }
}

/// Indices of at most `count` entries of a list of outfits, evenly spaced among the entries of each
/// outfit, with a different offset for each.
fn spread(outfits: &[Outfit], count: usize) -> Vec<usize> {
    let of_outfit = |outfit: Outfit| -> Vec<usize> {
        (0..outfits.len()).filter(|&at| outfits[at] == outfit).collect()
    };
    let worn: BTreeSet<Outfit> = outfits.iter().copied().collect();
    let mut groups: Vec<Vec<usize>> = worn.into_iter().map(of_outfit).collect();
    // From the smallest group, so that larger ones compensate for missing entries.
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

/// [`spread`] of the entries that the benchmark of [`FRAMES`] does not take.
fn spread_apart(outfits: &[Outfit], count: usize) -> Vec<usize> {
    let taken: BTreeSet<usize> = spread(outfits, FRAMES).into_iter().collect();
    let others: Vec<usize> = (0..outfits.len()).filter(|at| !taken.contains(at)).collect();
    let of_others: Vec<Outfit> = others.iter().map(|&at| outfits[at]).collect();
    spread(&of_others, count).into_iter().map(|at| others[at]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_spread_over_outfits() {
        // Subjects one after the other, each in four outfits.
        let outfits: Vec<Outfit> = (0..96).map(|at| Outfit::PAPER[at / 3 % 4]).collect();
        for count in [1, 4, 6, 24, 50, 96, 200] {
            let frames = spread(&outfits, count);
            assert_eq!(frames.len(), count.min(96));
            assert!(frames.windows(2).all(|pair| pair[0] < pair[1]), "{frames:?}");
            for outfit in Outfit::PAPER {
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
        let mut few = vec![Outfit::SHORT_LONG; 20];
        few[7] = Outfit::LONG_LONG;
        assert_eq!(spread(&few, 10).len(), 10);
        assert!(spread(&few, 10).contains(&7));
        assert!(spread(&[], 3).is_empty());
    }

    #[test]
    fn frames_for_tuning_are_none_of_the_benchmark() {
        let outfits: Vec<Outfit> = (0..432).map(|at| Outfit::PAPER[at / 3 % 4]).collect();
        let (taken, apart) = (spread(&outfits, FRAMES), spread_apart(&outfits, 24));
        assert_eq!(apart.len(), 24);
        assert!(apart.iter().all(|frame| !taken.contains(frame)));
        assert!(
            Outfit::PAPER.iter().all(|&worn| {
                apart.iter().filter(|&&frame| outfits[frame] == worn).count() == 6
            })
        );
        // A set as small as the benchmark has no others.
        assert!(spread_apart(&outfits[..96], 24).is_empty());
    }
}
