use std::path::{Path, PathBuf};

use cape_data::Split;
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
    console::Console,
    error::{Error, Result},
    options::{DataArgs, GlobalArgs, RunArgs, StoreArgs, at_least_one, non_negative, share},
    table::Table,
};

/// Benchmark scan fitting on held-out frames with noise and holes.
///
/// Samples points of held-out clothing on bodies of random shape and fits them with the outfit known, at
/// every combination of --noise and --holes. Writes benchmark.json. Run the same command again to
/// resume.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  cape fit benchmark scan runs/cape --frames 8 --noise 0,2,5 --holes \
                        0,0.2 --out scans"
)]
pub(crate) struct ScanBenchmarkArgs {
    #[command(flatten)]
    run: RunArgs,
    #[command(flatten)]
    data: DataArgs,
    #[command(flatten)]
    output: StoreArgs,
    /// Number of held-out frames, evenly spaced.
    #[arg(long, default_value_t = 8, value_name = "N", value_parser = at_least_one)]
    frames: usize,
    /// Number of points of a scan without holes.
    #[arg(long, default_value_t = 20_000, value_name = "N", value_parser = at_least_one)]
    points: usize,
    /// Standard deviations of the coordinates' noise, mm.
    #[arg(long, default_value = "0,2,5", value_delimiter = ',', value_name = "MM,…", value_parser = non_negative)]
    noise: Vec<f64>,
    /// Shares of the surface without points.
    #[arg(long, default_value = "0,0.2", value_delimiter = ',', value_name = "SHARE,…", value_parser = share)]
    holes: Vec<f64>,
}

/// Largest share of holes and largest noise, mm.
const MOST_HOLES: f64 = 0.9;
const MOST_NOISE: f64 = 100.0;

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    frames: usize,
    levels: Vec<NoiseLevel>,
    cases: Vec<ScanCase>,
}

/// Means over the scans of one level of noise and holes.
#[derive(Debug, Serialize)]
struct NoiseLevel {
    noise_mm: f64,
    hole: f64,
    error: ScanError,
    /// Number of fits judged unreliable.
    failed: usize,
}

impl ScanBenchmarkArgs {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        if let Some(hole) = self.holes.iter().find(|hole| **hole > MOST_HOLES) {
            return Err(Error::message(format!("--holes {hole}: must be at most {MOST_HOLES}")));
        }
        if let Some(noise) = self.noise.iter().find(|noise| **noise > MOST_NOISE) {
            return Err(Error::message(format!(
                "--noise {noise}: must be at most {MOST_NOISE} mm"
            )));
        }
        let run = self.run.open(global)?;
        let data = self.data.of(&run)?;
        let set = run.open_set(&data, Split::Test)?;
        let options = ScanBenchmarkOptions {
            frames: self.frames,
            points: self.points,
            noises: self.noise.iter().map(|mm| mm / 1000.0).collect(),
            holes: self.holes.clone(),
            seed: global.seed(),
        };
        let frames = options.frames.min(set.frames());
        let config = ScanConfig::default();
        let store = self.store(&run, &data, &options, &config)?;
        let _lock = store.lock()?;
        store.begin()?;
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
        let report = Report { out: self.output.out, frames, levels, cases };
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
            overwrite: self.output.overwrite,
            earlier: &["benchmark.json"],
            ..StoreOptions::default()
        };
        Ok(ResultStore::open(&self.output.out, settings, options)?)
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
            "mean clothing",
            "CAPE",
            "encoded",
            "displaced",
            "bare",
            "surface",
            "displaced surface",
            "unreliable",
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
            "{}\n\nmean over {} scans per row, mm\n{}",
            table.text(),
            self.frames,
            self.out.join("benchmark.json").display()
        )
    }
}
