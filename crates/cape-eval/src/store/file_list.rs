//! The file that lists what a store wrote.

use std::{
    collections::BTreeSet,
    fs::{File, OpenOptions},
    io::{self, Read, Seek, SeekFrom, Write},
    path::{Component, Path, PathBuf},
};

use crate::{Error, Result};

/// Name of the file that lists what the store wrote, one path per line.
pub(super) const FILES: &str = "files.txt";

/// The list of a store, locked against other processes until it is dropped.
#[derive(Debug)]
pub(super) struct FileList {
    path: PathBuf,
    file: File,
}

impl FileList {
    /// Locks the list in `root`, after waiting for another process that has it. Where the file system has
    /// no locks, it is not locked.
    pub(super) fn lock(root: &Path) -> Result<Self> {
        let path = root.join(FILES);
        let mut options = OpenOptions::new();
        let file = options.create(true).read(true).append(true).open(&path);
        let file = file.map_err(|source| Error::io(&path, source))?;
        unless_unsupported(file.lock(), &path)?;
        Ok(Self { path, file })
    }

    /// Entries of the list.
    pub(super) fn entries(&self) -> Result<BTreeSet<String>> {
        let mut file = &self.file;
        file.rewind().map_err(|source| Error::io(&self.path, source))?;
        entries(file, &self.path)
    }

    /// Adds a line, after what an interruption may have left of another.
    pub(super) fn append(&self, line: &str) -> Result<()> {
        let fault = |source| Error::io(&self.path, source);
        let mut file = &self.file;
        let mut last = [b'\n'];
        if file.seek(SeekFrom::End(-1)).is_ok() {
            file.read_exact(&mut last).map_err(fault)?;
        }
        let begin = if last == [b'\n'] { "" } else { "\n" };
        // In one piece, so that lines of several processes do not mix where there are no locks.
        file.write_all(format!("{begin}{line}\n").as_bytes()).map_err(fault)
    }

    /// Removes all lines.
    pub(super) fn clear(&self) -> Result<()> {
        self.file.set_len(0).map_err(|source| Error::io(&self.path, source))
    }
}

/// True for a relative path without `..`.
pub(super) fn is_inside(name: &str) -> bool {
    let mut parts = Path::new(name).components().peekable();
    parts.peek().is_some() && parts.all(|part| matches!(part, Component::Normal(_)))
}

/// Entries of the list in `root`, after waiting for another process that has it; none if there is no list.
pub(super) fn listed(root: &Path) -> Result<BTreeSet<String>> {
    let path = root.join(FILES);
    let file = match File::open(&path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(BTreeSet::new()),
        file => file.map_err(|source| Error::io(&path, source))?,
    };
    unless_unsupported(file.lock_shared(), &path)?;
    entries(&file, &path)
}

fn entries(mut file: &File, path: &Path) -> Result<BTreeSet<String>> {
    let mut text = String::new();
    file.read_to_string(&mut text).map_err(|source| Error::io(path, source))?;
    let mut entries = BTreeSet::new();
    for (index, line) in text.lines().enumerate().filter(|(_, line)| !line.is_empty()) {
        if !is_inside(line) {
            let message = format!("`{line}` is not a path inside this directory: remove the line");
            return Err(Error::field(path, format!("line {}", index + 1), message));
        }
        entries.insert(line.to_owned());
    }
    Ok(entries)
}

/// The result of locking a file, where the file system has locks.
fn unless_unsupported(locked: io::Result<()>, path: &Path) -> Result<()> {
    match locked {
        Err(error) if error.kind() != io::ErrorKind::Unsupported => Err(Error::io(path, error)),
        _ => Ok(()),
    }
}
