//! Table of the results of several methods.

use serde::Serialize;

use cape_stats::{
    bootstrap::{Cluster, ConfidenceInterval, clusters, mean_interval},
    paired_test::sign_flip_test,
};

use super::{MethodResults, RunErrors};
use crate::surface_detail::SurfaceDetail;
use cape_stats::errors::{GroupedSummary, Histogram};

/// Comparison of methods on the same test frames.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/../cape-train/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use cape_synth::synthetic_body;
/// use cape_data::{PackedSet, Split};
/// use cape_eval::comparison::{RunErrorMeter, MethodResults, ComparisonTable};
///
/// // Two methods: one without errors, one with an error of 1 mm along x.
/// let directory = captures()?;
/// let set = PackedSet::open(&directory.path().join("packed"), Split::Test)?;
/// let clothing = [3000, 3001, 3002];
/// let measure = |offset: f32| -> cape_train::Result<_> {
///     let mut meter = RunErrorMeter::new(&synthetic_body(), &clothing);
///     for row in 0..set.frames() {
///         let truth: Vec<f32> = set.displacement_row(row)?.iter().map(|&x| x as f32).collect();
///         let mut predicted = truth.clone();
///         predicted.iter_mut().step_by(3).for_each(|x| *x += offset);
///         meter.push_sampled(&set, row, &predicted, &truth)?;
///         meter.push_mean(&set, row, &predicted, &truth)?;
///     }
///     Ok(meter.errors())
/// };
/// let (exact, near) = (measure(0.0)?, measure(0.001)?);
/// let method = |name: &str, result| MethodResults {
///     name: name.to_lowercase(),
///     label: name.to_owned(),
///     results: vec![result],
///     seconds: 1.0,
/// };
/// let table = ComparisonTable::new(&[method("Exact", &exact), method("Near", &near)], Some(0));
/// assert_eq!((table.frames, table.captures, table.vertices), (4, Some(1), 3));
/// assert!((table.lines[1].mean - 1.0).abs() < 1e-3);
/// assert!(table.markdown().contains("Near"));
/// assert!(table.with_body("sculpted").caption().contains("Body: sculpted."));
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, Serialize)]
pub struct ComparisonTable {
    /// One row per method.
    pub lines: Vec<ComparisonRow>,
    /// Name of the reference method, with which the others are compared.
    pub reference: Option<String>,
    /// Number of test frames.
    pub frames: usize,
    /// Number of captures of the test frames, the units of confidence intervals and tests; `None` if
    /// the packed set does not tell the captures.
    pub captures: Option<usize>,
    /// Number of clothing vertices, at which errors are measured.
    pub vertices: usize,
    /// Name of the body of the frames, if it is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub body: Option<String>,
}

/// Row of a method, over all its seeds.
#[derive(Debug, Clone, Serialize)]
pub struct ComparisonRow {
    /// Name in files.
    #[serde(rename = "row")]
    pub name: String,
    /// Name in tables.
    #[serde(skip)]
    pub label: String,
    /// Number of seeds.
    pub seeds: usize,
    /// Mean sampled error, millimetres; mean over seeds.
    pub mean: f64,
    /// Standard deviation of the sampled error over frames and vertices, millimetres; mean over
    /// seeds.
    pub std: f64,
    /// Median sampled error, millimetres; mean over seeds.
    pub median: f64,
    /// Standard deviation of the mean error between seeds, millimetres; `None` for one seed.
    pub between_seeds: Option<f64>,
    /// 95 % confidence interval of the mean error, by bootstrap over captures; `None` if they are
    /// unknown or fewer than two.
    pub interval: Option<ConfidenceInterval>,
    /// Mean error of reconstructions from the mean of the posterior, millimetres.
    pub posterior_mean: f64,
    /// Surface detail.
    pub detail: SurfaceDetail,
    /// Mean error minus that of the reference, millimetres, and the p-value of the difference, if
    /// captures are known.
    pub against: Option<(f64, Option<f64>)>,
    /// Training time of all seeds together, seconds.
    pub seconds: f64,
    /// Mean sampled error by outfit, millimetres.
    pub outfits: Vec<(String, f64)>,
    /// Mean sampled error by sequence, millimetres.
    pub sequences: Vec<(String, f64)>,
    /// Histogram of the sampled errors, all seeds together.
    pub histogram: Histogram,
}

