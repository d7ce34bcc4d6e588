use std::path::PathBuf;

use cape_core::smpl::Gender;
use cape_data::{
    self, PackOptions, PackReport, SplitSpec,
    raw::{SPLIT_FILE, gender_split_file},
};
use clap::Args;
use serde::Serialize;

use crate::{
    console::Console,
    error::{Error, Result},
    options::{ResumableOutputArgs, choices},
    table::Table,
};

/// Genders of the release's splits.
const PRESETS: [(&str, Gender); 2] = [("male", Gender::Male), ("female", Gender::Female)];
/// Missing subjects and sequences that are listed at most.
const SHOWN: usize = 20;

/// Pack raw captures into the arrays for training.
///
/// Writes displacements, poses and outfit labels of all frames in the layout of the CAPE release, and
/// normalisation statistics. Unreadable frames are left out and listed. Run the same command again to
/// resume an interrupted packing.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  cape data pack raw --preset male --out packed\n  cape data pack cape_release --preset \
                        male --out packed-male"
)]
pub(crate) struct PackArgs {
    /// Raw data, with sequences/ and minimal_body_shape/.
    #[arg(value_name = "RAW")]
    raw: PathBuf,
    #[command(flatten)]
    output: ResumableOutputArgs,
    /// Pack the male or female subjects by RAW/split_male.toml or RAW/split_female.toml, or without
    /// that file by the public release's split.
    #[arg(long, value_name = "GENDER", value_parser = choices(PRESETS), conflicts_with = "split")]
    preset: Option<Gender>,
    /// Split into training and test sequences [default: RAW/split.toml].
    #[arg(long, value_name = "FILE")]
    split: Option<PathBuf>,
    /// Pack every training frame a second time with left and right exchanged, as `mirror` of the split.
    #[arg(long)]
    mirror: bool,
    /// Stop at the first missing or unreadable frame.
    #[arg(long)]
    strict: bool,
    /// Follow symbolic links out of RAW.
    #[arg(long)]
    follow_links: bool,
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    #[serde(flatten)]
    packed: PackReport,
}

impl PackArgs {
    pub(crate) fn run(self, console: Console) -> Result {
        let mut split = self.split()?;
        split.mirror |= self.mirror;
        let options = PackOptions { strict: self.strict, follow_links: self.follow_links };
        let packed = console.while_showing("pack", "frames", |progress| {
            cape_data::pack(&self.raw, &self.output.out, &split, options, progress)
        })?;
        for frame in &packed.broken {
            console.note(&format!("left out {}: {}", frame.path.display(), frame.reason));
        }
        for missing in packed.missing.iter().take(SHOWN) {
            console.note(&format!("missing {}: {}", missing.subject, missing.reason));
        }
        if packed.missing.len() > SHOWN {
            let more = packed.missing.len() - SHOWN;
            console.note(&format!("{more} more are missing: list them with --json"));
        }
        for outfit in &packed.missing_outfits {
            console.note(&format!("no capture of the outfit {outfit}, which the split lists"));
        }
        if packed.resumed > 0 {
            console.note(&format!("resumed: {} frames had been packed before", packed.resumed));
        }
        let report = Report { out: self.output.out, packed };
        console.result(&report, || report.text())
    }

    fn split(&self) -> Result<SplitSpec> {
        let own =
            |gender| Some(self.raw.join(gender_split_file(gender))).filter(|path| path.exists());
        if let Some(gender) = self.preset {
            return Ok(match own(gender) {
                Some(path) => SplitSpec::from_file(path)?,
                None => SplitSpec::preset(&gender.to_string())?,
            });
        }
        let path = self.split.clone().unwrap_or_else(|| self.raw.join(SPLIT_FILE));
        if self.split.is_some() || path.exists() || !self.raw.is_dir() {
            return Ok(SplitSpec::from_file(path)?);
        }
        // All subjects are of one gender.
        if let (Some(path), None) | (None, Some(path)) = (own(Gender::Male), own(Gender::Female)) {
            return Ok(SplitSpec::from_file(path)?);
        }
        Err(Error::message(format!(
            "{}: no {SPLIT_FILE} in it: choose frames by --preset male, --preset female or \
             --split FILE",
            self.raw.display()
        )))
    }
}

impl Report {
    fn text(&self) -> String {
        let PackReport {
            vertices,
            train_frames,
            validation_frames,
            test_frames,
            broken,
            missing,
            ..
        } = &self.packed;
        let mut table = Table::default();
        for (name, count) in [
            ("training frames", train_frames - validation_frames),
            ("validation frames", *validation_frames),
            ("test frames", *test_frames),
            ("vertices", *vertices),
            ("unreadable frames", broken.len()),
            ("missing sequences", missing.len()),
        ] {
            table.row([name.to_owned(), count.to_string()]);
        }
        let out = self.out.display();
        format!("{}\n\n{out}\nnext: cape train --data {out} --out run", table.text())
    }
}
