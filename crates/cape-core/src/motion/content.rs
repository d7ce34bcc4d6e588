//! Named arrays in nested dictionaries and lists, whatever file holds them.

use std::{
    cell::{Cell, RefCell},
    fs::File,
    io::{BufReader, Read},
    path::{Path, PathBuf},
};

use ndarray::{ArrayD, IxDyn};

use super::{
    foreign,
    matlab::{self, Variable},
    table::MotionRows,
};
use crate::{
    Error, Result,
    npy::{Npz, npy_header, read_f64, read_objects},
    pickle::{Pickle, Value},
};

/// Largest size of a file that is read as a whole, bytes.
const MAX_FILE: u64 = 4 << 30;
/// Largest size of decompressed data, bytes, and largest ratio to the compressed size beyond it.
const BOMB_SIZE: u64 = 64 << 20;
const BOMB_RATIO: u64 = 100;
/// First bytes of MATLAB's files to version 7.
const MATLAB: &[u8] = b"MATLAB 5.0";
/// Largest nesting depth.
const MAX_DEPTH: usize = 12;
/// Number of arrays that are listed in an error.
const LISTED: usize = 16;

/// Open file.
pub(super) struct Content {
    path: PathBuf,
    source: Source,
    /// Entries that may still be made.
    budget: Cell<usize>,
}

enum Source {
    Archive { archive: RefCell<Npz>, arrays: Vec<(String, Array)> },
    Pickle(Pickle),
    Json(serde_json::Value),
    Matlab(Vec<(String, Variable)>),
    Numbers(ArrayD<f64>),
}

/// An array of an archive.
enum Array {
    Numbers(Vec<usize>),
    Objects(Pickle),
    Text(String),
    Other(String),
}

