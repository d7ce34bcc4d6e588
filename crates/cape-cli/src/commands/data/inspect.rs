use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
};

use cape_core::{
    Outfit, SmplModel,
    smpl::{BODY_FILE, ClothingMask},
};
use cape_data::{
    DisplacementStatistics,
    inspect::{InspectOptions, Inspection, Magnitudes, PresetCompleteness, inspect},
    raw::CLOTHING_FILE,
};
use cape_eval::clothing_statistics::{ClothingStatistics, ClothingStatisticsOptions};
use clap::Args;
use serde::Serialize;

use crate::{
    body_source::BodyFileArgs,
    console::Console,
    error::{Error, Result},
    options::at_least_one,
    table::Table,
};

/// Check raw captures or a packed set for problems.
///
/// Counts frames by subject and outfit, reads some frames of each capture, and checks units,
/// alignment with the minimal body shape, poses and files. Each warning names a remedy.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  cape data inspect cape_release --preset male\n  \
                        cape data inspect packed --statistics --reference trainset_stats.npz")]
pub(crate) struct InspectArgs {
    /// Raw data (sequences/, minimal_body_shape/) or a packed set.
    #[arg(value_name = "PATH")]
    path: PathBuf,
    /// Frames to read per capture.
    #[arg(long, default_value_t = 3, value_name = "N", value_parser = at_least_one)]
    frames: usize,
    /// Indices of the clothing vertices, if PATH has no clothing_verts_idx.npy.
    #[arg(long, value_name = "FILE.npy")]
    clothing: Option<PathBuf>,
    /// Preset to compare raw data with: how many of its frames are there, and what is missing.
    #[arg(long, value_parser = ["male", "female"])]
    preset: Option<String>,
    /// Also measure how the clothing of a packed set varies: principal components, dependence on the
    /// pose, repeated poses, wrinkles.
    #[arg(long)]
    statistics: bool,
    /// Statistics to compare mean and deviation with, such as the release's trainset_stats.npz.
    #[arg(long, value_name = "FILE.npz", requires = "statistics")]
    reference: Option<PathBuf>,
    /// Indices of the clothing vertices of --reference [default: those of PATH].
    #[arg(long, value_name = "FILE.npy", requires = "reference")]
    reference_clothing: Option<PathBuf>,
    #[command(flatten)]
    body: BodyFileArgs,
}

/// Report of `cape data inspect --json`.
#[derive(Debug, Serialize)]
struct InspectReport {
    #[serde(flatten)]
    found: Inspection,
    #[serde(skip_serializing_if = "Option::is_none")]
    clothing_statistics: Option<ClothingStatistics>,
}

impl InspectArgs {
    pub(crate) fn run(self, console: Console) -> Result {
        let reference = self.reference.map(DisplacementStatistics::load).transpose()?;
        let reference_clothing = match (&reference, self.reference_clothing) {
            (Some(reference), Some(file)) => {
                Some(ClothingMask::load(file, reference.vertices())?.indices().collect())
            }
            _ => None,
        };
        let options = InspectOptions {
            frames: self.frames,
            clothing: self.clothing,
            body: self.body.load()?,
            preset: self.preset,
        };
        let found = console.while_showing("inspect", "frames", |progress| {
            inspect(&self.path, &options, progress)
        })?;
        let clothing_statistics = if self.statistics {
            if found.kind != "packed" {
                return Err(Error::message(format!(
                    "{}: --statistics is of packed sets: pack the data first (cape data pack)",
                    self.path.display()
                )));
            }
            let InspectOptions { clothing, body, .. } = options;
            let options =
                ClothingStatisticsOptions { reference, reference_clothing, ..Default::default() };
            let (body, clothing) = clothed_body(&self.path, body, clothing)?;
            let clothing: Vec<usize> = clothing.indices().collect();
            Some(console.while_showing("clothing", "steps", |progress| {
                ClothingStatistics::measure(&self.path, &body, &clothing, &options, progress)
            })?)
        } else {
            None
        };
        let report = InspectReport { found, clothing_statistics };
        console.result(&report, || {
            let mut parts = vec![text(&report.found)];
            parts.extend(report.clothing_statistics.as_ref().map(statistics));
            parts.join("\n\n")
        })
    }
}

