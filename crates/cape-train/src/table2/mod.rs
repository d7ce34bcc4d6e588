//! CAPE's table 2: every method under one protocol.
//!
//! A [`Job`] is one row with one seed in a directory of its own: it is trained (or fitted), measured
//! on the test frames, and leaves a `result.json` with a key of its configuration and data, so that
//! it is not done again unless either changed. [`Table`] puts results side by side.

mod resample;
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
use cape_model::{DecoderBlock, DecoderConditions, LossConfig};
use ndarray::{Array2, Axis};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

pub use resample::Interval;

use crate::{
    Error, EvalOptions, Gathered, PosteriorUse, Progress, Result, Run, RunConfig, RunPaths,
    Trainer, checkpoint,
    data::{PackedSet, Part, Statistics, raw::BODY_FILE},
    detail::{Detail, DetailMeter},
    metrics::GroupedSummary,
    pca::{Pca, PcaOptions},
    reconstruct_test, run, write_json,
};
use resample::{Cluster, clusters, interval, sign_test};

const RESULT: &str = "result.json";
const PCA: &str = "pca.npz";

/// A row of the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Row {
    /// The mean training displacement in place of every frame.
    Mean,
    /// Principal components.
    Pca,
    /// CoMA with four-fold down-sampling.
    #[serde(rename = "coma-4")]
    Coma4,
    /// CoMA without down-sampling.
    #[serde(rename = "coma-1")]
    Coma1,
    /// CAPE.
    Cape,
    /// CAPE with affine blocks in the decoder.
    CapeAffine,
    /// CAPE without discriminator.
    NoDiscriminator,
    /// CAPE without residual blocks.
    NoResidual,
    /// CAPE without edge loss.
    NoEdge,
}

impl Row {
    /// All rows, in the table's order.
    pub const ALL: [Self; 9] = [
        Self::Mean,
        Self::Pca,
        Self::Coma4,
        Self::Coma1,
        Self::Cape,
        Self::CapeAffine,
        Self::NoDiscriminator,
        Self::NoResidual,
        Self::NoEdge,
    ];

    /// Its name in commands and directories.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Mean => "mean",
            Self::Pca => "pca",
            Self::Coma4 => "coma-4",
            Self::Coma1 => "coma-1",
            Self::Cape => "cape",
            Self::CapeAffine => "cape-affine",
            Self::NoDiscriminator => "no-discriminator",
            Self::NoResidual => "no-residual",
            Self::NoEdge => "no-edge",
        }
    }

    /// Its name in the table.
    pub const fn label(self) -> &'static str {
        match self {
            Self::Mean => "mean shape",
            Self::Pca => "PCA",
            Self::Coma4 => "CoMA-4",
            Self::Coma1 => "CoMA-1",
            Self::Cape => "CAPE",
            Self::CapeAffine => "CAPE-affine",
            Self::NoDiscriminator => "w/o discriminator",
            Self::NoResidual => "w/o residual block",
            Self::NoEdge => "w/o edge loss",
        }
    }

    /// Whether it is trained by gradients, so that seeds matter.
    pub const fn is_trained(self) -> bool {
        !matches!(self, Self::Mean | Self::Pca)
    }

    /// The configuration of this row: that of CAPE with one switch set another way; for CoMA the
    /// same encoder, latent size and training, without conditions and with the reconstruction loss
    /// only.
    pub fn configure(self, cape: &RunConfig) -> RunConfig {
        let mut config = cape.clone();
        let RunConfig { model, loss, .. } = &mut config;
        match self {
            Self::Mean | Self::Pca | Self::Cape => {}
            Self::CapeAffine => model.decoder = DecoderBlock::Affine,
            Self::NoDiscriminator => {
                model.discriminator = None;
                loss.gan = 0.0;
            }
            Self::NoResidual => model.decoder = DecoderBlock::Plain,
            Self::NoEdge => loss.edge = 0.0,
            Self::Coma4 | Self::Coma1 => {
                model.decoder = DecoderBlock::Plain;
                model.decoder_conditions = DecoderConditions::None;
                model.encoder_conditions = false;
                model.pose_embedding = 0;
                model.outfit_embedding = 0;
                model.variational = false;
                model.discriminator = None;
                // Where CAPE halves the mesh, and after the last layer, CoMA-4 quarters it.
                let layers = model.factors.len();
                for (layer, factor) in model.factors.iter_mut().enumerate() {
                    let pools = *factor > 1 || layer + 1 == layers;
                    *factor = if pools && self == Self::Coma4 { 4 } else { 1 };
                }
                *loss = LossConfig { edge: 0.0, kl: 0.0, gan: 0.0, ..loss.clone() };
            }
        }
        config
    }
}

