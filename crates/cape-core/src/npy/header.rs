//! Header of a `.npy` file: magic bytes, version, and a Python dictionary literal.

use std::{fmt, io::Read};

use super::element::{NpyElement, ReadError, read_elements};

/// Longest accepted header, bytes; the limit of NumPy is 10,000.
const MAX_HEADER: usize = 1 << 16;
/// Largest accepted number of axes, that of NumPy 2.
const MAX_AXES: usize = 64;

/// Kind of an array element.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum NpyKind {
    /// IEEE floating point.
    Float,
    /// Signed integer.
    Int,
    /// Unsigned integer.
    Uint,
    /// Boolean, one byte.
    Bool,
    /// Unsupported dtype (Python objects, strings, records, complex numbers …), as written.
    Other(String),
}

/// Element type (dtype) of an array file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NpyType {
    /// Kind of the elements.
    pub kind: NpyKind,
    /// Bytes per element (0 for [`NpyKind::Other`]).
    pub size: usize,
    /// True if the most significant byte comes first.
    pub big_endian: bool,
}

impl NpyType {
    /// Little-endian 64-bit floats, `<f8`.
    pub const F64: Self = Self { kind: NpyKind::Float, size: 8, big_endian: false };
    /// Little-endian 32-bit floats, `<f4`.
    pub const F32: Self = Self { kind: NpyKind::Float, size: 4, big_endian: false };

    pub(crate) fn parse(text: &str) -> Self {
        let other = || Self { kind: NpyKind::Other(text.to_owned()), size: 0, big_endian: false };
        let (order, rest) = match text.as_bytes().first() {
            Some(b'<' | b'|' | b'=' | b'>') => (text.as_bytes()[0], &text[1..]),
            _ => (b'<', text),
        };
        let Some((code, size)) = rest.split_at_checked(1) else { return other() };
        let (kind, size) = match (code, size) {
            ("f", "2" | "4" | "8") => (NpyKind::Float, size),
            ("i", "1" | "2" | "4" | "8") => (NpyKind::Int, size),
            ("u", "1" | "2" | "4" | "8") => (NpyKind::Uint, size),
            ("b", "1") | ("?", "") => (NpyKind::Bool, "1"),
            _ => return other(),
        };
        match size.parse() {
            Ok(size) => Self { kind, size, big_endian: order == b'>' && size > 1 },
            Err(_) => other(),
        }
    }
}

impl NpyType {
    /// Bytes of an element, of strings too; `None` for other unsupported dtypes.
    pub(crate) fn element_bytes(&self) -> Option<usize> {
        match &self.kind {
            NpyKind::Other(text) => {
                let text = text.trim_start_matches(['|', '<', '>', '=']);
                let (code, length) = text.split_at_checked(1)?;
                let length: usize = length.parse().ok()?;
                match code {
                    "S" | "a" => Some(length),
                    "U" => length.checked_mul(4),
                    _ => None,
                }
            }
            _ => Some(self.size),
        }
    }

    /// Text of one element of NumPy's strings (`S` or `U`); `None` for other dtypes.
    pub(crate) fn text(&self, bytes: &[u8]) -> Option<String> {
        let NpyKind::Other(code) = &self.kind else { return None };
        let big_endian = code.starts_with('>');
        let wide = match code.trim_start_matches(['|', '<', '>', '=']).chars().next()? {
            'S' | 'a' => false,
            'U' => true,
            _ => return None,
        };
        let text: String = if wide {
            let (units, _) = bytes.as_chunks::<4>();
            let decode = |&unit: &[u8; 4]| {
                let number =
                    if big_endian { u32::from_be_bytes(unit) } else { u32::from_le_bytes(unit) };
                char::from_u32(number).unwrap_or('\u{fffd}')
            };
            units.iter().map(decode).collect()
        } else {
            String::from_utf8_lossy(bytes).into_owned()
        };
        Some(text.trim_end_matches('\0').to_owned())
    }

    /// True if the elements are pickled Python objects.
    pub fn is_object(&self) -> bool {
        matches!(&self.kind, NpyKind::Other(text) if text.trim_start_matches(['|', '<', '=']).starts_with('O'))
    }
}

