//! Reader of TensorFlow checkpoints of version 2 ("tensor bundles") that does not need TensorFlow.
//!
//! A checkpoint consists of `<prefix>.index`, a sorted table of element type, shape, location and
//! checksum of every variable, and of `<prefix>.data-00000-of-00001` (or several shards) with the
//! values. Every block of the table and every tensor is checked against its CRC-32C. Sizes in the
//! index are checked against the sizes of the files before memory is allocated.

mod proto;
mod table;
#[cfg(test)]
mod tests;

use std::{
    fs::{self, File},
    io::{Read, Seek, SeekFrom},
    path::{Path, PathBuf},
};

use proto::{Entry, Header};

use crate::{Error, Result, weights::HostArray};

/// Largest size of an index file, bytes; an index has a few hundred bytes per variable.
const MAX_INDEX: u64 = 64 << 20;

/// TensorFlow's masked CRC-32C, the checksum of checkpoints and of TensorBoard event files.
pub fn masked_crc32c(bytes: &[u8]) -> u32 {
    mask(crc32c::crc32c(bytes))
}

fn mask(crc: u32) -> u32 {
    crc.rotate_right(15).wrapping_add(0xa282_ead8)
}

/// Element type of a variable.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ElementType {
    /// 32-bit floats.
    F32,
    /// 64-bit floats.
    F64,
    /// 32-bit integers.
    I32,
    /// 64-bit integers.
    I64,
    /// Another type, by its number in TensorFlow.
    Other(u64),
}

impl ElementType {
    fn from_number(number: u64) -> Self {
        match number {
            1 => Self::F32,
            2 => Self::F64,
            3 => Self::I32,
            9 => Self::I64,
            other => Self::Other(other),
        }
    }

    const fn size(self) -> Option<u64> {
        match self {
            Self::F32 | Self::I32 => Some(4),
            Self::F64 | Self::I64 => Some(8),
            Self::Other(_) => None,
        }
    }

    /// True for floating-point types.
    pub const fn is_float(self) -> bool {
        matches!(self, Self::F32 | Self::F64)
    }
}

/// A variable of a checkpoint.
#[derive(Debug, Clone, PartialEq)]
pub struct Variable {
    /// Name in TensorFlow, without `:0`.
    pub name: String,
    /// Element type.
    pub element: ElementType,
    /// Extents.
    pub shape: Vec<usize>,
    place: DataLocation,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct DataLocation {
    shard: usize,
    offset: u64,
    size: u64,
    crc: u32,
}

/// An open TensorFlow checkpoint.
///
/// ```
/// use cape_model::tensorflow::{TensorFlowCheckpoint, ElementType};
///
/// let checkpoint = TensorFlowCheckpoint::open("fixtures/checkpoint")?;
/// let names: Vec<_> = checkpoint.variables().iter().map(|v| v.name.as_str()).collect();
/// assert_eq!(names[2], "global_step");
/// let step = checkpoint.variable("global_step").unwrap();
/// assert_eq!((step.element, &step.shape[..]), (ElementType::I64, &[][..]));
/// assert_eq!(checkpoint.integers(step)?, [7]);
///
/// let weights = checkpoint.variable("generator/encoder/1x1-conv/weights").unwrap();
/// assert_eq!(checkpoint.floats(weights)?.values, [0., 1., 2., 3., 4., 5.]);
/// // Integers are not read as floats.
/// assert!(checkpoint.floats(step).is_err());
/// # Ok::<(), cape_model::Error>(())
/// ```
#[derive(Debug)]
pub struct TensorFlowCheckpoint {
    prefix: PathBuf,
    index: PathBuf,
    shards: usize,
    variables: Vec<Variable>,
}

impl TensorFlowCheckpoint {
    /// Opens a checkpoint by its prefix (`…/model-1234`), its `.index` file, one of its `.data`
    /// files, or its directory; in a directory of several checkpoints, the one named in the file
    /// `checkpoint`.
    ///
    /// # Errors
    /// If there is no checkpoint, or its index is damaged or does not match the data files.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        let prefix = prefix_of(path.as_ref())?;
        let index = with_suffix(&prefix, ".index");
        let fault = |message: String| Error::File { path: index.clone(), message };
        let length =
            fs::metadata(&index).map_err(|e| Error::Io { path: index.clone(), source: e })?.len();
        if length > MAX_INDEX {
            return Err(fault(format!("{length} bytes, expected at most {MAX_INDEX}")));
        }
        let bytes = fs::read(&index).map_err(|e| Error::Io { path: index.clone(), source: e })?;
        let start = &bytes[..bytes.len().min(4096)];
        if let Some(found) = cape_core::unexpected_content(start, length) {
            return Err(fault(found.to_owned()));
        }
        let mut header = None;
        let mut variables = Vec::new();
        for (key, value) in table::read(&bytes).map_err(fault)? {
            if key.is_empty() {
                header = Some(Header::parse(&value).map_err(fault)?);
                continue;
            }
            let name = String::from_utf8(key)
                .map_err(|_| fault("the name of a variable is not UTF-8".into()))?;
            let named = |message: String| fault(format!("`{name}`: {message}"));
            let entry = Entry::parse(&value).map_err(named)?;
            variables.push(variable(name.clone(), entry).map_err(named)?);
        }
        let header = header.ok_or_else(|| fault("no header entry".into()))?;
        if header.big_endian {
            return Err(fault("big-endian checkpoint, expected little-endian".into()));
        }
        let checkpoint = Self { prefix, index: index.clone(), shards: header.shards, variables };
        checkpoint.check_places()?;
        Ok(checkpoint)
    }

