//! Finished work on disk, and everything it depends on.
//!
//! A [`ResultStore`] is a directory with a settings.json ([`StoreSettings`]): the kind of results,
//! the version of the program, all settings, and the SHA-256 of every input (data set, checkpoint,
//! body, clothing vertices, pose prior, layer set). Opening it again with anything else is an error
//! that names the first field that differs (`inputs.body`), both values, and the way out: another
//! directory, or to overwrite. Results of another version count as different, whatever changed in it.
//! The device is no setting: it changes results by rounding only.
//!
//! # What belongs to the settings
//! Settings are what an item depends on, not what was asked for this time. How many frames, seeds,
//! rows, noise levels or sets there are is not among them, so that more can be added later. Where items
//! depend on different things, each group has a store of its own, in a directory of its own: in table
//! 2 every row and seed, so that changing the settings of one row is an error of that row and leaves
//! the others as they are; in the report on clothing layers every set. The directory above is a store
//! without settings: it keeps tables and pictures, and says that the directory is the command's.
//!
//! # Safety
//! - Items appear whole or not at all. An item that is not there is computed, so an interrupted command
//!   resumes; one that cannot be read is an error that names its file.
//! - Everything written is listed in files.txt before it is written, a directory that is filled as a
//!   whole with `/` at the end. Only what is listed is ever removed, and only to overwrite; overwriting
//!   removes results of other settings and keeps matching ones. A directory with other files is refused,
//!   as are the results of another command.
//! - Nothing is written or removed before [`begin`](ResultStore::begin) or the first item, so that
//!   many stores can be checked before the first is touched.

mod file_list;
mod hash;
mod settings;

use std::{
    collections::BTreeSet,
    fs, io,
    path::{Path, PathBuf},
    sync::{Mutex, MutexGuard, PoisonError},
};

use cape_core::{DirectoryLock, is_temporary};
use cape_infer::write_json;
use serde::{Serialize, de::DeserializeOwned};

use file_list::{FILES, FileList, is_inside, listed};
pub use hash::{sha256, sha256_of_files};
pub use settings::{StoreSettings, packed_set_sha256};

use crate::{Error, Result};

/// Name of the file with everything that results depend on.
const SETTINGS: &str = "settings.json";

/// Options for opening a directory as a [`ResultStore`].
#[derive(Debug, Clone, Copy, Default)]
pub struct StoreOptions<'a> {
    /// Discard results of other settings, inputs or versions instead of refusing them.
    pub overwrite: bool,
    /// Files that versions without settings.json wrote: `name`, `directory/`, or `directory/*.json`
    /// for all of an extension. A directory that has one of the plain names is taken for such a
    /// version's and opened only to overwrite, which removes these files.
    pub earlier: &'a [&'a str],
    /// Names that may be in the directory before it becomes a store: stores inside it.
    pub beside: &'a [&'a str],
}

/// A directory of finished results that all depend on the same settings and inputs.
///
/// ```
/// use cape_eval::store::{ResultStore, StoreOptions, StoreSettings};
///
/// let directory = tempfile::tempdir()?;
/// let (body, out) = (directory.path().join("body.txt"), directory.path().join("out"));
/// std::fs::write(&body, "SMPL")?;
/// let settings = |noise: f64| {
///     StoreSettings::new("fits", &serde_json::json!({ "noise": noise }))?.with_input("body", &body)
/// };
/// let store = ResultStore::open(&out, settings(0.5)?, StoreOptions::default())?;
/// assert_eq!(store.read::<f64>("fit-1.json")?, None);
/// store.write("fit-1.json", &0.25)?;
///
/// // The same again has it; other settings or another body are refused.
/// let again = ResultStore::open(&out, settings(0.5)?, StoreOptions::default())?;
/// assert_eq!(again.read("fit-1.json")?, Some(0.25));
/// let other = ResultStore::open(&out, settings(1.0)?, StoreOptions::default());
/// assert!(other.unwrap_err().to_string().contains("`settings.noise`"));
/// std::fs::write(&body, "another")?;
/// let other = ResultStore::open(&out, settings(0.5)?, StoreOptions::default());
/// assert!(other.unwrap_err().to_string().contains("`inputs.body`"));
/// let overwrite = StoreOptions { overwrite: true, ..StoreOptions::default() };
/// let fresh = ResultStore::open(&out, settings(0.5)?, overwrite)?;
/// assert_eq!(fresh.read::<f64>("fit-1.json")?, None);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct ResultStore {
    root: PathBuf,
    settings: StoreSettings,
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    /// Entries to remove before settings.json is written; none once the directory has these settings.
    pending: Option<Vec<String>>,
    /// True if there was no settings.json when the directory was opened.
    fresh: bool,
    /// Entries of files.txt.
    listed: BTreeSet<String>,
}

