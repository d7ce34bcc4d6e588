//! Results side by side.

use serde::Serialize;

use super::{
    Row, RowResult,
    resample::{Cluster, Interval, clusters, interval, sign_test},
};
use crate::{detail::Detail, metrics::GroupedSummary};

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
