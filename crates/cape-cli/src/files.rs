//! Small things about files and directories.

use std::{fs, io::Write, path::Path};

use cape_core::write_atomically;

use crate::error::{Error, Result};

/// Whether `path` is a directory with nothing in it, or is not there at all.
pub(crate) fn require_empty(path: &Path) -> Result {
    let Ok(metadata) = fs::metadata(path) else { return Ok(()) };
    let occupied = if metadata.is_dir() {
        fs::read_dir(path).map_err(|error| Error::io(path, error))?.next().is_some()
    } else {
        true
    };
    if occupied {
        return Err(Error::message(format!(
            "{} exists already: remove it, or choose another --out",
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

pub(crate) fn write_bytes(path: &Path, bytes: &[u8]) -> Result {
    Ok(write_atomically(path, |file| file.write_all(bytes))?)
}
