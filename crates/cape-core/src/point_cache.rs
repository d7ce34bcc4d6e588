//! Point caches of animated meshes, as Blender, Maya and 3ds Max exchange them: PC2 (also with
//! half-precision numbers, `.pc16`) and Lightwave's MDD. A cache has no triangles; they are those of
//! the mesh that it moves.

use std::path::Path;

use ndarray::Array3;

use crate::{Error, Result, mesh::read_bytes};

const PC2_MAGIC: &[u8; 12] = b"POINTCACHE2\0";
/// Length of the header of a PC2 file, bytes.
const PC2_HEADER: usize = 32;

/// Positions of the points of a mesh over time.
///
/// ```
/// use cape_core::PointCache;
///
/// // A PC2 file of two samples of one point.
/// let mut bytes = b"POINTCACHE2\0".to_vec();
/// bytes.extend([1i32, 1].map(i32::to_le_bytes).as_flattened());
/// bytes.extend([0f32, 1.0].map(f32::to_le_bytes).as_flattened());
/// bytes.extend(2i32.to_le_bytes());
/// bytes.extend([0f32, 0.0, 0.0, 0.5, 0.0, 0.0].map(f32::to_le_bytes).as_flattened());
/// let directory = tempfile::tempdir()?;
/// let path = directory.path().join("cache.pc2");
/// std::fs::write(&path, bytes)?;
/// let cache = PointCache::read(&path)?;
/// assert_eq!(cache.positions.dim(), (2, 1, 3));
/// assert_eq!(cache.positions[(1, 0, 0)], 0.5);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct PointCache {
    /// Positions in the unit of the file, `[frames, points, 3]`.
    pub positions: Array3<f32>,
    /// Frames per second, where the file has the times of its frames (MDD).
    pub frame_rate: Option<f64>,
}

impl PointCache {
    /// Reads a `.pc2`, `.pc16` or `.mdd` file.
    ///
    /// # Errors
    /// If the file cannot be read, its header does not fit its length, or a number is not finite.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let is = |name| path.extension().is_some_and(|found| found.eq_ignore_ascii_case(name));
        let bytes = read_bytes(path)?;
        let cache = if bytes.starts_with(PC2_MAGIC) {
            pc2(&bytes)
        } else if is("mdd") {
            mdd(&bytes)
        } else {
            Err("not a point cache: expected `POINTCACHE2` at the start, or an .mdd file".into())
        };
        let cache = cache.map_err(|message| Error::format(path, message))?;
        if let Some(at) = cache.positions.iter().position(|x| !x.is_finite()) {
            let points = cache.positions.dim().1;
            return Err(Error::format(
                path,
                format!("frame {}, point {} is not finite", at / (3 * points), at / 3 % points),
            ));
        }
        Ok(cache)
    }
}

/// A PC2 file, whose numbers are of 4 bytes, or of 2 if only that fits its length.
fn pc2(bytes: &[u8]) -> Result<PointCache, String> {
    let word = |at: usize| -> Result<usize, String> {
        let word = bytes.get(at..at + 4).and_then(|word| word.try_into().ok());
        let number = i32::from_le_bytes(word.ok_or("the header is cut off")?);
        usize::try_from(number).map_err(|_| format!("the header has the count {number}"))
    };
    let (points, frames) = (word(16)?, word(28)?);
    let numbers = count(frames, points)?;
    let payload = &bytes[PC2_HEADER..];
    let values: Vec<f32> = if payload.len() == 2 * numbers {
        payload.as_chunks::<2>().0.iter().map(|&half| from_half(u16::from_le_bytes(half))).collect()
    } else {
        let payload = exactly(payload, 4 * numbers, frames, points)?;
        payload.as_chunks::<4>().0.iter().map(|&word| f32::from_le_bytes(word)).collect()
    };
    Ok(PointCache { positions: shaped(frames, points, values)?, frame_rate: None })
}

fn mdd(bytes: &[u8]) -> Result<PointCache, String> {
    let (header, rest) = bytes.split_at_checked(8).ok_or("the header is cut off")?;
    let [frames, points] = [0, 4].map(|at| {
        u32::from_be_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]]) as usize
    });
    let numbers = count(frames, points)?;
    let payload = exactly(rest, 4 * (frames + numbers), frames, points)?;
    let (times, payload) = payload.split_at(4 * frames);
    let floats = |bytes: &[u8]| -> Vec<f32> {
        bytes.as_chunks::<4>().0.iter().map(|&word| f32::from_be_bytes(word)).collect()
    };
    let times = floats(times);
    let span = f64::from(times[frames - 1]) - f64::from(times[0]);
    let rate = (frames - 1) as f64 / span;
    let positions = shaped(frames, points, floats(payload))?;
    Ok(PointCache { positions, frame_rate: (rate.is_finite() && rate > 0.0).then_some(rate) })
}

fn count(frames: usize, points: usize) -> Result<usize, String> {
    if frames == 0 || points == 0 {
        return Err(format!("{frames} frames of {points} points, expected at least one of each"));
    }
    // Both come from 32 bits, so that the product fits 64.
    frames
        .checked_mul(points)
        .and_then(|both| both.checked_mul(3))
        .filter(|&numbers| numbers < usize::MAX / 8)
        .ok_or_else(|| format!("{frames} frames of {points} points, more than memory can hold"))
}