impl std::str::FromStr for Row {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        Self::ALL.into_iter().find(|row| row.name() == text).ok_or_else(|| {
            let names: Vec<&str> = Self::ALL.iter().map(|row| row.name()).collect();
            Error::argument(format!("unknown row `{text}`: expected {}", names.join(", ")))
        })
    }
}

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
        let data = hash_of(&self.data)?;
        let mut jobs = Vec::new();
        for &row in rows {
            for seed in 0..if row.is_trained() { seeds } else { 1 } {
                let mut config = row.configure(&self.config);
                config.train.seed = self.config.train.seed + seed;
                config.validate()?;
                let text = toml::to_string(&config)
                    .map_err(|error| Error::argument(format!("settings: {error}")))?;
                let mut hash = Sha256::new();
                for part in [row.name(), &text, &data, env!("CARGO_PKG_VERSION")] {
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

/// Rows side by side.
#[derive(Debug, Clone, Serialize)]
pub struct Table {
    /// Rows in the table's order.
    pub lines: Vec<Line>,
    /// Test frames.
    pub frames: usize,
    /// Captures they are of, which intervals and tests are drawn over.
    pub captures: usize,
}

/// A row of the table, over all its seeds.
#[derive(Debug, Clone, Serialize)]
pub struct Line {
    /// The row.
    pub row: Row,
    /// How many seeds.
    pub seeds: usize,
    /// Mean error of sampled reconstructions, millimetres; mean over seeds.
    pub mean: f64,
    /// Standard deviation over frames and vertices; mean over seeds.
    pub std: f64,
    /// Median; mean over seeds.
    pub median: f64,
    /// Standard deviation of the mean over seeds.
    pub between_seeds: Option<f64>,
    /// 95 % interval of the mean, by bootstrap over captures.
    pub interval: Option<Interval>,
    /// Mean error of the posterior's mean.
    pub posterior_mean: f64,
    /// Wrinkles.
    pub detail: Detail,
    /// Mean error minus CAPE's, and how likely a difference as large is by chance.
    pub against_cape: Option<(f64, Option<f64>)>,
    /// Seconds of training, all seeds together.
    pub seconds: f64,
    /// Mean error by outfit, of sampled reconstructions.
    pub outfits: Vec<(String, f64)>,
    /// Mean error by sequence.
    pub sequences: Vec<(String, f64)>,
}

impl Table {
    /// Of results, in any order.
    pub fn new(results: &[RowResult]) -> Self {
        let of = |row: Row| results.iter().filter(move |result| result.row == row);
        let cape: Vec<&RowResult> = of(Row::Cape).collect();
        let lines = Row::ALL
            .into_iter()
            .filter_map(|row| {
                let results: Vec<&RowResult> = of(row).collect();
                (!results.is_empty()).then(|| Line::new(row, &results, &cape))
            })
            .collect();
        let first = results.first();
        let frames = first.map_or(0, |r| r.captures.iter().map(|(_, errors)| errors.len()).sum());
        let captures = first.map_or(0, |result| result.clusters().len());
        Self { lines, frames, captures }
    }
}

impl RowResult {
    fn clusters(&self) -> Vec<(String, Cluster)> {
        let frames = self.captures.iter().flat_map(|(capture, errors)| {
            errors.iter().map(move |&error| (capture.as_str(), f64::from(error)))
        });
        let found = clusters(frames);
        found.into_iter().map(|(capture, cluster)| (capture.to_owned(), cluster)).collect()
    }
}

/// Clusters of several seeds, averaged.
fn averaged(results: &[&RowResult]) -> Vec<Cluster> {
    let mut sum: Vec<Cluster> = Vec::new();
    for result in results {
        let own = result.clusters();
        sum.resize(own.len(), Cluster::default());
        for (sum, (_, own)) in sum.iter_mut().zip(&own) {
            sum.sum += own.sum / results.len() as f64;
            sum.count = own.count;
        }
    }
    sum
}

fn mean_of(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), x| (sum + x, count + 1.0));
    sum / count
}

impl Line {
    fn new(row: Row, results: &[&RowResult], cape: &[&RowResult]) -> Self {
        let over = |f: &dyn Fn(&RowResult) -> f64| mean_of(results.iter().map(|result| f(result)));
        let mean = over(&|r| r.sampled.overall.mean);
        let between_seeds = (results.len() > 1).then(|| {
            let squares = results.iter().map(|r| (r.sampled.overall.mean - mean).powi(2));
            (squares.sum::<f64>() / (results.len() - 1) as f64).sqrt()
        });
        let own = averaged(results);
        let comparable = row != Row::Cape
            && cape.first().is_some_and(|cape| {
                cape.clusters()
                    .iter()
                    .map(|(name, _)| name)
                    .eq(results[0].clusters().iter().map(|(name, _)| name))
            });
        let against_cape = comparable.then(|| {
            let theirs = averaged(cape);
            let differences: Vec<Cluster> = own
                .iter()
                .zip(&theirs)
                .map(|(a, b)| Cluster { sum: a.sum - b.sum, count: a.count })
                .collect();
            let count: f64 = differences.iter().map(|d| d.count).sum();
            let sum: f64 = differences.iter().map(|d| d.sum).sum();
            (sum / count, sign_test(&differences))
        });
        let by = |of: &dyn Fn(&GroupedSummary) -> Vec<(String, f64)>| -> Vec<(String, f64)> {
            let names = of(&results[0].sampled);
            names
                .into_iter()
                .map(|(name, _)| {
                    let found = |r: &&RowResult| {
                        of(&r.sampled).into_iter().find(|(n, _)| *n == name).map(|(_, x)| x)
                    };
                    let mean = mean_of(results.iter().filter_map(found));
                    (name, mean)
                })
                .collect()
        };
        Self {
            row,
            seeds: results.len(),
            mean,
            std: over(&|r| r.sampled.overall.std),
            median: over(&|r| r.sampled.overall.median),
            between_seeds,
            interval: interval(&own),
            posterior_mean: over(&|r| r.mean.overall.mean),
            detail: Detail {
                edge_mm: over(&|r| r.detail.edge_mm),
                normal_degrees: over(&|r| r.detail.normal_degrees),
                high_energy: over(&|r| r.detail.high_energy),
            },
            against_cape,
            seconds: results.iter().map(|r| r.seconds).sum(),
            outfits: by(&|s| s.outfits.iter().map(|(k, v)| (k.to_string(), v.mean)).collect()),
            sequences: by(&|s| s.sequences.iter().map(|(k, v)| (k.clone(), v.mean)).collect()),
        }
    }
}

#[cfg(test)]
mod tests {
    use cape_model::CapeConfig;

    use super::*;

    #[test]
    fn every_row_is_a_valid_configuration_and_differs_by_its_switch() {
        let cape = RunConfig::default();
        for row in Row::ALL {
            let config = row.configure(&cape);
            config.validate().unwrap();
            assert_eq!(config.train, cape.train);
            assert_eq!(config == cape, matches!(row, Row::Cape | Row::Mean | Row::Pca), "{row:?}");
            assert_eq!(row.name().parse::<Row>().unwrap(), row);
            assert_eq!(serde_json::to_string(&row).unwrap(), format!("\"{}\"", row.name()));
        }
        assert!("kilt".parse::<Row>().unwrap_err().to_string().contains("coma-4"));
        let of = |row: Row| row.configure(&cape).model;
        assert_eq!(of(Row::Coma4).factors, [1, 4, 1, 4, 1, 4, 1, 4]);
        assert_eq!(of(Row::Coma1).factors, [1; 8]);
        assert_eq!(of(Row::Coma1).latent, CapeConfig::paper().latent);
        assert_eq!(of(Row::Coma4).filters, CapeConfig::paper().filters);
    }
}
