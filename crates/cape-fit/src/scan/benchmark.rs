//! Benchmark of scan fitting on synthetic scans of held-out clothed bodies.

use std::{
    collections::{BTreeMap, BTreeSet},
    time::Instant,
};

use cape_core::Outfit;
use cape_data::PackedSet;
use cape_infer::Run;
use cape_stats::errors::mean_distance_mm;
use glam::{DQuat, DVec3};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use rand_distr::StandardNormal;
use serde::{Deserialize, Serialize};

use super::{
    FreeFormConfig, Scan, ScanConfig, ScanFit, ScanFitter, ScanInit, Unit, UpAxis,
    energy::surface_distance, free_displacement, sample::sample_faces,
};
use crate::{Error, FitProblem, PosePrior, Result};

/// Number of random shape coefficients.
const SHAPES: usize = 4;
/// Radius of a hole, metres.
const HOLE: f64 = 0.12;
/// Largest coordinate of the bodies' translations, metres.
const FAR: f64 = 2.0;

/// Options of the scan fitting benchmark.
///
/// ```no_run
/// use burn::tensor::Device;
/// use cape_fit::scan::{ScanConfig, benchmark::{ScanBenchmark, ScanBenchmarkOptions}};
/// use cape_data::{PackedSet, Split};
/// use cape_infer::Run;
///
/// // Two scans of each of four frames: complete, and with a tenth of the surface missing.
/// let run = Run::open("runs/cape", &Device::default())?;
/// let set = PackedSet::open("data/packed", Split::Test)?;
/// let options = ScanBenchmarkOptions {
///     frames: 4,
///     points: 20_000,
///     noises: vec![0.001],
///     holes: vec![0.0, 0.1],
///     seed: 1,
/// };
/// let benchmark = ScanBenchmark::new(&run, &set, options, &ScanConfig::default())?;
/// for trial in benchmark.trials() {
///     let case = benchmark.case(trial)?;
///     println!("{:?} {:.0} %: {:.1} mm", case.capture, 100.0 * case.hole, case.error.clothed);
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct ScanBenchmarkOptions {
    /// Held-out frames, evenly spaced.
    pub frames: usize,
    /// Number of points of a scan without holes.
    pub points: usize,
    /// Standard deviations of the points' coordinates, metres.
    pub noises: Vec<f64>,
    /// Missing shares of the surface, 0 to 1.
    pub holes: Vec<f64>,
    /// Random seed of shapes, translations, points and noise.
    pub seed: u64,
}

/// Errors of the fit to one scan; distances in millimetres.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct ScanError {
    /// Mean distance of clothing vertices from the ground truth, in the mean clothing.
    pub mean_clothes: f64,
    /// Mean distance of clothing vertices from the ground truth, in the fitted clothing.
    pub clothed: f64,
    /// Mean distance of clothing vertices from the ground truth, with the true clothing encoded and
    /// decoded: the model's reconstruction error.
    pub encoded: f64,
    /// Mean distance of clothing vertices from the ground truth, after the free-form displacement.
    pub displaced: f64,
    /// Mean distance of all vertices of the body under the clothing from the ground truth.
    pub bare: f64,
    /// Mean distance of the true vertices from the fitted surface.
    pub surface: f64,
    /// Mean distance of the true vertices from the displaced surface.
    pub displaced_surface: f64,
    /// Duration of the fit, seconds.
    pub seconds: f64,
    /// Duration of the free-form displacement, seconds.
    pub displacement_seconds: f64,
}

/// Result of one scan of the benchmark.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ScanCase {
    /// Index of the held-out frame.
    pub frame: usize,
    /// Subject and sequence, if known.
    pub capture: Option<String>,
    /// Outfit.
    pub outfit: Outfit,
    /// Standard deviation of the points' coordinates, metres.
    pub noise: f64,
    /// Missing share of the surface, 0 to 1.
    pub hole: f64,
    /// Errors.
    pub error: ScanError,
    /// Problem of the fit, if it is unreliable.
    pub problem: Option<FitProblem>,
}

/// Ground truth: clothed surface and the body under it, metres, `[V]` each.
struct GroundTruth {
    surface: Vec<DVec3>,
    bare: Vec<DVec3>,
    /// Surface in the encoded and decoded true clothing.
    encoded: Vec<DVec3>,
}

