//! File and directory helpers.

use std::{fs, io::Write, path::Path};

use cape_core::{is_temporary, write_atomically};
use serde::Serialize;

use crate::error::{Error, Result};

/// Returns an error unless `path` is missing or an empty directory, but for lock files and what a killed
/// process had not finished.
pub(crate) fn require_empty(path: &Path) -> Result {
    require_empty_as(path, "--out")
}

/// Like [`require_empty`], of the path that `option` gives.
pub(crate) fn require_empty_as(path: &Path, option: &str) -> Result {
    let Ok(metadata) = fs::metadata(path) else { return Ok(()) };
    let occupied = if metadata.is_dir() {
        let entries = fs::read_dir(path).map_err(|error| Error::io(path, error))?;
        entries.flatten().any(|entry| !is_temporary(&entry.file_name().to_string_lossy()))
    } else {
        true
    };
    if occupied {
        return Err(Error::message(format!(
            "{} already exists and is not empty: remove it or choose another {option}",
            path.display()
        )));
    }
    Ok(())
}

pub(crate) fn create_dir(path: &Path) -> Result {
    fs::create_dir_all(path).map_err(|error| Error::io(path, error))
}

pub(crate) fn write_text(path: &Path, text: &str) -> Result {
    write_bytes(path, text.as_bytes())
}

/// Writes `lines` as JSON, one per line.
pub(crate) fn write_json_lines(path: &Path, lines: &[impl Serialize]) -> Result {
    let mut text = String::new();
    for line in lines {
        text += &serde_json::to_string(line)
            .map_err(|error| Error::message(format!("{}: {error}", path.display())))?;
        text.push('\n');
    }
    write_text(path, &text)
}

pub(crate) fn write_bytes(path: &Path, bytes: &[u8]) -> Result {
    Ok(write_atomically(path, |file| file.write_all(bytes))?)
}
