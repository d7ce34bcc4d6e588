use std::path::{Path, PathBuf};

use cape_core::parse_device;
use cape_data::{PackedSet, Split};
use cape_eval::store::{ResultStore, StoreOptions, StoreSettings};
use cape_fit::scan::{
    ScanConfig,
    benchmark::{ScanBenchmark, ScanBenchmarkOptions, ScanCase, ScanError, ScanTrial},
};
use cape_infer::{Run, write_json};
use clap::Args;
use serde::Serialize;
use serde_json::json;

use crate::{
    arguments::{GlobalArgs, at_least_one},
    console::Console,
    error::{Error, Result},
    table::Table,
};

/// Measure how well clothed bodies are found again from scans with noise and holes.
///
/// Points of held-out clothes on bodies of random shape are fitted, the outfit being known, at
/// every level of noise and of holes. Writes benchmark.json. Finished scans are kept in scans/: run
/// the same command again to resume. `cape fit-benchmark RUN --scans` is the
/// same.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  cape scan-benchmark run --frames 8 --noise 0,2,5 --holes 0,0.2 \
                        --out scans"
)]
pub(crate) struct ScanBenchmarkArgs {
    /// A training run.
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// How `cape fit-benchmark` asks for this.
    #[arg(long, hide = true)]
    scans: bool,
    /// Packed set with the held-out frames; by default the run's own.
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Directory to write, or to resume in.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Held-out frames, evenly spaced.
    #[arg(long, default_value_t = 8, value_name = "N", value_parser = at_least_one)]
    frames: usize,
    /// Points of a scan without holes.
    #[arg(long, default_value_t = 20_000, value_name = "N", value_parser = at_least_one)]
    points: usize,
    /// Standard deviations of the points' coordinates, millimetres.
    #[arg(long, default_value = "0,2,5", value_delimiter = ',', value_name = "MM,…")]
    noise: Vec<f64>,
    /// Shares of the surface that are missing, 0 to 0.9.
    #[arg(long, default_value = "0,0.2", value_delimiter = ',', value_name = "SHARE,…")]
    holes: Vec<f64>,
    /// Discard results of other settings, inputs or versions in --out and compute them afresh;
    /// matching results are kept.
    #[arg(long)]
    overwrite: bool,
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    frames: usize,
    levels: Vec<NoiseLevel>,
    cases: Vec<ScanCase>,
}

/// Means over the scans of one level.
#[derive(Debug, Serialize)]
struct NoiseLevel {
    noise_mm: f64,
    hole: f64,
    error: ScanError,
    /// Fits that say that they cannot be trusted.
    failed: usize,
}

