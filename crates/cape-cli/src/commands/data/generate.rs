use std::{
    path::{Path, PathBuf},
    time::Instant,
};

use cape_core::{
    BodyPose, Mesh, Outfit,
    npy::{NpzWriter, write_npy},
    obj, ply,
};
use cape_infer::{BodySpec, Run, prior::Prior, write_json};
use cape_synth::{Motion, MotionStyle};
use clap::Args;
use ndarray::{Array2, Array3};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng, seq::IndexedRandom};
use rand_distr::StandardNormal;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::{
    console::Console,
    error::{Error, Result},
    files,
    motion_source::MotionFileArgs,
    options::{
        FileKind, GlobalArgs, ResumableOutputArgs, RunArgs, at_least_one, kinds, non_negative,
    },
    priors::{PriorArgs, load_prior},
};

/// Bodies that are decoded and written at a time.
const PART: usize = 64;
/// Number of shape coefficients that are sampled.
const SHAPES: usize = 10;
/// Length of a motion that poses are taken from, seconds.
const SECONDS: f64 = 4.0;
const PLAN: &str = "plan.json";
const INDEX: &str = "index.jsonl";

/// Generate dressed bodies in bulk, as training data.
///
/// Samples shape, pose, outfit and latent code of every body. Writes meshes and index.jsonl, a line of
/// parameters for each. A body depends on the seed and its number only. Run the same command again to
/// resume.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  cape data generate runs/cape --n 5000 --out bodies\n  cape data generate \
                        runs/cape --n 200 --poses amass.npz --prior gmm --format ply --out meshes"
)]
pub(crate) struct GenerateArgs {
    #[command(flatten)]
    run: RunArgs,
    #[command(flatten)]
    output: ResumableOutputArgs,
    /// Number of bodies.
    #[arg(long, short, default_value_t = 1000, value_name = "N", value_parser = at_least_one)]
    n: usize,
    /// File of poses to choose from [default: synthetic motions].
    #[arg(long, value_name = "FILE")]
    poses: Option<String>,
    #[command(flatten)]
    reading: MotionFileArgs,
    /// Outfits of the run to choose from [default: all].
    #[arg(long, value_delimiter = ',', value_name = "OUTFIT,…")]
    outfit: Vec<Outfit>,
    /// Standard deviation of the ten shape coefficients.
    #[arg(long, default_value_t = 1.0, value_name = "S", value_parser = non_negative)]
    shape_deviation: f64,
    #[command(flatten)]
    drawn: PriorArgs,
    /// File format: npz holds 64 bodies as `vertices` [n, vertices, 3], others one body.
    #[arg(long, default_value = "npz", value_name = "FORMAT", value_parser = kinds([FileKind::Npz, FileKind::Ply, FileKind::Obj]))]
    format: FileKind,
}

/// Settings that an output directory belongs to.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct GenerationPlan {
    checkpoint_step: u64,
    poses: Option<String>,
    outfits: Vec<Outfit>,
    shape_deviation: f32,
    prior: String,
    temperature: f64,
    format: FileKind,
    seed: u64,
}

/// A line of index.jsonl.
#[derive(Debug, Serialize)]
struct IndexLine {
    file: String,
    /// Row in the file.
    row: usize,
    outfit: Outfit,
    betas: Vec<f32>,
    pose: Vec<f32>,
    code: Vec<f32>,
    seed: u64,
    sample: usize,
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    bodies: usize,
    made_now: usize,
    bodies_per_second: f64,
}

impl GenerateArgs {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        let temperature = self.drawn.temperature()?;
        let poses: Vec<BodyPose> = match &self.poses {
            Some(text) => self.reading.poses(text, console)?.upright_poses()?,
            None => Vec::new(),
        };
        let run = self.run.open(global)?;
        let outfits = match &self.outfit[..] {
            [] => run.outfits().to_vec(),
            chosen => chosen.to_vec(),
        };
        outfits.iter().try_for_each(|&outfit| run.outfits().require(outfit).map(drop))?;
        let plan = GenerationPlan {
            checkpoint_step: run.progress().step,
            poses: self.poses.clone(),
            outfits: outfits.clone(),
            shape_deviation: self.shape_deviation as f32,
            prior: self.drawn.name(&run).name().to_owned(),
            temperature,
            format: self.format,
            seed: global.seed(),
        };
        self.begin(&plan, &run)?;
        let prior = load_prior(&run, self.drawn.name(&run), console)?;
        let dice = BodySampler { plan: &plan, run: &run, poses: &poses, prior: prior.as_ref() };

