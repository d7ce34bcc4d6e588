mod pictures;
mod report;
mod store;

use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
};

use cape_data::{PackedSet, Split};
use cape_fit::benchmark::{Benchmark, BenchmarkCase, BenchmarkOptions, FRAMES};
use cape_infer::write_json;
use clap::Args;
use ndarray::Array2;

use super::method::FitMethodArgs;
use crate::{
    console::Console,
    error::{Context, Error, Result},
    exit_code::ExitCode,
    interrupt::Interrupt,
    options::{DataArgs, GlobalArgs, RunArgs, StoreArgs, at_least_one, non_negative, share},
    registration::read_shape,
};
use report::Report;
use store::{CaseStore, FrameInputs};

/// Benchmark image fitting against SMPLify on held-out frames (section 6.3 of the paper).
///
/// Renders held-out clothing on bodies of random shape and fits them from silhouette, keypoints and
/// outfit, by SMPLify and with CAPE. Writes results.json and errors.png and, for the best, median and
/// worst fit, fits.png and input files for `cape fit image`. Run the same command again to resume.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  cape fit benchmark image runs/cape --out fits\n  cape fit benchmark \
                        image runs/cape --noise 3 --dropped 0.1 --ragged 0.3 --out noisy"
)]
pub(crate) struct FitBenchmarkArgs {
    #[command(flatten)]
    run: RunArgs,
    #[command(flatten)]
    data: DataArgs,
    #[command(flatten)]
    output: StoreArgs,
    /// Number of held-out frames, the same for each outfit, evenly spaced.
    #[arg(long, default_value_t = FRAMES, value_name = "N", value_parser = at_least_one)]
    frames: usize,
    /// Take frames that the benchmark of 120 frames does not, to choose weights on.
    #[arg(long)]
    tuning: bool,
    /// Directory of the subjects' minimal shapes, minimal_body_shape of the raw data [default: bodies of
    /// random shape].
    #[arg(long, value_name = "DIR")]
    bodies: Option<PathBuf>,
    /// Side of the images in pixels.
    #[arg(long, default_value_t = 512, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(64..=2048))]
    size: u32,
    /// Standard deviation of keypoint noise in pixels.
    #[arg(long, default_value_t = 0.0, value_name = "PIXELS", value_parser = non_negative)]
    noise: f64,
    /// Distance of the detector's hips and neck from the body's joints in millimetres: hips outwards and
    /// upwards, neck downwards.
    #[arg(long, default_value_t = 0.0, value_name = "MM", value_parser = non_negative)]
    bias: f64,
    /// Share of missing keypoints.
    #[arg(long, default_value_t = 0.0, value_name = "SHARE", value_parser = share)]
    dropped: f64,
    /// Share of flipped pixels along the silhouette's edge.
    #[arg(long, default_value_t = 0.0, value_name = "SHARE", value_parser = share)]
    ragged: f64,
    #[command(flatten)]
    method: FitMethodArgs,
}

impl FitBenchmarkArgs {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result<ExitCode> {
        let options = self.options(global);
        let config = self.method.config()?;
        let run = self.run.open(global)?;
        let data = self.data.of(&run)?;
        let set = run.open_set(&data, Split::Test)?;
        let smplify = self.method.smplify(run.body(), &config)?;
        let vertices = run.body().vertices();
        let read = |directory: &PathBuf| SubjectShapes::read(directory, &set, vertices);
        let bodies = self.bodies.as_ref().map(read).transpose()?;
        let inputs = FrameInputs {
            run: &run,
            data: &data,
            pose_prior: self.method.pose_prior.as_deref(),
            bodies: bodies.as_ref(),
            options,
            config: &config,
        };
        let mut benchmark = Benchmark::new(&run, &set, &smplify, &config.clothed, options)?;
        if let Some(SubjectShapes { shapes, .. }) = &bodies {
            benchmark = benchmark.with_shapes(shapes.clone())?;
        }
        let frames = benchmark.frames();
        if frames.is_empty() {
            return Err(Error::message(format!(
                "{}: no test frames{}",
                data.display(),
                if options.tuning { " beside those of the benchmark" } else { "" }
            )));
        }
        let store = CaseStore::open(&self.output.out, &inputs, self.output.overwrite)?;
        let interrupt = Interrupt::listen(console)?;
        let workers = super::image::fit_workers(&run)?;
        let mut done = 0;
        let cases = console.while_showing("fit", "images", |progress| {
            let case = |_, &frame: &usize| {
                if interrupt.was_asked() {
                    return Ok(None);
                }
                if let Some(case) = store.case(frame)? {
                    return Ok(Some(case));
                }
                let found = benchmark.case(frame);
                store.keep(&found.doing(|| format!("fitting frame {frame}"))?).map(Some)
            };
            workers.map(&frames, case, &mut || {
                done += 1;
                progress(done, frames.len());
            })
        });
        let cases = cases.into_iter().collect::<Result<Option<Vec<BenchmarkCase>>>>()?;
        let Some(cases) = cases else {
            console.note("interrupted and saved: run the same command again to resume");
            return Ok(ExitCode::INTERRUPTED);
        };
        let out = self.output.out;
        let chosen = pictures::chosen(&cases);
        for (name, case) in &chosen {
            for file in ["keypoints.json", "mask.png", "image.png"] {
                store.files().claim(&format!("{name}/{file}"))?;
            }
            pictures::inputs(&benchmark, &out.join(name), case)?;
        }
        pictures::sheet(&benchmark, &chosen)?.save(store.files().claim("fits.png")?)?;
        pictures::errors(&cases)?.save(store.files().claim("errors.png")?)?;
        let results = store.files().claim("results.json")?;
        let report = Report::new(out, options, cases)?;
        write_json(&results, &report)?;
        console.result(&report, || report.text())?;
        Ok(ExitCode::SUCCESS)
    }

    fn options(&self, global: &GlobalArgs) -> BenchmarkOptions {
        BenchmarkOptions {
            frames: self.frames,
            tuning: self.tuning,
            side: self.size,
            noise: self.noise,
            bias: self.bias / 1000.0,
            dropped: self.dropped,
            ragged: self.ragged,
            seed: global.seed(),
        }
    }
}

/// Minimal shapes of a set's subjects.
#[derive(Debug)]
struct SubjectShapes {
    directory: PathBuf,
    /// Their files in the directory.
    files: Vec<String>,
    /// By name, metres, `[V, 3]`.
    shapes: BTreeMap<String, Array2<f64>>,
}

impl SubjectShapes {
    /// Reads those of a directory in the layout of minimal_body_shape.
    fn read(directory: &Path, set: &PackedSet, vertices: usize) -> Result<Self> {
        let subjects: BTreeSet<&String> =
            set.origins().unwrap_or_default().iter().map(|origin| &origin.subject).collect();
        let file = |subject: &String| format!("{subject}/{subject}_minimal.npy");
        let shape = |&subject: &&String| {
            Ok((subject.clone(), read_shape(&directory.join(file(subject)), vertices)?))
        };
        Ok(Self {
            directory: directory.to_owned(),
            files: subjects.iter().map(|subject| file(subject)).collect(),
            shapes: subjects.iter().map(shape).collect::<Result<_>>()?,
        })
    }
}
