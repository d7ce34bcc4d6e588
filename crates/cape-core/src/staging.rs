//! Output directories that appear under their name only when they are complete.

use std::{
    fs::{self, File, TryLockError},
    path::{Path, PathBuf},
};

use crate::{Error, Result};

/// Hidden directory beside its final path that is filled, then renamed; removed unless committed.
pub struct StagingDirectory {
    /// Path of the hidden directory, to write into.
    pub path: PathBuf,
    /// Lock file that keeps other processes from filling the same directory.
    lock: (PathBuf, File),
    /// Keep the contents on drop, so that a later run can resume.
    pub keep: bool,
}

impl StagingDirectory {
    /// Opens the staging directory of `out`, which must be empty or missing; contents left by an
    /// interrupted run are kept.
    ///
    /// # Errors
    /// If `out` has contents, or another process fills it.
    pub fn prepare(out: &Path) -> Result<Self> {
        let fail = |e| Error::io(out, e);
        let Some(name) = out.file_name() else {
            return Err(Error::argument(format!(
                "{} is not the name of a directory",
                out.display()
            )));
        };
        let path = out.with_file_name(format!(".{}.cape-partial", name.to_string_lossy()));
        let lock_path = path.with_extension("cape-lock");
        if out.exists() && (!out.is_dir() || fs::read_dir(out).map_err(fail)?.next().is_some()) {
            // Left by a process that was killed after it had completed `out`.
            if lock_path.exists() && lock(lock_path.clone(), out).is_ok() {
                let _ = fs::remove_file(lock_path);
            }
            return Err(Error::Data(format!(
                "{} already exists: remove it, or choose another directory",
                out.display()
            )));
        }
        fs::create_dir_all(&path).map_err(|e| Error::io(&path, e))?;
        let lock = lock(lock_path, out)?;
        // The previous holder of the lock may have renamed the directory.
        fs::create_dir_all(&path).map_err(|e| Error::io(&path, e))?;
        Ok(Self { path, lock, keep: false })
    }

    /// Opens an empty staging directory of `out`.
    pub fn create(out: &Path) -> Result<Self> {
        let staging = Self::prepare(out)?;
        staging.clear()?;
        Ok(staging)
    }

    /// Deletes the contents.
    pub fn clear(&self) -> Result<()> {
        fs::remove_dir_all(&self.path)
            .and_then(|()| fs::create_dir(&self.path))
            .map_err(|e| Error::io(&self.path, e))
    }

    /// Renames the staging directory to `out`.
    pub fn commit(mut self, out: &Path) -> Result<()> {
        if out.is_dir() {
            fs::remove_dir(out).map_err(|e| Error::io(out, e))?;
        }
        fs::rename(&self.path, out).map_err(|e| Error::io(out, e))?;
        self.keep = true;
        Ok(())
    }
}

/// Locks the file at `path`, so that no other process fills `out`.
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
            "{}: another process is writing it: wait, or choose another directory",
            out.display()
        ))),
        Err(TryLockError::Error(error)) => Err(Error::io(path, error)),
    }
}

impl Drop for StagingDirectory {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.lock.0);
        if !self.keep {
            // `drop` cannot report a failed clean-up.
            let _ = fs::remove_dir_all(&self.path);
        }
    }
}
