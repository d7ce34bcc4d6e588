//! Quality of samples, measured against held-out frames and on their own.

mod captures;
mod classify;
mod inside;
mod principal;
mod sets;
mod transfer;
mod worn;

use std::{collections::BTreeSet, path::Path};

use cape_core::Outfit;
use ndarray::{Array2, Axis};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use rand_distr::StandardNormal;
use serde::Serialize;

pub use sets::{ClothingSet, SetDistances, SetQuality};
pub use transfer::PoseTransfer;

use crate::{
    Error, Result,
    quality::{
        captures::HeldOutCaptures, classify::OutfitCentroids, principal::PrincipalProjection,
    },
};
use cape_core::ProgressFn;
use cape_data::{PackedSet, Split};
use cape_infer::{BodySpec, Run};

/// Options of [`quality`](quality()).
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/../cape-train/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use burn::tensor::Device;
/// use cape_core::silent;
/// use cape_eval::quality::{QualityOptions, quality, standard_normal};
/// use cape_infer::{BodySpec, Run};
///
/// let directory = trained()?;
/// let [packed, run] = ["packed", "run"].map(|name| directory.path().join(name));
/// let run = Run::open(&run, &Device::default())?;
/// let codes = standard_normal(run.config().model.latent, 1.0, 7);
/// let options = QualityOptions { frames: 4, each: 2, ..QualityOptions::default() };
/// let report = quality(&run, &packed, &codes, options, &mut silent)?;
/// assert_eq!(report.frames, 4);
/// assert!((0.0..=1.0).contains(&report.samples.coverage));
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, Copy)]
pub struct QualityOptions {
    /// Largest number of held-out frames, evenly spaced, that are compared with as many samples.
    pub frames: usize,
    /// Samples per outfit in one pose, for diversity.
    pub each: usize,
    /// Largest number of training frames of the outfit classifier.
    pub training_frames: usize,
    /// Seed of the joints and axes of pose sensitivity.
    pub seed: u64,
}

impl Default for QualityOptions {
    fn default() -> Self {
        Self { frames: 200, each: 16, training_frames: 400, seed: 1 }
    }
}

/// Quality measures of samples. Distances are mean Euclidean distances of clothing vertices in
/// canonical space, millimetres.
#[derive(Debug, Clone, Serialize)]
pub struct QualityReport {
    /// Number of held-out frames, each with a sample of its pose and outfit.
    pub frames: usize,
    /// Samples in the poses of one half of the held-out captures against the frames of the other half:
    /// mean over both halves. All frames of a capture have one code.
    #[serde(flatten)]
    pub samples: SetQuality,
    /// The same measures of the frames of one half against those of the other: the best that samples can
    /// reach.
    pub held_out: SetQuality,
    /// The same measures of frames of training captures in place of samples, with their offsets as they are:
    /// what a model reaches that reproduces its training data. `None` if an outfit has no training frames.
    pub training: Option<SetQuality>,
    /// Samples against held-out frames after projection onto the first 64 principal components of the
    /// training frames, where a lack of fine detail does not count.
    pub principal: SetQuality,
    /// Held-out frames against each other after this projection.
    pub principal_held_out: SetQuality,
    /// Frames of training captures against held-out frames after this projection.
    pub principal_training: Option<SetQuality>,
    /// Mean distance between samples of an outfit in one pose, by outfit.
    pub diversity_mm: Vec<(Outfit, f64)>,
    /// Mean distance between held-out frames of an outfit in any pose, by outfit.
    pub held_out_diversity_mm: Vec<(Outfit, f64)>,
    /// Mean change of the canonical displacement per radian of one joint at a fixed code,
    /// millimetres.
    pub pose_sensitivity_mm: f64,
    /// Transfer of clothing between poses of a capture, beside the true change; `None` if captures are
    /// unknown or have one frame each.
    pub pose_transfer: Option<PoseTransfer>,
    /// Share of samples that the outfit classifier assigns to the requested outfit.
    pub outfit_consistency: f64,
    /// Share of held-out frames that the outfit classifier assigns to their outfit.
    pub classifier_accuracy: f64,
    /// Share of clothing vertices inside the body in the canonical pose, of samples and of held-out
    /// frames.
    pub inside_body: [f64; 2],
}

