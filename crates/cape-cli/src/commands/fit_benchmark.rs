use std::path::PathBuf;

use cape_core::parse_device;
use cape_fit::{
    ClothedConfig, PosePrior, Smplify, SmplifyConfig,
    benchmark::{BenchmarkOptions, Case, FitError, benchmark},
    silhouette::render,
};
use cape_render::{Tile, contact_sheet};
use cape_train::{
    Run,
    data::{PackedSet, Part},
    write_json,
};
use clap::Args;
use serde::Serialize;

use super::fit::overlay;
use crate::{
    arguments::{Global, at_least_one},
    console::Console,
    error::{Error, Result},
    files,
    table::Table,
};

/// Measure how well clothed bodies are found again from images (tables 3 and 4 of the paper).
///
/// Held-out clothes on bodies of random shape are drawn; from silhouette, keypoints and outfit alone
/// they are fitted, by SMPLify and by CAPE. Writes benchmark.json and a picture of the best, the
/// median and the worst.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  cape fit-benchmark run --frames 120 --noise 3 --out fits")]
pub(crate) struct FitBenchmark {
    /// A training run.
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// Packed set with the held-out frames; by default the run's own.
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Directory to write; it must be empty or missing.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Held-out frames, evenly spaced.
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
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    frames: usize,
    noise: f64,
    dropped: f64,
    ragged: f64,
    bare: FitError,
    clothed: FitError,
    /// 1 − clothed / bare, of the squared errors.
    improvement: f64,
    /// Frames in which the clothed body is nearer to the truth.
    better: usize,
    /// Fits that say that they cannot be trusted.
    failed: usize,
    cases: Vec<Case>,
}

impl FitBenchmark {
    pub(crate) fn run(self, global: &Global, console: Console) -> Result {
        let device = parse_device(&global.device)?;
        let shares = [("--dropped", self.dropped), ("--ragged", self.ragged)];
        if let Some((name, share)) = shares.iter().find(|(_, s)| !(0.0..=1.0).contains(s)) {
            return Err(Error::message(format!("{name} {share}: expected 0 to 1")));
        }
        if !(self.noise.is_finite() && self.noise >= 0.0) {
            return Err(Error::message(format!("--noise {}: expected 0 or more", self.noise)));
        }
        files::require_empty(&self.out)?;
        let run = Run::open(&self.run, &device)?;
        let data = match &self.data {
            Some(data) => data.clone(),
            None => run.data()?,
        };
        let set = PackedSet::open(&data, Part::Test)?;
        let smplify = Smplify::new(run.body(), PosePrior::synthetic()?, SmplifyConfig::default())?;
        let options = BenchmarkOptions {
            frames: self.frames,
            side: self.size,
            noise: self.noise,
            dropped: self.dropped,
            ragged: self.ragged,
            seed: global.seed.unwrap_or(1),
        };
        let count = options.frames.min(set.frames());
        let (mut cases, mut tiles) = (Vec::with_capacity(count), Vec::with_capacity(count));
        let faces = &run.body().faces;
        console.while_showing("fit", "images", |progress| {
            benchmark(
                &run,
                &set,
                &smplify,
                &ClothedConfig::default(),
                &options,
                &mut |case, seen| {
                    let picture = |vertices, name: &str, error: &FitError| {
                        let drawn = render(vertices, faces, &seen.camera)?;
                        let image = overlay(None, &seen.mask, drawn.mask(), &seen.keypoints)
                            .map_err(|error| cape_fit::Error::Failed(error.to_string()))?;
                        let label = format!("{name} {} {:.0} mm", case.frame, error.distance_mm);
                        Ok::<_, cape_fit::Error>(Tile { image, label })
                    };
                    let bare = picture(&seen.bare, "SMPLify", &case.bare)?;
                    let clothed = picture(&seen.clothed, "CAPE", &case.clothed)?;
                    tiles.push([bare, clothed]);
                    cases.push(case);
                    progress(cases.len(), count);
                    Ok(())
                },
            )
        })?;
        files::create_dir(&self.out)?;
        let mut order: Vec<usize> = (0..cases.len()).collect();
        order.sort_by(|&a, &b| cases[a].clothed.squared.total_cmp(&cases[b].clothed.squared));
        let chosen: Vec<Tile> = [0, order.len() / 2, order.len().saturating_sub(1)]
            .into_iter()
            .filter_map(|place| order.get(place))
            .flat_map(|&index| tiles[index].clone())
            .collect();
        contact_sheet(&chosen, 2, None)?.save(self.out.join("fits.png"))?;
        let report = Report::new(self, cases);
        write_json(&report.out.join("benchmark.json"), &report)?;
        console.result(&report, || report.text())
    }
}

impl Report {
    fn new(command: FitBenchmark, cases: Vec<Case>) -> Self {
        let mean = |of: fn(&Case) -> FitError| {
            let part = |value: fn(&FitError) -> f64| {
                cases.iter().map(|case| value(&of(case))).sum::<f64>() / cases.len().max(1) as f64
            };
            FitError {
                squared: part(|error| error.squared),
                distance_mm: part(|error| error.distance_mm),
                intersection_over_union: part(|error| error.intersection_over_union),
                seconds: part(|error| error.seconds),
            }
        };
        let (bare, clothed) = (mean(|case| case.bare), mean(|case| case.clothed));
        Self {
            frames: cases.len(),
            noise: command.noise,
            dropped: command.dropped,
            ragged: command.ragged,
            improvement: 1.0 - clothed.squared / bare.squared,
            better: cases.iter().filter(|case| case.clothed.squared < case.bare.squared).count(),
            failed: cases.iter().filter(|case| case.problem.is_some()).count(),
            bare,
            clothed,
            cases,
            out: command.out,
        }
    }

    fn text(&self) -> String {
        let mut table = Table::new(["", "squared, cm²", "mean, mm", "silhouettes", "seconds"]);
        for (name, error) in [("SMPLify", &self.bare), ("with CAPE", &self.clothed)] {
            table.row([
                name.to_owned(),
                format!("{:.1}", 1e4 * error.squared),
                format!("{:.1}", error.distance_mm),
                format!("{:.1} %", 100.0 * error.intersection_over_union),
                format!("{:.1}", error.seconds),
            ]);
        }
        format!(
            "{}\n\n{} images, {:.0} % less squared error, better in {}; {} fits say that they cannot \
             be trusted\n{}",
            table.text(),
            self.frames,
            100.0 * self.improvement,
            self.better,
            self.failed,
            self.out.join("fits.png").display()
        )
    }
}