impl fmt::Display for NpyType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let code = match &self.kind {
            NpyKind::Float => 'f',
            NpyKind::Int => 'i',
            NpyKind::Uint => 'u',
            NpyKind::Bool => 'b',
            NpyKind::Other(text) => return f.write_str(text),
        };
        let order = match (self.size, self.big_endian) {
            (1, _) => '|',
            (_, true) => '>',
            (_, false) => '<',
        };
        write!(f, "{order}{code}{}", self.size)
    }
}

/// Header of a `.npy` file.
///
/// ```
/// use cape_core::npy::{NpyKind, NpyType, npy_header, write_npy};
/// use ndarray::Array2;
///
/// let directory = tempfile::tempdir()?;
/// let path = directory.path().join("vertices.npy");
/// write_npy::<f32, _>(&path, &Array2::zeros((10, 3)))?;
/// let header = npy_header(&path)?;
/// assert_eq!(header.dtype, NpyType::F32);
/// assert_eq!(header.dtype.kind, NpyKind::Float);
/// assert_eq!(header.shape, [10, 3]);
/// assert_eq!(header.elements_and_bytes(), Some((30, 120)));
///
/// let bytes = std::fs::read(&path)?;
/// let row = header.decode::<f64>(&bytes[header.data_offset..][..12])?;
/// assert_eq!(row, [0.0; 3]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NpyHeader {
    /// Element type (dtype).
    pub dtype: NpyType,
    /// True for Fortran order: the first axis varies fastest.
    pub fortran: bool,
    /// Length of each axis; empty for a scalar.
    pub shape: Vec<usize>,
    /// Bytes from the start of the file to the first element.
    pub data_offset: usize,
}

impl NpyHeader {
    /// Number of elements and of data bytes; `None` if they exceed the address range.
    pub fn elements_and_bytes(&self) -> Option<(usize, usize)> {
        let elements = self.shape.iter().try_fold(1usize, |n, &axis| n.checked_mul(axis))?;
        let bytes = elements.checked_mul(self.dtype.size)?;
        isize::try_from(bytes.max(elements.checked_mul(8)?)).ok()?;
        Some((elements, bytes))
    }

    /// Numbers of `bytes`, which are consecutive elements of the array, in the order of the file.
    ///
    /// # Errors
    /// If the elements are not numbers, or one does not fit `T`; the message has the reason.
    pub fn decode<T: NpyElement>(&self, bytes: &[u8]) -> Result<Vec<T>, String> {
        let elements = bytes.len() / self.dtype.size.max(1);
        read_elements(self, elements, &mut &*bytes).map_err(|failed| match failed {
            ReadError::Io(source) => source.to_string(),
            ReadError::Content(message) => message,
        })
    }

    /// Reads a header and leaves `reader` at the first element.
    pub(crate) fn read(reader: &mut impl Read) -> Result<Self, String> {
        let short = |_| "unexpected end in the .npy header".to_owned();
        let mut start = [0u8; 8];
        reader.read_exact(&mut start).map_err(|_| "too short for a .npy array".to_owned())?;
        if &start[..6] != b"\x93NUMPY" {
            return Err("not a .npy array (its first bytes are not \\x93NUMPY)".into());
        }
        let (length, before) = match start[6] {
            1 => {
                let mut length = [0; 2];
                reader.read_exact(&mut length).map_err(short)?;
                (u16::from_le_bytes(length) as usize, 10)
            }
            2 | 3 => {
                let mut length = [0; 4];
                reader.read_exact(&mut length).map_err(short)?;
                (u32::from_le_bytes(length) as usize, 12)
            }
            version => return Err(format!(".npy version {version}, expected 1, 2 or 3")),
        };
        if length > MAX_HEADER {
            return Err(format!(".npy header of {length} bytes, expected at most {MAX_HEADER}"));
        }
        let mut text = vec![0; length];
        reader.read_exact(&mut text).map_err(short)?;
        let text =
            std::str::from_utf8(&text).map_err(|_| "the .npy header is not UTF-8".to_owned())?;
        let (dtype, fortran, shape) = Literal { rest: text.trim() }.header()?;
        Ok(Self { dtype, fortran, shape, data_offset: before + length })
    }