/// Number of pose changes of the pose sensitivity.
const NUDGES: usize = 64;
/// Rotation of a pose change, radians.
const NUDGE: f64 = 0.1;
/// Joints of the pose sensitivity: all but root, wrists and hands.
const MOVING: std::ops::Range<usize> = 1..20;

/// Measures samples of a run against the test frames of the packed set in `data`. `codes` draws `n`
/// latent codes for an outfit, `[n, latent]`; its last argument is the stream of random numbers.
pub fn quality(
    run: &Run,
    data: impl AsRef<Path>,
    codes: &dyn Fn(Outfit, usize, u64) -> Array2<f32>,
    options: QualityOptions,
    progress: &mut ProgressFn,
) -> Result<QualityReport> {
    let data = data.as_ref();
    let set = run.open_set(data, Split::Test)?;
    let step = set.frames().div_ceil(options.frames.max(1)).max(1);
    let rows: Vec<usize> = (0..set.frames()).step_by(step).collect();
    let outfits: Vec<Outfit> = rows.iter().map(|&row| set.outfits()[row]).collect();
    let mut truth = Vec::with_capacity(rows.len());
    let mut poses = Vec::with_capacity(rows.len());
    for &row in &rows {
        truth.push(set.displacement_row(row)?.iter().map(|&x| x as f32).collect::<Vec<f32>>());
        poses.push(pose_of(&set, row)?);
    }
    let captures = HeldOutCaptures::of(&set, &rows);
    let mut drawn = Array2::zeros((rows.len(), run.config().model.latent));
    for (index, (&outfit, &capture)) in outfits.iter().zip(&captures.of).enumerate() {
        drawn.row_mut(index).assign(&codes(outfit, 1, capture as u64).row(0));
    }
    let worn = worn::training_clothing(run, data, &outfits, &captures.of, options.seed)?;
    let steps = 7;
    let samples = decoded(run, &drawn, &poses, &outfits)?;
    progress(1, steps);

    let clothing = run.clothing();
    let of_clothes = |rows: &[Vec<f32>]| -> Vec<Vec<[f32; 3]>> {
        let at = |row: &Vec<f32>, v: usize| [row[3 * v], row[3 * v + 1], row[3 * v + 2]];
        rows.iter().map(|row| clothing.iter().map(|&v| at(row, v)).collect()).collect()
    };
    let (truth_points, sample_points) = (of_clothes(&truth), of_clothes(&samples));
    let samples_quality = captures.compare(&truth_points, &sample_points);
    let held_out = captures.compare(&truth_points, &truth_points);
    let compare_worn = |worn: &Vec<Vec<f32>>| captures.compare(&truth_points, &of_clothes(worn));
    let training = worn.as_ref().map(compare_worn);
    progress(2, steps);

    let projection = PrincipalProjection::from_training(run, data, options.training_frames)?;
    let project = |rows: &[Vec<f32>]| Ok::<_, Error>(of_clothes(&projection.project(rows)?));
    let (true_principal, principal) = (project(&truth)?, project(&samples)?);
    let principal = captures.compare(&true_principal, &principal);
    let principal_held_out = captures.compare(&true_principal, &true_principal);
    let principal_training = match &worn {
        Some(worn) => Some(captures.compare(&true_principal, &project(worn)?)),
        None => None,
    };
    progress(3, steps);

    let classifier = OutfitCentroids::from_training(run, data, options.training_frames)?;
    let consistent = |points: &[Vec<[f32; 3]>]| {
        let right =
            points.iter().zip(&outfits).filter(|(p, o)| classifier.classify(p) == Some(**o));
        right.count() as f64 / points.len().max(1) as f64
    };
    let outfit_consistency = consistent(&sample_points);
    let classifier_accuracy = consistent(&truth_points);
    progress(4, steps);

    let mut diversity = Vec::new();
    for outfit in present(&outfits) {
        let index = outfits.iter().position(|&o| o == outfit).unwrap_or(0);
        let codes = codes(outfit, options.each, 1 << 32);
        let n = codes.nrows();
        let rows = decoded(run, &codes, &vec![poses[index]; n], &vec![outfit; n])?;
        diversity.push((outfit, sets::mean_distance(&of_clothes(&rows))));
    }
    progress(5, steps);
    let pose_sensitivity_mm = sensitivity(run, &drawn, &poses, &outfits, options.seed)?;
    progress(6, steps);
    let pose_transfer = PoseTransfer::measure(run, &set)?;
    progress(7, steps);
    let body = run.body().mesh();
    let inside = |rows: &[Vec<f32>]| inside::inside_share(rows, clothing, &body);
    Ok(QualityReport {
        frames: rows.len(),
        samples: samples_quality,
        held_out,
        training,
        principal,
        principal_held_out,
        principal_training,
        diversity_mm: diversity,
        held_out_diversity_mm: present(&outfits)
            .into_iter()
            .map(|outfit| {
                let own = truth_points.iter().zip(&outfits).filter(|(_, o)| **o == outfit);
                let own: Vec<_> = own.map(|(points, _)| points.clone()).collect();
                (outfit, sets::mean_distance(&own))
            })
            .collect(),
        pose_sensitivity_mm,
        pose_transfer,
        outfit_consistency,
        classifier_accuracy,
        inside_body: [inside(&samples)?, inside(&truth)?],
    })
}

