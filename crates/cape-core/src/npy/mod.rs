//! NumPy array files: `.npy` (one array) and `.npz` (ZIP archive of arrays).
//!
//! Reading converts any numeric dtype, byte order and memory order. Sizes in headers are checked
//! against the length of the file before memory is allocated.

mod archive;
mod element;
mod header;

use std::{
    fs::File,
    io::{self, BufReader, Cursor, Read, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
};

use ndarray::{ArrayD, ArrayRef, Dimension, IxDyn, ShapeBuilder};
use zip::{
    CompressionMethod, DateTime, ZipArchive, ZipWriter, read::ZipFile, result::ZipError,
    write::SimpleFileOptions,
};

use archive::ArchiveFile;
pub use element::NpyElement;
use element::{ReadError, read_elements};
pub use header::{NpyHeader, NpyKind, NpyType};

use crate::{AtomicFile, Error, Result, pickle::Pickle, unexpected_file, write_atomically};

/// Explanation of what `torch.save` writes.
pub(crate) const PYTORCH_FILE: &str = "a PyTorch file: load it in Python, convert its tensors by \
    `.cpu().numpy()`, and save them by `numpy.savez(\"….npz\", name=array, …)`";
/// Largest expansion ratio of Deflate.
const MAX_DEFLATE_RATIO: u64 = 1032;

/// Size in bytes from which an array compressed by more than [`BOMB_RATIO`] is rejected, so that a
/// small file cannot fill the memory.
const BOMB_SIZE: u64 = 64 << 20;
const BOMB_RATIO: u64 = 100;

/// File, and array in an archive, that errors name.
#[derive(Clone, Copy)]
struct Source<'a> {
    path: &'a Path,
    name: Option<&'a str>,
}

impl Source<'_> {
    fn error(self, message: impl Into<String>) -> Error {
        match self.name {
            Some(name) => Error::field(self.path, name, message),
            None => Error::format(self.path, message),
        }
    }

    /// Reads an array from at most `available` bytes, header included.
    fn read<T: NpyElement>(self, mut reader: impl Read, available: u64) -> Result<ArrayD<T>> {
        let header = NpyHeader::read(&mut reader).map_err(|message| header_error(self, message))?;
        let elements = self.check_size(&header, available)?;
        let values =
            read_elements(&header, elements, &mut reader).map_err(|failed| match failed {
                ReadError::Io(source) => self.error(format!("cannot be read: {source}")),
                ReadError::Content(message) => self.error(message),
            })?;
        // The ZIP reader verifies the checksum at the end of the entry.
        reader.read(&mut [0]).map_err(|source| self.error(format!("cannot be read: {source}")))?;
        let shape = IxDyn(&header.shape).set_f(header.fortran);
        let array = ArrayD::from_shape_vec(shape, values)
            .map_err(|source| self.error(source.to_string()))?;
        Ok(if header.fortran { array.as_standard_layout().into_owned() } else { array })
    }

    /// Reads an array of objects from at most `available` bytes.
    fn objects(self, reader: &mut impl Read, available: u64) -> Result<Pickle> {
        let header = NpyHeader::read(reader).map_err(|message| header_error(self, message))?;
        if !header.dtype.is_object() {
            return Err(self.error(format!("holds `{}`, expected objects", header.dtype)));
        }
        let mut pickle = Vec::new();
        reader
            .take(available)
            .read_to_end(&mut pickle)
            .map_err(|source| self.error(format!("cannot be read: {source}")))?;
        Pickle::parse(self.path, pickle)
    }

    /// Number of elements; an error if fewer bytes than their size are available.
    fn check_size(self, header: &NpyHeader, available: u64) -> Result<usize> {
        let declared = || format!("header declares shape {:?} of `{}`", header.shape, header.dtype);
        let (elements, bytes) = header
            .elements_and_bytes()
            .ok_or_else(|| self.error(format!("{}, more than memory can hold", declared())))?;
        let present = available.saturating_sub(header.data_offset as u64);
        if bytes as u64 > present {
            return Err(
                self.error(format!("{}: {bytes} bytes, but the file has {present}", declared()))
            );
        }
        Ok(elements)
    }
}

