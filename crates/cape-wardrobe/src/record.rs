//! Records of simulated takes in a data set's directory.

use std::{
    fs,
    path::{Path, PathBuf},
};

use cape_core::write_atomically;
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use crate::{Error, Result, TakeQuality};

/// Name of the report of all takes in a data set's directory.
pub const QUALITY_FILE: &str = "quality.json";

/// Directory of the records of single takes.
const TAKES: &str = "takes";

/// Record of a simulated take: its names, seed, garments and quality.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TakeRecord {
    /// Name of the subject.
    pub subject: String,
    /// Name of the take, such as `shortlong_squats`.
    pub take: String,
    /// Seed of garments and dressing.
    pub seed: u64,
    /// Number of frames.
    pub frames: usize,
    /// Cuts, size and material of the garments.
    pub garments: serde_json::Value,
    /// Quality of the frames.
    pub quality: TakeQuality,
}

impl TakeRecord {
    /// Path of the record of a take.
    pub(crate) fn path(root: &Path, subject: &str, take: &str) -> PathBuf {
        root.join(TAKES).join(format!("{subject}_{take}.json"))
    }

    pub(crate) fn read(root: &Path, subject: &str, take: &str) -> Result<Option<Self>> {
        let path = Self::path(root, subject, take);
        if path.exists() { read_json(&path).map(Some) } else { Ok(None) }
    }
}

pub(crate) fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T> {
    let text = fs::read(path).map_err(|error| Error::io(path, error))?;
    serde_json::from_slice(&text).map_err(|error| Error::format(path, error.to_string()))
}

/// The value as indented JSON.
pub(crate) fn to_json(value: &impl Serialize) -> Result<String> {
    let text = serde_json::to_string_pretty(value);
    Ok(text.map_err(|error| Error::argument(error.to_string()))? + "\n")
}

pub(crate) fn write_json(path: &Path, value: &impl Serialize) -> Result<()> {
    if let Some(directory) = path.parent() {
        fs::create_dir_all(directory).map_err(|error| Error::io(directory, error))?;
    }
    let text = to_json(value)?;
    write_atomically(path, |file| std::io::Write::write_all(file, text.as_bytes()))
}
