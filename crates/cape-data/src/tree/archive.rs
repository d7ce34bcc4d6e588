//! Frames in the archive of a subject, which is read where it lies.

use std::{
    collections::BTreeMap,
    fs::File,
    io::{BufReader, Read},
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
};

use cape_core::natural_order;
use zip::ZipArchive;

use super::split_title;
use crate::{Error, Result, raw};

/// Largest size of a frame's file; those of the release have 0.7 MB.
const LARGEST: u64 = 256 << 20;

/// Archive with the captures of one subject.
#[derive(Debug)]
pub(super) struct SubjectArchive {
    path: PathBuf,
    archive: Mutex<ZipArchive<BufReader<File>>>,
}

/// Members of a capture.
#[derive(Debug, Default)]
pub(super) struct CaptureMembers {
    /// File names and places in the archive, by name.
    pub(super) frames: Vec<(String, usize)>,
    pub(super) misnamed: Vec<String>,
}

impl SubjectArchive {
    /// Opens an archive and lists its captures by name. Members are recognised by their last two
    /// components, `<outfit>_<sequence>/<frame>.npz`.
    pub(super) fn open(
        path: &Path,
        subject: &str,
    ) -> Result<(Self, BTreeMap<String, CaptureMembers>)> {
        let file = File::open(path).map_err(|source| Error::io(path, source))?;
        let unreadable = |error| {
            let message = format!(
                "not a readable ZIP archive of subject {subject}: {error}: download it again"
            );
            Error::format(path, message)
        };
        let mut archive = ZipArchive::new(BufReader::new(file)).map_err(unreadable)?;
        let mut captures: BTreeMap<String, CaptureMembers> = BTreeMap::new();
        for index in 0..archive.len() {
            let entry = archive.by_index_raw(index).map_err(unreadable)?;
            let name = entry.name().map_err(unreadable)?.to_string();
            let parts: Vec<&str> = name.split('/').collect();
            let [above @ .., title, file] = &parts[..] else { continue };
            let hidden = above.first() == Some(&"__MACOSX") || file.starts_with('.');
            if entry.is_dir() || hidden || split_title(title).is_none() {
                continue;
            }
            let members = captures.entry((*title).to_owned()).or_default();
            if raw::is_frame_name(file) {
                members.frames.push(((*file).to_owned(), index));
            } else if raw::is_misnamed_frame(file) {
                members.misnamed.push((*file).to_owned());
            }
        }
        for members in captures.values_mut() {
            members.frames.sort_by(|(a, _), (b, _)| natural_order(a, b));
            members.misnamed.sort_unstable();
        }
        Ok((Self { path: path.to_owned(), archive: Mutex::new(archive) }, captures))
    }

    /// Contents of a member; `shown` is its path in errors.
    pub(super) fn read(&self, index: usize, shown: &Path) -> Result<Vec<u8>> {
        let mut archive = self.archive.lock().unwrap_or_else(PoisonError::into_inner);
        let mut entry =
            archive.by_index(index).map_err(|error| Error::format(shown, error.to_string()))?;
        let size = entry.size();
        if size > LARGEST {
            let message = format!("{size} bytes, more than a frame can have");
            return Err(Error::format(shown, message));
        }
        // Memory grows with what is there, not with what the archive claims.
        let mut bytes = Vec::with_capacity(size.min(4 << 20) as usize);
        entry
            .by_ref()
            .take(size.saturating_add(1))
            .read_to_end(&mut bytes)
            .map_err(|error| Error::format(shown, format!("cannot be read: {error}")))?;
        Ok(bytes)
    }

    /// Size and checksum of a member.
    pub(super) fn identity(&self, index: usize) -> Result<[u64; 2]> {
        let mut archive = self.archive.lock().unwrap_or_else(PoisonError::into_inner);
        let entry = archive
            .by_index_raw(index)
            .map_err(|error| Error::format(&self.path, error.to_string()))?;
        Ok([entry.size(), u64::from(entry.crc32())])
    }
}
