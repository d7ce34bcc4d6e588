//! CAPE's table 2: every method under one protocol.
//!
//! A [`Table2Job`] is one row with one seed. It is trained (or fitted) and measured on the test frames in
//! a [`ResultStore`] of its own, `<row>/seed-<seed>`, and leaves a `result.json` and the
//! [`FigureFrames`] that pictures show. The settings of its store are those that this row depends on
//! (its configuration with the seed; of PCA the number of components; of the mean shape none), its
//! inputs the packed set, the body and the clothing vertices. Rows and seeds can therefore be added,
//! and directories of rows moved together from several machines. [`methods`] are what a
//! [`ComparisonTable`](crate::comparison::ComparisonTable) puts side by side.

mod estimate;
mod frames;
mod measure;
mod rows;

use std::{
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use burn::tensor::Device;
use cape_core::{DirectoryLock, SmplModel, is_temporary, smpl::ClothingMask};
use serde::{Deserialize, Serialize};
use serde_json::json;

pub use estimate::JobEstimate;
pub use frames::{FigureFrames, select_frames};
pub use rows::Table2Row;

use crate::{
    Error, Result,
    comparison::{MethodResults, RunErrors},
    store::{ResultStore, StoreOptions, StoreSettings, unreadable},
};
use cape_data::{
    PackedSet, Split,
    raw::{BODY_FILE, CLOTHING_FILE},
};
use cape_infer::{MIXTURE, RunConfig, RunPaths, body_and_clothing, checkpoint};
use cape_train::{Trainer, TrainerOptions};

const RESULT: &str = "result.json";
const FRAMES: &str = "frames.npz";
const RUN: &str = "run";

/// Tables and pictures from versions without settings.json.
const EARLIER_TABLES: [&str; 8] = [
    "table2.json",
    "table2.md",
    "table2.csv",
    "table2.tex",
    "report.html",
    "reconstructions.png",
    "error_maps.png",
    "histograms.png",
];
/// Files of a row from versions without settings.json.
const EARLIER_ROW: [&str; 12] = [
    "result.json",
    "key.txt",
    "frames.npz",
    "pca.npz",
    "run/config.toml",
    "run/data.json",
    "run/stats.npz",
    "run/body.npz",
    "run/clothing_verts_idx.npy",
    "run/metrics.jsonl",
    "run/checkpoints/",
    "run/tensorboard/",
];

/// Options that all rows share.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/../cape-train/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use burn::tensor::Device;
/// use cape_core::silent;
/// use cape_eval::table2::{Table2Options, Table2Row, methods, select_frames};
///
/// let directory = captures()?;
/// let data = directory.path().join("packed");
/// let grid = Table2Options {
///     out: directory.path().join("table2"),
///     body: None,
///     clothing: None,
///     config: small_config(),
///     shown: select_frames(&data)?,
///     data,
///     overwrite: false,
/// };
/// // Two seeds of CAPE, and one of what is not trained.
/// let jobs = grid.jobs(&[Table2Row::Mean, Table2Row::Cape], 2)?;
/// let rows: Vec<Table2Row> = jobs.iter().map(|job| job.row).collect();
/// assert_eq!(rows, [Table2Row::Mean, Table2Row::Cape, Table2Row::Cape]);
/// assert!(jobs[0].result()?.is_none());
/// let result = jobs[0].measure(&grid, 0.0, &Device::default(), &mut silent)?;
/// assert_eq!(result.row, Table2Row::Mean);
/// assert!(result.measured.sampled.overall.mean > 0.0);
/// // Done once, it is kept, with its reconstructions of the frames to be shown.
/// assert!(jobs[0].result()?.is_some());
/// assert_eq!(jobs[0].frames()?.rows, grid.shown);
/// assert_eq!(methods(&[result]).0.len(), 1);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct Table2Options {
    /// The packed set.
    pub data: PathBuf,
    /// Directory of the results.
    pub out: PathBuf,
    /// The body, unless the packed set has its own.
    pub body: Option<SmplModel>,
    /// The clothing vertices, likewise.
    pub clothing: Option<PathBuf>,
    /// CAPE's configuration.
    pub config: RunConfig,
    /// Test frames of the pictures, as [`select_frames`] gives them.
    pub shown: Vec<usize>,
    /// Discard rows of other settings, data or versions instead of refusing them.
    pub overwrite: bool,
}

