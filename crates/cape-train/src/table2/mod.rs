//! CAPE's table 2: every method under one protocol.
//!
//! A [`Job`] is one row with one seed in a directory of its own: it is trained (or fitted), measured
//! on the test frames, and leaves a `result.json` with a key of its configuration and data, so that
//! it is not done again unless either changed. [`Table`] puts results side by side.

mod compare;
mod resample;
mod rows;
mod text;

use std::{
    fs,
    io::Read,
    path::{Path, PathBuf},
    sync::Arc,
    time::Instant,
};

use burn::tensor::Device;
use cape_core::{SmplModel, smpl::ClothingMask};
use ndarray::{Array2, Axis};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

pub use compare::{Line, Table};
pub use resample::Interval;
pub use rows::Row;

use crate::{
    Error, EvalOptions, Gathered, PosteriorUse, Progress, Result, Run, RunConfig, RunPaths,
    Trainer, checkpoint,
    data::{PackedSet, Part, Statistics, raw::BODY_FILE},
    detail::{Detail, DetailMeter},
    metrics::GroupedSummary,
    pca::{Pca, PcaOptions},
    reconstruct_test, run, write_json,
};

const RESULT: &str = "result.json";
const PCA: &str = "pca.npz";

/// What all rows have in common.
#[derive(Debug, Clone)]
pub struct Grid {
    /// The packed set.
    pub data: PathBuf,
    /// Where rows are kept.
    pub out: PathBuf,
    /// The body, unless the packed set has its own.
    pub body: Option<PathBuf>,
    /// The clothing vertices, likewise.
    pub clothing: Option<PathBuf>,
    /// CAPE's configuration.
    pub config: RunConfig,
    /// The packed set's [`hash_of`].
    pub data_hash: String,
}

/// One row with one seed.
#[derive(Debug, Clone)]
pub struct Job {
    /// The row.
    pub row: Row,
    /// Fixes weights, shuffles, noise and samples.
    pub seed: u64,
    /// Where it is kept.
    pub directory: PathBuf,
    config: RunConfig,
    key: String,
}

/// What a job came to.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct RowResult {
    /// The row.
    pub row: Row,
    /// Its seed.
    pub seed: u64,
    /// Of its configuration and data.
    key: String,
    /// Seconds of training or fitting.
    pub seconds: f64,
    /// Errors of a sample of the posterior, as the paper's table has them.
    pub sampled: GroupedSummary,
    /// Errors of the posterior's mean.
    pub mean: GroupedSummary,
    /// Wrinkles, for the posterior's mean.
    pub detail: Detail,
    /// Mean error of every test frame's sampled reconstruction, millimetres, by capture.
    captures: Vec<(String, Vec<f32>)>,
    /// Mean error of the sampled reconstruction at every vertex, millimetres.
    pub vertex_means: Vec<f32>,
}

impl Grid {
    /// The jobs of these rows, every trained one with `seeds` seeds.
    pub fn jobs(&self, rows: &[Row], seeds: u64) -> Result<Vec<Job>> {
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
                jobs.push(Job {
                    row,
                    seed: config.train.seed,
                    directory: self
                        .out
                        .join(row.name())
                        .join(format!("seed-{}", config.train.seed)),
                    key: format!("{:x}", hash.finalize()),
                    config,
                });
            }
        }
        Ok(jobs)
    }

    /// The body's file.
    pub fn body_path(&self) -> PathBuf {
        self.body.clone().unwrap_or_else(|| self.data.join(BODY_FILE))
    }

    fn body(&self, set: &PackedSet) -> Result<(SmplModel, ClothingMask)> {
        run::body_and_clothing(&self.data, set, self.body.as_deref(), self.clothing.as_deref())
    }
}

