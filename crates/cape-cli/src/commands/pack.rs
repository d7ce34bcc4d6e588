use std::path::PathBuf;

use cape_data::{self, PackOptions, PackReport, SplitSpec, raw::SPLIT_FILE};
use clap::Args;
use serde::Serialize;

use crate::{
    console::Console,
    error::{Error, Result},
    table::Table,
};

/// Missing subjects and sequences that are named.
const SHOWN: usize = 20;

/// Pack raw captures into the arrays that training reads.
///
/// Displacements, poses and outfit labels of all frames, as the CAPE release packs them, with their
/// statistics. Frames that cannot be read are left out and listed. An interrupted packing goes on
/// where it was when it is started again.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  cape pack raw --out packed\n  cape pack cape_release --preset \
                        male --out packed"
)]
pub(crate) struct PackArgs {
    /// Raw data, with sequences/ and minimal_body_shape/.
    #[arg(value_name = "RAW")]
    raw: PathBuf,
    /// Directory to write; it must be empty or missing.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// The paper's subjects and sequences.
    #[arg(long, value_parser = ["male", "female"], conflicts_with = "split")]
    preset: Option<String>,
    /// Which frames train and which test; by default RAW/split.toml.
    #[arg(long, value_name = "FILE")]
    split: Option<PathBuf>,
    /// Stop at the first frame that is missing or cannot be read.
    #[arg(long)]
    strict: bool,
    /// Read what links bring in from outside of RAW.
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
            cape_data::pack(&self.raw, &self.out, &split, options, progress)
        })?;
        for frame in &packed.broken {
            console.note(&format!("left out {}: {}", frame.path.display(), frame.reason));
        }
        for missing in packed.missing.iter().take(SHOWN) {
            console.note(&format!("missing {}: {}", missing.subject, missing.reason));
        }
        if packed.missing.len() > SHOWN {
            let more = packed.missing.len() - SHOWN;
            console.note(&format!("and {more} more are missing: --json lists them"));
        }
        if packed.resumed > 0 {
            console.note(&format!("{} frames were packed before", packed.resumed));
        }
        let report = Report { out: self.out, packed };
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
                "{}: no {SPLIT_FILE} there: choose the frames with --preset male, --preset female \
                 or --split FILE",
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
            ("left out", broken.len()),
            ("missing sequences", missing.len()),
        ] {
            table.row([name.to_owned(), count.to_string()]);
        }
        let out = self.out.display();
        format!("{}\n\n{out}\nnext: cape train --data {out} --out run", table.text())
    }
}
