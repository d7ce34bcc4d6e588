//! Results of a report and their tables.

use std::path::PathBuf;

use cape_layer::experiment::{
    BaselineErrors, ComponentCurve, ReconstructionResult, RegressionResult,
};
use serde::Serialize;

use super::{cape::CapeComparison, jobs::NamedSet, tables::ReportTable};
use crate::html;

/// Name and size of a set.
#[derive(Debug, Serialize)]
pub(super) struct SetDescription {
    pub(super) name: String,
    pub(super) sequences: usize,
    pub(super) frames: usize,
    pub(super) vertices: usize,
}

#[derive(Debug, Serialize)]
pub(super) struct OutputPaths {
    pub(super) out: PathBuf,
    pub(super) sets: Vec<SetDescription>,
    pub(super) reconstruction: Vec<ReconstructionResult>,
    pub(super) regression: Vec<RegressionResult>,
    pub(super) curves: Vec<ComponentCurve>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) comparison: Option<CapeComparison>,
}

impl SetDescription {
    pub(super) fn new(named: &NamedSet) -> Self {
        let NamedSet { name, set, .. } = named;
        Self {
            name: name.clone(),
            sequences: set.sequences.len(),
            frames: set.frames(),
            vertices: set.vertices(),
        }
    }
}

impl OutputPaths {
    /// Sizes of the sets, as a paragraph of the page.
    pub(super) fn described(&self) -> String {
        let line = |set: &SetDescription| {
            let SetDescription { name, sequences, frames, vertices } = set;
            let name = html::escaped(name);
            format!("{name}: {sequences} sequences, {frames} frames of {vertices} vertices")
        };
        format!("<p>{}</p>\n", self.sets.iter().map(line).collect::<Vec<_>>().join("<br>"))
    }

    pub(super) fn tables(&self) -> Vec<ReportTable> {
        let mut tables = vec![self.reconstructions(), self.components()];
        let (seen, new): (Vec<_>, Vec<_>) =
            self.regression.iter().partition(|line| line.factor.is_empty());
        tables.push(ReportTable {
            name: "regression",
            title: "Regression of held-out frames (table 2), mm".into(),
            caption: "One frame of five plays no part in the training, and a fifth of the others decides \
                      when it stops. Errors are means over trainings, with their standard deviation. \
                      \u{201c}Space\u{201d} is the error of the projection of held-out frames on the \
                      components of the training frames, the lower bound of predictions. Baselines: the \
                      mean of the training frames, the training frame with the nearest pose, ridge \
                      regression, interpolation in time between training frames, and the mean of the \
                      same moment in the other sequences of the motion. \u{201c}Inside\u{201d} is the share of \
                      the predicted surface inside the body before and after it is pushed out, and \
                      \u{201c}pushed out\u{201d} the error afterwards. \u{201c}Dressed surface\u{201d} is \
                      E_pred over clothing and bare skin, by area, with no error of the skin, because the \
                      body is known; the paper\u{2019}s errors are over the whole surface."
                .into(),
            header: heads(&["set", "sequence", "trained", "held out", "E_train", "E_pred"]),
            rows: seen.iter().map(|line| cells(line, [&line.set, &line.name])).collect(),
        });
        if !new.is_empty() {
            tables.push(ReportTable {
                name: "new",
                title: "Prediction of left-out values, mm".into(),
                caption:
                    "All sequences of the named value are left out of components and regression."
                        .into(),
                header: heads(&["new", "left out", "trained", "predicted", "E_train", "E_pred"]),
                rows: new.iter().map(|line| cells(line, [&line.factor, &line.name])).collect(),
            });
        }
        tables.extend(self.comparison.as_ref().map(compared));
        tables
    }

    fn components(&self) -> ReportTable {
        let longest = self.curves.iter().map(|curve| &curve.components[..]).max_by_key(|c| c.len());
        let counts = longest.unwrap_or_default();
        let mut rows = Vec::new();
        for ComponentCurve { set, components: _, own_mm, held_out_mm } in &self.curves {
            for (kind, errors) in [("all", own_mm), ("held out", held_out_mm)] {
                let names = [set.clone(), kind.to_owned()].into_iter();
                rows.push(names.chain(padded(errors, counts.len())).collect());
            }
        }
        let header = ["set", "frames"].into_iter().map(str::to_owned);
        ReportTable {
            name: "components",
            title: "Error by number of components (figure 3), mm".into(),
            caption: "Mean over the sequences of a set, each with its own components: of all frames, and \
                      of every fifth frame with the components of the other frames."
                .into(),
            header: header.chain(counts.iter().map(ToString::to_string)).collect(),
            rows,
        }
    }

