use std::{
    collections::{BTreeMap, BTreeSet},
    path::PathBuf,
};

use cape_core::Outfit;
use cape_data::inspect::{InspectOptions, Inspection, Magnitudes, PresetCompleteness, inspect};
use clap::Args;

use crate::{
    body_source::BodyFileArgs, console::Console, error::Result, options::at_least_one, table::Table,
};

/// Check raw captures or a packed set for problems.
///
/// Counts frames by subject and outfit, reads some frames of each capture, and checks units,
/// alignment with the minimal body shape, poses and files. Each warning names a remedy.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  cape data inspect cape_release --preset male\n  \
                        cape data inspect packed --frames 10")]
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
    #[command(flatten)]
    body: BodyFileArgs,
}

impl InspectArgs {
    pub(crate) fn run(self, console: Console) -> Result {
        let options = InspectOptions {
            frames: self.frames,
            clothing: self.clothing,
            body: self.body.load()?,
            preset: self.preset,
        };
        let found = console.while_showing("inspect", "frames", |progress| {
            inspect(&self.path, &options, progress)
        })?;
        console.result(&found, || text(&found))
    }
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
