//! How well held-out clothed bodies are found again from synthetic scans.

use std::time::Instant;

use cape_core::Outfit;
use cape_data::PackedSet;
use cape_infer::Run;
use glam::{DQuat, DVec3};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use rand_distr::StandardNormal;
use serde::Serialize;

use super::{
    FreeFormConfig, Scan, ScanConfig, ScanFit, ScanFitter, ScanInit, Unit, UpAxis,
    energy::surface_distance, free_displacement, sample::sample_faces,
};
use crate::{Error, PosePrior, Result};

/// Shape coefficients that are drawn.
const SHAPES: usize = 4;
/// Radius of a hole, metres.
const HOLE: f64 = 0.12;
/// How far from the origin people stand, metres.
const FAR: f64 = 2.0;

/// What is scanned, and how badly.
///
/// ```no_run
/// use burn::tensor::Device;
/// use cape_fit::scan::{ScanConfig, benchmark::{ScanBenchmarkOptions, scan_benchmark}};
/// use cape_data::{PackedSet, Split};
/// use cape_infer::Run;
///
/// // Two scans of each of four frames: whole, and with a tenth missing.
/// let run = Run::open("runs/cape".as_ref(), &Device::default())?;
/// let set = PackedSet::open("data/packed".as_ref(), Split::Test)?;
/// let options = ScanBenchmarkOptions {
///     frames: 4,
///     points: 20_000,
///     noises: vec![0.001],
///     holes: vec![0.0, 0.1],
///     seed: 1,
/// };
/// scan_benchmark(&run, &set, &options, &ScanConfig::default(), &mut |case| {
///     println!("{} {:.0} %: {:.1} mm", case.capture, 100.0 * case.hole, case.error.clothed);
///     Ok(())
/// })?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct ScanBenchmarkOptions {
    /// Held-out frames, evenly spaced.
    pub frames: usize,
    /// Points of a scan without holes.
    pub points: usize,
    /// Standard deviations of the points' coordinates, metres.
    pub noises: Vec<f64>,
    /// Shares of the surface that are missing, 0 to 1.
    pub holes: Vec<f64>,
    /// Fixes shapes, places, points and noise.
    pub seed: u64,
}

/// Errors of one scan's fit, millimetres.
///
/// See [`ScanBenchmarkOptions`] for an example.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct ScanError {
    /// Mean distance of clothing vertices from the true ones, in the mean clothes.
    pub mean_clothes: f64,
    /// In the clothes that were found.
    pub clothed: f64,
    /// Of the true clothes themselves, encoded and decoded: what the model can say.
    pub encoded: f64,
    /// After every vertex went where the scan is.
    pub displaced: f64,
    /// Of all vertices of the body under the clothes.
    pub bare: f64,
    /// Mean distance of the true surface from that in the clothes that were found.
    pub surface: f64,
    /// And from the displaced one.
    pub displaced_surface: f64,
    /// What the fit took.
    pub seconds: f64,
    /// What the displacement took.
    pub displacement_seconds: f64,
}

/// One scan of the benchmark.
///
/// See [`ScanBenchmarkOptions`] for an example.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ScanCase {
    /// Number of the held-out frame.
    pub frame: usize,
    /// Subject and sequence.
    pub capture: String,
    /// What is worn.
    pub outfit: Outfit,
    /// Standard deviation of the points, metres.
    pub noise: f64,
    /// Share of the surface that is missing.
    pub hole: f64,
    /// How far off it is.
    pub error: ScanError,
    /// Why the fit cannot be trusted, if it cannot.
    pub problem: Option<String>,
}

/// A true surface and the body under it, metres, `[vertices]`.
struct GroundTruth {
    surface: Vec<DVec3>,
    bare: Vec<DVec3>,
    /// The surface in what the true clothes' code is decoded to.
    encoded: Vec<DVec3>,
}

/// Fits scans of held-out frames of `set` in the clothes of `run`, the outfit being known; `each`
/// gets every one in turn.
///
/// # Errors
/// If the set does not suit the run, or a fit fails altogether.
pub fn scan_benchmark(
    run: &Run,
    set: &PackedSet,
    options: &ScanBenchmarkOptions,
    config: &ScanConfig,
    each: &mut dyn FnMut(ScanCase) -> Result<()>,
) -> Result<()> {
    if set.vertices() != run.body().vertices() {
        return Err(Error::argument(format!(
            "frames of {} vertices, but the body has {}",
            set.vertices(),
            run.body().vertices()
        )));
    }
    let prior = PosePrior::synthetic()?;
    let start = ScanInit::default_poses(&prior);
    let fitter =
        |&outfit: &Outfit| ScanFitter::new(run, &[outfit], None, prior.clone(), config.clone());
    let fitters: Vec<ScanFitter> = Outfit::ALL.iter().map(fitter).collect::<Result<_>>()?;
    let count = options.frames.min(set.frames());
    for index in 0..count {
        let frame = index * set.frames() / count.max(1);
        let outfit = set.outfits()[frame];
        for &noise in &options.noises {
            for &hole in &options.holes {
                // The same person in the same place, whatever the noise.
                let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
                rng.set_stream(frame as u64);
                let truth = truth(run, set, frame, &mut rng)?;
                let scan = simulate_scan(run, &truth, options.points, noise, hole, &mut rng)?;
                let fitter = &fitters[outfit.index()];
                let clock = Instant::now();
                let fit = fitter.fit(&scan, &start, UpAxis::Y, &mut |_, _| {})?;
                let seconds = clock.elapsed().as_secs_f64();
                each(ScanCase {
                    frame,
                    capture: set.capture(frame),
                    outfit,
                    noise,
                    hole,
                    error: error(run, fitter, &truth, &scan, &fit, seconds)?,
                    problem: fit.problem,
                })?;
            }
        }
    }
    Ok(())
}

