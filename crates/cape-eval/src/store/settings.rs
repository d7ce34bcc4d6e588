//! Everything that the results in a store depend on.

use std::{
    collections::BTreeMap,
    fmt, fs,
    path::{Path, PathBuf},
};

use cape_data::{DisplacementStatistics, PackedSet, Split};
use cape_infer::{Run, checkpoint};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::hash::{sha256, sha256_of_files};
use crate::{Error, Result};

/// Characters of a value that a message shows.
const SHOWN: usize = 60;
/// Hexadecimal digits of a hash that a message shows.
const DIGITS: usize = 12;

/// Settings, program version and inputs that the results in a [`ResultStore`](super::ResultStore)
/// depend on; the contents of its settings.json.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StoreSettings {
    /// Command, and the part of it, that produced the results.
    kind: String,
    /// Version of the program.
    version: String,
    /// Settings as the command's types serialise them.
    settings: Value,
    /// Data sets, checkpoints, bodies and other files by role.
    inputs: BTreeMap<String, StoreInput>,
}

/// A file, directory or built-in object that results depend on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
enum StoreInput {
    /// Contents of a file or of files in a directory. The path is a hint for people and is not
    /// compared: a data set may be moved.
    Contents { path: PathBuf, sha256: String },
    /// Something that the program makes itself, or derives from the other inputs.
    BuiltIn { built_in: String },
}

/// A field in which two settings differ.
pub(super) struct Difference {
    /// Path of the field in settings.json, for example `settings.train.epochs` or `inputs.body`.
    pub(super) field: String,
    /// Value in the file, shortened.
    pub(super) stored: String,
    /// Value of this time, shortened.
    pub(super) current: String,
}