/// Message about a file that is no complete ZIP archive.
fn unreadable_archive(path: &Path, error: ZipError) -> String {
    let mut start = [0; 4];
    let begins = File::open(path).and_then(|mut file| file.read_exact(&mut start)).is_ok()
        && &start == b"PK\x03\x04";
    match unexpected_file(path) {
        Some(found) => found.to_owned(),
        None if begins => {
            format!("the end of the archive is missing ({error}): copy or download the file again")
        }
        None => format!("not a readable .npz (ZIP) archive: {error}"),
    }
}

/// Error of a header, or the content in its place.
fn header_error(source: Source, message: String) -> Error {
    let found = if source.name.is_none() { unexpected_file(source.path) } else { None };
    source.error(found.map_or(message, str::to_owned))
}

fn open(path: &Path) -> Result<(BufReader<File>, u64)> {
    let file = File::open(path).map_err(|source| Error::io(path, source))?;
    let metadata = file.metadata().map_err(|source| Error::io(path, source))?;
    if metadata.is_dir() {
        return Err(Error::format(path, "is a directory, expected a file"));
    }
    Ok((BufReader::with_capacity(1 << 16, file), metadata.len()))
}

/// Decodes the array of `header` whose data are `bytes`.
pub(crate) fn read_array<T: NpyElement>(
    header: &NpyHeader,
    bytes: &[u8],
) -> Result<ArrayD<T>, String> {
    let NpyHeader { dtype, fortran, shape, .. } = header;
    let (elements, size) = header
        .elements_and_bytes()
        .ok_or_else(|| format!("header declares shape {shape:?}, more than memory can hold"))?;
    // Unsupported dtypes have size 0; `read_elements` rejects them.
    if size != bytes.len() && dtype.size > 0 {
        return Err(format!(
            "header declares shape {shape:?} of `{dtype}`: {size} bytes, but there are {}",
            bytes.len()
        ));
    }
    let values = read_elements(header, elements, &mut &*bytes).map_err(|failed| match failed {
        ReadError::Io(source) => source.to_string(),
        ReadError::Content(message) => message,
    })?;
    let array = ArrayD::from_shape_vec(IxDyn(shape).set_f(*fortran), values)
        .map_err(|source| source.to_string())?;
    Ok(if *fortran { array.as_standard_layout().into_owned() } else { array })
}

/// Reads a `.npy` file of pickled Python objects.
pub fn read_objects(path: impl AsRef<Path>) -> Result<Pickle> {
    let path = path.as_ref();
    let (mut reader, length) = open(path)?;
    Source { path, name: None }.objects(&mut reader, length)
}

/// Reads a `.npy` file, converted to `T`.
pub fn read_npy<T: NpyElement>(path: impl AsRef<Path>) -> Result<ArrayD<T>> {
    let path = path.as_ref();
    let (reader, length) = open(path)?;
    Source { path, name: None }.read(reader, length)
}

/// Reads a `.npy` file as `f64`.
pub fn read_f64(path: impl AsRef<Path>) -> Result<ArrayD<f64>> {
    read_npy(path)
}

/// Reads a `.npy` file as `i64`; a value that is not a whole number in range is an error.
pub fn read_i64(path: impl AsRef<Path>) -> Result<ArrayD<i64>> {
    read_npy(path)
}

/// Reads the header of a `.npy` file and checks that the file has all the data, so that it can be
/// memory-mapped.
pub fn npy_header(path: impl AsRef<Path>) -> Result<NpyHeader> {
    let path = path.as_ref();
    let (mut reader, length) = open(path)?;
    let source = Source { path, name: None };
    let header = NpyHeader::read(&mut reader).map_err(|message| header_error(source, message))?;
    source.check_size(&header, length)?;
    Ok(header)
}