fn exactly(bytes: &[u8], size: usize, frames: usize, points: usize) -> Result<&[u8], String> {
    bytes.get(..size).ok_or_else(|| {
        format!(
            "the header declares {frames} frames of {points} points, {size} bytes, but {} follow",
            bytes.len()
        )
    })
}

fn shaped(frames: usize, points: usize, values: Vec<f32>) -> Result<Array3<f32>, String> {
    Array3::from_shape_vec((frames, points, 3), values).map_err(|error| error.to_string())
}

/// The number of an IEEE half-precision float.
fn from_half(bits: u16) -> f32 {
    let sign = if bits & 0x8000 == 0 { 1.0 } else { -1.0 };
    let (exponent, fraction) = (i32::from(bits >> 10 & 0x1f), f32::from(bits & 0x3ff));
    sign * match exponent {
        0 => fraction * 2f32.powi(-24),
        31 if fraction == 0.0 => f32::INFINITY,
        31 => f32::NAN,
        _ => (1024.0 + fraction) * 2f32.powi(exponent - 25),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAMES: [[[f32; 3]; 2]; 3] = [
        [[0.0, 1.0, 2.0], [0.5, -0.25, 1.5]],
        [[0.125, 1.0, 2.0], [0.5, -0.25, 1.75]],
        [[0.25, 1.0, 2.0], [0.5, -0.25, 2.0]],
    ];

    fn numbers() -> Vec<f32> {
        FRAMES.as_flattened().as_flattened().to_vec()
    }

    fn pc2_file(payload: &[u8]) -> Vec<u8> {
        let mut bytes = PC2_MAGIC.to_vec();
        bytes.extend([1i32, 2].map(i32::to_le_bytes).as_flattened());
        bytes.extend([0f32, 1.0].map(f32::to_le_bytes).as_flattened());
        bytes.extend(3i32.to_le_bytes());
        bytes.extend(payload);
        bytes
    }

    fn read(name: &str, bytes: &[u8]) -> Result<PointCache> {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        PointCache::read(path)
    }

    #[test]
    fn the_three_kinds_are_read() {
        let full: Vec<u8> = numbers().iter().flat_map(|x| x.to_le_bytes()).collect();
        let cache = read("a.pc2", &pc2_file(&full)).unwrap();
        assert_eq!(cache.positions.iter().copied().collect::<Vec<_>>(), numbers());
        assert_eq!(cache.frame_rate, None);
        // These numbers have exact halves: sign, exponent and ten bits.
        let half = |x: f32| {
            let bits = x.to_bits();
            let exponent = (bits >> 23 & 0xff) as i32 - 112;
            let rest = if x == 0.0 { 0 } else { (exponent as u32) << 10 | bits >> 13 & 0x3ff };
            ((bits >> 16 & 0x8000 | rest) as u16).to_le_bytes()
        };
        let halves: Vec<u8> = numbers().iter().flat_map(|&x| half(x)).collect();
        assert_eq!(read("a.pc16", &pc2_file(&halves)).unwrap(), cache);
        let mut bytes = [3u32, 2].map(u32::to_be_bytes).as_flattened().to_vec();
        bytes.extend([0f32, 0.04, 0.08].map(f32::to_be_bytes).as_flattened());
        bytes.extend(numbers().iter().flat_map(|x| x.to_be_bytes()));
        let other = read("a.mdd", &bytes).unwrap();
        assert_eq!(other.positions, cache.positions);
        assert!((other.frame_rate.unwrap() - 25.0).abs() < 1e-4);
    }

    #[test]
    fn halves_are_those_of_ieee_754() {
        for (bits, value) in [
            (0x3c00, 1.0),
            (0xc000, -2.0),
            (0x7bff, 65504.0),
            (0x0001, 5.960_464_5e-8),
            (0x3555, 0.333_251_95),
        ] {
            assert_eq!(from_half(bits), value);
        }
        assert!(from_half(0x7e00).is_nan() && from_half(0xfc00) == f32::NEG_INFINITY);
    }

    #[test]
    fn broken_caches_are_refused() {
        let said = |name: &str, bytes: &[u8]| read(name, bytes).unwrap_err().to_string();
        assert!(said("a.pc2", b"POINTCACHE2\0").contains("header is cut off"));
        assert!(said("a.pc2", &pc2_file(&[0; 70])).contains("3 frames of 2 points, 72 bytes"));
        assert!(said("a.mdd", &[255; 64]).contains("frames of"));
        assert!(said("a.mdd", &[0; 8]).contains("at least one"));
        assert!(said("a.pc2", b"solid").contains("not a point cache"));
        let nan: Vec<u8> =
            (0..18).flat_map(|at| if at == 9 { f32::NAN } else { 0.0 }.to_le_bytes()).collect();
        assert!(said("a.pc2", &pc2_file(&nan)).contains("frame 1, point 1 is not finite"));
    }
}
