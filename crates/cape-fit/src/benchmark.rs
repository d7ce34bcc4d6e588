//! How well clothed bodies are found again (CAPE §6.3, tables 3 and 4): held-out clothes on bodies of
//! random shape, seen by a camera of our own, whose truth is known.

use std::time::Instant;

use cape_core::Outfit;
use cape_train::{Run, data::PackedSet};
use glam::DVec3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use serde::Serialize;

use crate::{
    BodyFit, BodyParameters, Camera, ClothedConfig, ClothedFit, Detector, DressedBody, Error,
    Keypoint, Keypoints, Mask, Result, Smplify, aligned_error, silhouette::render,
};

/// Where bodies stand, metres in front of the camera.
const PLACE: DVec3 = DVec3::new(0.0, 0.15, -3.3);
/// Shape coefficients that vary.
const SHAPES: usize = 4;

/// What is seen.
#[derive(Debug, Clone, Copy, PartialEq)]
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
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
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

/// One frame of the benchmark.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Case {
    /// Number of the held-out frame.
    pub frame: usize,
    /// Subject and sequence.
    pub capture: String,
    /// What is worn.
    pub outfit: Outfit,
    /// Of SMPLify alone.
    pub bare: FitError,
    /// Of CAPE's clothed body.
    pub clothed: FitError,
    /// Why the fit cannot be trusted, if it cannot.
    pub problem: Option<String>,
}

/// What a case is made of, for pictures.
#[derive(Debug, Clone)]
pub struct Seen {
    /// The camera.
    pub camera: Camera,
    /// What the detector saw.
    pub keypoints: Keypoints,
    /// The silhouette that was given.
    pub mask: Mask,
    /// The true surface, `[vertices]`, metres.
    pub truth: Vec<DVec3>,
    /// SMPLify's.
    pub bare: Vec<DVec3>,
    /// The clothed one.
    pub clothed: Vec<DVec3>,
}

/// Fits held-out frames of `set` in the clothes of `run`, the outfit being known; `each` gets every
/// one in turn.
///
/// # Errors
/// If the set does not suit the run, or a fit fails altogether.
pub fn benchmark(
    run: &Run,
    set: &PackedSet,
    smplify: &Smplify,
    config: &ClothedConfig,
    options: &BenchmarkOptions,
    each: &mut dyn FnMut(Case, Seen) -> Result<()>,
) -> Result<()> {
    if set.vertices() != run.body().vertices() {
        return Err(Error::argument(format!(
            "frames of {} vertices, but the body has {}",
            set.vertices(),
            run.body().vertices()
        )));
    }
    let bodies: Vec<DressedBody> =
        Outfit::ALL.iter().map(|&outfit| DressedBody::new(run, outfit)).collect::<Result<_>>()?;
    let count = options.frames.min(set.frames());
    for index in 0..count {
        let frame = index * set.frames() / count.max(1);
        let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
        rng.set_stream(frame as u64);
        let outfit = set.outfits()[frame];
        let (truth, keypoints, camera) = scene(run, set, frame, options, &mut rng)?;
        let dressed = &bodies[outfit.index()];
        let mask = render(&truth, dressed.faces(), &camera)?.mask().clone();
        let mask = ragged(&mask, options.ragged, &mut rng)?;

        let start = Instant::now();
        let bare = smplify.fit(&camera, &keypoints, None)?;
        let bare_seconds = start.elapsed().as_secs_f64();
        let start = Instant::now();
        let fit = smplify.fit_clothed(dressed, &camera, &keypoints, &mask, &bare, config)?;
        let clothed_seconds = start.elapsed().as_secs_f64();

        let [bare_at, clothed_at] = [
            posed(run, &bare.parameters)?,
            dressed.surface(&fit.parameters, &fit.code)?.vertices().to_vec(),
        ];
        let error = |vertices: &[DVec3], seconds: f64| {
            let error = aligned_error(vertices, &truth, run.clothing())?;
            let drawn = render(vertices, dressed.faces(), &camera)?;
            Ok::<_, Error>(FitError {
                squared: error.squared,
                distance_mm: 1000.0 * error.distance,
                intersection_over_union: drawn.mask().intersection_over_union(&mask)?,
                seconds,
            })
        };
        let case = Case {
            frame,
            capture: set.capture(frame),
            outfit,
            bare: error(&bare_at, bare_seconds)?,
            clothed: error(&clothed_at, clothed_seconds)?,
            problem: problem(&bare, &fit),
        };
        each(case, Seen { camera, keypoints, mask, truth, bare: bare_at, clothed: clothed_at })?;
    }
    Ok(())
}