impl ScanBenchmarkArgs {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        let device = parse_device(&global.device)?;
        if let Some(hole) = self.holes.iter().find(|hole| !(0.0..=0.9).contains(*hole)) {
            return Err(Error::message(format!("--holes {hole}: expected 0 to 0.9")));
        }
        if let Some(noise) = self.noise.iter().find(|noise| !(0.0..=100.0).contains(*noise)) {
            return Err(Error::message(format!("--noise {noise}: expected 0 to 100")));
        }
        let run = Run::open(&self.run, &device)?;
        let data = match &self.data {
            Some(data) => data.clone(),
            None => run.data()?,
        };
        let set = PackedSet::open(&data, Split::Test)?;
        let options = ScanBenchmarkOptions {
            frames: self.frames,
            points: self.points,
            noises: self.noise.iter().map(|mm| mm / 1000.0).collect(),
            holes: self.holes.clone(),
            seed: global.seed.unwrap_or(1),
        };
        let frames = options.frames.min(set.frames());
        let config = ScanConfig::default();
        let store = self.store(&run, &data, &options, &config)?;
        let benchmark = ScanBenchmark::new(&run, &set, options.clone(), &config)?;
        let trials = benchmark.trials();
        let mut cases = Vec::with_capacity(trials.len());
        console.while_showing("fit", "scans", |progress| {
            for &trial in &trials {
                let name = item(trial);
                cases.push(match store.read(&name)? {
                    Some(case) => case,
                    None => store.write(&name, &benchmark.case(trial)?)?,
                });
                progress(cases.len(), trials.len());
            }
            Ok::<_, Error>(())
        })?;
        let mut levels = Vec::new();
        for &noise in &options.noises {
            for &hole in &options.holes {
                let of = |case: &&ScanCase| (case.noise, case.hole) == (noise, hole);
                levels.push(NoiseLevel::from_cases(
                    &cases.iter().filter(of).collect::<Vec<_>>(),
                    noise,
                    hole,
                ));
            }
        }
        let report = Report { out: self.out, frames, levels, cases };
        write_json(&store.claim("benchmark.json")?, &report)?;
        console.result(&report, || report.text())
    }

    /// Finished scans in --out. A scan is the same whatever other frames and levels there are.
    fn store(
        &self,
        run: &Run,
        data: &Path,
        options: &ScanBenchmarkOptions,
        config: &ScanConfig,
    ) -> Result<ResultStore> {
        let ScanBenchmarkOptions { points, seed, .. } = options;
        let settings = json!({ "points": points, "seed": seed, "config": config });
        let settings = StoreSettings::new("fit benchmark scan", &settings)?
            .with_run(run)?
            .with_packed_set(data, &[Split::Test])?;
        let options = StoreOptions {
            overwrite: self.overwrite,
            earlier: &["benchmark.json"],
            ..StoreOptions::default()
        };
        let store = ResultStore::open(&self.out, settings, options)?;
        store.begin()?;
        Ok(store)
    }
}

/// Name of a scan's file.
fn item(ScanTrial { frame, noise, hole }: ScanTrial) -> String {
    format!("scans/{frame:06}-noise-{noise}-hole-{hole}.json")
}

impl NoiseLevel {
    fn from_cases(cases: &[&ScanCase], noise: f64, hole: f64) -> Self {
        let mean = |part: fn(&ScanError) -> f64| {
            cases.iter().map(|case| part(&case.error)).sum::<f64>() / cases.len().max(1) as f64
        };
        Self {
            noise_mm: 1000.0 * noise,
            hole,
            error: ScanError {
                mean_clothes: mean(|error| error.mean_clothes),
                clothed: mean(|error| error.clothed),
                encoded: mean(|error| error.encoded),
                displaced: mean(|error| error.displaced),
                bare: mean(|error| error.bare),
                surface: mean(|error| error.surface),
                displaced_surface: mean(|error| error.displaced_surface),
                seconds: mean(|error| error.seconds),
                displacement_seconds: mean(|error| error.displacement_seconds),
            },
            failed: cases.iter().filter(|case| case.problem.is_some()).count(),
        }
    }
}

impl Report {
    fn text(&self) -> String {
        let mut table = Table::new([
            "noise",
            "holes",
            "mean clothes",
            "CAPE",
            "(encoded)",
            "displaced",
            "bare",
            "surface",
            "displaced",
            "failed",
            "seconds",
        ]);
        for level in &self.levels {
            let error = &level.error;
            let mm = |mm: f64| format!("{mm:.1}");
            table.row([
                format!("{} mm", level.noise_mm),
                format!("{:.0} %", 100.0 * level.hole),
                mm(error.mean_clothes),
                mm(error.clothed),
                mm(error.encoded),
                mm(error.displaced),
                mm(error.bare),
                mm(error.surface),
                mm(error.displaced_surface),
                level.failed.to_string(),
                format!("{:.1} + {:.1}", error.seconds, error.displacement_seconds),
            ]);
        }
        format!(
            "{}\n\nmillimetres in the mean over {} scans a row\n{}",
            table.text(),
            self.frames,
            self.out.join("benchmark.json").display()
        )
    }
}
