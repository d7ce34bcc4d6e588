mod outcome;
mod pictures;

use std::{
    fs,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use burn::tensor::Device;
use cape_core::{Outfit, obj, silent, smpl::Gender};
use cape_data::{PackOptions, Split, SplitSpec, pack};
use cape_eval::{EvalOptions, EvalReport, PosteriorUse, evaluate};
use cape_infer::{
    BodySpec, MIXTURE, Run, RunConfig, RunPaths, TrainConfig,
    prior::{DensityKind, Prior, PriorOptions},
    write_json,
};
use cape_model::{CapeConfig, LossConfig};
use cape_synth::{self, poses};
use cape_train::{TrainEvent, TrainOutcome, Trainer, TrainerOptions};
use clap::Args;

use crate::{
    commands::data::synth::split_of,
    console::Console,
    dressed_mesh::{DressedMesh, dress, unclothed_meshes},
    error::{Context, Error, Result},
    files,
    options::{GlobalArgs, positive},
    training,
};
use outcome::{Report, Stage};
use pictures::LossCurves;

/// Training frames that the prior is fitted to.
const CODE_FRAMES: usize = 256;
/// Temperature of the samples.
const TEMPERATURE: f64 = 0.5;
/// Share of the time for training; the rest is for evaluation and pictures.
const TRAINING_SHARE: f64 = 0.8;
/// File that marks a directory of a demo, which the next demo may replace.
const MARKER: &str = ".cape-demo";
const FILES: [&str; 4] = [MARKER, "demo.json", "loss.png", "contact_sheet.png"];
const DIRECTORIES: [&str; 3] = ["raw", "packed", "run"];
/// Name of the bare body's file.
const BARE: &str = "bare";

/// Create data, train, evaluate and sample in about four minutes.
///
/// Packs synthetic captures, trains a narrow model on them, evaluates it on held-out motions and samples
/// dressed bodies. Writes the run, meshes, loss.png and contact_sheet.png.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  cape demo --out demo --minutes 5")]
pub(crate) struct DemoArgs {
    /// Directory to write; an earlier demo in it is replaced.
    #[arg(long, default_value = "demo", value_name = "DIR")]
    out: PathBuf,
    /// Approximate time limit in minutes.
    #[arg(long, default_value_t = 5.0, value_name = "M", value_parser = positive)]
    minutes: f64,
}

/// State of the demo.
struct DemoContext {
    out: PathBuf,
    seed: u64,
    device: Device,
    console: Console,
    stages: Vec<Stage>,
}

impl DemoArgs {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        let start = Instant::now();
        let device = global.device()?;
        prepare(&self.out)?;
        let mut setting =
            DemoContext { out: self.out, seed: global.seed(), device, console, stages: Vec::new() };
        let deadline = start + Duration::from_secs_f64(60.0 * self.minutes * TRAINING_SHARE);
        setting.data()?;
        let (outcome, losses) = setting.train(deadline)?;
        let run = Run::open(setting.path("run"), &setting.device)?;
        let evaluation = setting.evaluate(&run)?;
        setting.pictures(&run, &losses)?;
        let report = Report {
            finished: outcome.finished,
            seconds: start.elapsed().as_secs_f64(),
            stages: setting.stages,
            training: outcome,
            evaluation,
            out: setting.out,
        };
        write_json(&report.out.join("demo.json"), &report)?;
        console.result(&report, || report.text())
    }
}

/// Synthetic captures and their split.
pub(crate) fn captures(
    subjects: usize,
    frames: usize,
    seed: u64,
) -> (cape_synth::SynthSpec, SplitSpec) {
    let spec = cape_synth::SynthSpec {
        subjects,
        frames_per_sequence: frames,
        seed,
        frame_rate: 1.5,
        ..cape_synth::SynthSpec::default()
    };
    // Many short sequences, none of which is cut: clothing varies more between sequences.
    let split = SplitSpec { cut: 0, ..split_of(&spec) };
    (spec, split)
}

/// Configuration of a training of a few minutes.
pub(crate) fn recipe(seed: u64) -> RunConfig {
    RunConfig {
        model: CapeConfig::narrow(),
        // Few steps: a low weight of the KL term keeps the code in use, and small batches give more steps.
        loss: LossConfig { kl: 1e-5, gan: 0.02, ..LossConfig::default() },
        train: TrainConfig {
            epochs: 8,
            batch: 2,
            seed,
            peak_rate: 0.03,
            warmup_epochs: 0.3,
            decay: 0.7,
            keep: 1,
            preload: true,
            ..TrainConfig::default()
        },
        ..RunConfig::default()
    }
}

/// Removes the files of an earlier demo; other files in the directory are an error.
fn prepare(out: &Path) -> Result {
    if out.join(MARKER).exists() {
        let meshes = Outfit::PAPER.iter().map(Outfit::name).chain([BARE]);
        let meshes = meshes.map(|name| format!("{name}.obj"));
        for name in FILES.iter().map(ToString::to_string).chain(meshes) {
            let path = out.join(name);
            if path.exists() {
                fs::remove_file(&path).map_err(|error| Error::io(&path, error))?;
            }
        }
        for path in DIRECTORIES.map(|name| out.join(name)) {
            if path.exists() {
                fs::remove_dir_all(&path).map_err(|error| Error::io(&path, error))?;
            }
        }
    }
    files::require_empty(out)?;
    files::create_dir(out)?;
    files::write_text(&out.join(MARKER), "Written by `cape demo`, which may replace it.\n")
}

