//! The file under a ZIP archive that is being written.

use std::{
    io::{self, Seek, SeekFrom, Write},
    sync::{Mutex, PoisonError, Weak},
};

use crate::AtomicFile;

/// Writes to an [`AtomicFile`] as long as that exists and no write has failed; then to nowhere.
///
/// `ZipWriter` completes its archive when dropped and prints to standard error if that fails: an
/// archive given up must not fail again.
pub(super) struct ArchiveFile {
    file: Weak<Mutex<AtomicFile>>,
    position: u64,
    length: u64,
}

impl ArchiveFile {
    /// An empty file.
    pub(super) fn new(file: Weak<Mutex<AtomicFile>>) -> Self {
        Self { file, position: 0, length: 0 }
    }

    /// True if all that was written is in the file.
    pub(super) fn is_complete(&self) -> bool {
        self.file.strong_count() > 0
    }

    /// Calls `act` with the file, `None` without one, and forgets the file if that fails.
    fn with_file<T>(
        &mut self,
        act: impl FnOnce(&mut AtomicFile) -> io::Result<T>,
    ) -> Option<io::Result<T>> {
        let file = self.file.upgrade()?;
        let result = act(&mut file.lock().unwrap_or_else(PoisonError::into_inner));
        if result.as_ref().is_err_and(|error| error.kind() != io::ErrorKind::Interrupted) {
            self.file = Weak::new();
        }
        Some(result)
    }
}

impl Write for ArchiveFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.with_file(|file| file.write(bytes)).unwrap_or(Ok(bytes.len()))?;
        self.position += written as u64;
        self.length = self.length.max(self.position);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.with_file(Write::flush).unwrap_or(Ok(()))
    }
}

impl Seek for ArchiveFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let position = match to {
            SeekFrom::Start(position) => Some(position),
            SeekFrom::Current(by) => self.position.checked_add_signed(by),
            SeekFrom::End(by) => self.length.checked_add_signed(by),
        };
        let position = position.ok_or(io::ErrorKind::InvalidInput)?;
        self.with_file(|file| file.seek(SeekFrom::Start(position))).transpose()?;
        self.position = position;
        Ok(position)
    }

    fn stream_position(&mut self) -> io::Result<u64> {
        Ok(self.position)
    }
}