impl ComparisonTable {
    /// Creates a table of `methods` in this order; `reference` is the index of the reference
    /// method.
    pub fn new(methods: &[MethodResults], reference: Option<usize>) -> Self {
        let reference = reference
            .and_then(|place| methods.get(place))
            .filter(|method| !method.results.is_empty());
        let lines = methods
            .iter()
            .filter(|method| !method.results.is_empty())
            .map(|method| {
                let other = reference.filter(|other| other.name != method.name);
                ComparisonRow::new(method, other.map_or(&[][..], |other| &other.results))
            })
            .collect();
        let first = methods.iter().find_map(|method| method.results.first());
        let frames = first.map_or(0, |result| result.frames());
        let captures = first.map_or(Some(0), |result| result.clusters().map(|found| found.len()));
        let errors = first.map_or(0, |result| result.sampled.overall.count as usize);
        let vertices = errors.checked_div(frames).unwrap_or(0);
        let reference = reference.map(|method| method.name.clone());
        Self { lines, reference, frames, captures, vertices, body: None }
    }

    /// The table with the name of the body of its frames.
    #[must_use]
    pub fn with_body(self, name: impl Into<String>) -> Self {
        Self { body: Some(name.into()), ..self }
    }
}

impl RunErrors {
    /// Number of test frames.
    fn frames(&self) -> usize {
        self.captures.iter().map(|(_, errors)| errors.len()).sum()
    }

    /// Errors summed by capture; `None` if the captures are unknown.
    fn clusters(&self) -> Option<Vec<(String, Cluster)>> {
        let mut frames = Vec::with_capacity(self.frames());
        for (capture, errors) in &self.captures {
            let capture = capture.as_deref()?;
            frames.extend(errors.iter().map(|&error| (capture, f64::from(error))));
        }
        let found = clusters(frames.into_iter()).into_iter();
        Some(found.map(|(capture, cluster)| (capture.to_owned(), cluster)).collect())
    }
}

/// Clusters averaged over seeds; `None` if the captures are unknown.
fn averaged(results: &[&RunErrors]) -> Option<Vec<Cluster>> {
    let mut sum: Vec<Cluster> = Vec::new();
    for result in results {
        let own = result.clusters()?;
        sum.resize(own.len(), Cluster::default());
        for (sum, (_, own)) in sum.iter_mut().zip(&own) {
            sum.sum += own.sum / results.len() as f64;
            sum.count = own.count;
        }
    }
    Some(sum)
}

/// Difference of the mean errors of two methods on the same frames, and its p-value if the captures
/// are known; `None` if the frames differ.
fn difference(own: &[&RunErrors], reference: &[&RunErrors]) -> Option<(f64, Option<f64>)> {
    let (ours, theirs) = (own.first()?, reference.first()?);
    let names = |result: &RunErrors| -> Option<Vec<String>> {
        Some(result.clusters()?.into_iter().map(|(name, _)| name).collect())
    };
    if ours.frames() != theirs.frames() || names(ours) != names(theirs) {
        return None;
    }
    let (Some(ours), Some(theirs)) = (averaged(own), averaged(reference)) else {
        let mean = |results: &[&RunErrors]| {
            mean_of(results.iter().map(|result| result.sampled.overall.mean))
        };
        return Some((mean(own) - mean(reference), None));
    };
    let differences: Vec<f64> = ours.iter().zip(&theirs).map(|(a, b)| a.sum - b.sum).collect();
    let count: f64 = ours.iter().map(|cluster| cluster.count).sum();
    Some((differences.iter().sum::<f64>() / count, sign_flip_test(&differences)))
}

fn mean_of(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), x| (sum + x, count + 1.0));
    sum / count
}

impl ComparisonRow {
    fn new(method: &MethodResults, reference: &[&RunErrors]) -> Self {
        let results = &method.results;
        let over = |f: &dyn Fn(&RunErrors) -> f64| mean_of(results.iter().map(|result| f(result)));
        let mean = over(&|r| r.sampled.overall.mean);
        let between_seeds = (results.len() > 1).then(|| {
            let squares = results.iter().map(|r| (r.sampled.overall.mean - mean).powi(2));
            (squares.sum::<f64>() / (results.len() - 1) as f64).sqrt()
        });
        let by = |of: &dyn Fn(&GroupedSummary) -> Vec<(String, f64)>| -> Vec<(String, f64)> {
            let names = of(&results[0].sampled);
            names
                .into_iter()
                .map(|(name, _)| {
                    let found = |r: &&RunErrors| {
                        of(&r.sampled).into_iter().find(|(n, _)| *n == name).map(|(_, x)| x)
                    };
                    let mean = mean_of(results.iter().filter_map(found));
                    (name, mean)
                })
                .collect()
        };
        let mut histogram = results[0].histogram.clone();
        for result in &results[1..] {
            histogram.add(&result.histogram);
        }
        Self {
            name: method.name.clone(),
            label: method.label.clone(),
            seeds: results.len(),
            mean,
            std: over(&|r| r.sampled.overall.std),
            median: over(&|r| r.sampled.overall.median),
            between_seeds,
            interval: averaged(results).and_then(|own| mean_interval(&own)),
            posterior_mean: over(&|r| r.mean.overall.mean),
            detail: SurfaceDetail {
                edge_mm: over(&|r| r.detail.edge_mm),
                normal_degrees: over(&|r| r.detail.normal_degrees),
                high_energy: over(&|r| r.detail.high_energy),
            },
            against: difference(results, reference),
            seconds: method.seconds,
            outfits: by(&|s| s.outfits.iter().map(|(k, v)| (k.to_string(), v.mean)).collect()),
            sequences: by(&|s| s.sequences.iter().map(|(k, v)| (k.clone(), v.mean)).collect()),
            histogram,
        }
    }
}