/// One row with one seed.
#[derive(Debug, Clone)]
pub struct Table2Job {
    /// The row.
    pub row: Table2Row,
    /// Fixes weights, shuffles, noise and samples.
    pub seed: u64,
    /// Directory of the job.
    pub directory: PathBuf,
    config: RunConfig,
    store: Arc<ResultStore>,
    shown: Vec<usize>,
}

/// Result of a job.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct RowResult {
    /// The row.
    pub row: Table2Row,
    /// Its seed.
    pub seed: u64,
    /// Seconds of training or fitting.
    pub seconds: f64,
    /// Errors on the test frames.
    #[serde(flatten)]
    pub measured: RunErrors,
}

/// The rows that there are results of, in the table's order, and the place of CAPE's among them.
pub fn methods(results: &[RowResult]) -> (Vec<MethodResults<'_>>, Option<usize>) {
    let mut methods = Vec::new();
    let mut cape = None;
    for row in Table2Row::ALL {
        let of = || results.iter().filter(|result| result.row == row);
        if of().next().is_none() {
            continue;
        }
        if row == Table2Row::Cape {
            cape = Some(methods.len());
        }
        methods.push(MethodResults {
            name: row.name().to_owned(),
            label: row.label().to_owned(),
            results: of().map(|result| &result.measured).collect(),
            seconds: of().map(|result| result.seconds).sum(),
        });
    }
    (methods, cape)
}

impl Table2Options {
    /// The jobs of these rows, every trained one with `seeds` seeds: all rows with the first seed, then
    /// all trained rows with the next, so that there is a whole table early.
    ///
    /// # Errors
    /// If a row was begun with other settings, inputs or another version and is not to be overwritten.
    /// Nothing is written before a job starts.
    pub fn jobs(&self, rows: &[Table2Row], seeds: u64) -> Result<Vec<Table2Job>> {
        let inputs = self.inputs()?;
        let mut jobs = Vec::new();
        for seed in 0..seeds {
            for &row in rows.iter().filter(|row| seed == 0 || row.is_trained()) {
                let mut config = row.configure(&self.config);
                config.train.seed = self.config.train.seed + seed;
                config.validate()?;
                let seed = config.train.seed;
                let directory = self.out.join(row.name()).join(format!("seed-{seed}"));
                let settings = inputs.with_settings(&row_settings(row, &config))?;
                let options = StoreOptions {
                    overwrite: self.overwrite,
                    earlier: &EARLIER_ROW,
                    ..StoreOptions::default()
                };
                let store = Arc::new(ResultStore::open(&directory, settings, options)?);
                let shown = self.shown.clone();
                jobs.push(Table2Job { row, seed, directory, config, store, shown });
            }
        }
        Ok(jobs)
    }

    /// Inputs of all rows: packed set, body and clothing vertices.
    fn inputs(&self) -> Result<StoreSettings> {
        let own = |name: &str| Some(self.data.join(name)).filter(|path| path.exists());
        let clothing = self.clothing.clone().or_else(|| own(CLOTHING_FILE));
        let settings = StoreSettings::new("table2, row", &())?
            .with_packed_set(&self.data, &[Split::Train, Split::Test])?;
        let settings = match &self.body {
            Some(body) => settings.with_built_in("body", &format!("SHA-256 {}", body.sha256())),
            None => settings.with_optional_input("body", own(BODY_FILE).as_deref(), "no body")?,
        };
        settings.with_optional_input("clothing", clothing.as_deref(), "derived from the body")
    }

    /// The body and the clothing vertices of frames like those of `set`.
    pub fn body(&self, set: &PackedSet) -> Result<(SmplModel, ClothingMask)> {
        body_and_clothing(&self.data, set, self.body.as_ref(), self.clothing.as_deref())
    }
}