/// Writes a `.npy` file (little-endian, C order), atomically.
pub fn write_npy<T: NpyElement, D: Dimension>(
    path: impl AsRef<Path>,
    array: &ArrayRef<T, D>,
) -> Result<()> {
    write_atomically(path, |file| write_array(file, array))
}

fn write_array<T: NpyElement, D: Dimension>(
    writer: &mut impl Write,
    array: &ArrayRef<T, D>,
) -> io::Result<()> {
    writer.write_all(&NpyHeader::bytes(T::DESCR, array.shape()))?;
    let mut bytes = Vec::with_capacity(1 << 16);
    for &value in array {
        value.append_to(&mut bytes);
        if bytes.len() >= (1 << 16) - 8 {
            writer.write_all(&bytes)?;
            bytes.clear();
        }
    }
    writer.write_all(&bytes)
}

/// Checks the shape of array `field` of `path`; an expected length of `None` matches any.
pub fn expect_shape(
    path: impl AsRef<Path>,
    field: &str,
    found: &[usize],
    expected: &[Option<usize>],
) -> Result<()> {
    let agrees = found.len() == expected.len()
        && found.iter().zip(expected).all(|(&f, e)| e.is_none_or(|e| e == f));
    if agrees {
        return Ok(());
    }
    let expected: Vec<String> =
        expected.iter().map(|axis| axis.map_or("_".into(), |n| n.to_string())).collect();
    Err(Error::field(path, field, format!("shape {found:?}, expected [{}]", expected.join(", "))))
}

/// Contents of an archive.
#[derive(Debug)]
enum NpzReader {
    File(BufReader<File>),
    Memory(Cursor<Vec<u8>>),
}

impl Read for NpzReader {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::File(file) => file.read(buffer),
            Self::Memory(bytes) => bytes.read(buffer),
        }
    }
}

impl Seek for NpzReader {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        match self {
            Self::File(file) => file.seek(to),
            Self::Memory(bytes) => bytes.seek(to),
        }
    }
}

/// Open `.npz` archive.
///
/// ```
/// use cape_core::npy::{Npz, NpzWriter};
/// use ndarray::{Array1, array};
///
/// let directory = tempfile::tempdir()?;
/// let path = directory.path().join("frame.npz");
/// let mut writer = NpzWriter::create(&path)?.deflate();
/// writer.add::<f64, _>("pose", &Array1::zeros(72))?;
/// writer.add::<f64, _>("transl", &array![0., 1., 0.])?;
/// writer.finish()?;
///
/// let mut frame = Npz::open(&path)?;
/// assert_eq!(frame.names(), ["pose", "transl"]);
/// let pose = frame.f64("pose")?;
/// frame.expect_shape("pose", pose.shape(), &[Some(72)])?;
/// assert_eq!(frame.f32("transl")?, array![0., 1., 0.].into_dyn());
/// assert!(frame.f64("v_cano").is_err());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Npz {
    path: PathBuf,
    length: u64,
    archive: ZipArchive<NpzReader>,
    names: Vec<String>,
}