#[cfg(test)]
mod tests {
    use cape_core::Outfit;

    use super::*;
    use cape_stats::errors::GroupedErrors;

    /// Results with one error per frame and capture.
    fn measured(frames: &[(&str, f32)]) -> RunErrors {
        let mut errors = GroupedErrors::new();
        let mut captures = Vec::new();
        for &(capture, error) in frames {
            errors.push(Outfit::LONG_LONG, Some(capture), &[error]);
            captures.push((Some(capture.to_owned()), vec![error]));
        }
        RunErrors {
            sampled: errors.summary(),
            mean: errors.summary(),
            detail: SurfaceDetail::default(),
            captures,
            vertex_means: vec![0.0],
            histogram: errors.overall().histogram(0.25, 200),
        }
    }

    fn method<'a>(name: &str, results: &[&'a RunErrors]) -> MethodResults<'a> {
        let label = name.to_uppercase();
        MethodResults { name: name.to_owned(), label, results: results.to_vec(), seconds: 1.0 }
    }

    #[test]
    fn lines_are_compared_with_the_reference() {
        let one = measured(&[("a", 1.0), ("b", 3.0), ("a", 2.0)]);
        let two = measured(&[("a", 2.0), ("b", 4.0), ("a", 3.0)]);
        let elsewhere = measured(&[("c", 2.0)]);
        let methods = [method("x", &[&two]), method("y", &[&one]), method("z", &[&elsewhere])];
        let table = ComparisonTable::new(&methods, Some(1));
        assert_eq!((table.frames, table.captures, table.vertices), (3, Some(2), 1));
        assert_eq!(table.reference.as_deref(), Some("y"));
        let [x, y, z] = &table.lines[..] else { panic!("{table:?}") };
        assert_eq!(x.against, Some((1.0, Some(0.5))));
        assert_eq!((y.against, z.against), (None, None));
        assert!(
            ComparisonTable::new(&methods, None).lines.iter().all(|line| line.against.is_none())
        );
    }

    #[test]
    fn unknown_captures_give_no_intervals_and_tests() {
        let unknown = |errors: &[f32]| {
            let frames: Vec<(&str, f32)> = errors.iter().map(|&error| ("", error)).collect();
            let mut measured = measured(&frames);
            measured.captures = vec![(None, errors.to_vec())];
            measured
        };
        let (one, two, short) = (unknown(&[1.0, 3.0]), unknown(&[2.0, 5.0]), unknown(&[2.0]));
        let methods = [method("x", &[&two]), method("y", &[&one]), method("z", &[&short])];
        let table = ComparisonTable::new(&methods, Some(1));
        assert_eq!((table.frames, table.captures), (2, None));
        assert_eq!(table.lines[0].against, Some((1.5, None)));
        assert_eq!(table.lines[2].against, None, "another number of frames");
        assert!(table.lines.iter().all(|line| line.interval.is_none()));
        let caption = table.caption();
        assert!(caption.contains("captures of the frames are unknown"), "{caption}");
        assert!(!caption.contains("bootstrap"), "{caption}");
    }

    #[test]
    fn seeds_are_averaged_and_counted_together() {
        let results = [measured(&[("a", 1.0), ("b", 3.0)]), measured(&[("a", 2.0), ("b", 4.0)])];
        let table = ComparisonTable::new(&[method("x", &[&results[0], &results[1]])], None);
        let line = &table.lines[0];
        assert_eq!((line.seeds, line.mean), (2, 2.5));
        assert!((line.between_seeds.unwrap() - 0.5_f64.sqrt()).abs() < 1e-12);
        assert_eq!(line.sequences, [("a".to_owned(), 1.5), ("b".to_owned(), 3.5)]);
        assert_eq!(line.histogram.total(), 4);
    }
}
