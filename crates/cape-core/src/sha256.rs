use std::{
    fs::File,
    io::{self, Read},
    path::Path,
};

use sha2::{Digest, Sha256};

use crate::{Error, Result, hex};

/// Bytes read at a time.
const CHUNK: usize = 1 << 20;

/// SHA-256 of a file's contents in hexadecimal, as `sha256sum` prints it.
///
/// ```
/// let directory = tempfile::tempdir()?;
/// std::fs::write(directory.path().join("body.txt"), "SMPL")?;
/// let hash = cape_core::sha256_of_file(directory.path().join("body.txt"))?;
/// assert!(hash.starts_with("ae2a1c30"), "{hash}");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn sha256_of_file(path: impl AsRef<Path>) -> Result<String> {
    let path = path.as_ref();
    let mut file = File::open(path).map_err(|source| Error::io(path, source))?;
    let (mut hash, mut buffer) = (Sha256::new(), vec![0; CHUNK]);
    loop {
        match file.read(&mut buffer) {
            Ok(0) => return Ok(hex(hash.finalize())),
            Ok(read) => hash.update(&buffer[..read]),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(source) => return Err(Error::io(path, source)),
        }
    }
}
