mod estimate;
mod figures;
mod quick;
mod report;

use std::{path::PathBuf, time::Instant};

use burn::tensor::Device;
use cape_core::smpl::Gender;
use cape_data::{PackedSet, Split};
use cape_eval::{
    comparison::ComparisonTable,
    store::ResultStore,
    table2::{RowResult, Table2Job, Table2Options, Table2Row, methods, open_store, select_frames},
};
use cape_infer::{RunConfig, write_json};
use cape_model::CapeConfig;
use cape_synth::embedded_body;
use clap::Args;
use serde::Serialize;
use tempfile::TempDir;

use crate::{
    body_source::{self, BodyFileArgs},
    comparison,
    console::{Console, seconds},
    error::{Context, Error, Result},
    exit_code::ExitCode,
    files,
    html::HtmlFigure,
    interrupt::Interrupt,
    options::{
        CheckpointArgs, GlobalArgs, PRESETS, PrecisionArgs, StoreArgs, at_least_one, choices,
        note_precision,
    },
    training,
};
use figures::MethodFigure;

/// Train and evaluate all rows of the paper's table 2 under one protocol.
///
/// Trains PCA, CoMA, CAPE and its ablations, each in its own directory under --out. Writes table2.md,
/// .csv, .json and .tex after every row, and pictures of reconstructions and errors and report.html with
/// all of them at the end. Run the same command again to resume.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  cape table2 --data packed --out table2 --seeds 3 --dry-run\n  cape table2 \
                        --data packed --out table2 --seeds 3\n  cape table2 --quick --body female --out quick"
)]
pub(crate) struct Table2Args {
    /// Packed set with training and test frames.
    #[arg(long, value_name = "DIR", required_unless_present = "quick")]
    data: Option<PathBuf>,
    #[command(flatten)]
    output: StoreArgs,
    /// Train narrow models briefly, without --data on synthetic captures of --body [default: neutral].
    #[arg(long)]
    quick: bool,
    /// Rows of the table [default: all].
    #[arg(
        long,
        value_name = "ROW,…",
        value_delimiter = ',',
        value_parser = choices(Table2Row::ALL.map(|row| (row.name(), row)))
    )]
    rows: Vec<Table2Row>,
    /// Number of seeds per trained row; all rows are trained with the first seed before the next.
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = at_least_one)]
    seeds: usize,
    /// Number of epochs; the warm-up is scaled with it.
    #[arg(long, value_name = "N", value_parser = at_least_one)]
    epochs: Option<usize>,
    #[command(flatten)]
    checkpoints: CheckpointArgs,
    /// Do every N-th job only, from the I-th on: shares of the table for several processes or machines.
    #[arg(long, value_name = "I/N", value_parser = Shard::parse)]
    shard: Option<Shard>,
    /// Write the table of the finished jobs without training.
    #[arg(long, conflicts_with_all = ["dry_run", "shard"])]
    tabulate: bool,
    /// Estimate the training time of all rows from a few timed updates, and write nothing.
    #[arg(long)]
    dry_run: bool,
    /// Configuration of CAPE, TOML, from which the other rows are derived.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["preset", "quick"])]
    config: Option<PathBuf>,
    /// Architecture of CAPE [default: paper].
    #[arg(long, value_name = "NAME", value_parser = PRESETS)]
    preset: Option<String>,
    #[command(flatten)]
    precision: PrecisionArgs,
    #[command(flatten)]
    body: BodyFileArgs,
    /// Indices of the clothing vertices, if the packed set has no clothing_verts_idx.npy.
    #[arg(long, value_name = "FILE.npy")]
    clothing: Option<PathBuf>,
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    seconds: f64,
    #[serde(flatten)]
    table: ComparisonTable,
}