fn problem(bare: &BodyFit, clothed: &ClothedFit) -> Option<String> {
    bare.problem.clone().or(clothed.problem.clone())
}

/// Unclothed vertices, metres.
fn posed(run: &Run, body: &BodyParameters) -> Result<Vec<DVec3>> {
    let posed = run.body().pose(&body.betas, &body.pose, body.transl, None)?;
    Ok(posed.vertices.rows().into_iter().map(|v| DVec3::new(v[0], v[1], v[2])).collect())
}

/// The true surface, what a detector sees of it, and the camera.
fn scene(
    run: &Run,
    set: &PackedSet,
    frame: usize,
    options: &BenchmarkOptions,
    rng: &mut ChaCha8Rng,
) -> Result<(Vec<DVec3>, Keypoints, Camera)> {
    let camera = Camera::new(options.side, options.side, None)?;
    let (displacement, mut wearer) = set.registration(frame)?;
    let shapes = SHAPES.min(run.body().betas());
    wearer.betas = (0..shapes).map(|_| rng.sample(StandardNormal)).collect();
    let mesh = run.wear(&displacement, std::slice::from_ref(&wearer))?.remove(0);
    let truth =
        mesh.vertices.iter().map(|&[x, y, z]| DVec3::new(x.into(), y.into(), z.into()) + PLACE);
    let betas: Vec<f64> = wearer.betas.iter().copied().map(f64::from).collect();
    let pose = wearer.pose.map(f64::from);
    let joints = run.body().pose(&betas, &pose, [0.0; 3], None)?.joints;
    let detector = Detector::Body25;
    let unseen = Keypoint { x: 0.0, y: 0.0, confidence: 0.0 };
    let mut points = vec![unseen; detector.points()];
    for &(point, joint) in detector.joints() {
        let at = DVec3::new(joints[[joint, 0]], joints[[joint, 1]], joints[[joint, 2]]) + PLACE;
        let at = camera.project(at);
        let [dx, dy] = [0; 2].map(|_| options.noise * rng.sample::<f64, _>(StandardNormal));
        if rng.random::<f64>() >= options.dropped {
            points[point] = Keypoint { x: at.x + dx, y: at.y + dy, confidence: 1.0 };
        }
    }
    Ok((truth.collect(), Keypoints::new(detector, points)?, camera))
}

/// The mask with some of the pixels beside its edge on the other side of it.
fn ragged(mask: &Mask, share: f64, rng: &mut ChaCha8Rng) -> Result<Mask> {
    let (width, height) = (mask.width() as usize, mask.height() as usize);
    let inside = mask.covered();
    let mut covered = inside.to_vec();
    for y in 0..height {
        for x in 0..width {
            let at = y * width + x;
            let differs = |other: usize| inside[other] != inside[at];
            let edge = (x > 0 && differs(at - 1))
                || (x + 1 < width && differs(at + 1))
                || (y > 0 && differs(at - width))
                || (y + 1 < height && differs(at + width));
            if edge && rng.random::<f64>() < share {
                covered[at] = !inside[at];
            }
        }
    }
    Mask::new(mask.width(), mask.height(), covered)
}
