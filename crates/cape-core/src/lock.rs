//! Locks between processes.

use std::{
    fs::{File, OpenOptions, TryLockError},
    io,
    path::Path,
};

use crate::{Error, Result};

/// Name of the lock file.
const LOCK: &str = ".cape-lock";

/// Lock on a directory that one process at a time may write to. It lasts until it is dropped or its
/// process ends, however that ends; the file `.cape-lock` stays.
///
/// ```
/// use cape_core::DirectoryLock;
///
/// let directory = tempfile::tempdir()?;
/// let lock = DirectoryLock::try_acquire(directory.path())?;
/// assert!(DirectoryLock::was_in(directory.path()));
/// assert!(lock.is_some() && DirectoryLock::try_acquire(directory.path())?.is_none());
/// let refused = DirectoryLock::acquire(directory.path()).unwrap_err().to_string();
/// assert!(refused.contains("another process"));
/// drop(lock);
/// assert!(DirectoryLock::try_acquire(directory.path())?.is_some());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct DirectoryLock {
    /// Holds the lock; `None` where the file system has no locks.
    _file: Option<File>,
}

impl DirectoryLock {
    /// Locks `directory`; `None` if another process has it.
    ///
    /// # Errors
    /// If the lock file cannot be created in the directory.
    pub fn try_acquire(directory: &Path) -> Result<Option<Self>> {
        let path = directory.join(LOCK);
        let file = open(&path)?;
        match file.try_lock() {
            Ok(()) => Ok(Some(Self { _file: Some(file) })),
            Err(TryLockError::WouldBlock) => Ok(None),
            Err(TryLockError::Error(error)) if error.kind() == io::ErrorKind::Unsupported => {
                Ok(Some(Self { _file: None }))
            }
            Err(TryLockError::Error(source)) => Err(Error::io(&path, source)),
        }
    }

    /// True if a process has ever locked `directory`.
    pub fn was_in(directory: &Path) -> bool {
        directory.join(LOCK).exists()
    }

    /// Locks `directory`, after waiting for another process that has it.
    ///
    /// # Errors
    /// As of [`try_acquire`](Self::try_acquire).
    pub fn wait(directory: &Path) -> Result<Self> {
        let path = directory.join(LOCK);
        let file = open(&path)?;
        match file.lock() {
            Ok(()) => Ok(Self { _file: Some(file) }),
            Err(error) if error.kind() == io::ErrorKind::Unsupported => Ok(Self { _file: None }),
            Err(source) => Err(Error::io(&path, source)),
        }
    }

    /// Locks `directory`.
    ///
    /// # Errors
    /// If another process has it, or as of [`try_acquire`](Self::try_acquire).
    pub fn acquire(directory: &Path) -> Result<Self> {
        Self::try_acquire(directory)?.ok_or_else(|| {
            Error::Data(format!(
                "{}: another process is writing to it: wait until it ends, or choose another \
                 directory",
                directory.display()
            ))
        })
    }
}

fn open(path: &Path) -> Result<File> {
    let mut options = OpenOptions::new();
    let file = options.create(true).truncate(false).write(true).open(path);
    file.map_err(|source| Error::io(path, source))
}

/// True for a lock file, and for what an interrupted [`AtomicFile`](crate::AtomicFile) leaves behind:
/// names in a directory that are not part of its contents.
pub fn is_temporary(name: &str) -> bool {
    name == LOCK || crate::atomic::is_unfinished(name)
}