impl Table2Args {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result<ExitCode> {
        let start = Instant::now();
        let device = global.device()?;
        let store = open_store(&self.output.out, self.output.overwrite)?;
        let scratch = self.scratch()?;
        let given = self.body.load()?;
        let (data, body) = if let Some(data) = &self.data {
            (data.clone(), given)
        } else {
            let body = given.map_or_else(|| embedded_body(Gender::Neutral), Ok)?;
            let overwrite = self.output.overwrite;
            let data = match &scratch {
                Some(scratch) => {
                    quick::data(&open_store(scratch.path(), false)?, &body, overwrite, console)?
                }
                None => quick::data(&store, &body, overwrite, console)?,
            };
            // The captures have their body.
            (data, None)
        };
        let set = PackedSet::open(&data, Split::Train)?;
        let shown = select_frames(&data)?;
        let grid = Table2Options {
            data,
            out: self.output.out.clone(),
            body,
            clothing: self.clothing.clone(),
            config: self.configured(global)?,
            shown,
            overwrite: self.output.overwrite,
        };
        note_precision(grid.config.train.precision, &global.device, console);
        let rows = if self.rows.is_empty() { Table2Row::ALL.to_vec() } else { self.rows.clone() };
        let jobs = grid.jobs(&rows, self.seeds as u64)?;
        if self.dry_run {
            return estimate::run(&grid, &jobs, &device, console);
        }
        store.begin()?;
        let body_name = body_source::describe(&grid.body(&set)?.0);
        let interrupt = Interrupt::listen(console)?;
        let report = |results: &[RowResult]| {
            let (methods, cape) = methods(results);
            let table = ComparisonTable::new(&methods, cape).with_body(&body_name);
            Report { out: grid.out.clone(), seconds: start.elapsed().as_secs_f64(), table }
        };
        let mine: Vec<&Table2Job> = match self.shard {
            _ if self.tabulate => Vec::new(),
            Some(shard) => shard.of(&jobs),
            None => jobs.iter().collect(),
        };
        let mut clock = RemainingTime::new(&mine);
        for (index, &job) in mine.iter().enumerate() {
            let title =
                format!("[{}/{}] {}, seed {}", index + 1, mine.len(), job.row.name(), job.seed);
            if job.result()?.is_some() {
                console.note(&format!("{title}: already done"));
                clock.pass(job);
                continue;
            }
            let Some(lock) = job.try_lock()? else {
                console.note(&format!("{title}: another process works on it"));
                clock.pass(job);
                continue;
            };
            console.note(&format!("{title}{}", clock.left()));
            if !train_and_measure(&grid, job, self.checkpoints, &device, console, &interrupt)
                .doing(|| title)?
            {
                console.note("interrupted and saved: run the same command again to resume");
                return Ok(ExitCode::INTERRUPTED);
            }
            drop(lock);
            let writing = store.wait_for_lock()?;
            write_tables(&store, &report(&finished(&jobs)?))?;
            drop(writing);
            clock.pass(job);
        }
        // Another process that finishes a row meanwhile writes after this one, with that row.
        let _writing = store.wait_for_lock()?;
        let results = finished(&jobs)?;
        if results.is_empty() {
            return Err(Error::message(format!("{}: no row is finished", grid.out.display())));
        }
        if results.len() < jobs.len() {
            let left = jobs.len() - results.len();
            console.note(&format!("{left} of {} jobs are not finished", jobs.len()));
        }
        let report = report(&results);
        write_tables(&store, &report)?;
        write_figures(&store, &report, &grid, &jobs, &results)?;
        console.result(&report, || report.text())?;
        Ok(ExitCode::SUCCESS)
    }

    /// Directory for the synthetic data of an estimate.
    fn scratch(&self) -> Result<Option<TempDir>> {
        let packed = self.output.out.join("data").join("stats.txt");
        if !self.dry_run || self.data.is_some() || packed.exists() {
            return Ok(None);
        }
        let created =
            TempDir::new().map_err(|error| Error::message(format!("temporary: {error}")))?;
        Ok(Some(created))
    }

    fn configured(&self, global: &GlobalArgs) -> Result<RunConfig> {
        let mut config = match &self.config {
            Some(path) => RunConfig::load(path)?,
            None if self.quick => quick::config(),
            None => RunConfig::default(),
        };
        if let Some(preset) = &self.preset {
            config.model = CapeConfig::preset(preset)?;
        }
        if let Some(epochs) = self.epochs {
            config.train.scale_to_epochs(epochs);
        }
        if let Some(precision) = self.precision.precision {
            config.train.precision = precision;
        }
        if let Some(seed) = global.seed {
            config.train.seed = seed;
        }
        config.validate()?;
        Ok(config)
    }
}

/// Trains and measures a job; false if it was interrupted.
fn train_and_measure(
    grid: &Table2Options,
    job: &Table2Job,
    checkpoints: CheckpointArgs,
    device: &Device,
    console: Console,
    interrupt: &Interrupt,
) -> Result<bool> {
    let mut spent = 0.0;
    if let Some(mut trainer) = job.trainer(grid, device)? {
        training::note_damage(&trainer, console);
        trainer.set_checkpoint_interval(checkpoints.interval());
        let outcome = training::run(&mut trainer, console, None, |_| interrupt.was_asked())?;
        if !outcome.finished {
            return Ok(false);
        }
        spent = outcome.seconds;
    }
    console.while_showing("measure", "frames", |progress| {
        job.measure(grid, spent, device, progress)
    })?;
    Ok(true)
}

/// Results of the finished jobs, by whatever process.
fn finished(jobs: &[Table2Job]) -> Result<Vec<RowResult>> {
    let mut results = Vec::new();
    for job in jobs {
        results.extend(job.result()?);
    }
    Ok(results)
}

