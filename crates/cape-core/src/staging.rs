//! Output directories that appear under their name only when they are complete.

use std::{
    fs::{self, File, TryLockError},
    io::ErrorKind,
    path::{Path, PathBuf},
};

use same_file::Handle;

use crate::{Error, Result};

/// Hidden directory beside its final path that is filled, then renamed; removed unless committed.
pub struct StagingDirectory {
    /// Path of the hidden directory, to write into.
    pub path: PathBuf,
    /// Keeps other processes from filling the same directory.
    _lock: LockFile,
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
        if let Some(parent) = out.parent().filter(|parent| !parent.exists()) {
            fs::create_dir_all(parent).map_err(|e| Error::io(parent, e))?;
        }
        // Before anything else is looked at: another process may be completing `out`.
        let lock = lock(&path.with_extension("cape-lock"), out)?;
        if out.exists() && (!out.is_dir() || fs::read_dir(out).map_err(fail)?.next().is_some()) {
            return Err(Error::Data(format!(
                "{} already exists: remove it, or choose another directory",
                out.display()
            )));
        }
        fs::create_dir_all(&path).map_err(|e| Error::io(&path, e))?;
        Ok(Self { path, _lock: lock, keep: false })
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

/// Locked file that keeps other processes from filling the same directory; removed when dropped.
struct LockFile {
    path: PathBuf,
    /// Holds the lock, where the file system has locks.
    _file: File,
}

/// Locks the file at `path`, so that no other process fills `out`.
fn lock(path: &Path, out: &Path) -> Result<LockFile> {
    let fail = |error| Error::io(path, error);
    loop {
        let mut options = File::options();
        let file = options.create(true).truncate(false).write(true).open(path).map_err(fail)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                return Err(Error::Data(format!(
                    "{}: another process is writing it: wait, or choose another directory",
                    out.display()
                )));
            }
            Err(TryLockError::Error(error)) if error.kind() == ErrorKind::Unsupported => {}
            Err(TryLockError::Error(error)) => return Err(fail(error)),
        }
        // Its previous holder may have removed the file after it was opened here.
        let opened = Handle::from_file(file.try_clone().map_err(fail)?).map_err(fail)?;
        if Handle::from_path(path).is_ok_and(|present| present == opened) {
            return Ok(LockFile { path: path.to_owned(), _file: file });
        }
    }
}

impl Drop for LockFile {
    fn drop(&mut self) {
        // `drop` cannot report a failed clean-up.
        let _ = fs::remove_file(&self.path);
    }
}

impl Drop for StagingDirectory {
    fn drop(&mut self) {
        if !self.keep {
            // `drop` cannot report a failed clean-up.
            let _ = fs::remove_dir_all(&self.path);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::thread;

    use super::*;

    /// One at a time has the directory, and what is complete is whole; the others are refused.
    #[test]
    fn writers_of_one_directory_exclude_each_other() {
        let root = tempfile::tempdir().unwrap();
        let out = root.path().join("parent/out");
        let committed: usize = thread::scope(|scope| {
            let writers = (0..6).map(|writer| {
                let out = &out;
                scope.spawn(move || write_repeatedly(writer, out))
            });
            let writers: Vec<_> = writers.collect();
            writers.into_iter().map(|writer| writer.join().unwrap()).sum()
        });
        assert!(committed > 0);
        let left: Vec<_> = fs::read_dir(out.parent().unwrap()).unwrap().collect();
        assert!(left.len() <= 1, "{left:?}");
    }

    /// Fills `out` when nobody else does, and removes it when it is complete; the number of times it
    /// was completed here.
    fn write_repeatedly(writer: usize, out: &Path) -> usize {
        let mut committed = 0;
        for round in 0..300 {
            let staging = match StagingDirectory::create(out) {
                Ok(staging) => staging,
                Err(error) => {
                    let refused = error.to_string();
                    let expected = ["another process", "already exists"];
                    assert!(expected.iter().any(|said| refused.contains(said)), "{refused}");
                    continue;
                }
            };
            for file in 0..3 {
                fs::write(staging.path.join(format!("{writer}-{file}")), "").unwrap();
            }
            assert_eq!(fs::read_dir(&staging.path).unwrap().count(), 3);
            if round % 3 > 0 {
                staging.commit(out).unwrap();
                assert_eq!(fs::read_dir(out).unwrap().count(), 3);
                // Under another name, so that the directory is never seen empty.
                let removed = out.with_file_name(format!("removed-{writer}"));
                fs::rename(out, &removed).unwrap();
                fs::remove_dir_all(removed).unwrap();
                committed += 1;
            }
        }
        committed
    }
}