fn pose_of(set: &PackedSet, row: usize) -> Result<[f32; 72]> {
    let pose = set.pose(row)?;
    <[f32; 72]>::try_from(pose.as_slice()).map_err(|_| {
        Error::data(format!("test frame {row}: pose of {} numbers, expected 72", pose.len()))
    })
}

fn present(outfits: &[Outfit]) -> BTreeSet<Outfit> {
    outfits.iter().copied().collect()
}

/// Displacements of latent codes `[n, latent]`, `[n][3 V]`, metres.
fn decoded(
    run: &Run,
    codes: &Array2<f32>,
    poses: &[[f32; 72]],
    outfits: &[Outfit],
) -> Result<Vec<Vec<f32>>> {
    let bodies: Vec<BodySpec> = poses
        .iter()
        .zip(outfits)
        .map(|(&pose, &outfit)| BodySpec { betas: Vec::new(), pose, outfit })
        .collect();
    let decoded = run.decode_displacements(codes, &bodies)?;
    Ok(decoded.axis_iter(Axis(0)).map(|frame| frame.iter().copied().collect()).collect())
}

/// Mean change of clothing vertices by a small rotation of one joint, millimetres per radian.
fn sensitivity(
    run: &Run,
    codes: &Array2<f32>,
    poses: &[[f32; 72]],
    outfits: &[Outfit],
    seed: u64,
) -> Result<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let count = NUDGES.min(poses.len());
    let chosen: Vec<usize> = (0..count).map(|i| i * poses.len() / count.max(1)).collect();
    let mut moved = Vec::with_capacity(count);
    for &index in &chosen {
        let joint = rng.random_range(MOVING);
        let axis: [f64; 3] = std::array::from_fn(|_| rng.sample(StandardNormal));
        let length = axis.iter().map(|x| x * x).sum::<f64>().sqrt().max(1e-9);
        let mut pose = poses[index];
        for (angle, along) in pose[3 * joint..3 * joint + 3].iter_mut().zip(axis) {
            *angle += (NUDGE * along / length) as f32;
        }
        moved.push(pose);
    }
    let codes = codes.select(Axis(0), &chosen);
    let outfits: Vec<Outfit> = chosen.iter().map(|&index| outfits[index]).collect();
    let before: Vec<[f32; 72]> = chosen.iter().map(|&index| poses[index]).collect();
    let [before, after] = [&before, &moved].map(|poses| decoded(run, &codes, poses, &outfits));
    let mut sum = 0.0;
    for (before, after) in before?.iter().zip(&after?) {
        for &vertex in run.clothing() {
            let at = 3 * vertex..3 * vertex + 3;
            let squares = before[at.clone()].iter().zip(&after[at]).map(|(a, b)| (a - b).powi(2));
            sum += f64::from(squares.sum::<f32>()).sqrt();
        }
    }
    Ok(1000.0 * sum / (NUDGE * (count * run.clothing().len()).max(1) as f64))
}

/// Sampler of latent codes from the standard normal prior, scaled by `temperature`, for
/// [`quality`].
pub fn standard_normal(
    latent: usize,
    temperature: f64,
    seed: u64,
) -> impl Fn(Outfit, usize, u64) -> Array2<f32> {
    move |outfit, n, call| {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(outfit.stream() << 48 | call);
        Array2::from_shape_simple_fn((n, latent), || {
            (temperature * rng.sample::<f64, _>(StandardNormal)) as f32
        })
    }
}