/// Content at one place of a file.
pub(super) enum Entry<'a> {
    Map(Vec<(String, Entry<'a>)>),
    List(Vec<Entry<'a>>),
    Numbers(Numbers<'a>),
    Text(String),
    /// Anything else, with its description.
    Other(String),
}

/// An array that has not been read yet.
pub(super) struct Numbers<'a> {
    pub(super) shape: Vec<usize>,
    place: Place<'a>,
}

enum Place<'a> {
    Archive(&'a RefCell<Npz>, &'a str),
    Pickle(Value<'a>),
    Given(ArrayD<f64>),
}

impl Numbers<'_> {
    pub(super) fn read(&self) -> Result<ArrayD<f64>> {
        match &self.place {
            Place::Archive(archive, name) => archive.borrow_mut().f64(name),
            Place::Pickle(value) => value.array(),
            Place::Given(array) => Ok(array.clone()),
        }
    }
}

impl Content {
    /// Opens a file; its first bytes tell the format, not its extension.
    pub(super) fn open(path: &Path) -> Result<Self> {
        let io = |error| Error::io(path, error);
        let file = File::open(path).map_err(io)?;
        let metadata = file.metadata().map_err(io)?;
        let size = metadata.len();
        let mut head = [0; 64];
        let mut reader = BufReader::new(file);
        let mut length = 0;
        while length < head.len() {
            match reader.read(&mut head[length..]).map_err(io)? {
                0 => break,
                more => length += more,
            }
        }
        let head = &head[..length];
        let source = match head {
            [] => return Err(Error::format(path, "is empty")),
            [b'P', b'K', 3 | 5, ..] => Source::archive(path)?,
            [0x93, b'N', b'U', b'M', b'P', b'Y', ..] => Source::array(path)?,
            [0x78, 0x01 | 0x5e | 0x9c | 0xda, ..] => {
                let file = File::open(path).map_err(io)?;
                inflated(path, flate2::read::ZlibDecoder::new(file), size)?
            }
            [0x1f, 0x8b, ..] => {
                let file = File::open(path).map_err(io)?;
                inflated(path, flate2::read::GzDecoder::new(file), size)?
            }
            _ => match foreign::named(head) {
                Some(name) => return Err(Error::format(path, name)),
                None => Source::whole(path, head, size)?,
            },
        };
        let budget = Cell::new((size as usize / 8).saturating_add(1 << 12));
        Ok(Self { path: path.to_owned(), source, budget })
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// The file's content, arrays unread.
    pub(super) fn root(&self) -> Result<Entry<'_>> {
        Ok(match &self.source {
            Source::Archive { archive, arrays } => {
                let mut entries = Vec::new();
                for (name, array) in arrays {
                    let entry = match array {
                        Array::Numbers(shape) => Entry::Numbers(Numbers {
                            shape: shape.clone(),
                            place: Place::Archive(archive, name),
                        }),
                        Array::Objects(pickle) => self.object(&pickle.root(), MAX_DEPTH)?,
                        Array::Text(text) => Entry::Text(text.clone()),
                        Array::Other(what) => Entry::Other(what.clone()),
                    };
                    entries.push((name.clone(), entry));
                }
                Entry::Map(entries)
            }
            Source::Pickle(pickle) => self.object(&pickle.root(), MAX_DEPTH)?,
            Source::Json(value) => self.json(value, MAX_DEPTH)?,
            Source::Matlab(variables) => {
                let entry = |(name, variable): &(String, Variable)| {
                    let entry = match variable {
                        Variable::Numbers(array) => Entry::given(array.clone()),
                        Variable::Text(text) => Entry::Text(text.clone()),
                        Variable::Other(what) => Entry::Other((*what).to_owned()),
                    };
                    (name.clone(), entry)
                };
                Entry::Map(variables.iter().map(entry).collect())
            }
            Source::Numbers(array) => Entry::given(array.clone()),
        })
    }

    fn spend(&self) -> Result<()> {
        match self.budget.get().checked_sub(1) {
            Some(left) => {
                self.budget.set(left);
                Ok(())
            }
            None => {
                Err(Error::format(&self.path, "more entries than a file of this size can hold"))
            }
        }
    }

    fn object<'a>(&self, value: &Value<'a>, depth: usize) -> Result<Entry<'a>> {
        self.spend()?;
        let Some(depth) = depth.checked_sub(1) else {
            return Ok(Entry::Other("nested too deeply".into()));
        };
        if let Some(shape) = value.numeric_shape() {
            return Ok(Entry::Numbers(Numbers { shape, place: Place::Pickle(value.clone()) }));
        }
        if let Some(entries) = value.items_by_name() {
            let inner = entries.into_iter().map(|(name, v)| Ok((name, self.object(&v, depth)?)));
            return Ok(Entry::Map(inner.collect::<Result<_>>()?));
        }
        if let Ok((shape, mut elements)) = value.objects() {
            return match (&shape[..], elements.len()) {
                ([], 1) => self.object(&elements.remove(0), depth),
                _ => self.list(elements, depth),
            };
        }
        if let Some(elements) = value.elements() {
            return self.list(elements, depth);
        }
        Ok(match value.string() {
            Ok(text) => Entry::Text(text),
            Err(_) if value.is_none() => Entry::Other("None".into()),
            Err(_) => Entry::Other(value.class().unwrap_or("no numbers").to_owned()),
        })
    }

    fn list<'a>(&self, elements: Vec<Value<'a>>, depth: usize) -> Result<Entry<'a>> {
        let inner = elements.iter().map(|element| self.object(element, depth));
        Ok(Entry::List(inner.collect::<Result<_>>()?))
    }

    fn json(&self, value: &serde_json::Value, depth: usize) -> Result<Entry<'static>> {
        use serde_json::Value as Json;
        self.spend()?;
        let Some(depth) = depth.checked_sub(1) else {
            return Ok(Entry::Other("nested too deeply".into()));
        };
        let mut shape = Vec::new();
        let mut numbers = Vec::new();
        if json_numbers(value, 0, &mut shape, &mut numbers).is_some()
            && let Ok(array) = ArrayD::from_shape_vec(IxDyn(&shape), numbers)
        {
            return Ok(Entry::given(array));
        }
        Ok(match value {
            Json::Object(entries) => {
                let inner =
                    entries.iter().map(|(name, v)| Ok((name.clone(), self.json(v, depth)?)));
                Entry::Map(inner.collect::<Result<_>>()?)
            }
            Json::Array(elements) => {
                let inner = elements.iter().map(|element| self.json(element, depth));
                Entry::List(inner.collect::<Result<_>>()?)
            }
            Json::String(text) => Entry::Text(text.clone()),
            _ => Entry::Other("no numbers".into()),
        })
    }
}

impl Entry<'_> {
    fn given(array: ArrayD<f64>) -> Self {
        Self::Numbers(Numbers { shape: array.shape().to_vec(), place: Place::Given(array) })
    }

    /// Names and shapes of the arrays, for errors.
    pub(super) fn describe(&self) -> String {
        let mut found = Vec::new();
        self.gather("", &mut found);
        match found.len() {
            0 => "no arrays".to_owned(),
            count => {
                found.truncate(LISTED);
                let more = count.saturating_sub(LISTED);
                let rest = if more > 0 { " and more".to_owned() } else { String::new() };
                found.join(", ") + &rest
            }
        }
    }

    fn gather(&self, name: &str, found: &mut Vec<String>) {
        if found.len() > LISTED {
            return;
        }
        let inner = |part: &str| match name {
            "" => part.to_owned(),
            name => format!("{name}.{part}"),
        };
        match self {
            Self::Map(entries) => {
                for (part, entry) in entries {
                    entry.gather(&inner(part), found);
                }
            }
            Self::List(entries) => {
                for (part, entry) in entries.iter().enumerate() {
                    entry.gather(&inner(&part.to_string()), found);
                }
            }
            Self::Numbers(numbers) => {
                let name = if name.is_empty() { "an array" } else { name };
                found.push(format!("{name} {:?}", numbers.shape));
            }
            Self::Text(_) => found.push(format!("{name} (text)")),
            Self::Other(what) => found.push(format!("{name} ({what})")),
        }
    }
}