    /// Path of the checkpoint without `.index`.
    pub fn prefix(&self) -> &Path {
        &self.prefix
    }

    /// All variables, sorted by name.
    pub fn variables(&self) -> &[Variable] {
        &self.variables
    }

    /// The variable called `name`.
    pub fn variable(&self, name: &str) -> Option<&Variable> {
        self.variables.iter().find(|variable| variable.name == name)
    }

    /// Reads a variable of floating-point numbers as f32.
    ///
    /// # Errors
    /// If the variable has another element type, or its bytes do not match their checksum.
    pub fn floats(&self, variable: &Variable) -> Result<HostArray> {
        let bytes = self.bytes(variable)?;
        let values: Vec<f32> = match variable.element {
            ElementType::F32 => chunks(&bytes, f32::from_le_bytes),
            ElementType::F64 => chunks(&bytes, |b: [u8; 8]| f64::from_le_bytes(b) as f32),
            other => {
                return Err(self.fault(variable, format!("holds {other:?}, expected floats")));
            }
        };
        Ok(HostArray { shape: variable.shape.clone(), values })
    }

    /// Reads a variable of integers.
    ///
    /// # Errors
    /// As [`floats`](Self::floats).
    pub fn integers(&self, variable: &Variable) -> Result<Vec<i64>> {
        let bytes = self.bytes(variable)?;
        Ok(match variable.element {
            ElementType::I32 => chunks(&bytes, |b| i64::from(i32::from_le_bytes(b))),
            ElementType::I64 => chunks(&bytes, i64::from_le_bytes),
            other => {
                return Err(self.fault(variable, format!("holds {other:?}, expected integers")));
            }
        })
    }

    fn bytes(&self, variable: &Variable) -> Result<Vec<u8>> {
        let DataLocation { shard, offset, size, crc } = variable.place;
        let path = self.shard_path(shard);
        let io = |source| Error::Io { path: path.clone(), source };
        let mut file = File::open(&path).map_err(io)?;
        file.seek(SeekFrom::Start(offset)).map_err(io)?;
        let mut bytes = Vec::new();
        file.take(size).read_to_end(&mut bytes).map_err(io)?;
        if bytes.len() as u64 != size {
            return Err(self.fault(variable, format!("{} is truncated", path.display())));
        }
        if masked_crc32c(&bytes) != crc {
            let message = format!("bytes in {} are damaged (checksum)", path.display());
            return Err(self.fault(variable, message));
        }
        Ok(bytes)
    }

    fn fault(&self, variable: &Variable, message: String) -> Error {
        let message = format!("`{}`: {message}", variable.name);
        Error::File { path: self.index.clone(), message }
    }

    fn shard_path(&self, shard: usize) -> PathBuf {
        with_suffix(&self.prefix, &format!(".data-{shard:05}-of-{:05}", self.shards))
    }

