//! Conversion between the bytes of an array file and Rust numbers.

use std::io::{self, Read};

use super::header::{NpyHeader, NpyKind, NpyType};

/// Element type of arrays in memory: `f32`, `f64`, `i32`, `i64`, `u32` or `u8` (sealed).
///
/// Files of any numeric dtype convert to the requested type:
///
/// ```
/// use cape_core::npy::{read_npy, write_npy};
/// use ndarray::array;
///
/// let directory = tempfile::tempdir()?;
/// let path = directory.path().join("counts.npy");
/// write_npy::<i64, _>(&path, &array![1, 2, 300])?;
/// assert_eq!(read_npy::<f32>(&path)?, array![1., 2., 300.].into_dyn());
/// // 300 is not a byte.
/// assert!(read_npy::<u8>(&path).is_err());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub trait NpyElement: Copy + Default + private::Sealed + 'static {
    /// NumPy's dtype string of the type.
    #[doc(hidden)]
    const DESCR: &'static str;
    #[doc(hidden)]
    fn from_float(value: f64) -> Option<Self>;
    #[doc(hidden)]
    fn from_int(value: i128) -> Option<Self>;
    #[doc(hidden)]
    fn append_to(self, bytes: &mut Vec<u8>);
}

mod private {
    pub trait Sealed {}
    impl Sealed for f32 {}
    impl Sealed for f64 {}
    impl Sealed for i32 {}
    impl Sealed for i64 {}
    impl Sealed for u32 {}
    impl Sealed for u8 {}
}

macro_rules! float {
    ($type:ty, $descr:literal) => {
        impl NpyElement for $type {
            const DESCR: &'static str = $descr;
            fn from_float(value: f64) -> Option<Self> {
                Some(value as $type)
            }
            fn from_int(value: i128) -> Option<Self> {
                Some(value as $type)
            }
            fn append_to(self, bytes: &mut Vec<u8>) {
                bytes.extend(self.to_le_bytes());
            }
        }
    };
}
macro_rules! integer {
    ($type:ty, $descr:literal) => {
        impl NpyElement for $type {
            const DESCR: &'static str = $descr;
            fn from_float(value: f64) -> Option<Self> {
                (value.fract() == 0.0 && value.abs() < 9e15)
                    .then(|| <$type>::try_from(value as i64).ok())?
            }
            fn from_int(value: i128) -> Option<Self> {
                value.try_into().ok()
            }
            fn append_to(self, bytes: &mut Vec<u8>) {
                bytes.extend(self.to_le_bytes());
            }
        }
    };
}
float!(f32, "<f4");
float!(f64, "<f8");
integer!(i32, "<i4");
integer!(i64, "<i8");
integer!(u32, "<u4");
integer!(u8, "|u1");

/// Value of an IEEE half-precision number.
fn half(bits: u16) -> f64 {
    let mantissa = f64::from(bits & 0x3ff);
    let magnitude = match (bits >> 10) & 0x1f {
        0 => mantissa * 2f64.powi(-24),
        31 if mantissa == 0.0 => f64::INFINITY,
        31 => f64::NAN,
        exponent => (1.0 + mantissa / 1024.0) * 2f64.powi(i32::from(exponent) - 15),
    };
    if bits >> 15 == 0 { magnitude } else { -magnitude }
}

/// Reason why an array cannot be read.
pub(super) enum ReadError {
    Io(io::Error),
    Content(String),
}

fn not_numbers(found: &NpyType) -> ReadError {
    let hint = if found.is_object() { " (it holds pickled Python objects)" } else { "" };
    ReadError::Content(format!("holds `{found}`, expected numbers{hint}"))
}

/// Reads the elements after `header`, in the order of the file. The caller has checked that the
/// source is long enough for the shape in the header.
pub(super) fn read_elements<T: NpyElement>(
    header: &NpyHeader,
    elements: usize,
    reader: &mut impl Read,
) -> Result<Vec<T>, ReadError> {
    let NpyType { kind, size, big_endian } = &header.dtype;
    if *size == 0 {
        return Err(not_numbers(&header.dtype));
    }
    let mut values = vec![T::default(); elements];
    let mut buffer = vec![0; (1 << 16).min(elements.saturating_mul(*size)).max(1)];
    let mut done = 0;
    macro_rules! decode {
        ($bytes:expr, $type:ty, $convert:expr) => {{
            let convert = $convert;
            let (sources, _) = $bytes.as_chunks::<{ size_of::<$type>() }>();
            for (at, (place, &source)) in values[done..].iter_mut().zip(sources).enumerate() {
                let value = <$type>::from_le_bytes(source);
                *place = convert(value).ok_or_else(|| {
                    ReadError::Content(format!(
                        "value {value} at element {} does not fit {}",
                        done + at,
                        std::any::type_name::<T>()
                    ))
                })?;
            }
        }};
    }
    while done < elements {
        let now = (elements - done).min(buffer.len() / size);
        let bytes = &mut buffer[..now * size];
        reader.read_exact(bytes).map_err(|source| match source.kind() {
            io::ErrorKind::UnexpectedEof => ReadError::Content("unexpected end of data".into()),
            _ => ReadError::Io(source),
        })?;
        if *big_endian {
            bytes.chunks_exact_mut(*size).for_each(<[u8]>::reverse);
        }
        match (kind, size) {
            (NpyKind::Float, 2) => decode!(bytes, u16, |bits| T::from_float(half(bits))),
            (NpyKind::Float, 4) => decode!(bytes, f32, |x| T::from_float(f64::from(x))),
            (NpyKind::Float, 8) => decode!(bytes, f64, T::from_float),
            (NpyKind::Int, 1) => decode!(bytes, i8, |x| T::from_int(i128::from(x))),
            (NpyKind::Int, 2) => decode!(bytes, i16, |x| T::from_int(i128::from(x))),
            (NpyKind::Int, 4) => decode!(bytes, i32, |x| T::from_int(i128::from(x))),
            (NpyKind::Int, 8) => decode!(bytes, i64, |x| T::from_int(i128::from(x))),
            (NpyKind::Uint, 1) => decode!(bytes, u8, |x| T::from_int(i128::from(x))),
            (NpyKind::Bool, 1) => decode!(bytes, u8, |x| T::from_int(i128::from(x != 0))),
            (NpyKind::Uint, 2) => decode!(bytes, u16, |x| T::from_int(i128::from(x))),
            (NpyKind::Uint, 4) => decode!(bytes, u32, |x| T::from_int(i128::from(x))),
            (NpyKind::Uint, 8) => decode!(bytes, u64, |x| T::from_int(i128::from(x))),
            _ => return Err(not_numbers(&header.dtype)),
        }
        done += now;
    }
    Ok(values)
}