impl Source {
    fn archive(path: &Path) -> Result<Self> {
        let mut archive = Npz::open(path)?;
        let mut arrays = Vec::new();
        for name in archive.names() {
            let header = archive.header(&name)?;
            let array = if header.dtype.is_object() {
                Array::Objects(archive.objects(&name)?)
            } else if header.dtype.size > 0 {
                Array::Numbers(header.shape)
            } else {
                match archive.text(&name) {
                    Ok(text) => Array::Text(text),
                    Err(_) => Array::Other(format!("`{}`", header.dtype)),
                }
            };
            arrays.push((name, array));
        }
        Ok(Self::Archive { archive: RefCell::new(archive), arrays })
    }

    fn array(path: &Path) -> Result<Self> {
        if npy_header(path)?.dtype.is_object() {
            return Ok(Self::Pickle(read_objects(path)?));
        }
        Ok(Self::Numbers(read_f64(path)?))
    }

    /// A pickle, JSON or text.
    fn whole(path: &Path, head: &[u8], size: u64) -> Result<Self> {
        if size > MAX_FILE {
            let message = format!("{size} bytes, expected at most {MAX_FILE}");
            return Err(Error::format(path, message));
        }
        let start = head.strip_prefix(b"\xef\xbb\xbf").unwrap_or(head).trim_ascii_start();
        if Pickle::is_start(head) {
            return Ok(Self::Pickle(Pickle::open(path)?));
        }
        let bytes = std::fs::read(path).map_err(|error| Error::io(path, error))?;
        if start.starts_with(MATLAB) {
            let most = BOMB_SIZE.max(size.saturating_mul(BOMB_RATIO));
            return Ok(Self::Matlab(matlab::variables(path, &bytes, most)?));
        }
        if matches!(start, [b'{' | b'[', ..]) {
            let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&bytes);
            let value = serde_json::from_slice(text)
                .map_err(|error| Error::format(path, format!("not JSON: {error}")))?;
            return Ok(Self::Json(value));
        }
        let name = path.display().to_string();
        let rows: Result<Vec<Vec<f64>>> = MotionRows::new(name, &bytes[..]).collect();
        let rows = match rows {
            Ok(rows) if !rows.is_empty() => rows,
            Err(error) if std::str::from_utf8(&bytes).is_ok() => return Err(error),
            _ => return Err(Error::format(path, UNKNOWN)),
        };
        let shape = [rows.len(), rows[0].len()];
        let table = ArrayD::from_shape_vec(IxDyn(&shape), rows.concat())
            .map_err(|error| Error::format(path, error.to_string()))?;
        Ok(Self::Numbers(table))
    }
}

const UNKNOWN: &str = "unknown kind of file: expected poses in .npz, .npy, .pkl (joblib's too), .mat, \
                       .json, .csv or .smpl";

/// Decompresses a pickle.
fn inflated(path: &Path, reader: impl Read, size: u64) -> Result<Source> {
    let most = BOMB_SIZE.max(size.saturating_mul(BOMB_RATIO));
    let mut bytes = Vec::new();
    let read = reader.take(most + 1).read_to_end(&mut bytes);
    read.map_err(|error| Error::format(path, format!("compressed data: {error}")))?;
    if bytes.len() as u64 > most {
        let message = format!("rejected as a decompression bomb: more than {most} bytes");
        return Err(Error::format(path, message));
    }
    Ok(Source::Pickle(Pickle::parse(path, bytes)?))
}

/// Appends the numbers of nested lists of one shape; `None` for anything else.
fn json_numbers(
    value: &serde_json::Value,
    depth: usize,
    shape: &mut Vec<usize>,
    numbers: &mut Vec<f64>,
) -> Option<()> {
    match value {
        serde_json::Value::Number(number) if depth == shape.len() => {
            numbers.push(number.as_f64()?);
            Some(())
        }
        serde_json::Value::Array(elements) if depth < MAX_DEPTH => {
            match shape.get(depth) {
                Some(&length) => (length == elements.len()).then_some(())?,
                None if numbers.is_empty() => shape.push(elements.len()),
                None => return None,
            }
            elements.iter().try_for_each(|e| json_numbers(e, depth + 1, shape, numbers))
        }
        _ => None,
    }
}