impl DemoContext {
    fn path(&self, name: &str) -> PathBuf {
        self.out.join(name)
    }

    /// Runs a stage of the demo and records its time.
    fn stage<T>(
        &mut self,
        name: &'static str,
        what: &str,
        work: impl FnOnce(&Self) -> Result<T>,
    ) -> Result<T> {
        self.console.note(&format!("{name}: {what}"));
        let start = Instant::now();
        let result = work(self).doing(|| format!("demo: {name}"))?;
        self.stages.push(Stage { name, seconds: start.elapsed().as_secs_f64() });
        Ok(result)
    }

    /// Synthetic captures, packed.
    fn data(&mut self) -> Result {
        let raw = self.path("raw");
        let (spec, split) = captures(8, 2, self.seed);
        self.stage("synth", "8 subjects in 4 outfits, 15 motions", |this| {
            let body = cape_synth::embedded_body(Gender::Neutral)?;
            let synth = cape_synth::CaptureGenerator::new(&body, spec)?;
            let write = |progress: &mut dyn FnMut(usize, usize)| synth.write(&raw, progress);
            Ok(this.console.while_showing("synth", "frames", write)?)
        })?;
        self.stage("pack", "displacements, poses, labels and statistics", |this| {
            let packed = this.path("packed");
            this.console.while_showing("pack", "frames", |progress| {
                pack(
                    &raw,
                    &packed,
                    &split,
                    PackOptions { strict: true, ..PackOptions::default() },
                    progress,
                )
            })?;
            fs::remove_dir_all(&raw).map_err(|error| Error::io(&raw, error))
        })
    }

    fn train(&mut self, deadline: Instant) -> Result<(TrainOutcome, LossCurves)> {
        let config = recipe(self.seed);
        self.stage("train", "narrow model", |this| {
            let (run, packed) = (this.path("run"), this.path("packed"));
            let options = TrainerOptions::new(packed, config);
            let mut trainer = Trainer::create(&run, options, &this.device)?;
            let mut losses = LossCurves::default();
            let outcome = training::run(&mut trainer, this.console, None, |event| {
                losses.on_event(event);
                matches!(event, TrainEvent::Step { .. }) && Instant::now() >= deadline
            })?;
            if !outcome.finished {
                this.console.note("time limit reached: continuing with the trained model");
            }
            Ok((outcome, losses))
        })
    }

    fn evaluate(&mut self, run: &Run) -> Result<EvalReport> {
        let seed = self.seed;
        self.stage("evaluate", "held-out motions", |this| {
            let options = EvalOptions { posterior: PosteriorUse::Mean, seed, batch: 16 };
            let report = this.console.while_showing("evaluate", "frames", |progress| {
                evaluate(run, this.path("packed"), options, progress)
            })?;
            write_json(&RunPaths::new(&this.path("run")).evaluation(), &report)?;
            Ok(report)
        })
    }

    /// Meshes of the bare body and of the four outfits, and the pictures.
    fn pictures(&mut self, run: &Run, losses: &LossCurves) -> Result {
        self.stage("sample", "meshes and pictures of 4 outfits", |this| {
            // A training that its time ended has no prior yet.
            let prior = if let Some(prior) = run.prior()? {
                prior
            } else {
                let set = run.open_set(this.path("packed"), Split::Train)?;
                let options = PriorOptions {
                    kind: DensityKind::Mixture(1),
                    frames: CODE_FRAMES,
                    ..PriorOptions::default()
                };
                let prior = Prior::of_run(run, &set, &options, &mut silent)?;
                prior.save(RunPaths::new(&this.path("run")).prior(MIXTURE))?;
                prior
            };
            let codes = prior.sample_each(run.outfits(), TEMPERATURE, this.seed)?;
            let mut rows = Vec::new();
            for (row, &(name, view)) in pictures::POSES.iter().enumerate() {
                let pose = poses::preset(name).ok_or_else(|| {
                    Error::message(format!("internal error: unknown pose `{name}`"))
                })?;
                let wearers =
                    Outfit::PAPER.map(|outfit| BodySpec { betas: Vec::new(), pose, outfit });
                let mut bodies = unclothed_meshes(run, &wearers[..1])?;
                dress(run, &codes, &wearers, |_, dressed| {
                    bodies.push(dressed);
                    Ok(())
                })?;
                if row == 0 {
                    this.meshes(&bodies)?;
                }
                rows.push((view, bodies));
            }
            pictures::contact_sheet(&rows)?.save(this.path("contact_sheet.png"))?;
            losses.plot()?.save(this.path("loss.png"))?;
            Ok(())
        })
    }

    fn meshes(&self, bodies: &[DressedMesh]) -> Result {
        let names = [BARE].into_iter().chain(Outfit::PAPER.iter().map(Outfit::name));
        for (name, body) in names.zip(bodies) {
            obj::write(self.path(&format!("{name}.obj")), &body.mesh, None)?;
        }
        Ok(())
    }
}