impl Npz {
    /// Opens an archive and reads its directory.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref().to_owned();
        let (reader, length) = open(&path)?;
        Self::new(path, NpzReader::File(reader), length)
    }

    /// Opens an archive whose contents are `bytes`; errors name `path`.
    pub fn from_bytes(path: impl AsRef<Path>, bytes: Vec<u8>) -> Result<Self> {
        let length = bytes.len() as u64;
        Self::new(path.as_ref().to_owned(), NpzReader::Memory(Cursor::new(bytes)), length)
    }

    fn new(path: PathBuf, reader: NpzReader, length: u64) -> Result<Self> {
        let unreadable = |source| Error::format(&path, unreadable_archive(&path, source));
        let mut archive = ZipArchive::new(reader).map_err(unreadable)?;
        let mut names = Vec::new();
        for index in 0..archive.len() {
            let entry = archive.by_index_raw(index).map_err(unreadable)?;
            let name = entry.name().map_err(unreadable)?;
            names.extend(name.strip_suffix(".npy").map(str::to_owned));
        }
        if names.is_empty() && !archive.is_empty() {
            let first = archive.name_for_index(0).and_then(Result::ok).unwrap_or_default();
            if first.ends_with("data.pkl") {
                return Err(Error::format(&path, PYTORCH_FILE));
            }
            let message = format!(
                "a ZIP archive of files such as `{first}`, expected one of arrays: unpack it and give \
                 the file in it"
            );
            return Err(Error::format(&path, message));
        }
        Ok(Self { path, length, archive, names })
    }

    /// Path of the archive.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Names of the arrays, in the order of the file.
    pub fn names(&self) -> Vec<String> {
        self.names.clone()
    }

    /// True if the archive has an array `name`.
    pub fn contains(&self, name: &str) -> bool {
        self.names.iter().any(|found| found == name)
    }

    /// Reads array `name`, converted to `T`.
    pub fn get<T: NpyElement>(&mut self, name: &str) -> Result<ArrayD<T>> {
        self.with_entry(name, |source, entry, size| source.read(entry, size))
    }

    /// True if array `name` holds pickled Python objects.
    pub fn is_object(&mut self, name: &str) -> Result<bool> {
        self.with_entry(name, |source, mut entry, _| {
            let header = NpyHeader::read(&mut entry).map_err(|message| source.error(message))?;
            Ok(header.dtype.is_object())
        })
    }

    /// Header of array `name`.
    pub fn header(&mut self, name: &str) -> Result<NpyHeader> {
        self.with_entry(name, |source, mut entry, _| {
            NpyHeader::read(&mut entry).map_err(|message| source.error(message))
        })
    }

    /// Reads array `name` of one string, such as `np.array('male')`.
    pub fn text(&mut self, name: &str) -> Result<String> {
        self.with_entry(name, |source, mut entry, size| {
            let header = NpyHeader::read(&mut entry).map_err(|message| source.error(message))?;
            let wrong = || source.error(format!("holds `{}`, expected one string", header.dtype));
            let bytes = header.dtype.element_bytes().ok_or_else(wrong)?;
            if header.shape.iter().any(|&axis| axis != 1) || bytes as u64 > size {
                return Err(wrong());
            }
            let mut text = vec![0; bytes];
            entry
                .read_exact(&mut text)
                .map_err(|failed| source.error(format!("cannot be read: {failed}")))?;
            header.dtype.text(&text).ok_or_else(wrong)
        })
    }

    /// Reads array `name` of pickled Python objects.
    pub fn objects(&mut self, name: &str) -> Result<Pickle> {
        self.with_entry(name, |source, mut entry, size| source.objects(&mut entry, size))
    }

    fn with_entry<R>(
        &mut self,
        name: &str,
        read: impl FnOnce(Source<'_>, ZipFile<'_, NpzReader>, u64) -> Result<R>,
    ) -> Result<R> {
        let Self { path, length, archive, .. } = self;
        let source = Source { path, name: Some(name) };
        let entry = archive.by_name(&format!("{name}.npy")).map_err(|failed| match failed {
            ZipError::FileNotFound => source.error("missing array"),
            other => source.error(other.to_string()),
        })?;
        let (size, compressed) = (entry.size(), entry.compressed_size());
        let possible = if entry.compression() == CompressionMethod::Stored {
            compressed
        } else {
            compressed.saturating_mul(MAX_DEFLATE_RATIO)
        };
        if compressed > *length || size > possible {
            return Err(source.error(format!(
                "corrupt archive: {size} bytes of data compressed to {compressed} are impossible in \
                 a file of {length} bytes"
            )));
        }
        if size > BOMB_SIZE && size / BOMB_RATIO > compressed {
            return Err(source.error(format!(
                "rejected as a decompression bomb: {size} bytes of data compressed to {compressed}, \
                 more than {BOMB_RATIO} times"
            )));
        }
        read(source, entry, size)
    }

    /// Reads array `name` as `f64`.
    pub fn f64(&mut self, name: &str) -> Result<ArrayD<f64>> {
        self.get(name)
    }

    /// Reads array `name` as `f32`.
    pub fn f32(&mut self, name: &str) -> Result<ArrayD<f32>> {
        self.get(name)
    }

    /// Reads array `name` as `i64`; a value that is not a whole number in range is an error.
    pub fn i64(&mut self, name: &str) -> Result<ArrayD<i64>> {
        self.get(name)
    }

    /// Checks the shape of array `name`; an expected length of `None` matches any.
    pub fn expect_shape(
        &self,
        name: &str,
        found: &[usize],
        expected: &[Option<usize>],
    ) -> Result<()> {
        expect_shape(&self.path, name, found, expected)
    }
}