/// Body and clothing vertices: those given, else those in the packed set.
fn clothed_body(
    data: &Path,
    body: Option<SmplModel>,
    clothing: Option<PathBuf>,
) -> Result<(SmplModel, ClothingMask), Error> {
    let body = match body {
        Some(body) => body,
        None => SmplModel::load(data.join(BODY_FILE)).map_err(|error| {
            Error::message(format!("{error}: give the body of the data with --body"))
        })?,
    };
    let indices = clothing.unwrap_or_else(|| data.join(CLOTHING_FILE));
    let mask = if indices.is_file() {
        ClothingMask::load(&indices, body.vertices())?
    } else {
        ClothingMask::from_weights(&body)?
    };
    Ok((body, mask))
}

/// Variation of the clothing.
fn statistics(found: &ClothingStatistics) -> String {
    let axes = |values: [f64; 3]| values.map(|x| format!("{x:.1}")).join(", ");
    let mut table = Table::new(["clothing", "x, y, z"]);
    table.row(["median of the mean, mm".to_owned(), axes(found.mean_mm)]);
    table.row(["median of the deviation, mm".to_owned(), axes(found.std_mm)]);
    if let Some(reference) = &found.reference {
        for (name, values) in [
            ("  reference: mean, mm", reference.mean_mm),
            ("  reference: deviation, mm", reference.std_mm),
            ("  ratio of the means", reference.mean_ratio),
            ("  ratio of the deviations", reference.std_ratio),
        ] {
            table.row([name.to_owned(), axes(values)]);
        }
    }
    let mut parts = vec![table.text()];
    let mut table = Table::new(["components", "error on test frames, mm", "explained variance"]);
    for error in &found.components {
        table.row([
            error.components.to_string(),
            format!("{:.2}", error.error_mm),
            format!("{:.3}", error.explained),
        ]);
    }
    parts.push(table.text());
    let mut lines = Vec::new();
    lines.push(match &found.pose {
        Some(pose) => format!(
            "pose: explains {:.0} % of the variance within {} captures ({:.1} of {:.1} mm are left); \
             autocorrelation of the rest {:.2}",
            100.0 * pose.explained,
            pose.captures,
            pose.error_mm,
            pose.variation_mm,
            pose.autocorrelation
        ),
        None => "pose: not measured, as captures are unknown or shorter than ten frames".into(),
    });
    lines.push(match &found.repeats {
        Some(repeats) => format!(
            "repeated poses: {:.1} mm between frames of the same garments and pose ({} pairs of \
             captures' frames, {:.2} rad apart in a joint)",
            repeats.difference_mm, repeats.pairs, repeats.angle
        ),
        None => "repeated poses: none in different captures of the same garments".into(),
    });
    let wrinkles = &found.wrinkles;
    lines.push(format!(
        "wrinkles: {:.2} mm in the upper half of the spectrum ({:.2} % of the energy), normals turned \
         by {:.1}°",
        wrinkles.fine_mm,
        100.0 * wrinkles.fine_share,
        wrinkles.normal_degrees
    ));
    parts.push(lines.join("\n"));
    parts.join("\n\n")
}

fn text(found: &Inspection) -> String {
    let mut parts = vec![format!("{} data, {} frames", found.kind, found.frames)];
    parts.push(counts(found));
    parts.push(facts(found));
    if !found.release.is_empty() {
        parts.push(found.release.join("\n"));
    }
    if let Some(preset) = &found.preset {
        parts.push(completeness(preset));
    }
    if found.warnings.is_empty() {
        parts.push("no problems found".into());
    } else {
        let lines: Vec<String> =
            found.warnings.iter().map(|warning| format!("warning: {warning}")).collect();
        parts.push(lines.join("\n"));
    }
    parts.join("\n\n")
}