    /// Bytes of a version 1 header of a C-order array, padded so that the data start at a multiple of
    /// 64 bytes.
    pub fn bytes(descr: &str, shape: &[usize]) -> Vec<u8> {
        let axes: Vec<String> = shape.iter().map(usize::to_string).collect();
        let axes = axes.join(", ") + if shape.len() == 1 { "," } else { "" };
        let mut text =
            format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({axes}), }}");
        let unpadded = 10 + text.len() + 1;
        text.push_str(&" ".repeat(unpadded.next_multiple_of(64) - unpadded));
        text.push('\n');
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((text.len() as u16).to_le_bytes());
        bytes.extend(text.as_bytes());
        bytes
    }
}

/// Scanner of the dictionary literal in a header.
struct Literal<'a> {
    rest: &'a str,
}

impl<'a> Literal<'a> {
    fn header(mut self) -> Result<(NpyType, bool, Vec<usize>), String> {
        let (mut dtype, mut fortran, mut shape) = (None, None, None);
        self.expect('{')?;
        while !self.accept('}') {
            let key = self.string()?;
            self.expect(':')?;
            match key {
                "descr" if self.rest.starts_with('[') => {
                    return Err("a record (structured) array; expected plain numbers".into());
                }
                "descr" => dtype = Some(NpyType::parse(self.string()?)),
                "fortran_order" => fortran = Some(self.boolean()?),
                "shape" => shape = Some(self.tuple()?),
                _ => return Err(format!("unknown key `{key}` in the .npy header")),
            }
            if !self.accept(',') {
                self.expect('}')?;
                break;
            }
        }
        let missing = |key: &str| format!("the .npy header has no `{key}`");
        Ok((
            dtype.ok_or_else(|| missing("descr"))?,
            fortran.ok_or_else(|| missing("fortran_order"))?,
            shape.ok_or_else(|| missing("shape"))?,
        ))
    }

    fn accept(&mut self, wanted: char) -> bool {
        match self.rest.strip_prefix(wanted) {
            Some(rest) => {
                self.rest = rest.trim_start();
                true
            }
            None => false,
        }
    }

    fn expect(&mut self, wanted: char) -> Result<(), String> {
        if self.accept(wanted) { Ok(()) } else { Err(self.unexpected(&format!("`{wanted}`"))) }
    }

    fn unexpected(&self, wanted: &str) -> String {
        let found: String = self.rest.chars().take(20).collect();
        format!("malformed .npy header: expected {wanted} at `{found}`")
    }

    fn string(&mut self) -> Result<&'a str, String> {
        let inner = ['\'', '"'].into_iter().find_map(|quote| {
            let inner = self.rest.strip_prefix(quote)?;
            inner.split_once(quote)
        });
        let (text, rest) = inner.ok_or_else(|| self.unexpected("a quoted string"))?;
        self.rest = rest.trim_start();
        Ok(text)
    }

    fn boolean(&mut self) -> Result<bool, String> {
        for (word, value) in [("True", true), ("False", false)] {
            if let Some(rest) = self.rest.strip_prefix(word) {
                self.rest = rest.trim_start();
                return Ok(value);
            }
        }
        Err(self.unexpected("True or False"))
    }

    fn tuple(&mut self) -> Result<Vec<usize>, String> {
        self.expect('(')?;
        let mut axes = Vec::new();
        while !self.accept(')') {
            let digits = self.rest.bytes().take_while(u8::is_ascii_digit).count();
            let (number, rest) = self.rest.split_at(digits);
            let axis = number.parse().map_err(|_| self.unexpected("the length of an axis"))?;
            axes.push(axis);
            if axes.len() > MAX_AXES {
                return Err(format!("more than {MAX_AXES} axes"));
            }
            // Python 2 wrote long integers as `3L`.
            self.rest = rest.strip_prefix('L').unwrap_or(rest).trim_start();
            if !self.accept(',') {
                self.expect(')')?;
                break;
            }
        }
        Ok(axes)
    }
}