        let (start, mut made) = (Instant::now(), 0);
        let mut index = Vec::with_capacity(self.n);
        console.while_showing("generate", "bodies", |progress| {
            for first in (0..self.n).step_by(PART) {
                let count = PART.min(self.n - first);
                let drawn: Vec<(BodySpec, Vec<f32>)> =
                    (first..first + count).map(|sample| dice.draw(sample)).collect();
                let lines = self.lines(first, &drawn, plan.seed);
                if !lines.iter().all(|line| self.is_there(line, count, run.body().vertices())) {
                    let (wearers, codes): (Vec<BodySpec>, Vec<Vec<f32>>) =
                        drawn.into_iter().unzip();
                    let codes =
                        Array2::from_shape_vec((count, run.config().model.latent), codes.concat())
                            .map_err(|error| Error::message(error.to_string()))?;
                    self.write(&run.dress(&codes, &wearers)?, &lines)?;
                    made += count;
                }
                index.extend(lines);
                progress(first + count, self.n);
            }
            Ok::<_, Error>(())
        })?;
        files::write_json_lines(&self.output.out.join(INDEX), &index)?;
        let report = Report {
            bodies: self.n,
            made_now: made,
            bodies_per_second: made as f64 / start.elapsed().as_secs_f64(),
            out: self.output.out,
        };
        console.result(&report, || {
            format!(
                "{} bodies, {} of them new, {:.0} per second\n{}",
                report.bodies,
                report.made_now,
                report.bodies_per_second,
                report.out.join(INDEX).display()
            )
        })
    }

    /// Creates the directory, or checks that it belongs to the same settings.
    fn begin(&self, plan: &GenerationPlan, run: &Run) -> Result {
        let out = &self.output.out;
        let path = out.join(PLAN);
        if path.exists() {
            let text = std::fs::read(&path).map_err(|error| Error::io(&path, error))?;
            let there: GenerationPlan = serde_json::from_slice(&text)
                .map_err(|error| cape_core::Error::format(&path, error.to_string()))?;
            if there != *plan {
                return Err(Error::message(format!(
                    "{}: holds bodies of other settings: choose another --out",
                    out.display()
                )));
            }
            return Ok(());
        }
        files::require_empty(out)?;
        files::create_dir(out)?;
        let faces: Vec<i64> = run.body().faces.as_flattened().iter().map(|&i| i.into()).collect();
        let faces = Array2::from_shape_vec((run.body().faces.len(), 3), faces)
            .map_err(|error| Error::message(error.to_string()))?;
        write_npy(out.join("faces.npy"), &faces)?;
        Ok(write_json(&path, plan)?)
    }

    /// True if the file of a body exists with all its `count` bodies.
    fn is_there(&self, line: &IndexLine, count: usize, vertices: usize) -> bool {
        let least = match self.format {
            FileKind::Npz => (count * vertices * 3 * size_of::<f32>()) as u64,
            _ => 0,
        };
        std::fs::metadata(self.output.out.join(&line.file)).is_ok_and(|file| file.len() >= least)
    }

    fn lines(&self, first: usize, drawn: &[(BodySpec, Vec<f32>)], seed: u64) -> Vec<IndexLine> {
        let of = |(row, (wearer, code)): (usize, &(BodySpec, Vec<f32>))| {
            let sample = first + row;
            let (file, row) = match self.format {
                FileKind::Npz => (format!("bodies-{:06}.npz", first / PART), row),
                kind => (format!("body-{sample:06}.{}", kind.name()), 0),
            };
            IndexLine {
                file,
                row,
                outfit: wearer.outfit,
                betas: wearer.betas.clone(),
                pose: wearer.pose.to_vec(),
                code: code.clone(),
                seed,
                sample,
            }
        };
        drawn.iter().enumerate().map(of).collect()
    }

    fn write(&self, meshes: &[Mesh], lines: &[IndexLine]) -> Result {
        let path = |line: &IndexLine| self.output.out.join(&line.file);
        match self.format {
            FileKind::Npz => match lines.first() {
                Some(line) => write_part(&path(line), meshes),
                None => Ok(()),
            },
            FileKind::Ply => meshes
                .par_iter()
                .zip(lines)
                .try_for_each(|(mesh, line)| Ok(ply::write(path(line), mesh, None)?)),
            _ => meshes
                .par_iter()
                .zip(lines)
                .try_for_each(|(mesh, line)| Ok(obj::write(path(line), mesh, None)?)),
        }
    }
}

fn write_part(path: &Path, meshes: &[Mesh]) -> Result {
    let vertices = meshes.first().map_or(0, |mesh| mesh.vertices.len());
    let values: Vec<f32> =
        meshes.iter().flat_map(|mesh| mesh.vertices.as_flattened()).copied().collect();
    let values = Array3::from_shape_vec((meshes.len(), vertices, 3), values)
        .map_err(|error| Error::message(error.to_string()))?;
    let mut archive = NpzWriter::create(path)?;
    archive.add("vertices", &values)?;
    Ok(archive.finish()?)
}

/// Draws bodies, each from its own stream of random numbers.
struct BodySampler<'a> {
    plan: &'a GenerationPlan,
    run: &'a Run,
    poses: &'a [BodyPose],
    prior: Option<&'a Prior>,
}

impl BodySampler<'_> {
    fn draw(&self, sample: usize) -> (BodySpec, Vec<f32>) {
        let GenerationPlan { seed, temperature, shape_deviation, outfits, .. } = self.plan;
        let mut rng = ChaCha8Rng::seed_from_u64(*seed);
        rng.set_stream(sample as u64 + 1);
        let outfit = outfits.choose(&mut rng).copied().unwrap_or(self.run.default_outfit());
        let normal = |rng: &mut ChaCha8Rng| rng.sample::<f32, _>(StandardNormal);
        let shapes = self.run.body().betas().min(SHAPES);
        let betas = (0..shapes).map(|_| shape_deviation * normal(&mut rng)).collect();
        let pose = match self.poses.choose(&mut rng) {
            Some(pose) => *pose,
            None => moment(&mut rng),
        };
        let code_seed = rng.random();
        let code = match self.prior {
            Some(prior) => prior.sample(outfit, 1, *temperature, code_seed),
            None => self.run.sample_codes(1, code_seed) * *temperature as f32,
        };
        (BodySpec { betas, pose, outfit }, code.row(0).to_vec())
    }
}

fn moment(rng: &mut ChaCha8Rng) -> BodyPose {
    let style = MotionStyle::random(rng);
    let motion = Motion::CAPTURED[rng.random_range(0..Motion::CAPTURED.len())];
    motion.pose(&style, rng.random_range(0.0..SECONDS)).map(|angle| angle as f32)
}
