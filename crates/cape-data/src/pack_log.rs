//! What an interrupted packing had done, so that the next one goes on.

use std::{
    fs::{self, File, OpenOptions},
    io::Write,
    path::{Path, PathBuf},
    time::UNIX_EPOCH,
};

use cape_core::hex;
use sha2::{Digest, Sha256};

use super::{
    SplitSpec,
    pack::{PackOptions, PlannedFrame},
};
use crate::{Error, Result};

const FILE: &str = "journal.txt";
const PACKED: &str = "packed";
const BROKEN: &str = "broken\t";

/// One line for the plan, then one for each of its frames that was dealt with, in order.
#[derive(Debug)]
pub(super) struct PackLog {
    path: PathBuf,
    file: File,
    lines: String,
}

/// What became of a frame.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum FrameStatus {
    Packed,
    /// Left out, for this reason.
    Broken(String),
}

impl PackLog {
    /// The fates of the plan's first frames, if `directory` holds its journal; none otherwise.
    pub(super) fn read(directory: &Path, plan: &str) -> Vec<FrameStatus> {
        let Ok(text) = fs::read_to_string(directory.join(FILE)) else { return Vec::new() };
        // A line that was cut off is not there yet.
        let whole = text.rfind('\n').map_or("", |end| &text[..end]);
        let mut lines = whole.lines();
        if lines.next() != Some(plan) {
            return Vec::new();
        }
        let fate = |line: &str| match line {
            PACKED => Some(FrameStatus::Packed),
            _ => line.strip_prefix(BROKEN).map(|reason| FrameStatus::Broken(reason.to_owned())),
        };
        lines.map_while(fate).collect()
    }

    /// Starts the journal of a plan with what is done already.
    pub(super) fn start(directory: &Path, plan: &str, done: &[FrameStatus]) -> Result<Self> {
        let path = directory.join(FILE);
        let file = OpenOptions::new()
            .create(true)
            .write(true)
            .truncate(true)
            .open(&path)
            .map_err(|source| Error::io(&path, source))?;
        let mut journal = Self { path, file, lines: format!("{plan}\n") };
        for fate in done {
            journal.note(fate);
        }
        journal.commit()?;
        Ok(journal)
    }

    /// Notes what became of the next frame.
    pub(super) fn note(&mut self, fate: &FrameStatus) {
        match fate {
            FrameStatus::Packed => self.lines.push_str(PACKED),
            FrameStatus::Broken(reason) => {
                self.lines.push_str(BROKEN);
                self.lines.push_str(reason);
            }
        }
        self.lines.push('\n');
    }

    /// Writes what was noted. What it says must be in its files by now.
    pub(super) fn commit(&mut self) -> Result<()> {
        self.file
            .write_all(self.lines.as_bytes())
            .map_err(|source| Error::io(&self.path, source))?;
        self.lines.clear();
        Ok(())
    }

    /// Removes the journal of a packing that is complete.
    pub(super) fn finish(self) -> Result<()> {
        fs::remove_file(&self.path).map_err(|source| Error::io(&self.path, source))
    }
}

/// A hash of everything that the result depends on: the split, the subjects' minimal shapes, and
/// name, size and time of every frame, and whether links are followed.
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
        hash.update(frame.path.to_string_lossy().as_bytes());
        // A frame that is gone by now will be found broken, then as later.
        if let Ok(metadata) = fs::metadata(&frame.path) {
            hash.update(metadata.len().to_le_bytes());
            let since =
                metadata.modified().ok().and_then(|time| time.duration_since(UNIX_EPOCH).ok());
            hash.update(since.map_or(0, |since| since.as_nanos()).to_le_bytes());
        }
    }
    Ok(hex(hash.finalize()))
}
