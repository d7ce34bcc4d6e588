//! SHA-256 of files and directories.

use std::{
    collections::HashMap,
    fs,
    path::{Path, PathBuf},
    sync::{LazyLock, Mutex, PoisonError},
    time::SystemTime,
};

use sha2::{Digest, Sha256};

use crate::{Error, Result};

/// Path, size and time of the last change of a file.
type FileState = (PathBuf, u64, SystemTime);

/// Hashes of this process, so that an input of many stores is read once.
static KNOWN: LazyLock<Mutex<HashMap<FileState, String>>> = LazyLock::new(Mutex::default);

/// SHA-256 of a file's contents in hexadecimal, as `sha256sum` prints it; of a directory that of
/// [`sha256_of_files`] over all files below it.
///
/// ```
/// use cape_eval::store::sha256;
///
/// let directory = tempfile::tempdir()?;
/// std::fs::write(directory.path().join("body.txt"), "SMPL")?;
/// let file = sha256(&directory.path().join("body.txt"))?;
/// assert!(file.starts_with("ae2a1c30"), "{file}");
/// assert_ne!(sha256(directory.path())?, file);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn sha256(path: &Path) -> Result<String> {
    let metadata = fs::metadata(path).map_err(|source| Error::io(path, source))?;
    if !metadata.is_dir() {
        return sha256_of_file(path);
    }
    let mut names = Vec::new();
    list(path, "", &mut names)?;
    sha256_of_files(path, &names)
}

/// SHA-256 of the lines `HASH  NAME` of files in `root`, sorted by name: that of the output of
/// `sha256sum`, called in `root` with the sorted names.
pub fn sha256_of_files(root: &Path, names: &[String]) -> Result<String> {
    let mut names: Vec<&String> = names.iter().collect();
    names.sort_unstable();
    let mut hash = Sha256::new();
    for name in names {
        let file = sha256_of_file(&root.join(name))?;
        hash.update(format!("{file}  {name}\n"));
    }
    Ok(cape_core::hex(hash.finalize()))
}

fn sha256_of_file(path: &Path) -> Result<String> {
    let fault = |source| Error::io(path, source);
    let absolute = fs::canonicalize(path).map_err(fault)?;
    let metadata = fs::metadata(path).map_err(fault)?;
    let state = (absolute, metadata.len(), metadata.modified().map_err(fault)?);
    let known = || KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(hash) = known().get(&state) {
        return Ok(hash.clone());
    }
    let hash = cape_core::sha256_of_file(path)?;
    known().insert(state, hash.clone());
    Ok(hash)
}

/// Names of the files below `root/within`, relative to `root`, with `/` between their parts.
fn list(root: &Path, within: &str, names: &mut Vec<String>) -> Result<()> {
    let directory = root.join(within);
    let fault = |source| Error::io(&directory, source);
    for entry in fs::read_dir(&directory).map_err(fault)? {
        let entry = entry.map_err(fault)?;
        let path = entry.path();
        let name = entry.file_name();
        let Some(name) = name.to_str() else {
            return Err(Error::format(&path, "the name is not UTF-8: rename the file"));
        };
        let name = if within.is_empty() { name.to_owned() } else { format!("{within}/{name}") };
        let kind = entry.file_type().map_err(fault)?;
        if kind.is_dir() {
            list(root, &name, names)?;
        } else if kind.is_symlink() && path.is_dir() {
            return Err(Error::format(
                &path,
                "is a link to a directory, whose contents cannot be hashed: copy the directory",
            ));
        } else {
            names.push(name);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn contents_and_names_count_and_places_do_not() {
        let [one, other] = [(); 2].map(|()| tempfile::tempdir().unwrap());
        for root in [&one, &other] {
            fs::create_dir(root.path().join("train")).unwrap();
            fs::write(root.path().join("train/b.npy"), "1").unwrap();
            fs::write(root.path().join("a.npy"), "2").unwrap();
        }
        let hash = |root: &tempfile::TempDir| sha256(root.path()).unwrap();
        assert_eq!(hash(&one), hash(&other));
        // printf '%s  a.npy\n%s  train/b.npy\n' $(printf 2 | sha256sum) $(printf 1 | sha256sum) | sha256sum
        assert_eq!(
            sha256(&one.path().join("a.npy")).unwrap(),
            "d4735e3a265e16eee03f59718b9b5d03019c07d8b6c51f90da3a666eec13ab35"
        );
        let before = hash(&one);
        fs::write(one.path().join("train/b.npy"), "10").unwrap();
        assert_ne!(hash(&one), before);
        fs::write(one.path().join("train/b.npy"), "1").unwrap();
        assert_eq!(hash(&one), before);
        fs::rename(one.path().join("a.npy"), one.path().join("c.npy")).unwrap();
        assert_ne!(hash(&one), before);
        let missing = sha256(&one.path().join("lost.npy")).unwrap_err().to_string();
        assert!(missing.contains("lost.npy"), "{missing}");
    }
}
