//! Log of the frames packed so far, from which an interrupted packing resumes.

use std::{
    fs::{self, File, OpenOptions},
    io::Write,
    path::{Path, PathBuf},
};

use cape_core::hex;
use sha2::{Digest, Sha256};

use super::{SplitSpec, pack::PackOptions, pack_plan::PlannedFrame};
use crate::{Error, Result};

const FILE: &str = "journal.txt";
const PACKED: &str = "packed";
const BROKEN: &str = "broken\t";

/// Log file of a packing: one line with the hash of the plan, then one per processed frame, in
/// order.
#[derive(Debug)]
pub(super) struct PackLog {
    path: PathBuf,
    file: File,
    lines: String,
}

/// Status of a processed frame.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum FrameStatus {
    Packed,
    /// Left out, with the reason.
    Broken(String),
}

impl PackLog {
    /// Statuses of the first frames of the plan; empty if `directory` has no log of that plan.
    pub(super) fn read(directory: &Path, plan: &str) -> Vec<FrameStatus> {
        let Ok(text) = fs::read_to_string(directory.join(FILE)) else { return Vec::new() };
        // A truncated last line is ignored.
        let whole = text.rfind('\n').map_or("", |end| &text[..end]);
        let mut lines = whole.lines();
        if lines.next() != Some(plan) {
            return Vec::new();
        }
        let status = |line: &str| match line {
            PACKED => Some(FrameStatus::Packed),
            _ => line.strip_prefix(BROKEN).map(|reason| FrameStatus::Broken(reason.to_owned())),
        };
        lines.map_while(status).collect()
    }

    /// Starts the log of a plan with the statuses of the frames that are `done` already.
    pub(super) fn start(directory: &Path, plan: &str, done: &[FrameStatus]) -> Result<Self> {
        let path = directory.join(FILE);
        let file = OpenOptions::new()
            .create(true)
            .write(true)
            .truncate(true)
            .open(&path)
            .map_err(|source| Error::io(&path, source))?;
        let mut log = Self { path, file, lines: format!("{plan}\n") };
        for status in done {
            log.push(status);
        }
        log.commit()?;
        Ok(log)
    }

    /// Adds the status of the next frame.
    pub(super) fn push(&mut self, status: &FrameStatus) {
        match status {
            FrameStatus::Packed => self.lines.push_str(PACKED),
            FrameStatus::Broken(reason) => {
                self.lines.push_str(BROKEN);
                self.lines.push_str(reason);
            }
        }
        self.lines.push('\n');
    }

    /// Writes the added statuses. The files of these frames must have been flushed before.
    pub(super) fn commit(&mut self) -> Result<()> {
        self.file
            .write_all(self.lines.as_bytes())
            .map_err(|source| Error::io(&self.path, source))?;
        self.lines.clear();
        Ok(())
    }

    /// Removes the log of a complete packing.
    pub(super) fn finish(self) -> Result<()> {
        fs::remove_file(&self.path).map_err(|source| Error::io(&self.path, source))
    }
}

/// SHA-256 of all inputs of a packing: split, options, minimal shapes, and name, size and time of
/// every frame file.
pub(super) fn plan_hash<'a>(
    raw: &Path,
    split: &SplitSpec,
    options: PackOptions,
    minimal: impl Iterator<Item = &'a ndarray::Array2<f64>>,
    frames: impl Iterator<Item = &'a PlannedFrame<'a>>,
) -> Result<String> {
    let mut hash = Sha256::new();
    hash.update(concat!(env!("CARGO_PKG_VERSION"), "\0"));
    hash.update(
        fs::canonicalize(raw).unwrap_or_else(|_| raw.to_owned()).to_string_lossy().as_bytes(),
    );
    hash.update(split.to_toml()?);
    hash.update([options.strict.into(), options.follow_links.into()]);
    for shape in minimal {
        for value in shape {
            hash.update(value.to_le_bytes());
        }
    }
    for frame in frames {
        hash.update(frame.source.path().to_string_lossy().as_bytes());
        // A missing file is reported as a broken frame when it is read.
        for number in frame.source.identity().into_iter().flatten() {
            hash.update(number.to_le_bytes());
        }
    }
    Ok(hex(hash.finalize()))
}
