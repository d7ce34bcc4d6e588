//! MATLAB's files of level 5 (`.mat`, to version 7): numeric and character arrays by name.
//!
//! SURREAL and CLOTH3D store their parameters so, with a frame in each column.

use std::{io::Read, path::Path};

use ndarray::{ArrayD, IxDyn, ShapeBuilder};

use crate::{Error, Result};

/// Length of the header, bytes.
const HEADER: usize = 128;
/// Types of data elements.
const MATRIX: u32 = 14;
const COMPRESSED: u32 = 15;
/// Classes of arrays.
const STRUCTURE: u8 = 2;
const CHARACTERS: u8 = 4;
const NUMERIC: std::ops::RangeInclusive<u8> = 6..=15;
/// Numbers of rows that are those of a pose, a shape or a translation of which each column is a frame.
const POSE_ROWS: usize = 72;
const SHAPE_ROWS: usize = 10;

/// A variable of a file.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Variable {
    Numbers(ArrayD<f64>),
    Text(String),
    /// Anything else, with its description.
    Other(&'static str),
}

/// Variables of a file, read from its bytes. Compressed data may have `most` bytes.
///
/// Poses `[72, frames]` and shapes `[10, frames]` are transposed, and a `gender` of 0 or 1 is female or
/// male, as in SURREAL and CLOTH3D.
pub(super) fn variables(path: &Path, bytes: &[u8], most: u64) -> Result<Vec<(String, Variable)>> {
    let fault = |message: &str| Error::format(path, format!("MATLAB file: {message}"));
    let body = bytes.get(HEADER..).ok_or_else(|| fault("ends within its header"))?;
    if bytes[126..128] != *b"IM" {
        return Err(fault("its numbers are big-endian, expected little-endian"));
    }
    let mut found = Vec::new();
    let mut rest = body;
    let mut budget = most;
    while !rest.is_empty() {
        let element =
            Element::take(&mut rest, false).ok_or_else(|| fault("ends within a variable"))?;
        let inflated = match element.kind {
            COMPRESSED => {
                let mut inner = Vec::new();
                let reader = flate2::read::ZlibDecoder::new(element.data);
                let read = reader.take(budget + 1).read_to_end(&mut inner);
                read.map_err(|error| fault(&format!("compressed data: {error}")))?;
                budget = budget
                    .checked_sub(inner.len() as u64)
                    .ok_or_else(|| fault("rejected as a decompression bomb"))?;
                inner
            }
            _ => Vec::new(),
        };
        let element = match element.kind {
            COMPRESSED => Element::take(&mut &inflated[..], true),
            _ => Some(element),
        };
        let variable =
            element.filter(|element| element.kind == MATRIX).and_then(|e| variable(e.data));
        let (name, variable) = variable.ok_or_else(|| fault("a variable cannot be read"))?;
        let variable = by_frames(&name, variable);
        found.push((name, variable));
    }
    Ok(found)
}

/// A data element: its type and bytes.
struct Element<'a> {
    kind: u32,
    data: &'a [u8],
}

impl<'a> Element<'a> {
    /// The next element of `bytes`; the last may lack its padding if `unpadded`.
    fn take(bytes: &mut &'a [u8], unpadded: bool) -> Option<Self> {
        let kind = word(bytes, 0)?;
        if kind >> 16 != 0 {
            let (kind, length) = (kind & 0xffff, (kind >> 16) as usize);
            let data = bytes.get(4..8)?.get(..length)?;
            *bytes = &bytes[8..];
            return Some(Self { kind, data });
        }
        let length = word(bytes, 4)? as usize;
        let data = bytes.get(8..8usize.checked_add(length)?)?;
        // Compressed elements are not padded, others are to 8 bytes.
        let padding = if kind == COMPRESSED { 0 } else { length.wrapping_neg() % 8 };
        *bytes = match bytes.get(8 + length + padding..) {
            Some(rest) => rest,
            None if unpadded => &[],
            None => return None,
        };
        Some(Self { kind, data })
    }
}

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?))
}

/// Name and value of the array in the data of a matrix element.
fn variable(data: &[u8]) -> Option<(String, Variable)> {
    let mut rest = data;
    let flags = Element::take(&mut rest, true)?;
    let class = *flags.data.first()?;
    let complex = flags.data.get(1)? & 0x08 != 0;
    let dimensions = Element::take(&mut rest, true)?;
    let shape: Vec<usize> = dimensions
        .data
        .chunks_exact(4)
        .map(|word| u32::from_le_bytes([word[0], word[1], word[2], word[3]]) as usize)
        .collect();
    let name = Element::take(&mut rest, true)?;
    let name = String::from_utf8_lossy(name.data).into_owned();
    let value = match class {
        _ if complex => Variable::Other("complex numbers"),
        CHARACTERS => {
            let text = numbers(&Element::take(&mut rest, true)?)?;
            let letters = text.iter().map(|&code| char::from_u32(code as u32).unwrap_or('?'));
            Variable::Text(letters.collect())
        }
        class if NUMERIC.contains(&class) => {
            let values = numbers(&Element::take(&mut rest, true)?)?;
            // By columns.
            let array = ArrayD::from_shape_vec(IxDyn(&shape).f(), values).ok()?;
            Variable::Numbers(array.as_standard_layout().into_owned())
        }
        STRUCTURE => Variable::Other("a structure"),
        _ => Variable::Other("no numeric array"),
    };
    Some((name, value))
}

/// Numbers of an element, which may be stored in a smaller type than that of their array.
fn numbers(element: &Element) -> Option<Vec<f64>> {
    fn each<const N: usize>(data: &[u8], number: impl Fn([u8; N]) -> f64) -> Option<Vec<f64>> {
        data.chunks(N).map(|bytes| Some(number(bytes.try_into().ok()?))).collect()
    }
    let data = element.data;
    match element.kind {
        1 => each(data, |b| f64::from(i8::from_le_bytes(b))),
        2 | 16 => each(data, |b: [u8; 1]| f64::from(b[0])),
        3 => each(data, |b| f64::from(i16::from_le_bytes(b))),
        4 | 17 => each(data, |b| f64::from(u16::from_le_bytes(b))),
        5 => each(data, |b| f64::from(i32::from_le_bytes(b))),
        6 | 18 => each(data, |b| f64::from(u32::from_le_bytes(b))),
        7 => each(data, |b| f64::from(f32::from_le_bytes(b))),
        9 => each(data, f64::from_le_bytes),
        12 => each(data, |b| i64::from_le_bytes(b) as f64),
        13 => each(data, |b| u64::from_le_bytes(b) as f64),
        _ => None,
    }
}

/// A variable in this library's order: frames in rows, gender by its name.
fn by_frames(name: &str, variable: Variable) -> Variable {
    match variable {
        Variable::Numbers(array) => match (name, array.shape()) {
            ("pose" | "poses", &[POSE_ROWS, frames]) if frames != POSE_ROWS => {
                Variable::Numbers(transposed(array))
            }
            ("shape" | "betas", &[SHAPE_ROWS, frames]) if frames != SHAPE_ROWS => {
                Variable::Numbers(transposed(array))
            }
            ("gender", _) if array.iter().all(|&x| x == 0.0) => Variable::Text("female".into()),
            ("gender", _) if array.iter().all(|&x| x == 1.0) => Variable::Text("male".into()),
            _ => Variable::Numbers(array),
        },
        other => other,
    }
}

fn transposed(array: ArrayD<f64>) -> ArrayD<f64> {
    array.reversed_axes().as_standard_layout().into_owned()
}