impl StoreSettings {
    /// Settings of this version of the program, without inputs so far; `kind` names the command.
    pub fn new(kind: &str, settings: &impl Serialize) -> Result<Self> {
        let fault = |error| Error::argument(format!("settings of {kind}: {error}"));
        // Numbers as they come back from a file.
        let text = serde_json::to_string(settings).map_err(fault)?;
        Ok(Self {
            kind: kind.to_owned(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            settings: serde_json::from_str(&text).map_err(fault)?,
            inputs: BTreeMap::new(),
        })
    }

    /// The same inputs with other settings.
    pub fn with_settings(&self, settings: &impl Serialize) -> Result<Self> {
        let Self { settings, .. } = Self::new(&self.kind, settings)?;
        Ok(Self { settings, ..self.clone() })
    }

    /// The same with the contents of a file or directory as the input `name`.
    pub fn with_input(self, name: &str, path: &Path) -> Result<Self> {
        let sha256 = sha256(path)?;
        Ok(self.with_contents(name, path, sha256))
    }

    /// The same with some files of the directory `root` as the input `name`.
    pub fn with_files(self, name: &str, root: &Path, files: &[String]) -> Result<Self> {
        let sha256 = sha256_of_files(root, files)?;
        Ok(self.with_contents(name, root, sha256))
    }

    /// The same with an input that the program makes itself, or that follows from the others.
    #[must_use]
    pub fn with_built_in(mut self, name: &str, description: &str) -> Self {
        let input = StoreInput::BuiltIn { built_in: description.to_owned() };
        self.inputs.insert(name.to_owned(), input);
        self
    }

    /// The same with a file as the input `name`, if there is one, or else `description`.
    pub fn with_optional_input(
        self,
        name: &str,
        path: Option<&Path>,
        description: &str,
    ) -> Result<Self> {
        match path {
            Some(path) => self.with_input(name, path),
            None => Ok(self.with_built_in(name, description)),
        }
    }

    /// The same with parts of the packed set in `root` as the input `data`.
    pub fn with_packed_set(self, root: &Path, splits: &[Split]) -> Result<Self> {
        let sha256 = packed_set_sha256(root, splits)?;
        Ok(self.with_contents("data", root, sha256))
    }

    /// The same with what a trained model consists of as the inputs `body`, `checkpoint`,
    /// `clothing`, `run_config` and `statistics`.
    pub fn with_run(self, run: &Run) -> Result<Self> {
        let (Some(paths), Some(checkpoint)) = (run.paths(), run.checkpoint()) else {
            let path = Some(run.name()).filter(|path| path.is_file());
            return self.with_optional_input("model", path, &run.name().display().to_string());
        };
        self.with_input("body", &paths.body())?
            .with_files("checkpoint", checkpoint, &checkpoint::weight_files(checkpoint))?
            .with_input("clothing", &paths.clothing())?
            .with_input("run_config", &paths.config())?
            .with_input("statistics", &paths.statistics())
    }

    fn with_contents(mut self, name: &str, path: &Path, sha256: String) -> Self {
        let input = StoreInput::Contents { path: path.to_owned(), sha256 };
        self.inputs.insert(name.to_owned(), input);
        self
    }

    /// Command, and the part of it, that produced the results.
    pub(super) fn kind(&self) -> &str {
        &self.kind
    }

    /// Reads settings.json; the message says what an older or foreign file lacks.
    pub(super) fn load(path: &Path) -> Result<Self> {
        let text = fs::read(path).map_err(|source| Error::io(path, source))?;
        let value: Value = serde_json::from_slice(&text)
            .map_err(|error| Error::format(path, format!("cannot be read: {error}")))?;
        let fields = ["kind", "version", "settings", "inputs"];
        let missing: Vec<String> = fields
            .iter()
            .filter(|name| value.get(name).is_none())
            .map(|name| format!("`{name}`"))
            .collect();
        if !missing.is_empty() {
            return Err(Error::format(
                path,
                format!(
                    "lacks {}: it is of an earlier version or of another program, and what the \
                     results beside it were computed from is not known",
                    missing.join(", ")
                ),
            ));
        }
        serde_json::from_value(value)
            .map_err(|error| Error::format(path, format!("cannot be read: {error}")))
    }

    /// Fields in which `self`, as stored, and `current` differ, the version first.
    pub(super) fn differences(&self, current: &Self) -> Vec<Difference> {
        let mut found = Vec::new();
        if self.version != current.version {
            found.push(Difference {
                field: "version".into(),
                stored: self.version.clone(),
                current: current.version.clone(),
            });
        }
        compare("settings", &self.settings, &current.settings, &mut found);
        let names: std::collections::BTreeSet<&String> =
            self.inputs.keys().chain(current.inputs.keys()).collect();
        for name in names {
            let [stored, current] = [self, current].map(|of| of.inputs.get(name));
            let same = match (stored, current) {
                (Some(stored), Some(current)) => stored.is_same(current),
                _ => false,
            };
            if !same {
                let text = |input: Option<&StoreInput>| {
                    input.map_or_else(|| "none".to_owned(), ToString::to_string)
                };
                found.push(Difference {
                    field: format!("inputs.{name}"),
                    stored: text(stored),
                    current: text(current),
                });
            }
        }
        found
    }
}

impl StoreInput {
    fn is_same(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Contents { sha256, .. }, Self::Contents { sha256: other, .. }) => {
                sha256 == other
            }
            _ => self == other,
        }
    }
}

impl fmt::Display for StoreInput {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Contents { path, sha256 } => {
                let digits = sha256.get(..DIGITS).unwrap_or(sha256);
                write!(f, "{} (SHA-256 {digits}…)", path.display())
            }
            Self::BuiltIn { built_in } => f.write_str(built_in),
        }
    }
}

