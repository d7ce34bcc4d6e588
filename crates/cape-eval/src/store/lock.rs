//! Locks between processes.

use std::{
    fs::{File, OpenOptions, TryLockError},
    path::Path,
};

use crate::{Error, Result};

/// Name of the lock file.
pub(super) const LOCK: &str = ".cape-lock";

/// Lock on a directory of results, which lasts until it is dropped or its process ends.
///
/// ```
/// use cape_eval::store::{ResultStore, StoreOptions, StoreSettings};
///
/// let directory = tempfile::tempdir()?;
/// let open = || {
///     let settings = StoreSettings::new("fits", &())?;
///     ResultStore::open(directory.path(), settings, StoreOptions::default())
/// };
/// let (one, other) = (open()?, open()?);
/// let lock = one.try_lock()?;
/// assert!(lock.is_some() && other.try_lock()?.is_none());
/// one.write("fit-1.json", &0.25)?;
/// drop(lock);
/// // The other one sees what was written in the meantime.
/// assert!(other.try_lock()?.is_some());
/// assert_eq!(other.read("fit-1.json")?, Some(0.25));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct StoreLock {
    /// Holds the lock; `None` where the file system has no locks.
    _file: Option<File>,
}

impl StoreLock {
    pub(super) fn acquire(root: &Path) -> Result<Option<Self>> {
        let path = root.join(LOCK);
        let mut options = OpenOptions::new();
        let file = options.create(true).truncate(false).write(true).open(&path);
        let file = file.map_err(|source| Error::io(&path, source))?;
        match file.try_lock() {
            Ok(()) => Ok(Some(Self { _file: Some(file) })),
            Err(TryLockError::WouldBlock) => Ok(None),
            Err(TryLockError::Error(error)) if error.kind() == std::io::ErrorKind::Unsupported => {
                Ok(Some(Self { _file: None }))
            }
            Err(TryLockError::Error(source)) => Err(Error::io(&path, source)),
        }
    }
}