/// Settings that a row's results depend on.
fn row_settings(row: Table2Row, config: &RunConfig) -> serde_json::Value {
    match row {
        Table2Row::Mean => json!({ "row": row }),
        Table2Row::Pca => {
            json!({ "row": row, "components": config.model.latent, "seed": config.train.seed })
        }
        _ => json!({
            "row": row,
            "model": config.model,
            "loss": config.loss,
            "train": config.train,
            "weighting": config.weighting,
        }),
    }
}

/// The directory of a table, with tables and pictures of all rows; the rows have stores of their own
/// inside it.
pub fn open_store(out: &Path, overwrite: bool) -> Result<ResultStore> {
    let mut beside = Table2Row::ALL.map(Table2Row::name).to_vec();
    // Where a packed set may be that was made for it.
    beside.extend(["data", "raw"]);
    let options = StoreOptions { overwrite, earlier: &EARLIER_TABLES, beside: &beside };
    ResultStore::open(out, StoreSettings::new("table2", &())?, options)
}

impl Table2Job {
    /// Result of the job; `None` if it is not done.
    ///
    /// # Errors
    /// If a file of a finished job cannot be read; it is named.
    pub fn result(&self) -> Result<Option<RowResult>> {
        self.store.refresh()?;
        let Some(result) = self.store.read::<RowResult>(RESULT)? else { return Ok(None) };
        if !self.store.path(FRAMES).exists() {
            return Ok(None);
        }
        let frames = self.frames()?;
        Ok((frames.rows == self.shown).then_some(result))
    }

    /// Reconstructions of the frames shown; written before the result.
    pub fn frames(&self) -> Result<FigureFrames> {
        let path = self.store.path(FRAMES);
        FigureFrames::load(&path).map_err(|error| unreadable(&path, &error.to_string()))
    }

    /// Locks the job against other processes; `None` if another one works on it.
    pub fn try_lock(&self) -> Result<Option<DirectoryLock>> {
        self.store.try_lock()
    }

    fn run_directory(&self) -> PathBuf {
        self.store.path(RUN)
    }

    /// Trainer of the row, resumed from the newest checkpoint if there is one; none for rows that are
    /// not trained.
    ///
    /// # Errors
    /// If there are files in the place of its run that the training did not write.
    pub fn trainer(&self, grid: &Table2Options, device: &Device) -> Result<Option<Trainer>> {
        if !self.row.is_trained() {
            return Ok(None);
        }
        let root = self.run_directory();
        let paths = RunPaths::new(&root);
        let files =
            [paths.config(), paths.data(), paths.statistics(), paths.body(), paths.clothing()];
        let name = |path: &Path, end: &str| {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            format!("{RUN}/{name}{end}")
        };
        let mut names: Vec<String> = files.iter().map(|path| name(path, "")).collect();
        names.extend([paths.metrics(), paths.prior(MIXTURE)].map(|path| name(&path, "")));
        names.extend([paths.checkpoints(), paths.events()].map(|path| name(&path, "/")));
        self.store.begin()?;
        if checkpoint::list(&paths.checkpoints())?.is_empty() {
            // What was interrupted before its first checkpoint has nothing to resume from.
            for name in &names {
                self.store.discard(name)?;
            }
            for other in fs::read_dir(&root).into_iter().flatten() {
                let other = other.map_err(|source| Error::io(&root, source))?;
                if !is_temporary(&other.file_name().to_string_lossy()) {
                    let message = "is not a file of this training: move it elsewhere";
                    return Err(Error::format(other.path(), message));
                }
            }
        }
        for name in &names {
            self.store.list(name)?;
        }
        if !checkpoint::list(&paths.checkpoints())?.is_empty() {
            return Trainer::resume(&root, Some(&grid.data), device).map(Some);
        }
        let options = TrainerOptions {
            data: grid.data.clone(),
            body: grid.body.clone(),
            clothing: grid.clothing.clone(),
            config: self.config.clone(),
        };
        Trainer::create(&root, options, device).map(Some)
    }
}
