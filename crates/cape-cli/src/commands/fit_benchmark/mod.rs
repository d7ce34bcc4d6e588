mod pictures;
mod report;
mod store;

use std::{path::PathBuf, process::ExitCode};

use cape_core::parse_device;
use cape_data::{PackedSet, Split};
use cape_fit::benchmark::{Benchmark, BenchmarkCase, BenchmarkOptions};
use cape_infer::{Run, write_json};
use clap::Args;

use crate::{
    arguments::{GlobalArgs, at_least_one},
    console::Console,
    error::{Context, Error, Result},
    fitting::FitMethodArgs,
    interrupt::Interrupt,
};
use report::Report;
use store::{CaseStore, FrameInputs};

/// Exit code of an interrupted benchmark: 128 + SIGINT.
const INTERRUPTED: u8 = 130;

/// Measure how well clothed bodies are found again from images (tables 3 and 4 of the paper).
///
/// Held-out clothes on bodies of random shape are drawn; from silhouette, keypoints and outfit alone
/// they are fitted, by SMPLify and by CAPE. Writes results.json, errors.png, and of the best, the
/// median and the worst fits.png and what `cape fit` can be tried on. Finished frames are kept in
/// frames/: run the same command again to resume.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  cape fit-benchmark run --out fits\n  cape fit-benchmark run \
                        --noise 3 --dropped 0.1 --ragged 0.3 --out noisy")]
pub(crate) struct FitBenchmarkArgs {
    /// A training run.
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// Packed set with the held-out frames; by default the run's own.
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Directory to write, or to go on with.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Held-out frames, as many of each outfit, evenly spaced.
    #[arg(long, default_value_t = 120, value_name = "N", value_parser = at_least_one)]
    frames: usize,
    /// Side of the images, pixels.
    #[arg(long, default_value_t = 512, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(64..=2048))]
    size: u32,
    /// Standard deviation of keypoints, pixels.
    #[arg(long, default_value_t = 0.0, value_name = "PIXELS")]
    noise: f64,
    /// Share of joints that are missed, 0 to 1.
    #[arg(long, default_value_t = 0.0, value_name = "SHARE")]
    dropped: f64,
    /// Share of pixels beside the silhouette's edge that are on the wrong side, 0 to 1.
    #[arg(long, default_value_t = 0.0, value_name = "SHARE")]
    ragged: f64,
    /// Discard results of other settings, inputs or versions in --out and compute them afresh;
    /// matching results are kept.
    #[arg(long)]
    overwrite: bool,
    #[command(flatten)]
    method: FitMethodArgs,
}

impl FitBenchmarkArgs {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result<ExitCode> {
        let device = parse_device(&global.device)?;
        let options = self.options(global)?;
        let config = self.method.config()?;
        let run = Run::open(&self.run, &device)?;
        let data = match &self.data {
            Some(data) => data.clone(),
            None => run.data()?,
        };
        let set = PackedSet::open(&data, Split::Test)?;
        let smplify = self.method.smplify(run.body(), &config)?;
        let inputs = FrameInputs {
            run: &run,
            data: &data,
            pose_prior: self.method.pose_prior.as_deref(),
            options,
            config: &config,
        };
        let store = CaseStore::open(&self.out, &inputs, self.overwrite)?;
        let interrupt = Interrupt::listen(console)?;
        let benchmark = Benchmark::new(&run, &set, &smplify, &config.clothed, options)?;
        let frames = benchmark.frames();
        let mut cases: Vec<BenchmarkCase> = Vec::with_capacity(frames.len());
        let whole = console.while_showing("fit", "images", |progress| {
            for &frame in &frames {
                if interrupt.was_asked() {
                    return Ok(false);
                }
                let case = if let Some(case) = store.case(frame)? {
                    case
                } else {
                    let found = benchmark.case(frame);
                    store.keep(&found.doing(|| format!("fitting frame {frame}"))?)?
                };
                cases.push(case);
                progress(cases.len(), frames.len());
            }
            Ok::<_, Error>(true)
        })?;
        if !whole {
            console.note(
                "interrupted; finished frames are saved, run the same command again to resume",
            );
            return Ok(ExitCode::from(INTERRUPTED));
        }
        let chosen = pictures::chosen(&cases);
        for (name, case) in &chosen {
            for file in ["keypoints.json", "mask.png", "image.png"] {
                store.files().claim(&format!("{name}/{file}"))?;
            }
            pictures::inputs(&benchmark, &self.out.join(name), case)?;
        }
        pictures::sheet(&benchmark, &chosen)?.save(store.files().claim("fits.png")?)?;
        pictures::errors(&cases)?.save(store.files().claim("errors.png")?)?;
        let results = store.files().claim("results.json")?;
        let report = Report::new(self.out, options, cases)?;
        write_json(&results, &report)?;
        console.result(&report, || report.text())?;
        Ok(ExitCode::SUCCESS)
    }

    fn options(&self, global: &GlobalArgs) -> Result<BenchmarkOptions> {
        let shares = [("--dropped", self.dropped), ("--ragged", self.ragged)];
        if let Some((name, share)) = shares.iter().find(|(_, s)| !(0.0..=1.0).contains(s)) {
            return Err(Error::message(format!("{name} {share}: expected 0 to 1")));
        }
        if !(self.noise.is_finite() && self.noise >= 0.0) {
            return Err(Error::message(format!("--noise {}: expected 0 or more", self.noise)));
        }
        Ok(BenchmarkOptions {
            frames: self.frames,
            side: self.size,
            noise: self.noise,
            dropped: self.dropped,
            ragged: self.ragged,
            seed: global.seed.unwrap_or(1),
        })
    }
}
