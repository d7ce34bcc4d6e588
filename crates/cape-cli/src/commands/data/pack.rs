use std::path::PathBuf;

use cape_data::{self, PackOptions, PackReport, SplitSpec, raw::SPLIT_FILE};
use clap::Args;
use serde::Serialize;

use crate::{
    console::Console,
    error::{Error, Result},
    options::ResumableOutputArgs,
    table::Table,
};

/// Missing subjects and sequences that are listed at most.
const SHOWN: usize = 20;

/// Pack raw captures into the arrays for training.
///
/// Writes displacements, poses and outfit labels of all frames in the layout of the CAPE release, and
/// normalisation statistics. Unreadable frames are left out and listed. Run the same command again to
/// resume an interrupted packing.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  cape data pack raw --out packed\n  cape data pack cape_release --preset \
                        male --out packed-male"
)]
pub(crate) struct PackArgs {
    /// Raw data, with sequences/ and minimal_body_shape/.
    #[arg(value_name = "RAW")]
    raw: PathBuf,
    #[command(flatten)]
    output: ResumableOutputArgs,
    /// Use the public release's split of the male or female subjects.
    #[arg(long, value_parser = ["male", "female"], conflicts_with = "split")]
    preset: Option<String>,
    /// Split into training and test sequences [default: RAW/split.toml].
    #[arg(long, value_name = "FILE")]
    split: Option<PathBuf>,
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
        let split = self.split()?;
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
        if let Some(preset) = &self.preset {
            return Ok(SplitSpec::preset(preset)?);
        }
        if let Some(path) = &self.split {
            return Ok(SplitSpec::from_file(path)?);
        }
        let path = self.raw.join(SPLIT_FILE);
        if self.raw.is_dir() && !path.exists() {
            return Err(Error::message(format!(
                "{}: no {SPLIT_FILE} in it: choose frames by --preset male, --preset female or \
                 --split FILE",
                self.raw.display()
            )));
        }
        Ok(SplitSpec::from_file(path)?)
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