    fn reconstructions(&self) -> ReportTable {
        let counts = self.reconstruction.first().map_or(&[][..], |line| &line.components);
        let counts = counts.iter().map(ToString::to_string);
        let header = ["set", "sequence", "frames"].into_iter().map(str::to_owned).chain(counts);
        let rows = self.reconstruction.iter().map(|line| {
            let mut cells = vec![line.set.clone(), line.sequence.clone(), line.frames.to_string()];
            let (all, few) = line.errors_mm.split_last().unwrap_or((&0.0, &[]));
            cells.extend(few.iter().map(|error| format!("{error:.2}")));
            cells.extend([format!("{all:.1e}"), format!("{:.1e}", line.largest_mm)]);
            cells
        });
        ReportTable {
            name: "reconstruction",
            title: "Reconstruction by number of components (table 1), mm".into(),
            caption:
                "Mean distance of clothing vertices from the ground truth with the first components \
                      of each sequence; with all components also the largest distance."
                    .into(),
            header: header.chain(["all".into(), "largest".into()]).collect(),
            rows: rows.collect(),
        }
    }
}

/// Cells of numbers, with dashes up to a number of columns.
fn padded(numbers: &[f64], columns: usize) -> Vec<String> {
    let mut cells: Vec<String> = numbers.iter().map(|number| format!("{number:.2}")).collect();
    cells.resize(columns, "–".into());
    cells
}

fn cells(line: &RegressionResult, names: [&str; 2]) -> Vec<String> {
    let mut cells: Vec<String> = names.into_iter().map(str::to_owned).collect();
    cells.extend([line.trained, line.frames].map(|count| count.to_string()));
    let deviation = line.predict_deviation_mm().map_or(String::new(), |d| format!(" ± {d:.2}"));
    cells.push(format!("{:.2}", line.train_mm));
    cells.push(format!("{:.2}{deviation}", line.predict_mm));
    cells.push(format!("{:.2}", line.dressed_mm));
    let BaselineErrors { mean_mm, nearest_pose_mm, ridge_mm, interpolation_mm, same_moment_mm } =
        line.baselines;
    let errors = [line.space_mm, mean_mm, nearest_pose_mm, ridge_mm];
    cells.extend(errors.map(|error| format!("{error:.2}")));
    let optional = [interpolation_mm, same_moment_mm];
    cells.extend(optional.map(|error| error.map_or("–".into(), |error| format!("{error:.2}"))));
    let [before, after] =
        [line.pushed_out.inside.before, line.pushed_out.inside.after].map(|share| 100.0 * share);
    cells.push(format!("{before:.2} → {after:.2}"));
    cells.push(format!("{:.2}", line.pushed_out.error_mm));
    cells.push(line.iterations.to_string());
    cells
}

fn heads(names: &[&str]) -> Vec<String> {
    let measures = [
        "dressed surface",
        "space",
        "mean",
        "nearest pose",
        "ridge",
        "interpolation",
        "same moment",
        "inside, %",
        "pushed out",
        "iterations",
    ];
    names.iter().chain(&measures).map(|&name| name.to_owned()).collect()
}

fn compared(comparison: &CapeComparison) -> ReportTable {
    let said = |is: bool| if is { "yes" } else { "no" }.to_owned();
    let rows = comparison.methods.iter().map(|method| {
        vec![
            method.method.clone(),
            method.code.to_string(),
            said(true),
            said(method.pose_dependent),
            said(method.probabilistic),
            format!("{:.2}", method.reconstruction_mm),
            format!("{:.2}", method.prediction_mm),
            method.spread_mm.map_or("–".into(), |spread| format!("{spread:.2}")),
        ]
    });
    let header = [
        "method",
        "code",
        "parametric",
        "pose-dependent",
        "probabilistic",
        "reconstruction",
        "from pose",
        "spread",
    ];
    ReportTable {
        name: "cape",
        title: format!("Displacements of {} test frames, mm", comparison.frames),
        caption:
            "Reconstruction is from a frame's own code. From pose is the prediction from pose and \
                  outfit alone: the mean of the components, the regression, and CAPE's decoder at the \
                  prior mean. Spread is the mean distance of samples from their mean."
                .into(),
        header: header.map(str::to_owned).to_vec(),
        rows: rows.collect(),
    }
}
