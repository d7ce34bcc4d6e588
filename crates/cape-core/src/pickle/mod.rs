//! Reader of Python pickles that builds data and executes nothing, and a writer of dictionaries of texts.
//!
//! A pickle is a program that may call any function. This reader interprets only the instructions
//! that build data: it imports and calls nothing. Classes come from an allow list of what body files
//! and clothing models contain (NumPy arrays, SciPy sparse matrices, chumpy arrays and views,
//! scikit-learn mixtures, joblib's files, Python containers); any other class is an error with its name.
//!
//! Protocols 0 to 5 and files of Python 2 are supported. Memory is bounded by a multiple of the file
//! size, for malicious files too: strings and arrays are copied out of the file on demand.

mod array;
mod chumpy;
mod class;
mod joblib;
mod latin1;
mod machine;
mod node;
mod sparse;
#[cfg(test)]
mod tests;
mod text;
mod value;
mod write;

use std::{
    cell::Cell,
    fs,
    path::{Path, PathBuf},
};

pub use sparse::Triplets;
pub use value::Value;
pub use write::write_texts;

use crate::{Error, Result};
use node::{Item, Node};

/// Largest accepted file, bytes; ten times the largest body files.
const MAX_FILE: u64 = 4 << 30;
/// Limit of the bytes copied out of a file, per byte of the file: one-byte numbers become eight-byte
/// ones, and the same array may be read several times.
const MAX_EXPANSION: u64 = 64;

/// Decoded pickle in memory.
///
/// ```
/// use cape_core::pickle::Pickle;
///
/// // pickle.dumps({"betas": [1, 2, 3], "gender": "female"}, protocol=0)
/// let written = b"(dp0\nVbetas\np1\n(lp2\nI1\naI2\naI3\nasVgender\np3\nVfemale\np4\ns.";
/// let pickle = Pickle::parse("body.pkl", written.to_vec())?;
/// let body = pickle.root();
/// assert_eq!(body.keys(), ["betas", "gender"]);
/// assert_eq!(body.require("gender")?.text()?, "female");
/// assert_eq!(body.require("betas")?.array::<f64>()?.into_raw_vec_and_offset().0, [1., 2., 3.]);
/// let missing = body.require("shapedirs").err().unwrap();
/// assert_eq!(missing.to_string(), "body.pkl: `shapedirs`: missing");
///
/// // A pickle that calls a function is rejected.
/// assert!(Pickle::parse("evil.pkl", b"cos\nsystem\n(S'ls'\ntR.".to_vec()).is_err());
/// # Ok::<(), cape_core::Error>(())
/// ```
pub struct Pickle {
    path: PathBuf,
    source: Vec<u8>,
    nodes: Vec<Node>,
    classes: Vec<class::Class>,
    root: Item,
    /// Remaining bytes that may be copied out.
    allowance: Cell<u64>,
}

impl Pickle {
    /// Reads a pickle file.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let length = fs::metadata(path).map_err(|source| Error::io(path, source))?.len();
        if length > MAX_FILE {
            return Err(Error::format(
                path,
                format!("pickle of {length} bytes, expected at most {MAX_FILE}"),
            ));
        }
        Self::parse(path, fs::read(path).map_err(|source| Error::io(path, source))?)
    }

    /// Decodes a pickle in memory; errors name `path`.
    pub fn parse(path: impl AsRef<Path>, source: Vec<u8>) -> Result<Self> {
        let path = path.as_ref();
        let start = &source[..source.len().min(4096)];
        if let Some(found) = crate::unexpected_content(start, source.len() as u64) {
            return Err(Error::format(path, found));
        }
        let allowance = (source.len() as u64).saturating_mul(MAX_EXPANSION).saturating_add(1 << 20);
        let machine::ObjectGraph { nodes, classes, root } = machine::run(&source)
            .map_err(|message| Error::format(path, format!("pickle: {message}")))?;
        let allowance = Cell::new(allowance);
        Ok(Self { path: path.to_owned(), source, nodes, classes, root, allowance })
    }

    /// The pickled object.
    pub fn root(&self) -> Value<'_> {
        Value::new(self, self.root, String::new())
    }

    /// Path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// True if `bytes` may be the start of a pickle.
    pub fn is_start(bytes: &[u8]) -> bool {
        // Protocols from 2 on start with a PROTO instruction, protocols 0 and 1 with a dictionary, a
        // list, a tuple or a class.
        matches!(bytes, [0x80, 2..=5, ..] | [b'(' | b'}' | b']' | b'c', ..])
    }
}
