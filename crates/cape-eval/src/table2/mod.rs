//! CAPE's table 2: every method under one protocol.
//!
//! A [`Table2Job`] is one row with one seed in a directory of its own: it is trained (or fitted),
//! measured on the test frames, and leaves a `result.json` with a key of its configuration and
//! data, so that it is not done again unless either changed, and the [`FigureFrames`] that pictures
//! show. [`methods`] are what a [`ComparisonTable`](crate::comparison::ComparisonTable) puts side
//! by side.

mod frames;
mod measure;
mod rows;

use std::{
    fs,
    io::Read,
    path::{Path, PathBuf},
};

use burn::tensor::Device;
use cape_core::{SmplModel, hex, smpl::ClothingMask};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

pub use frames::{FigureFrames, select_frames};
pub use rows::Table2Row;

use crate::{
    Error, Result,
    comparison::{MethodResults, RunErrors},
};
use cape_data::{PackedSet, Split};
use cape_infer::{RunConfig, RunPaths, body_and_clothing, checkpoint};
use cape_train::{Trainer, TrainerOptions};

const RESULT: &str = "result.json";
const FRAMES: &str = "frames.npz";

/// Options that all rows share.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/../cape-train/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use burn::tensor::Device;
/// use cape_core::silent;
/// use cape_eval::table2::{Table2Options, Table2Row, hash_of, methods, select_frames};
///
/// let directory = captures()?;
/// let data = directory.path().join("packed");
/// let grid = Table2Options {
///     out: directory.path().join("table2"),
///     body: None,
///     clothing: None,
///     config: small_config(),
///     data_hash: hash_of(&data)?,
///     shown: select_frames(&data)?,
///     data,
/// };
/// // Two seeds of CAPE, and one of what is not trained.
/// let jobs = grid.jobs(&[Table2Row::Mean, Table2Row::Cape], 2)?;
/// let rows: Vec<Table2Row> = jobs.iter().map(|job| job.row).collect();
/// assert_eq!(rows, [Table2Row::Mean, Table2Row::Cape, Table2Row::Cape]);
/// assert!(jobs[0].result().is_none());
/// let result = jobs[0].measure(&grid, 0.0, &Device::default(), &mut silent)?;
/// assert_eq!(result.row, Table2Row::Mean);
/// assert!(result.measured.sampled.overall.mean > 0.0);
/// // Done once, it is kept, with its reconstructions of the frames to be shown.
/// assert!(jobs[0].result().is_some());
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
    pub body: Option<PathBuf>,
    /// The clothing vertices, likewise.
    pub clothing: Option<PathBuf>,
    /// CAPE's configuration.
    pub config: RunConfig,
    /// The packed set's [`hash_of`].
    pub data_hash: String,
    /// Its [`select_frames`].
    pub shown: Vec<usize>,
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
    key: String,
    shown: Vec<usize>,
}

/// Result of a job.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct RowResult {
    /// The row.
    pub row: Table2Row,
    /// Its seed.
    pub seed: u64,
    /// SHA-256 of configuration and data.
    key: String,
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
    /// The jobs of these rows, every trained one with `seeds` seeds.
    pub fn jobs(&self, rows: &[Table2Row], seeds: u64) -> Result<Vec<Table2Job>> {
        let mut jobs = Vec::new();
        for &row in rows {
            for seed in 0..if row.is_trained() { seeds } else { 1 } {
                let mut config = row.configure(&self.config);
                config.train.seed = self.config.train.seed + seed;
                config.validate()?;
                let text = toml::to_string(&config)
                    .map_err(|error| Error::argument(format!("settings: {error}")))?;
                let mut hash = Sha256::new();
                for part in [row.name(), &text, &self.data_hash, env!("CARGO_PKG_VERSION")] {
                    hash.update(part);
                    hash.update("\0");
                }
                jobs.push(Table2Job {
                    row,
                    seed: config.train.seed,
                    directory: self
                        .out
                        .join(row.name())
                        .join(format!("seed-{}", config.train.seed)),
                    key: hex(hash.finalize()),
                    config,
                    shown: self.shown.clone(),
                });
            }
        }
        Ok(jobs)
    }

    /// The body and the clothing vertices of frames like those of `set`.
    pub fn body(&self, set: &PackedSet) -> Result<(SmplModel, ClothingMask)> {
        body_and_clothing(&self.data, set, self.body.as_deref(), self.clothing.as_deref())
    }
}

/// A hash of a packed set's arrays.
pub fn hash_of(data: &Path) -> Result<String> {
    let mut hash = Sha256::new();
    let mut buffer = vec![0; 1 << 20];
    for part in [Split::Train, Split::Test] {
        for what in ["disp", "rot", "clo_label"] {
            let path = part.path(data, what);
            let mut file = fs::File::open(&path).map_err(|source| Error::io(&path, source))?;
            loop {
                let read = file.read(&mut buffer).map_err(|source| Error::io(&path, source))?;
                if read == 0 {
                    break;
                }
                hash.update(&buffer[..read]);
            }
        }
    }
    Ok(hex(hash.finalize()))
}

impl Table2Job {
    /// Result of the job; `None` if it is not done, or configuration or data have changed since.
    pub fn result(&self) -> Option<RowResult> {
        let text = fs::read(self.directory.join(RESULT)).ok()?;
        let result: RowResult = serde_json::from_slice(&text).ok()?;
        let frames = self.frames().ok()?;
        (result.key == self.key && frames.rows == self.shown).then_some(result)
    }

    /// Reconstructions of the frames shown, once it is done.
    pub fn frames(&self) -> Result<FigureFrames> {
        FigureFrames::load(self.directory.join(FRAMES))
    }

    fn run_directory(&self) -> PathBuf {
        self.directory.join("run")
    }

    /// The trainer that goes on with it; none for rows that are not trained. A run of another
    /// configuration or other data in its place is removed.
    pub fn trainer(&self, grid: &Table2Options, device: &Device) -> Result<Option<Trainer>> {
        if !self.row.is_trained() {
            return Ok(None);
        }
        let root = self.run_directory();
        let marker = self.directory.join("key.txt");
        let ours = fs::read_to_string(&marker).is_ok_and(|key| key == self.key);
        if ours && !checkpoint::list(&RunPaths::new(&root).checkpoints())?.is_empty() {
            return Trainer::resume(&root, Some(&grid.data), device).map(Some);
        }
        if root.exists() {
            fs::remove_dir_all(&root).map_err(|source| Error::io(&root, source))?;
        }
        fs::create_dir_all(&self.directory).map_err(|source| Error::io(&self.directory, source))?;
        fs::write(&marker, &self.key).map_err(|source| Error::io(&marker, source))?;
        let options = TrainerOptions {
            data: grid.data.clone(),
            body: grid.body.clone(),
            clothing: grid.clothing.clone(),
            config: self.config.clone(),
        };
        Trainer::create(&root, options, device).map(Some)
    }
}
