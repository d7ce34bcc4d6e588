//! Finished frames on disk, and the settings they belong to.

use std::{
    fs,
    path::{Path, PathBuf},
};

use cape_fit::{
    FitConfig,
    benchmark::{BenchmarkCase, BenchmarkOptions},
};
use cape_infer::write_json;
use serde::Serialize;
use serde_json::Value;

use crate::{
    error::{Error, Result},
    files,
};

const SETTINGS: &str = "settings.json";
const FRAMES: &str = "frames";

/// Settings that finished frames depend on.
#[derive(Debug, Serialize)]
pub(super) struct StoredSettings<'a> {
    pub(super) version: &'static str,
    pub(super) checkpoint: PathBuf,
    pub(super) data: PathBuf,
    /// Frames of the set.
    pub(super) held_out: usize,
    pub(super) pose_prior: Option<PathBuf>,
    pub(super) options: BenchmarkOptions,
    pub(super) config: &'a FitConfig,
}

/// A benchmark's directory.
#[derive(Debug)]
pub(super) struct CaseStore {
    frames: PathBuf,
}

impl CaseStore {
    /// Opens a new directory, or one with frames of the same settings.
    pub(super) fn open(out: &Path, settings: &StoredSettings<'_>) -> Result<Self> {
        let path = out.join(SETTINGS);
        let store = Self { frames: out.join(FRAMES) };
        let now = serde_json::to_value(settings)
            .map_err(|error| Error::message(format!("settings: {error}")))?;
        if path.exists() {
            let before: Value = read(&path)?;
            // As they come back from a file.
            let now: Value = serde_json::from_str(&now.to_string())
                .map_err(|error| Error::message(format!("settings: {error}")))?;
            if let Some(field) = difference("", &before, &now) {
                return Err(Error::message(format!(
                    "{}: frames were fitted with another `{field}`: choose another --out",
                    path.display()
                )));
            }
            return Ok(store);
        }
        files::require_empty(out)?;
        files::create_dir(&store.frames)?;
        write_json(&path, &now)?;
        Ok(store)
    }

    fn path(&self, frame: usize) -> PathBuf {
        self.frames.join(format!("{frame:06}.json"))
    }

    /// A finished frame.
    pub(super) fn case(&self, frame: usize) -> Result<Option<BenchmarkCase>> {
        let path = self.path(frame);
        if path.exists() { read(&path).map(Some) } else { Ok(None) }
    }

    /// Keeps a frame, and returns it as it will be read.
    pub(super) fn keep(&self, case: BenchmarkCase) -> Result<BenchmarkCase> {
        let path = self.path(case.frame);
        write_json(&path, &case)?;
        read(&path)
    }
}

fn read<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T> {
    let text = fs::read(path).map_err(|error| Error::io(path, error))?;
    let value = serde_json::from_slice(&text);
    Ok(value.map_err(|error| cape_core::Error::format(path, error.to_string()))?)
}

/// The first field in which two values differ.
fn difference(field: &str, a: &Value, b: &Value) -> Option<String> {
    match (a, b) {
        (Value::Object(first), Value::Object(second)) => {
            let names = first.keys().chain(second.keys());
            names.into_iter().find_map(|name| {
                let inner = if field.is_empty() { name.clone() } else { format!("{field}.{name}") };
                let part = |map: &serde_json::Map<String, Value>| {
                    map.get(name).cloned().unwrap_or(Value::Null)
                };
                difference(&inner, &part(first), &part(second))
            })
        }
        _ => (a != b).then(|| field.to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn differences_are_named() {
        let before = json!({"data": "a", "options": {"noise": 0.5, "seed": 1}});
        let named = |after: Value| difference("", &before, &after);
        assert_eq!(named(before.clone()), None);
        let other = json!({"data": "a", "options": {"noise": 0.5, "seed": 2}});
        assert_eq!(named(other).as_deref(), Some("options.seed"));
        let more = json!({"data": "a", "options": {"noise": 0.5, "seed": 1}, "more": 3});
        assert_eq!(named(more).as_deref(), Some("more"));
    }
}