/// SHA-256 of parts of the packed set in `root`: of its arrays, the list of its frames and, with the
/// training part, its statistics.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/../cape-train/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use cape_data::Split;
/// use cape_eval::store::packed_set_sha256;
///
/// let directory = captures()?;
/// let data = directory.path().join("packed");
/// let whole = packed_set_sha256(&data, &[Split::Train, Split::Test])?;
/// assert_eq!(whole.len(), 64);
/// assert_ne!(packed_set_sha256(&data, &[Split::Test])?, whole);
/// # Ok(())
/// # }
/// ```
pub fn packed_set_sha256(root: &Path, splits: &[Split]) -> Result<String> {
    let mut files = Vec::new();
    let mut add = |path: PathBuf, required: bool| {
        if required || path.exists() {
            let name = path.strip_prefix(root).unwrap_or(&path);
            let parts: Vec<_> = name.iter().map(|part| part.to_string_lossy()).collect();
            files.push(parts.join("/"));
        }
    };
    for &split in splits {
        for array in ["disp", "clo_label"] {
            add(split.path(root, array), true);
        }
        for array in ["rot", "pose"] {
            add(split.path(root, array), false);
        }
        add(split.path(root, "frames").with_extension("csv"), false);
    }
    if splits.contains(&Split::Train) {
        let set = PackedSet::open(root, Split::Train)?;
        // Outfits other than the paper's have their names from the split.
        if !set.vocabulary().is_paper() {
            add(root.join("split.toml"), false);
        }
        // Sets of the official tools get their statistics when they are first needed.
        DisplacementStatistics::from_packed(root, &mut cape_core::silent)?;
        add(root.join("stats.npz"), false);
    }
    sha256_of_files(root, &files)
}

/// Adds the fields in which two values differ.
fn compare(field: &str, stored: &Value, current: &Value, found: &mut Vec<Difference>) {
    if let (Value::Object(first), Value::Object(second)) = (stored, current) {
        let names: std::collections::BTreeSet<&String> =
            first.keys().chain(second.keys()).collect();
        for name in names {
            let part = |map: &serde_json::Map<String, Value>| {
                map.get(name).cloned().unwrap_or(Value::Null)
            };
            compare(&format!("{field}.{name}"), &part(first), &part(second), found);
        }
    } else if stored != current {
        let [stored, current] = [stored, current].map(shortened);
        found.push(Difference { field: field.to_owned(), stored, current });
    }
}

fn shortened(value: &Value) -> String {
    if value.is_null() {
        return "none".into();
    }
    let text = value.to_string();
    match text.char_indices().nth(SHOWN) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text,
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn fields(stored: &StoreSettings, current: &StoreSettings) -> Vec<String> {
        stored.differences(current).into_iter().map(|difference| difference.field).collect()
    }

    #[test]
    fn differences_are_named() {
        let of = |settings: Value| StoreSettings::new("test", &settings).unwrap();
        let before = of(json!({"data": "a", "options": {"noise": 0.5, "seed": 1}}));
        assert!(fields(&before, &before).is_empty());
        let other = of(json!({"data": "a", "options": {"noise": 0.5, "seed": 2}, "more": [3]}));
        assert_eq!(fields(&before, &other), ["settings.more", "settings.options.seed"]);
        let Difference { stored, current, .. } = &before.differences(&other)[0];
        assert_eq!((stored.as_str(), current.as_str()), ("none", "[3]"));
        let older = StoreSettings { version: "0.0.1".into(), ..other };
        assert_eq!(fields(&older, &before)[0], "version");
        let long = of(json!({"data": "é".repeat(200), "options": {"noise": 0.5, "seed": 1}}));
        assert!(before.differences(&long)[0].current.chars().count() == SHOWN + 1);
    }

    #[test]
    fn inputs_are_compared_by_their_contents() {
        let directory = tempfile::tempdir().unwrap();
        let at = |name: &str| directory.path().join(name);
        for (name, text) in [("a", "one"), ("same", "one"), ("b", "two")] {
            fs::write(at(name), text).unwrap();
        }
        let of = |name: &str| {
            StoreSettings::new("test", &()).unwrap().with_input("body", &at(name)).unwrap()
        };
        assert!(fields(&of("a"), &of("same")).is_empty());
        assert_eq!(fields(&of("a"), &of("b")), ["inputs.body"]);
        let built_in = StoreSettings::new("test", &()).unwrap().with_built_in("body", "synthetic");
        assert_eq!(fields(&of("a"), &built_in), ["inputs.body"]);
        let difference = &of("a").differences(&built_in)[0];
        assert!(difference.stored.contains("SHA-256 7692c3ad3540…"), "{}", difference.stored);
        assert_eq!(difference.current, "synthetic");
        let none = StoreSettings::new("test", &()).unwrap();
        assert_eq!(none.differences(&built_in)[0].stored, "none");
    }
}