/// Frames of a preset that are there, and what is missing.
fn completeness(found: &PresetCompleteness) -> String {
    let PresetCompleteness { preset, train, test, missing_subjects, missing_captures } = found;
    let mut lines = Vec::new();
    for (name, [there, complete]) in [("training", train), ("test", test)] {
        lines.push(format!(
            "preset {preset}: {there} of {complete} {name} frames{}",
            match complete.cmp(there) {
                std::cmp::Ordering::Equal => ", complete".to_owned(),
                std::cmp::Ordering::Greater => format!(", {} missing", complete - there),
                std::cmp::Ordering::Less => format!(", {} too many", there - complete),
            }
        ));
    }
    if !missing_subjects.is_empty() {
        lines.push(format!("missing subjects: {}", missing_subjects.join(" ")));
    }
    match missing_captures {
        Some(missing) if missing.is_empty() => {
            lines.push("all captures that the sequence lists name are there".into());
        }
        Some(missing) => lines.push(format!("missing captures: {}", missing.join(" "))),
        None => lines.push("without seq_lists/, which captures are missing is unknown".into()),
    }
    lines.join("\n")
}

/// Frames by subject (or part, where subjects are not known) and outfit.
fn counts(found: &Inspection) -> String {
    #[derive(Default)]
    struct Row<'a> {
        outfits: BTreeMap<Outfit, usize>,
        sequences: BTreeSet<&'a str>,
    }
    let mut rows: BTreeMap<(String, String), Row> = BTreeMap::new();
    for capture in &found.captures {
        let part = capture.part.map_or_else(String::new, |part| part.to_string());
        let subject = capture.subject.clone().unwrap_or_else(|| "(unknown)".into());
        let Row { outfits, sequences } = rows.entry((part, subject)).or_default();
        if let Some(outfit) = capture.outfit {
            *outfits.entry(outfit).or_default() += capture.frames;
        }
        sequences.extend(capture.sequence.as_deref());
    }
    let mut header = vec!["subject".to_owned()];
    let mut worn: BTreeSet<Outfit> = Outfit::PAPER.into_iter().collect();
    worn.extend(found.captures.iter().filter_map(|capture| capture.outfit));
    header.extend(worn.iter().map(ToString::to_string));
    header.push("sequences".into());
    let mut table = Table::new(header);
    for ((part, subject), Row { outfits, sequences }) in &rows {
        let mut row = vec![format!("{part} {subject}").trim().to_owned()];
        row.extend(
            worn.iter().map(|outfit| {
                outfits.get(outfit).map_or_else(|| "–".to_owned(), ToString::to_string)
            }),
        );
        row.push(if sequences.is_empty() { "–".into() } else { sequences.len().to_string() });
        table.row(row);
    }
    table.text()
}

fn facts(found: &Inspection) -> String {
    let mut table = Table::default();
    let lengths = |lengths: Option<Magnitudes>| {
        lengths.map_or_else(
            || "–".to_owned(),
            |lengths| format!("mean {:.1} mm, largest {:.1} mm", lengths.mean, lengths.max),
        )
    };
    let number = |value: Option<f64>, unit: &str| {
        value.map_or_else(|| "–".to_owned(), |value| format!("{value:.2} {unit}"))
    };
    let height = found
        .height_m
        .map_or_else(|| "–".to_owned(), |[low, high]| format!("{low:.2} to {high:.2} m"));
    for (name, value) in [
        ("frames read", found.examined.to_string()),
        ("vertices", found.vertices.to_string()),
        ("height of subjects", height),
        ("displacements", lengths(found.displacement_mm)),
        ("  clothing vertices", lengths(found.clothing_mm)),
        ("  head, hands, feet", lengths(found.elsewhere_mm)),
        ("largest joint rotation", number(found.largest_rotation, "rad")),
        ("largest translation", number(found.largest_translation_m, "m")),
    ] {
        table.row([name.to_owned(), value]);
    }
    table.text()
}
