mod output;

use std::path::PathBuf;

use cape_core::{KeyframeRule, Outfit};
use cape_infer::{batches, write_json};
use clap::Args;
use ndarray::{Array1, Array3, Axis, concatenate};
use serde::Serialize;

use self::output::AnimationOutput;
use crate::{
    console::Console,
    error::{Error, Result},
    files,
    latent_sampler::LatentSampler,
    motion_source::{MotionFileArgs, shape_of},
    options::{
        FileKind, GlobalArgs, OutfitArgs, OutputArgs, RunArgs, ShapeArgs, at_least_one, kinds,
        positive,
    },
    priors::PriorArgs,
};

/// Frame rate of synthetic motions, frames per second.
const SYNTHETIC_RATE: f64 = 15.0;

/// Animate a dressed body by a motion with a fixed latent code.
///
/// Writes pictures and an animated PNG, a mesh per frame, or one animated file, and animation.json with
/// measures of smoothness. A motion file moves the body by its translations, at its frame rate, and gives
/// it its shape.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  cape animate runs/cape --motion squats --format png --out squats\n  cape \
                  animate runs/cape --motion amass.npz --outfit shortlong --format glb --out walking\n  \
                  cape animate runs/cape --motion amass.npz --fps 30 --format usda --every 5 --out stage"
)]
pub(crate) struct AnimateArgs {
    #[command(flatten)]
    run: RunArgs,
    #[command(flatten)]
    output: OutputArgs,
    /// Synthetic motion (walk, squats, …) or file of poses (AMASS, .smpl, results of pose estimators, …).
    #[arg(long, default_value = "walk", value_name = "MOTION")]
    motion: String,
    #[command(flatten)]
    reading: MotionFileArgs,
    /// Duration of a synthetic motion in seconds.
    #[arg(long, default_value_t = 2.0, value_name = "S", value_parser = positive)]
    seconds: f64,
    /// Frames per second; a file of another rate is resampled [default: those of the file; 15 for a
    /// synthetic motion].
    #[arg(long, value_name = "FPS", value_parser = positive)]
    fps: Option<f64>,
    #[command(flatten)]
    outfit: OutfitArgs,
    #[command(flatten)]
    shape: ShapeArgs,
    /// Latent code: mean, seed:N, frame:K, FILE.npy:ROW or samples.jsonl:ROW [default: sampled].
    #[arg(long, value_name = "CODE")]
    code: Option<String>,
    #[command(flatten)]
    drawn: PriorArgs,
    /// File format: png, obj and ply write each frame; glb and usda one file with skeleton and animation;
    /// pc2 and mdd a point cache beside animation.obj; smpl poses and mean displacements.
    #[arg(long, default_value = "png", value_name = "FORMAT", value_parser = kinds([FileKind::Png, FileKind::Glb, FileKind::Usda, FileKind::Pc2, FileKind::Mdd, FileKind::Smpl, FileKind::Obj, FileKind::Ply]))]
    format: FileKind,
    /// Largest error of a vertex in glb and usda, mm: as few frames as keep it are stored with their
    /// vertices.
    #[arg(long, default_value_t = 1.0, value_name = "MM", value_parser = positive)]
    tolerance: f64,
    /// Store the vertices of every N-th frame in glb and usda, whatever the error.
    #[arg(long, value_name = "N", value_parser = at_least_one, conflicts_with = "tolerance")]
    every: Option<usize>,
    /// Side of the pictures in pixels.
    #[arg(long, default_value_t = 512, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(16..=4096))]
    size: u32,
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    frames: usize,
    frames_per_second: f64,
    outfit: Outfit,
    betas: Vec<f32>,
    code: Vec<f32>,
    seed: u64,
    /// Mean speed of clothing vertices in canonical space, millimetres per second.
    speed: f64,
    /// Mean acceleration of them, metres per second squared; large if clothing flickers.
    acceleration: f64,
    /// Frames whose vertices glb and usda store.
    keyframes: Option<usize>,
    /// Largest distance of a vertex from where glb, usda and smpl put it, millimetres.
    error_mm: Option<f64>,
}

impl AnimateArgs {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        let rates = [self.fps, Some(SYNTHETIC_RATE)];
        let file = self.reading.motion(&self.motion, self.seconds, rates, console)?;
        self.output.require_empty()?;
        let run = self.run.open(global)?;
        let betas = shape_of(&file, &self.shape, run.body(), console)?;
        let double: Vec<f64> = betas.iter().map(|&beta| beta.into()).collect();
        let motion = file.motion_of(run.body(), &double, self.fps)?;
        let (seed, outfit) = (global.seed(), self.outfit.of(&run)?);
        let code = match &self.code {
            Some(name) => {
                let draw = LatentSampler { run: &run, drawn: self.drawn, outfit, console };
                Array1::from(draw.code(name)?).insert_axis(Axis(0))
            }
            None => self.drawn.codes(&run, &[outfit], 1, seed, console)?,
        };
        let output = AnimationOutput {
            run: &run,
            code: &code,
            betas: &betas,
            outfit: &outfit,
            motion: &motion,
            keyframes: match self.every {
                Some(step) => KeyframeRule::Every(step),
                None => KeyframeRule::Tolerance(self.tolerance / 1000.0),
            },
            format: self.format,
            size: self.size,
            gender: file.gender.as_deref(),
            out: &self.output.out,
            console,
        };
        output.check()?;
        files::create_dir(&self.output.out)?;
        let displacement = frames(&output)?;
        let written = output.write(&displacement)?;
        let [speed, acceleration] =
            cape_eval::clothing::smoothness(&displacement, run.clothing(), motion.frame_rate);
        let report = Report {
            frames: motion.frames(),
            frames_per_second: motion.frame_rate,
            outfit,
            betas,
            code: code.row(0).to_vec(),
            seed,
            speed,
            acceleration,
            keyframes: written.keyframes,
            error_mm: written.error.map(|metres| 1000.0 * metres),
            out: self.output.out,
        };
        write_json(&report.out.join("animation.json"), &report)?;
        console.result(&report, || report.text())
    }
}

/// Canonical displacements, `[frames, vertices, 3]`.
fn frames(output: &AnimationOutput) -> Result<Array3<f32>> {
    let frames = output.motion.frames();
    let mut parts = Vec::new();
    output.console.while_showing("decode", "frames", |progress| {
        for rows in batches(frames) {
            let done = rows.end;
            let bodies = output.bodies(rows);
            let codes = output.code.select(Axis(0), &vec![0; bodies.len()]);
            parts.push(output.run.decode_displacements(&codes, &bodies)?);
            progress(done, frames);
        }
        Ok::<_, Error>(())
    })?;
    let views: Vec<_> = parts.iter().map(|part| part.view()).collect();
    concatenate(Axis(0), &views).map_err(|error| Error::message(error.to_string()))
}

impl Report {
    fn text(&self) -> String {
        let stored = match (self.keyframes, self.error_mm) {
            (Some(count), Some(error)) => {
                format!("\n{count} keyframes with vertices, largest error {error:.2} mm")
            }
            (None, Some(error)) => {
                format!("\nmean displacements, off by {error:.1} mm in the worst frame and vertex")
            }
            _ => String::new(),
        };
        format!(
            "{} frames at {} per second of {} in {}{stored}\ncanonical clothing: mean speed {:.0} mm/s, \
             mean acceleration {:.2} m/s²",
            self.frames,
            (1000.0 * self.frames_per_second).round() / 1000.0,
            self.outfit,
            self.out.display(),
            self.speed,
            self.acceleration
        )
    }
}