impl ResultStore {
    /// Opens a directory that is empty, missing, or a store of the same settings, inputs and version.
    /// Nothing is written yet.
    ///
    /// # Errors
    /// If the directory holds results of something else, which is named; unless they are to be
    /// overwritten, also if they are of other settings, inputs or another version.
    pub fn open(root: &Path, settings: StoreSettings, options: StoreOptions<'_>) -> Result<Self> {
        if fs::metadata(root).is_ok_and(|metadata| !metadata.is_dir()) {
            return Err(Error::format(root, "is a file: choose another --out"));
        }
        let state = if root.join(SETTINGS).exists() {
            existing(root, &settings, options)?
        } else {
            State { pending: Some(adopted(root, options)?), fresh: true, listed: BTreeSet::new() }
        };
        Ok(Self { root: root.to_owned(), settings, state: Mutex::new(state) })
    }

    /// The directory.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Path of the file `name`, which need not exist.
    pub fn path(&self, name: &str) -> PathBuf {
        self.root.join(name)
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Makes the directory a store of these settings: removes results that are to be overwritten and
    /// writes settings.json. Done once, at the latest by the first [`claim`](Self::claim).
    pub fn begin(&self) -> Result<()> {
        self.begin_with(&mut self.state())
    }

    fn begin_with(&self, state: &mut State) -> Result<()> {
        if state.pending.is_none() {
            return Ok(());
        }
        create_dir(&self.root)?;
        let list = FileList::lock(&self.root)?;
        self.notice_settings(state);
        let Some(pending) = &state.pending else {
            state.listed.extend(list.entries()?);
            return Ok(());
        };
        if state.fresh && self.path(SETTINGS).exists() {
            // Of other settings, or unreadable.
            drop(list);
            *state = existing(&self.root, &self.settings, StoreOptions::default())?;
            return Ok(());
        }
        remove(&self.root, pending)?;
        list.clear()?;
        write_json(&self.path(SETTINGS), &self.settings)?;
        state.pending = None;
        Ok(())
    }

    /// Takes in a settings.json that another process has written since the directory was opened.
    fn notice_settings(&self, state: &mut State) {
        if state.pending.is_none() || !self.path(SETTINGS).exists() {
            return;
        }
        // Settings that are to be overwritten may be unreadable.
        let stored = StoreSettings::load(&self.path(SETTINGS)).ok();
        let same = |stored: StoreSettings| {
            stored.kind() == self.settings.kind() && stored.differences(&self.settings).is_empty()
        };
        if stored.is_some_and(same) {
            state.pending = None;
        }
    }

    /// Lists `name` as the store's, to be written by other code. With `/` at the end it is a
    /// directory that is filled as a whole.
    ///
    /// # Errors
    /// If there is such a file that the store did not write.
    pub fn list(&self, name: &str) -> Result<()> {
        if !is_inside(name) {
            return Err(Error::argument(format!("`{name}` is not a path inside a directory")));
        }
        let mut state = self.state();
        self.begin_with(&mut state)?;
        if state.listed.contains(name) {
            return Ok(());
        }
        let list = FileList::lock(&self.root)?;
        // Another process may have listed it since.
        state.listed.extend(list.entries()?);
        if !state.listed.contains(name) {
            let path = self.path(name);
            if path.symlink_metadata().is_ok() {
                return Err(foreign(&path));
            }
            list.append(name)?;
            state.listed.insert(name.to_owned());
        }
        Ok(())
    }

    /// [Lists](Self::list) `name`, makes its directory, and returns its path, to be written.
    pub fn claim(&self, name: &str) -> Result<PathBuf> {
        self.list(name)?;
        let path = self.path(name);
        create_dir(if name.ends_with('/') { &path } else { path.parent().unwrap_or(&self.root) })?;
        Ok(path)
    }

    /// Takes in what another process has written since the directory was opened.
    pub fn refresh(&self) -> Result<()> {
        let mut state = self.state();
        self.notice_settings(&mut state);
        if state.pending.is_none() {
            state.listed.extend(listed(&self.root)?);
        }
        Ok(())
    }

    /// Locks the directory against other processes until the lock is dropped; `None` if another one
    /// has it.
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
    pub fn try_lock(&self) -> Result<Option<DirectoryLock>> {
        create_dir(&self.root)?;
        let lock = DirectoryLock::try_acquire(&self.root)?;
        self.refresh()?;
        Ok(lock)
    }

    /// Locks the directory against other processes until the lock is dropped.
    ///
    /// # Errors
    /// If another process has it.
    pub fn lock(&self) -> Result<DirectoryLock> {
        create_dir(&self.root)?;
        let lock = DirectoryLock::acquire(&self.root)?;
        self.refresh()?;
        Ok(lock)
    }

    /// Locks the directory, after waiting for another process that has it.
    pub fn wait_for_lock(&self) -> Result<DirectoryLock> {
        create_dir(&self.root)?;
        let lock = DirectoryLock::wait(&self.root)?;
        self.refresh()?;
        Ok(lock)
    }

    /// True if the store has listed `name` as its own.
    pub fn owns(&self, name: &str) -> bool {
        let state = self.state();
        state.pending.is_none() && state.listed.contains(name)
    }

    /// Removes what the store wrote as `name`, if anything, to compute it again.
    ///
    /// # Errors
    /// If there is such a file that the store did not write.
    pub fn discard(&self, name: &str) -> Result<()> {
        if self.owns(name) {
            return remove(&self.root, &[name.to_owned()]);
        }
        let path = self.path(name);
        if path.symlink_metadata().is_ok() { Err(foreign(&path)) } else { Ok(()) }
    }

    /// An item, if it is finished.
    ///
    /// # Errors
    /// If its file cannot be read; it is named.
    pub fn read<T: DeserializeOwned>(&self, name: &str) -> Result<Option<T>> {
        if self.state().pending.is_some() {
            return Ok(None);
        }
        let path = self.path(name);
        let text = match fs::read(&path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            text => text.map_err(|source| Error::io(&path, source))?,
        };
        let item = serde_json::from_slice(&text);
        item.map(Some).map_err(|error| unreadable(&path, &error.to_string()))
    }

    /// Writes a finished item as JSON, atomically, and returns it as it will be read.
    pub fn write<T: Serialize + DeserializeOwned>(&self, name: &str, item: &T) -> Result<T> {
        let path = self.claim(name)?;
        write_json(&path, item)?;
        self.read(name)?.ok_or_else(|| unreadable(&path, "it was removed"))
    }
}

/// The error that a finished item cannot be read.
pub fn unreadable(path: &Path, reason: &str) -> Error {
    let reason = reason.strip_prefix(&format!("{}: ", path.display())).unwrap_or(reason);
    let message = format!("cannot be read: {reason}: remove this file to compute it again");
    Error::format(path, message)
}

/// A directory with a settings.json, compared with the settings of this time.
fn existing(root: &Path, settings: &StoreSettings, options: StoreOptions<'_>) -> Result<State> {
    let path = root.join(SETTINGS);
    let stored = match StoreSettings::load(&path) {
        Ok(stored) => stored,
        Err(error) => {
            // Whose it is, is known by the list, or by the names of an earlier version.
            let mut written = listed(root)?;
            if options.earlier.contains(&SETTINGS) {
                written.extend(matching(root, options.earlier)?);
            }
            let known = root.join(FILES).exists() || options.earlier.contains(&SETTINGS);
            if known && options.overwrite {
                return Ok(State {
                    pending: Some(written.into_iter().collect()),
                    fresh: false,
                    listed: BTreeSet::new(),
                });
            }
            let way = if known { overwrite_hint(root) } else { "choose another --out".into() };
            return Err(Error::argument(format!("{error}: {way}")));
        }
    };
    if stored.kind() != settings.kind() {
        let message = format!(
            "results of {}, not of {}: choose another --out",
            stored.kind(),
            settings.kind()
        );
        return Err(Error::field(&path, "kind", message));
    }
    let differences = stored.differences(settings);
    let Some(first) = differences.first() else {
        return Ok(State { pending: None, fresh: false, listed: listed(root)? });
    };
    if options.overwrite {
        let pending = Some(listed(root)?.into_iter().collect());
        return Ok(State { pending, fresh: false, listed: BTreeSet::new() });
    }
    let others: Vec<String> =
        differences[1..].iter().map(|other| format!("`{}`", other.field)).collect();
    let others = match others.as_slice() {
        [] => String::new(),
        others => format!(" (also different: {})", others.join(", ")),
    };
    let message = format!(
        "{} in the finished results, {} in this command{others}: {}",
        first.stored,
        first.current,
        overwrite_hint(root)
    );
    Err(Error::field(&path, &first.field, message))
}

/// Entries to remove from a directory without settings.json, which must be empty unless it is of an
/// earlier version.
fn adopted(root: &Path, options: StoreOptions<'_>) -> Result<Vec<String>> {
    let plain = |name: &&&str| !name.contains(['/', '*']) && root.join(name).exists();
    if let Some(name) = options.earlier.iter().find(plain) {
        if options.overwrite {
            return matching(root, options.earlier);
        }
        return Err(Error::format(
            root,
            format!(
                "has `{name}` but no {SETTINGS} with the settings, version and SHA-256 of the inputs \
                 that its results are of: it was written by an earlier version: {}",
                overwrite_hint(root)
            ),
        ));
    }
    for name in names(root)? {
        // Another process may have written settings.json since.
        let known =
            [FILES, SETTINGS].contains(&name.as_str()) || options.beside.contains(&name.as_str());
        if !known && !is_temporary(&name) {
            return Err(Error::format(
                root,
                format!(
                    "is not empty (`{name}`) and has no {SETTINGS} of finished results: choose \
                     another --out"
                ),
            ));
        }
    }
    Ok(Vec::new())
}

fn overwrite_hint(root: &Path) -> String {
    format!("discard the results in {} with --overwrite, or choose another --out", root.display())
}

fn foreign(path: &Path) -> Error {
    Error::format(path, "is in the way and was not written by this command: move it elsewhere")
}

/// Names in a directory, sorted; none if it is missing.
fn names(directory: &Path) -> Result<Vec<String>> {
    let entries = match fs::read_dir(directory) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries.map_err(|source| Error::io(directory, source))?,
    };
    let name = |entry: io::Result<fs::DirEntry>| -> Result<String> {
        let entry = entry.map_err(|source| Error::io(directory, source))?;
        Ok(entry.file_name().to_string_lossy().into_owned())
    };
    let mut names = entries.map(name).collect::<Result<Vec<_>>>()?;
    names.sort_unstable();
    Ok(names)
}