/// A held-out frame on a body of random shape, somewhere, facing anywhere.
fn truth(run: &Run, set: &PackedSet, frame: usize, rng: &mut ChaCha8Rng) -> Result<GroundTruth> {
    let (displacement, mut wearer) = cape_infer::registration(set, frame)?;
    let shapes = SHAPES.min(run.body().betas());
    wearer.betas = (0..shapes).map(|_| rng.sample(StandardNormal)).collect();
    let turn = DQuat::from_rotation_y(rng.random_range(0.0..std::f64::consts::TAU));
    let mut at = || rng.random_range(-FAR..FAR);
    let shift = DVec3::new(at(), at(), at());
    let placed = |mesh: cape_core::Mesh| -> Vec<DVec3> {
        let vertices = mesh.vertices.into_iter();
        vertices.map(|v| turn * DVec3::from_array(v.map(f64::from)) + shift).collect()
    };
    let wearers = std::slice::from_ref(&wearer);
    let decoded = run.decode_displacements(&run.encode(&displacement, wearers)?, wearers)?;
    Ok(GroundTruth {
        encoded: placed(run.pose_clothed(&decoded, wearers)?.remove(0)),
        surface: placed(run.pose_clothed(&displacement, wearers)?.remove(0)),
        bare: placed(run.pose_unclothed(wearers)?.remove(0)),
    })
}

/// Points of the surface, with noise, but for those in holes.
fn simulate_scan(
    run: &Run,
    truth: &GroundTruth,
    count: usize,
    noise: f64,
    hole: f64,
    rng: &mut ChaCha8Rng,
) -> Result<Scan> {
    let samples = sample_faces(&truth.surface, &run.body().faces, count, rng);
    let samples = samples.ok_or_else(|| Error::argument("the body's faces have no area"))?;
    let mut points: Vec<DVec3> = samples.into_iter().map(|sample| sample.at).collect();
    let wanted = ((1.0 - hole) * points.len() as f64) as usize;
    while points.len() > wanted {
        let middle = points[rng.random_range(0..points.len())];
        let mut spare = points.len() - wanted;
        points.retain(|point| {
            let lost = spare > 0 && point.distance(middle) < HOLE;
            spare -= usize::from(lost);
            !lost
        });
    }
    for point in &mut points {
        let mut off = || noise * rng.sample::<f64, _>(StandardNormal);
        *point += DVec3::new(off(), off(), off());
    }
    Scan::new(points, None, Vec::new(), Unit::M)
}

fn error(
    run: &Run,
    fitter: &ScanFitter,
    truth: &GroundTruth,
    scan: &Scan,
    fit: &ScanFit,
    seconds: f64,
) -> Result<ScanError> {
    let all: Vec<usize> = (0..truth.bare.len()).collect();
    let off = |found: &[DVec3], truth: &[DVec3], vertices: &[usize]| {
        let sum: f64 = vertices.iter().map(|&v| found[v].distance(truth[v])).sum();
        1000.0 * sum / vertices.len().max(1) as f64
    };
    let surface = fitter.surface(fit)?;
    let clock = Instant::now();
    let faces = &run.body().faces;
    let free =
        free_displacement(scan, &surface, faces, &FreeFormConfig::default(), &mut |_, _| {})?;
    let displacement_seconds = clock.elapsed().as_secs_f64();
    let clothing = run.clothing();
    Ok(ScanError {
        mean_clothes: off(
            &fitter.with_mean_clothing(&fit.before_clothes)?,
            &truth.surface,
            clothing,
        ),
        clothed: off(&surface, &truth.surface, clothing),
        encoded: off(&truth.encoded, &truth.surface, clothing),
        displaced: off(&free.vertices, &truth.surface, clothing),
        bare: off(&fitter.unclothed(&fit.parameters)?, &truth.bare, &all),
        surface: surface_distance(&truth.surface, &surface, faces),
        displaced_surface: surface_distance(&truth.surface, &free.vertices, faces),
        seconds,
        displacement_seconds,
    })
}
