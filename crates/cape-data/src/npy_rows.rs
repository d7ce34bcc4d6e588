//! Row-wise writer and reader of large `.npy` files.

use std::{
    fs::File,
    io::{self, BufReader, BufWriter, Read, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
};

use cape_core::npy::{NpyHeader, NpyType, expect_shape, npy_header};

use super::row_order::row_major_copy;
use crate::{Error, Result};

/// Writer of a float64 array whose number of rows is known at the end only.
#[derive(Debug)]
pub(super) struct RowWriter {
    path: PathBuf,
    file: BufWriter<File>,
    shape: Vec<usize>,
    header_bytes: usize,
    row: Vec<u8>,
}

impl RowWriter {
    /// Creates a file of rows of the given shape.
    pub(super) fn create(path: PathBuf, row_shape: &[usize]) -> Result<Self> {
        let shape = [&[0], row_shape].concat();
        let header = NpyHeader::bytes("<f8", &shape);
        let write = || {
            let mut file = BufWriter::with_capacity(1 << 18, File::create(&path)?);
            file.write_all(&header)?;
            Ok(file)
        };
        let file = write().map_err(|e| Error::io(&path, e))?;
        Ok(Self { path, file, shape, header_bytes: header.len(), row: Vec::new() })
    }

    /// Resumes a file of [`create`](Self::create) after its first `rows` rows; the rest is dropped.
    pub(super) fn resume(path: PathBuf, row_shape: &[usize], rows: usize) -> Result<Self> {
        let shape = [&[rows], row_shape].concat();
        let header_bytes = NpyHeader::bytes("<f8", &shape).len();
        let row_bytes = 8 * row_shape.iter().product::<usize>() as u64;
        let length = header_bytes as u64 + rows as u64 * row_bytes;
        let open = || {
            let mut file = File::options().read(true).write(true).open(&path)?;
            if file.metadata()?.len() < length {
                let message = "fewer rows than in journal.txt: remove the directory and pack again";
                return Err(io::Error::new(io::ErrorKind::UnexpectedEof, message));
            }
            file.set_len(length)?;
            file.seek(SeekFrom::End(0))?;
            Ok(BufWriter::with_capacity(1 << 18, file))
        };
        let file = open().map_err(|e| Error::io(&path, e))?;
        Ok(Self { path, file, shape, header_bytes, row: Vec::new() })
    }

    /// Calls `f` with all rows written so far, in order.
    pub(super) fn for_each_row(&mut self, mut f: impl FnMut(&[f64])) -> Result<()> {
        let numbers: usize = self.shape[1..].iter().product();
        let (start, rows) = (self.header_bytes as u64, self.shape[0]);
        let mut read = || {
            self.file.flush()?;
            let file = self.file.get_mut();
            file.seek(SeekFrom::Start(start))?;
            let mut reader = BufReader::with_capacity(1 << 18, &mut *file);
            let mut bytes = vec![0; 8 * numbers];
            let mut row = vec![0.0; numbers];
            for _ in 0..rows {
                reader.read_exact(&mut bytes)?;
                for (x, raw) in row.iter_mut().zip(bytes.as_chunks().0) {
                    *x = f64::from_le_bytes(*raw);
                }
                f(&row);
            }
            self.file.get_mut().seek(SeekFrom::End(0))?;
            Ok(())
        };
        read().map_err(|e| Error::io(&self.path, e))
    }

    /// Flushes appended rows to the file.
    pub(super) fn flush(&mut self) -> Result<()> {
        self.file.flush().map_err(|e| Error::io(&self.path, e))
    }

    /// Appends one row.
    pub(super) fn push(&mut self, row: impl IntoIterator<Item = f64>) -> Result<()> {
        self.row.clear();
        self.row.extend(row.into_iter().flat_map(f64::to_le_bytes));
        let expected: usize = self.shape[1..].iter().product::<usize>() * 8;
        if self.row.len() != expected {
            let message = format!("a row of {} bytes, expected {expected}", self.row.len());
            return Err(Error::format(&self.path, message));
        }
        self.shape[0] += 1;
        self.file.write_all(&self.row).map_err(|e| Error::io(&self.path, e))
    }

    /// Number of rows so far.
    pub(super) fn rows(&self) -> usize {
        self.shape[0]
    }

    /// Completes the header and syncs the file to disk.
    pub(super) fn finish(mut self) -> Result<()> {
        let header = NpyHeader::bytes("<f8", &self.shape);
        if header.len() != self.header_bytes {
            return Err(Error::format(&self.path, "the final shape does not fit into the header"));
        }
        let mut finish = || {
            self.file.seek(SeekFrom::Start(0))?;
            self.file.write_all(&header)?;
            self.file.flush()?;
            self.file.get_ref().sync_all()
        };
        finish().map_err(|e| Error::io(&self.path, e))
    }
}

/// Reader of single rows of an array of numbers of any type, byte order and memory order; it can be
/// shared between threads.
#[derive(Debug)]
pub(super) struct RowReader {
    path: PathBuf,
    file: PositionedFile,
    header: NpyHeader,
    /// Position of the first row in the file.
    offset: u64,
}

impl RowReader {
    /// Opens an array of rows of the given shape; `None` is any length. Arrays in Fortran order are
    /// copied to a temporary file first.
    pub(super) fn open(path: PathBuf, row_shape: &[Option<usize>]) -> Result<Self> {
        let header = npy_header(&path)?;
        if header.dtype.size == 0 {
            let message = format!("holds `{}`, expected numbers", header.dtype);
            return Err(Error::format(path, message));
        }
        expect_shape(&path, "array", &header.shape, &[&[None], row_shape].concat())?;
        let file = File::open(&path).map_err(|e| Error::io(&path, e))?;
        let file = PositionedFile::new(file);
        let empty = header.shape.contains(&0);
        let (file, offset) = if header.fortran && !empty {
            (PositionedFile::new(row_major_copy(&path, &header, &file)?), 0)
        } else {
            (file, header.data_offset as u64)
        };
        Ok(Self { path, file, header, offset })
    }

    /// Path of the file.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Extents of the array, rows first.
    pub(super) fn shape(&self) -> &[usize] {
        &self.header.shape
    }

    /// Number of rows.
    pub(super) fn rows(&self) -> usize {
        self.header.shape[0]
    }

    /// Reads row `index`, row-major; an error if a number is not finite.
    pub(super) fn row(&self, index: usize) -> Result<Vec<f64>> {
        if index >= self.rows() {
            let message = format!("frame {index} of a file of {} frames", self.rows());
            return Err(Error::format(&self.path, message));
        }
        let numbers: usize = self.shape()[1..].iter().product();
        let mut bytes = vec![0; numbers * self.header.dtype.size];
        let position = self.offset + index as u64 * bytes.len() as u64;
        self.file.read_exact_at(&mut bytes, position).map_err(|e| Error::io(&self.path, e))?;
        let row: Vec<f64> = match self.header.dtype {
            NpyType::F64 => {
                bytes.as_chunks().0.iter().map(|&raw| f64::from_le_bytes(raw)).collect()
            }
            NpyType::F32 => {
                bytes.as_chunks().0.iter().map(|&raw| f32::from_le_bytes(raw).into()).collect()
            }
            _ => self
                .header
                .decode(&bytes)
                .map_err(|message| Error::field(&self.path, format!("frame {index}"), message))?,
        };
        match row.iter().position(|x| !x.is_finite()) {
            None => Ok(row),
            Some(at) => {
                let message = format!("number {at} of the frame is not finite ({})", row[at]);
                Err(Error::field(&self.path, format!("frame {index}"), message))
            }
        }
    }
}

/// A file that is read at given positions through a shared reference.
#[derive(Debug)]
pub(super) struct PositionedFile {
    #[cfg(unix)]
    file: File,
    #[cfg(not(unix))]
    file: std::sync::Mutex<File>,
}

impl PositionedFile {
    #[cfg(unix)]
    pub(super) fn new(file: File) -> Self {
        Self { file }
    }

    #[cfg(unix)]
    pub(super) fn read_exact_at(&self, bytes: &mut [u8], position: u64) -> io::Result<()> {
        std::os::unix::fs::FileExt::read_exact_at(&self.file, bytes, position)
    }

    #[cfg(not(unix))]
    pub(super) fn new(file: File) -> Self {
        Self { file: std::sync::Mutex::new(file) }
    }

    #[cfg(not(unix))]
    pub(super) fn read_exact_at(&self, bytes: &mut [u8], position: u64) -> io::Result<()> {
        let mut file = self.file.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        file.seek(SeekFrom::Start(position))?;
        file.read_exact(bytes)
    }
}

#[cfg(test)]
mod tests {
    use cape_core::npy::{read_f64, write_npy};
    use ndarray::{Array2, array};

    use super::*;

    #[test]
    fn rows_written_are_a_numpy_array() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.npy");
        let mut writer = RowWriter::create(path.clone(), &[2, 2]).unwrap();
        for k in 0..1234 {
            writer.push([k as f64, 1.0, 2.0, 3.5]).unwrap();
        }
        assert!(writer.push([1.0]).is_err());
        assert_eq!(writer.rows(), 1234);
        writer.finish().unwrap();
        let array = read_f64(&path).unwrap();
        assert_eq!(array.shape(), &[1234, 2, 2]);
        assert_eq!((array[[1233, 0, 0]], array[[1233, 1, 1]]), (1233.0, 3.5));
        let reader = RowReader::open(path, &[None, Some(2)]).unwrap();
        assert_eq!(reader.row(77).unwrap(), [77.0, 1.0, 2.0, 3.5]);
        assert!(reader.row(1234).unwrap_err().to_string().contains("1234 frames"));
    }

    #[test]
    fn types_orders_and_bad_numbers() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.npy");
        let open = || RowReader::open(path.clone(), &[Some(2)]);
        write_npy(&path, &array![[1.5f32, 2.0], [f32::NAN, 3.0]]).unwrap();
        assert_eq!(open().unwrap().row(0).unwrap(), [1.5, 2.0]);
        let message = open().unwrap().row(1).unwrap_err().to_string();
        assert!(message.contains("a.npy") && message.contains("`frame 1`"), "{message}");
        write_npy(&path, &array![[1i64, 2]]).unwrap();
        assert_eq!(open().unwrap().row(0).unwrap(), [1.0, 2.0]);
        write_npy(&path, &array![[1u8, 0]]).unwrap();
        assert_eq!(open().unwrap().row(0).unwrap(), [1.0, 0.0]);
        // 1.5 and −2 in half precision and in big-endian integers.
        let write = |descr: &str, rows: usize, data: &[u8]| {
            std::fs::write(&path, [&NpyHeader::bytes(descr, &[rows, 2]), data].concat()).unwrap();
        };
        write("<f2", 1, &[0x00, 0x3e, 0x00, 0xc0]);
        assert_eq!(open().unwrap().row(0).unwrap(), [1.5, -2.0]);
        write(">i2", 2, &[0, 1, 0, 2, 1, 0, 0xff, 0xfe]);
        assert_eq!(open().unwrap().row(1).unwrap(), [256.0, -2.0]);
        write(">f8", 1, &[1.5f64.to_be_bytes(), f64::INFINITY.to_be_bytes()].concat());
        assert!(open().unwrap().row(0).unwrap_err().to_string().contains("not finite"));
        write("|O", 1, b"pickle");
        assert!(open().unwrap_err().to_string().contains("`|O`, expected numbers"));
        write_npy(&path, &Array2::<f64>::zeros((4, 3))).unwrap();
        assert!(open().unwrap_err().to_string().contains("[4, 3], expected [_, 2]"));
        let numbers = Array2::from_shape_fn((4, 2), |(row, column)| (10 * row + column) as f64);
        write_npy(&path, &numbers).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let at = bytes.windows(6).position(|w| w == b" False").unwrap();
        let mut changed = bytes.clone();
        changed[at..at + 6].copy_from_slice(b"  True");
        std::fs::write(&path, changed).unwrap();
        assert_eq!(open().unwrap().row(1).unwrap(), [1.0, 21.0], "columns of 4 numbers");
        let left = std::fs::read_dir(dir.path()).unwrap().count();
        assert_eq!(left, 1, "the copy has no name");
        std::fs::write(&path, &bytes[..bytes.len() - 1]).unwrap();
        assert!(open().unwrap_err().to_string().contains("a.npy"));
        std::fs::remove_file(&path).unwrap();
        assert!(open().unwrap_err().to_string().contains("a.npy"));
    }
}