/// Writer of a `.npz` archive, which appears under its name at [`finish`](Self::finish).
pub struct NpzWriter {
    path: PathBuf,
    options: SimpleFileOptions,
    // Goes before `archive`, which completes what it has when dropped.
    file: Arc<Mutex<AtomicFile>>,
    archive: ZipWriter<ArchiveFile>,
}

impl NpzWriter {
    /// Starts an uncompressed archive.
    pub fn create(path: impl AsRef<Path>) -> Result<Self> {
        let file = Arc::new(Mutex::new(AtomicFile::create(&path)?));
        let archive = ZipWriter::new(ArchiveFile::new(Arc::downgrade(&file)));
        // ZIP's default time stamp (1980-01-01), so that equal arrays give equal files.
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Stored)
            .last_modified_time(DateTime::default());
        Ok(Self { path: path.as_ref().to_owned(), options, file, archive })
    }

    /// Compresses the arrays added from now on with Deflate.
    #[must_use]
    pub fn deflate(mut self) -> Self {
        self.options = self.options.compression_method(CompressionMethod::Deflated);
        self
    }

    /// Adds an array (little-endian, C order).
    pub fn add<T: NpyElement, D: Dimension>(
        &mut self,
        name: &str,
        array: &ArrayRef<T, D>,
    ) -> Result<()> {
        let large = array.len().saturating_mul(size_of::<T>()) as u64 >= u64::from(u32::MAX) / 2;
        let Self { path, options, archive, .. } = self;
        archive
            .start_file(format!("{name}.npy"), options.large_file(large))
            .map_err(|failed| unwritable(path, Some(name), failed))?;
        write_array(archive, array).map_err(|source| Error::io(&*path, source))
    }

    /// Adds a string as a NumPy bytes scalar (`np.bytes_`).
    pub fn add_text(&mut self, name: &str, text: &str) -> Result<()> {
        let Self { path, options, archive, .. } = self;
        archive
            .start_file(format!("{name}.npy"), *options)
            .map_err(|failed| unwritable(path, Some(name), failed))?;
        let header = NpyHeader::bytes(&format!("|S{}", text.len()), &[]);
        archive
            .write_all(&header)
            .and_then(|()| archive.write_all(text.as_bytes()))
            .map_err(|source| Error::io(&*path, source))
    }

    /// Completes the archive and renames it to its path.
    pub fn finish(self) -> Result<()> {
        let Self { path, file, archive, .. } = self;
        let written = archive.finish().map_err(|failed| unwritable(&path, None, failed))?;
        // Before the file is taken out, after which the archive has none.
        let complete = written.is_complete();
        match Arc::into_inner(file) {
            Some(file) if complete => {
                file.into_inner().unwrap_or_else(PoisonError::into_inner).commit()
            }
            _ => Err(Error::io(path, io::Error::other("an array could not be written"))),
        }
    }
}

fn unwritable(path: &Path, name: Option<&str>, failed: ZipError) -> Error {
    match failed {
        ZipError::Io(source) => Error::io(path, source),
        other => Source { path, name }.error(other.to_string()),
    }
}

#[cfg(test)]
mod tests;
