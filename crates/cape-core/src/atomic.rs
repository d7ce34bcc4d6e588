use std::{
    collections::HashSet,
    fs::{self, File, TryLockError},
    io::{self, BufWriter, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
    sync::{LazyLock, Mutex, PoisonError},
};

use tempfile::NamedTempFile;

use crate::{Error, Result};

/// Parts of the names of temporary files.
const PREFIX: &str = ".cape-";
const SUFFIX: &str = ".tmp";

/// Directories that this process has cleared of temporary files left by others.
static SWEPT: LazyLock<Mutex<HashSet<PathBuf>>> = LazyLock::new(Mutex::default);

/// A buffered file that appears under its name only when [`commit`](Self::commit) succeeds.
///
/// Bytes go to a temporary file in the same directory, which `commit` renames over the target. The
/// temporary file is removed if the value is dropped uncommitted. One that a killed process left behind is
/// removed by the next process that writes to the directory.
///
/// ```
/// use std::io::Write;
///
/// use cape_core::AtomicFile;
///
/// let directory = tempfile::tempdir()?;
/// let path = directory.path().join("poses.csv");
/// let mut file = AtomicFile::create(&path)?;
/// writeln!(file, "0,0,0")?;
/// assert!(!path.exists());
/// file.commit()?;
/// assert_eq!(std::fs::read_to_string(&path)?, "0,0,0\n");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct AtomicFile {
    path: PathBuf,
    file: BufWriter<NamedTempFile>,
}

impl AtomicFile {
    /// Opens a temporary file for `path`, whose directory must exist.
    pub fn create(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref().to_owned();
        let directory = match path.parent() {
            Some(parent) if parent != Path::new("") => parent,
            _ => Path::new("."),
        };
        sweep(directory);
        let mut builder = tempfile::Builder::new();
        builder.prefix(PREFIX).suffix(SUFFIX);
        #[cfg(unix)]
        {
            // Narrowed by the process's umask, as for any other new file.
            use std::os::unix::fs::PermissionsExt;
            builder.permissions(std::fs::Permissions::from_mode(0o666));
        }
        let file = loop {
            let file = builder.tempfile_in(directory).map_err(|source| Error::io(&path, source))?;
            // Locked, so that no other process takes it for a leftover.
            if !matches!(file.as_file().try_lock(), Err(TryLockError::WouldBlock))
                && file.path().exists()
            {
                break file;
            }
        };
        Ok(Self { path, file: BufWriter::with_capacity(1 << 16, file) })
    }

    /// Path of the file after `commit`.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Renames the temporary file to its path.
    pub fn commit(self) -> Result<()> {
        let Self { path, file } = self;
        let file = file.into_inner().map_err(|failed| Error::io(&path, failed.into_error()))?;
        file.persist(&path).map_err(|failed| Error::io(&path, failed.error))?;
        Ok(())
    }
}

impl Write for AtomicFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Seek for AtomicFile {
    fn seek(&mut self, position: SeekFrom) -> io::Result<u64> {
        self.file.seek(position)
    }
}

/// True for the name of a file that is being written, or whose writing was cut off.
pub(crate) fn is_unfinished(name: &str) -> bool {
    name.starts_with(PREFIX) && name.ends_with(SUFFIX)
}

/// Removes the temporary files of processes that have ended, once in each directory. Files that cannot be
/// removed do no harm, so that there are no errors.
fn sweep(directory: &Path) {
    let first = SWEPT.lock().unwrap_or_else(PoisonError::into_inner).insert(directory.to_owned());
    if !first {
        return;
    }
    let Ok(entries) = fs::read_dir(directory) else { return };
    for entry in entries.flatten() {
        if !entry.file_name().to_str().is_some_and(is_unfinished) {
            continue;
        }
        let Ok(file) = File::options().write(true).open(entry.path()) else { continue };
        if file.try_lock().is_ok() {
            let _ = fs::remove_file(entry.path());
        }
    }
}

/// Writes the file `path` atomically: `write` produces its bytes, then it is renamed into place.
pub fn write_atomically(
    path: impl AsRef<Path>,
    write: impl FnOnce(&mut AtomicFile) -> io::Result<()>,
) -> Result<()> {
    let mut file = AtomicFile::create(path)?;
    write(&mut file).map_err(|source| Error::io(&file.path, source))?;
    file.commit()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_write_leaves_the_old_file_and_nothing_else() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a");
        write_atomically(&path, |file| file.write_all(b"old")).unwrap();
        let failed = write_atomically(&path, |file| {
            file.write_all(b"new")?;
            Err(io::Error::other("disk full"))
        });
        assert!(failed.unwrap_err().to_string().contains("disk full"));
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 1);
    }

    #[test]
    fn leftovers_are_removed_and_files_being_written_are_not() {
        let directory = tempfile::tempdir().unwrap();
        let at = |name: &str| directory.path().join(name);
        fs::write(at(".cape-dead.tmp"), "half").unwrap();
        fs::write(at(".cape-live.tmp"), "half").unwrap();
        fs::write(at("cape.tmp"), "another program's").unwrap();
        let live = File::options().write(true).open(at(".cape-live.tmp")).unwrap();
        live.lock().unwrap();
        write_atomically(at("a"), |file| file.write_all(b"new")).unwrap();
        let mut left: Vec<_> =
            fs::read_dir(directory.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
        left.sort();
        assert_eq!(left, [".cape-live.tmp", "a", "cape.tmp"]);
    }

    #[test]
    fn a_missing_directory_is_named() {
        let path = Path::new("/nonexistent-directory/file");
        let message = AtomicFile::create(path).unwrap_err().to_string();
        assert!(message.contains("/nonexistent-directory/file"), "{message}");
    }
}