/// Entries of the directory that patterns as in [`StoreOptions::earlier`] match.
fn matching(root: &Path, patterns: &[&str]) -> Result<Vec<String>> {
    let mut found = Vec::new();
    for &pattern in patterns {
        if let Some((directory, extension)) = pattern.split_once("/*") {
            let names = names(&root.join(directory))?.into_iter();
            let names = names.filter(|name| name.ends_with(extension));
            found.extend(names.map(|name| format!("{directory}/{name}")));
        } else if root.join(pattern).symlink_metadata().is_ok() {
            found.push(pattern.to_owned());
        }
    }
    Ok(found)
}

/// Removes files, and directories whose name ends with `/`, and then the directories of `root` that
/// are empty for it.
fn remove(root: &Path, entries: &[String]) -> Result<()> {
    for entry in entries {
        let path = root.join(entry);
        let removed = if entry.ends_with('/') {
            fs::remove_dir_all(root.join(entry.trim_end_matches('/')))
        } else {
            fs::remove_file(&path)
        };
        match removed {
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            removed => removed.map_err(|source| Error::io(&path, source))?,
        }
    }
    let mut directories: BTreeSet<&Path> = BTreeSet::new();
    for entry in entries {
        let above = Path::new(entry).ancestors().skip(1);
        directories.extend(above.filter(|directory| *directory != Path::new("")));
    }
    // From the innermost; what still holds something stays.
    for directory in directories.into_iter().rev() {
        let _ = fs::remove_dir(root.join(directory));
    }
    Ok(())
}

fn create_dir(path: &Path) -> Result<()> {
    fs::create_dir_all(path).map_err(|source| Error::io(path, source))
}

#[cfg(test)]
mod tests;
