//! Python's pickles, read as data.
//!
//! A pickle is a program that may call anything. This reader runs only the part that builds data:
//! nothing is imported and nothing is called. A class is a name beside the state that was stored
//! for it, and only the names that body files and clothing models are made of are let through:
//! NumPy's arrays, SciPy's sparse matrices, chumpy's arrays and views, scikit-learn's mixtures and
//! Python's own containers. Any other name is an error that says which.
//!
//! All protocols are read (0 to 5), and what Python 2 wrote. Memory is a small multiple of the
//! file's size, whatever the file says: strings and arrays stay where they are in the file until
//! they are asked for.

mod array;
mod chumpy;
mod class;
mod machine;
mod node;
mod sparse;
#[cfg(test)]
mod tests;
mod text;
mod value;

use std::{
    cell::Cell,
    fs,
    path::{Path, PathBuf},
};

pub use sparse::Triplets;
pub use value::Value;

use crate::{Error, Result};
use node::{Item, Node};

/// Largest file read, bytes. The largest body files are a tenth of it.
const MAX_FILE: u64 = 4 << 30;
/// Bytes that arrays taken out of a file may take, per byte of the file: one-byte numbers become
/// eight, and a file may be asked for the same array a few times.
const MAX_EXPANSION: u64 = 64;

/// A pickle in memory.
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
/// // What would run is refused, not run.
/// assert!(Pickle::parse("evil.pkl", b"cos\nsystem\n(S'ls'\ntR.".to_vec()).is_err());
/// # Ok::<(), cape_core::Error>(())
/// ```
pub struct Pickle {
    path: PathBuf,
    source: Vec<u8>,
    nodes: Vec<Node>,
    classes: Vec<class::Class>,
    root: Item,
    /// Bytes that may still be taken out.
    allowance: Cell<u64>,
}

impl Pickle {
    /// Reads a file.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let length = fs::metadata(path).map_err(|source| Error::io(path, source))?.len();
        if length > MAX_FILE {
            return Err(Error::format(
                path,
                format!("a pickle of {length} bytes, expected at most {MAX_FILE}"),
            ));
        }
        Self::parse(path, fs::read(path).map_err(|source| Error::io(path, source))?)
    }

    /// Reads a pickle from memory; errors name `path`.
    pub fn parse(path: impl AsRef<Path>, source: Vec<u8>) -> Result<Self> {
        let path = path.as_ref();
        let allowance = (source.len() as u64).saturating_mul(MAX_EXPANSION).saturating_add(1 << 20);
        let machine::ObjectGraph { nodes, classes, root } = machine::run(&source)
            .map_err(|message| Error::format(path, format!("pickle: {message}")))?;
        let allowance = Cell::new(allowance);
        Ok(Self { path: path.to_owned(), source, nodes, classes, root, allowance })
    }

    /// The object that was pickled.
    pub fn root(&self) -> Value<'_> {
        Value::new(self, self.root, String::new())
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether a file that starts with these bytes may be a pickle.
    pub fn is_start(bytes: &[u8]) -> bool {
        // Protocol 2 and later say so; protocols 0 and 1 start with a dictionary, a list, a tuple
        // or the name of a class.
        matches!(bytes, [0x80, 2..=5, ..] | [b'(' | b'}' | b']' | b'c', ..])
    }
}