/// Share of the jobs: those whose number leaves the same remainder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Shard {
    index: usize,
    count: usize,
}

impl Shard {
    /// `I/N` with I from 1 to N.
    fn parse(text: &str) -> std::result::Result<Self, String> {
        let numbers = text.split_once('/').and_then(|(index, count)| {
            Some(Self { index: index.parse().ok()?, count: count.parse().ok()? })
        });
        numbers
            .filter(|shard| (1..=shard.count).contains(&shard.index))
            .ok_or_else(|| "expected I/N with I from 1 to N, such as 2/4".to_owned())
    }

    fn of<T>(self, jobs: &[T]) -> Vec<&T> {
        jobs.iter().skip(self.index - 1).step_by(self.count).collect()
    }
}

/// Estimate of the remaining time from the trained rows so far.
struct RemainingTime {
    start: Instant,
    trained: usize,
    left: usize,
}

impl RemainingTime {
    fn new(jobs: &[&Table2Job]) -> Self {
        let left = jobs.iter().filter(|job| job.row.is_trained()).count();
        Self { start: Instant::now(), trained: 0, left }
    }

    fn pass(&mut self, job: &Table2Job) {
        if job.row.is_trained() {
            self.trained += 1;
            self.left -= 1;
        }
    }

    fn left(&self) -> String {
        if self.trained == 0 {
            return String::new();
        }
        let each = self.start.elapsed().as_secs_f64() / self.trained as f64;
        format!(" · about {} left", seconds(each * self.left as f64))
    }
}

fn write_tables(store: &ResultStore, report: &Report) -> Result {
    for name in ["table2.md", "table2.csv", "table2.tex"] {
        store.claim(name)?;
    }
    comparison::write(&report.out, "table2", &report.table)?;
    write_json(&store.claim("table2.json")?, report)?;
    Ok(())
}

fn write_figures(
    store: &ResultStore,
    report: &Report,
    grid: &Table2Options,
    jobs: &[Table2Job],
    results: &[RowResult],
) -> Result {
    let set = PackedSet::open(&grid.data, Split::Test)?;
    let (body, mask) = grid.body(&set)?;
    let shown = first_seeds(jobs, results)?;
    let reconstructions = figures::reconstructions(&set, &body, &mask, &grid.shown, &shown)?;
    reconstructions.save(store.claim("reconstructions.png")?)?;
    let maps = figures::maps(&body, &methods(results).0)?;
    maps.save(store.claim("error_maps.png")?)?;
    let histograms = comparison::histograms(&report.table)?;
    histograms.save(store.claim("histograms.png")?)?;
    let figures = [
        HtmlFigure {
            title: "Reconstructions",
            caption: "Test frames and their reconstructions from the posterior mean, first seed, front \
                      and back, on the mean body in the frame's pose.",
            image: &reconstructions,
        },
        HtmlFigure {
            title: "Mean error on the body",
            caption: "Error of sampled reconstructions at every clothing vertex, mean over test frames \
                      and seeds, on the body in A-pose.",
            image: &maps,
        },
        HtmlFigure {
            title: "Distribution of errors",
            caption: "Errors of sampled reconstructions at all clothing vertices of all test \
                      frames, up to the 99th percentile of the widest distribution.",
            image: &histograms,
        },
    ];
    let html = report::page(&report.table, grid, &figures)?;
    files::write_text(&store.claim("report.html")?, &html)
}

/// Reconstructions of the frames of the figure by the first finished seed of every row.
fn first_seeds(jobs: &[Table2Job], results: &[RowResult]) -> Result<Vec<MethodFigure>> {
    let of = |row| {
        let result = results.iter().find(|result| result.row == row)?;
        jobs.iter().find(|job| job.row == row && job.seed == result.seed)
    };
    Table2Row::ALL
        .into_iter()
        .filter_map(of)
        .map(|job| Ok(MethodFigure { label: job.row.label().to_owned(), frames: job.frames()? }))
        .collect()
}

impl Report {
    fn text(&self) -> String {
        format!(
            "{}\n\n{}: {}\n{}",
            comparison::text(&self.table),
            self.out.display(),
            seconds(self.seconds),
            self.out.join("report.html").display()
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_are_all_jobs_once() {
        let jobs: Vec<usize> = (0..7).collect();
        let parts = ["1/3", "2/3", "3/3"].map(|text| Shard::parse(text).unwrap().of(&jobs));
        let mut all: Vec<usize> = parts.concat().into_iter().copied().collect();
        all.sort_unstable();
        assert_eq!(all, jobs);
        for bad in ["0/3", "4/3", "1", "a/b", "1/0", ""] {
            assert!(Shard::parse(bad).is_err(), "{bad}");
        }
    }
}
