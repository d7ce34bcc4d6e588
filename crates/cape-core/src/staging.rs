//! Directories that appear whole or not at all.

use std::{
    fs::{self, File, TryLockError},
    path::{Path, PathBuf},
};

use crate::{Error, Result};

/// The directory being filled, hidden beside its final place and removed unless committed.
pub struct StagingDirectory {
    /// Directory to write into.
    pub path: PathBuf,
    /// Held as long as this process fills the directory.
    lock: (PathBuf, File),
    /// Whether it stays when it is dropped, to be gone on with.
    pub keep: bool,
}

impl StagingDirectory {
    /// A place for `out`, which must be empty or missing, and what an interrupted attempt left
    /// there.
    pub fn prepare(out: &Path) -> Result<Self> {
        let fail = |e| Error::io(out, e);
        if out.exists() && (!out.is_dir() || fs::read_dir(out).map_err(fail)?.next().is_some()) {
            return Err(Error::Data(format!(
                "{} exists already: remove it, or choose another place",
                out.display()
            )));
        }
        let Some(name) = out.file_name() else {
            return Err(Error::argument(format!("{} is not a directory's name", out.display())));
        };
        let path = out.with_file_name(format!(".{}.cape-partial", name.to_string_lossy()));
        fs::create_dir_all(&path).map_err(|e| Error::io(&path, e))?;
        let lock = lock(path.with_extension("cape-lock"), out)?;
        // Whoever held the lock before may have moved the directory away.
        fs::create_dir_all(&path).map_err(|e| Error::io(&path, e))?;
        Ok(Self { path, lock, keep: false })
    }

    /// An empty place for `out`.
    pub fn create(out: &Path) -> Result<Self> {
        let staging = Self::prepare(out)?;
        staging.clear()?;
        Ok(staging)
    }

    /// Removes what is there.
    pub fn clear(&self) -> Result<()> {
        fs::remove_dir_all(&self.path)
            .and_then(|()| fs::create_dir(&self.path))
            .map_err(|e| Error::io(&self.path, e))
    }

    /// Renames the directory to `out`.
    pub fn commit(mut self, out: &Path) -> Result<()> {
        if out.is_dir() {
            fs::remove_dir(out).map_err(|e| Error::io(out, e))?;
        }
        fs::rename(&self.path, out).map_err(|e| Error::io(out, e))?;
        self.keep = true;
        Ok(())
    }
}

/// Makes sure that no other process writes `out`.
fn lock(path: PathBuf, out: &Path) -> Result<(PathBuf, File)> {
    let file = File::options()
        .create(true)
        .truncate(false)
        .write(true)
        .open(&path)
        .map_err(|e| Error::io(&path, e))?;
    match file.try_lock() {
        Ok(()) => Ok((path, file)),
        Err(TryLockError::WouldBlock) => Err(Error::Data(format!(
            "{}: another process is writing it: wait, or choose another place",
            out.display()
        ))),
        Err(TryLockError::Error(error)) => Err(Error::io(path, error)),
    }
}

impl Drop for StagingDirectory {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.lock.0);
        if !self.keep {
            // A failure to clean up has no better place to go.
            let _ = fs::remove_dir_all(&self.path);
        }
    }
}
