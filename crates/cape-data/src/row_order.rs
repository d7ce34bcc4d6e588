//! Arrays in Fortran order, whose rows are not contiguous.

use std::{
    fs::File,
    io::{self, BufWriter, Write},
    path::Path,
};

use cape_core::npy::NpyHeader;

use super::npy_rows::PositionedFile;
use crate::{Error, Result};

/// Bytes of the rows that are brought into order at a time.
const BLOCK_BYTES: usize = 64 << 20;

/// A copy in C order, without a header, of the data of a Fortran-order array: a temporary file without
/// a name, beside the array if that directory is writable. Memory holds a block of rows.
pub(super) fn row_major_copy(
    path: &Path,
    header: &NpyHeader,
    file: &PositionedFile,
) -> Result<File> {
    let beside = path.parent().filter(|directory| !directory.as_os_str().is_empty());
    let temporary = tempfile::tempfile_in(beside.unwrap_or(Path::new(".")))
        .or_else(|_| tempfile::tempfile())
        .map_err(|error| Error::io(path, error))?;
    let mut writer = BufWriter::with_capacity(1 << 18, temporary);
    copy_rows(header, file, &mut writer, BLOCK_BYTES).map_err(|error| {
        let message = format!("cannot be copied from Fortran to C order: {error}");
        Error::format(path, message)
    })?;
    writer.into_inner().map_err(|error| Error::io(path, error.into_error()))
}

/// Writes the data in C order, `block` bytes of rows at a time.
fn copy_rows(
    header: &NpyHeader,
    file: &PositionedFile,
    writer: &mut impl Write,
    block: usize,
) -> io::Result<()> {
    let size = header.dtype.size;
    let (rows, columns) = (header.shape[0], columns(&header.shape[1..]));
    let at_once = (block / (columns.len() * size).max(1)).clamp(1, rows.max(1));
    let mut strip = vec![0; at_once * size];
    let mut rows_of_block = vec![0; at_once * columns.len() * size];
    for first in (0..rows).step_by(at_once) {
        let count = at_once.min(rows - first);
        let strip = &mut strip[..count * size];
        for (place, &column) in columns.iter().enumerate() {
            let start = header.data_offset + (column * rows + first) * size;
            file.read_exact_at(strip, start as u64)?;
            for (row, number) in strip.chunks_exact(size).enumerate() {
                let to = (row * columns.len() + place) * size;
                rows_of_block[to..to + size].copy_from_slice(number);
            }
        }
        writer.write_all(&rows_of_block[..count * columns.len() * size])?;
    }
    writer.flush()
}

/// For each number of a row in C order, its place in Fortran order.
fn columns(row_shape: &[usize]) -> Vec<usize> {
    let count: usize = row_shape.iter().product();
    let place = |mut index: usize| {
        let (mut place, mut stride) = (0, count);
        for &axis in row_shape.iter().rev() {
            stride /= axis;
            place += index % axis * stride;
            index /= axis;
        }
        place
    };
    (0..count).map(place).collect()
}

#[cfg(test)]
mod tests {
    use cape_core::npy::{npy_header, read_f64};
    use ndarray::{Array3, Axis};

    use super::*;

    /// Writes an array in Fortran order.
    pub(crate) fn write_fortran(path: &Path, array: &Array3<f64>) {
        let shape = array.shape().to_vec();
        let mut bytes = NpyHeader::bytes("<f8", &shape);
        let at = bytes.windows(6).position(|w| w == b" False").unwrap();
        bytes[at..at + 6].copy_from_slice(b"  True");
        let reversed = array.view().reversed_axes();
        bytes.extend(reversed.iter().flat_map(|x| x.to_le_bytes()));
        std::fs::write(path, bytes).unwrap();
    }

    #[test]
    fn copies_have_the_rows_of_the_array() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.npy");
        let array = Array3::from_shape_fn((7, 4, 3), |(n, v, k)| (100 * n + 10 * v + k) as f64);
        write_fortran(&path, &array);
        assert_eq!(read_f64(&path).unwrap(), array.clone().into_dyn());
        let header = npy_header(&path).unwrap();
        assert!(header.fortran);
        let expected: Vec<u8> = array
            .axis_iter(Axis(0))
            .flat_map(|row| row.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<_>>())
            .collect();
        let file = PositionedFile::new(File::open(&path).unwrap());
        // Blocks of one, two and all rows.
        for block in [1, 2 * 96, 1 << 20] {
            let mut copy = Vec::new();
            copy_rows(&header, &file, &mut copy, block).unwrap();
            assert_eq!(copy, expected, "{block}");
        }
    }
}