/// Conditions of one scan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScanTrial {
    /// Index of the held-out frame.
    pub frame: usize,
    /// Standard deviation of the points' coordinates, metres.
    pub noise: f64,
    /// Missing share of the surface, 0 to 1.
    pub hole: f64,
}

/// Simulated scans of held-out frames of a packed set, and the fitters of a run for them; outfits
/// are given.
#[derive(Debug)]
pub struct ScanBenchmark<'a> {
    run: &'a Run,
    set: &'a PackedSet,
    options: ScanBenchmarkOptions,
    start: ScanInit,
    fitters: BTreeMap<Outfit, ScanFitter>,
}

impl<'a> ScanBenchmark<'a> {
    /// Benchmark of frames of `set` with the clothing model of `run`.
    ///
    /// # Errors
    /// If the set has another number of vertices than the body.
    pub fn new(
        run: &'a Run,
        set: &'a PackedSet,
        options: ScanBenchmarkOptions,
        config: &ScanConfig,
    ) -> Result<Self> {
        if set.vertices() != run.body().vertices() {
            return Err(Error::argument(format!(
                "benchmark: frames of {} vertices, but the body has {}",
                set.vertices(),
                run.body().vertices()
            )));
        }
        let prior = PosePrior::synthetic()?;
        let start = ScanInit::default_poses(&prior);
        let worn: BTreeSet<Outfit> = set.outfits().iter().copied().collect();
        let fitter = |outfit| {
            let fitter = ScanFitter::new(run, &[outfit], None, prior.clone(), config.clone())?;
            Ok::<_, Error>((outfit, fitter))
        };
        let fitters = worn.into_iter().map(fitter).collect::<Result<_>>()?;
        Ok(Self { run, set, options, start, fitters })
    }

    /// Trials of all frames, noise levels and shares of holes; their results do not depend on each
    /// other.
    pub fn trials(&self) -> Vec<ScanTrial> {
        let ScanBenchmarkOptions { noises, holes, .. } = &self.options;
        let count = self.options.frames.min(self.set.frames());
        let mut trials = Vec::with_capacity(count * noises.len() * holes.len());
        for index in 0..count {
            let frame = index * self.set.frames() / count;
            for &noise in noises {
                trials.extend(holes.iter().map(|&hole| ScanTrial { frame, noise, hole }));
            }
        }
        trials
    }

    /// Simulates and fits the scan of a trial.
    ///
    /// # Errors
    /// If the frame cannot be read, or the fit fails.
    pub fn case(&self, ScanTrial { frame, noise, hole }: ScanTrial) -> Result<ScanCase> {
        let Self { run, set, options, start, fitters } = self;
        let outfit = set.outfits()[frame];
        // The same body and translation for all noise levels.
        let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
        rng.set_stream(frame as u64);
        let truth = truth(run, set, frame, &mut rng)?;
        let scan = simulate_scan(run, &truth, options.points, noise, hole, &mut rng)?;
        let fitter = fitters.get(&outfit).ok_or_else(|| {
            Error::argument(format!("benchmark: no frame of the set is in {outfit}"))
        })?;
        let clock = Instant::now();
        let fit = fitter.fit(&scan, start, UpAxis::Y, &mut |_, _| {})?;
        let seconds = clock.elapsed().as_secs_f64();
        Ok(ScanCase {
            frame,
            capture: set.capture(frame),
            outfit,
            noise,
            hole,
            error: error(run, fitter, &truth, &scan, &fit, seconds)?,
            problem: fit.problem,
        })
    }
}

/// Ground truth of a held-out frame on a body of random shape, translation and yaw.
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

/// Random points of the surface with noise, without those in holes.
fn simulate_scan(
    run: &Run,
    truth: &GroundTruth,
    count: usize,
    noise: f64,
    hole: f64,
    rng: &mut ChaCha8Rng,
) -> Result<Scan> {
    let samples = sample_faces(&truth.surface, &run.body().faces, count, rng);
    let samples = samples.ok_or_else(|| Error::argument("body: the faces have no area"))?;
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
        mean_distance_mm(vertices.iter().map(|&v| (found[v].to_array(), truth[v].to_array())))
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