/// A hash of a packed set's arrays.
pub fn hash_of(data: &Path) -> Result<String> {
    let mut hash = Sha256::new();
    let mut buffer = vec![0; 1 << 20];
    for part in [Part::Train, Part::Test] {
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
    Ok(format!("{:x}", hash.finalize()))
}

impl Job {
    /// What it came to, if it is done and neither its configuration nor its data changed since.
    pub fn result(&self) -> Option<RowResult> {
        let text = fs::read(self.directory.join(RESULT)).ok()?;
        let result: RowResult = serde_json::from_slice(&text).ok()?;
        (result.key == self.key).then_some(result)
    }

    fn run_directory(&self) -> PathBuf {
        self.directory.join("run")
    }

    /// The trainer that goes on with it; none for rows that are not trained. A run of another
    /// configuration or other data in its place is removed.
    pub fn trainer(&self, grid: &Grid, device: &Device) -> Result<Option<Trainer>> {
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
        let (body, clothing) = (grid.body.as_deref(), grid.clothing.as_deref());
        let config = self.config.clone();
        Trainer::create(&root, &grid.data, body, clothing, config, device).map(Some)
    }

    /// Measures the row on the test frames and keeps the result; `seconds` is what its training
    /// took. Rows that are not trained are fitted here.
    pub fn measure(
        &self,
        grid: &Grid,
        seconds: f64,
        device: &Device,
        progress: &mut Progress,
    ) -> Result<RowResult> {
        let start = Instant::now();
        let set = Arc::new(PackedSet::open(&grid.data, Part::Test)?);
        let (body, mask) = grid.body(&set)?;
        let clothing: Vec<usize> = mask.indices().collect();
        let mut sampled = Gathered::new(body.vertices(), &clothing);
        let mut mean = sampled.clone();
        let mut detail = DetailMeter::new(&body, &clothing);
        if self.row.is_trained() {
            let run = Run::open(&self.run_directory(), device)?;
            let options = EvalOptions { seed: self.seed, ..EvalOptions::default() };
            // An auto-encoder's code is its mean.
            let variational = self.config.model.variational;
            for posterior in [PosteriorUse::Mean, PosteriorUse::Sample] {
                if posterior == PosteriorUse::Sample && !variational {
                    continue;
                }
                let options = EvalOptions { posterior, ..options };
                reconstruct_test(&run, &set, options, progress, &mut |row, predicted, truth| {
                    if posterior == PosteriorUse::Sample {
                        return sampled.push(&set, row, predicted, truth);
                    }
                    detail.push(predicted, truth);
                    if !variational {
                        sampled.push(&set, row, predicted, truth)?;
                    }
                    mean.push(&set, row, predicted, truth)
                })?;
            }
        } else {
            let reconstruct = self.fitted(grid, progress)?;
            for row in 0..set.frames() {
                let truth = set.displacement_row(row)?;
                let predicted = reconstruct(&truth)?;
                let [predicted, truth] = [predicted, truth]
                    .map(|values| values.iter().map(|&x| x as f32).collect::<Vec<_>>());
                sampled.push(&set, row, &predicted, &truth)?;
                mean.push(&set, row, &predicted, &truth)?;
                detail.push(&predicted, &truth);
                progress(row + 1, set.frames());
            }
        }
        let mut captures: Vec<(String, Vec<f32>)> = Vec::new();
        for frame in sampled.frames() {
            match captures.last_mut() {
                Some((last, errors)) if *last == frame.capture => errors.push(frame.mean as f32),
                _ => captures.push((frame.capture.clone(), vec![frame.mean as f32])),
            }
        }
        let result = RowResult {
            row: self.row,
            seed: self.seed,
            key: self.key.clone(),
            seconds: if self.row.is_trained() { seconds } else { start.elapsed().as_secs_f64() },
            sampled: sampled.summary(),
            mean: mean.summary(),
            detail: detail.detail(),
            captures,
            vertex_means: sampled.vertex_means(),
        };
        fs::create_dir_all(&self.directory).map_err(|source| Error::io(&self.directory, source))?;
        write_json(&self.directory.join(RESULT), &result)?;
        // As it will be read from now on, to the last digit.
        Ok(self.result().unwrap_or(result))
    }

    /// The reconstruction of a row that is fitted, not trained.
    #[allow(clippy::type_complexity)]
    fn fitted(
        &self,
        grid: &Grid,
        progress: &mut Progress,
    ) -> Result<Box<dyn Fn(&[f64]) -> Result<Vec<f64>>>> {
        if self.row == Row::Mean {
            let statistics = Statistics::of_packed(&grid.data, progress)?;
            let mean: Vec<f64> = statistics.mean().iter().copied().collect();
            return Ok(Box::new(move |_| Ok(mean.clone())));
        }
        let set = PackedSet::open(&grid.data, Part::Train)?;
        let statistics = Statistics::of_packed(&grid.data, &mut crate::silent)?;
        let rows = statistics.training_rows(set.frames()).len();
        // A small set has fewer directions than the paper's 18.
        let components = self.config.model.latent.min(rows.saturating_sub(1));
        let options = PcaOptions { components, seed: self.seed, ..PcaOptions::default() };
        let pca = Pca::of_packed(&grid.data, &options, progress)?;
        fs::create_dir_all(&self.directory).map_err(|source| Error::io(&self.directory, source))?;
        pca.save(self.directory.join(PCA))?;
        Ok(Box::new(move |truth| {
            let rows = Array2::from_shape_vec((1, truth.len()), truth.to_vec())
                .map_err(|error| Error::argument(error.to_string()))?;
            let decoded = pca.decode(&pca.encode(&rows.view()).view());
            Ok(decoded.index_axis(Axis(0), 0).to_vec())
        }))
    }
}