    /// Checks that every variable lies inside its file and has the number of bytes of its shape.
    fn check_places(&self) -> Result<()> {
        let mut lengths: Vec<Option<u64>> = Vec::new();
        let mut claimed: Vec<u64> = Vec::new();
        for variable in &self.variables {
            let DataLocation { shard, offset, size, .. } = variable.place;
            if shard >= self.shards {
                let message = format!("data file {shard}, but there are {}", self.shards);
                return Err(self.fault(variable, message));
            }
            if lengths.len() <= shard {
                lengths.resize(shard + 1, None);
                claimed.resize(shard + 1, 0);
            }
            let length = if let Some(length) = lengths[shard] {
                length
            } else {
                let path = self.shard_path(shard);
                let found = fs::metadata(&path)
                    .map_err(|source| Error::Io { path: path.clone(), source })?
                    .len();
                *lengths[shard].insert(found)
            };
            if offset.checked_add(size).is_none_or(|end| end > length) {
                let message = format!(
                    "bytes {offset} to {} of {}, but the file has {length} bytes",
                    offset.saturating_add(size),
                    self.shard_path(shard).display()
                );
                return Err(self.fault(variable, message));
            }
            claimed[shard] += size;
            if claimed[shard] > length {
                return Err(self.fault(variable, "overlaps another variable".into()));
            }
            let elements =
                variable.shape.iter().try_fold(1u64, |n, &axis| n.checked_mul(axis as u64));
            let expected = variable.element.size().and_then(|each| elements?.checked_mul(each));
            if variable.element.size().is_some() && expected != Some(size) {
                let message = format!("shape {:?}, but {size} bytes", variable.shape);
                return Err(self.fault(variable, message));
            }
        }
        Ok(())
    }
}

fn variable(name: String, entry: Entry) -> Result<Variable, String> {
    if entry.sliced {
        return Err("sliced variables are not supported".into());
    }
    Ok(Variable {
        name,
        element: ElementType::from_number(entry.element),
        shape: entry.shape,
        place: DataLocation {
            shard: entry.shard,
            offset: entry.offset,
            size: entry.size,
            crc: entry.crc,
        },
    })
}

fn chunks<const N: usize, T>(bytes: &[u8], convert: impl Fn([u8; N]) -> T) -> Vec<T> {
    bytes.as_chunks::<N>().0.iter().map(|&chunk| convert(chunk)).collect()
}

fn with_suffix(prefix: &Path, suffix: &str) -> PathBuf {
    let mut path = prefix.as_os_str().to_owned();
    path.push(suffix);
    path.into()
}

/// Prefix of the checkpoint at `path`, without the suffixes of its files.
fn prefix_of(path: &Path) -> Result<PathBuf> {
    if path.is_dir() {
        return prefix_in(path);
    }
    let text = path.to_string_lossy();
    if let Some(prefix) = text.strip_suffix(".index") {
        return Ok(prefix.into());
    }
    if let Some((prefix, shard)) = text.rsplit_once(".data-")
        && shard.bytes().all(|b| b.is_ascii_digit() || b"-of".contains(&b))
    {
        return Ok(prefix.into());
    }
    if with_suffix(path, ".index").is_file() {
        return Ok(path.to_owned());
    }
    Err(Error::File {
        path: path.to_owned(),
        message: "no TensorFlow checkpoint: expected a directory, a `.index` file, or a path to \
                  which `.index` can be added"
            .into(),
    })
}

fn prefix_in(directory: &Path) -> Result<PathBuf> {
    let is_index = |path: &Path| path.to_string_lossy().ends_with(".index");
    let indices = cape_core::list_files(directory, is_index)?;
    let found: Vec<PathBuf> = indices.iter().map(|path| path.with_extension("")).collect();
    let fault = |message| Error::File { path: directory.to_owned(), message };
    match &found[..] {
        [] => Err(fault("no TensorFlow checkpoint: no `.index` file".into())),
        [one] => Ok(one.clone()),
        several => {
            let latest = latest_name(&directory.join("checkpoint"));
            let named = several.iter().find(|prefix| prefix.file_name() == latest.as_deref());
            named.cloned().ok_or_else(|| {
                let names = several.iter().filter_map(|p| p.file_name()?.to_str());
                fault(format!(
                    "several checkpoints: give the path of one of {}",
                    names.collect::<Vec<_>>().join(", ")
                ))
            })
        }
    }
}

/// File name in `model_checkpoint_path: "…"` of TensorFlow's `checkpoint` file. The directory in
/// that path is where the checkpoint was written, and is ignored.
fn latest_name(path: &Path) -> Option<std::ffi::OsString> {
    let text = fs::read_to_string(path).ok()?;
    let line = text.lines().find_map(|line| line.trim().strip_prefix("model_checkpoint_path:"))?;
    let quoted = line.trim().strip_prefix('"')?.strip_suffix('"')?;
    Some(Path::new(quoted).file_name()?.to_owned())
}
