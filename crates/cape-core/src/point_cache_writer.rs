//! Writing of point caches: the vertices of a mesh in every frame.

use std::{
    io::Write,
    path::{Path, PathBuf},
};

use crate::{AtomicFile, Error, Result};

const PC2_MAGIC: &[u8; 12] = b"POINTCACHE2\0";

/// Format of a point cache.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PointCacheFormat {
    /// PC2: little-endian, without a frame rate.
    Pc2,
    /// MDD: big-endian, with the time of each frame.
    Mdd,
}

/// Writer of a point cache, frame by frame.
///
/// ```
/// use cape_core::{PointCache, PointCacheFormat, PointCacheWriter};
///
/// let directory = tempfile::tempdir()?;
/// let path = directory.path().join("two.mdd");
/// let mut writer = PointCacheWriter::create(&path, PointCacheFormat::Mdd, [2, 1], 30.0)?;
/// writer.push(&[[0.0, 1.0, 2.0]])?;
/// writer.push(&[[0.5, 1.0, 2.0]])?;
/// writer.finish()?;
/// let cache = PointCache::read(&path)?;
/// assert_eq!((cache.positions.dim(), cache.positions[[1, 0, 0]]), ((2, 1, 3), 0.5));
/// assert!((cache.frame_rate.unwrap() - 30.0).abs() < 1e-3);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct PointCacheWriter {
    path: PathBuf,
    file: AtomicFile,
    format: PointCacheFormat,
    frames: usize,
    points: usize,
    written: usize,
}

impl PointCacheWriter {
    /// Begins a file of `[frames, points]` at a frame rate.
    ///
    /// # Errors
    /// If there are no frames or points, the frame rate is not positive, or the file cannot be
    /// written.
    pub fn create(
        path: impl AsRef<Path>,
        format: PointCacheFormat,
        [frames, points]: [usize; 2],
        frame_rate: f64,
    ) -> Result<Self> {
        let path = path.as_ref();
        let counts = (i32::try_from(frames), i32::try_from(points));
        let (Ok(frames_32 @ 1..), Ok(points_32 @ 1..)) = counts else {
            return Err(Error::argument(format!(
                "point cache of {frames} frames of {points} points: expected at least one of each"
            )));
        };
        if !(frame_rate.is_finite() && frame_rate > 0.0) {
            return Err(Error::argument(format!("frame rate {frame_rate}: must be positive")));
        }
        let mut head = Vec::new();
        match format {
            PointCacheFormat::Pc2 => {
                head.extend(PC2_MAGIC);
                head.extend(1_i32.to_le_bytes());
                head.extend(points_32.to_le_bytes());
                // First frame, and frames for each sample.
                head.extend(0_f32.to_le_bytes());
                head.extend(1_f32.to_le_bytes());
                head.extend(frames_32.to_le_bytes());
            }
            PointCacheFormat::Mdd => {
                head.extend(frames_32.to_be_bytes());
                head.extend(points_32.to_be_bytes());
                for frame in 0..frames {
                    head.extend(((frame as f64 / frame_rate) as f32).to_be_bytes());
                }
            }
        }
        let mut file = AtomicFile::create(path)?;
        file.write_all(&head).map_err(|error| Error::io(path, error))?;
        Ok(Self { path: path.to_owned(), file, format, frames, points, written: 0 })
    }

    /// Writes the points of the next frame, metres.
    ///
    /// # Errors
    /// If their number is not that of the file, all frames are written, or writing fails.
    pub fn push(&mut self, points: &[[f32; 3]]) -> Result<()> {
        if points.len() != self.points || self.written == self.frames {
            return Err(Error::argument(format!(
                "point cache: frame {} of {} points, expected {} frames of {}",
                self.written,
                points.len(),
                self.frames,
                self.points
            )));
        }
        let numbers = points.as_flattened().iter();
        let bytes: Vec<u8> = match self.format {
            PointCacheFormat::Pc2 => numbers.flat_map(|x| x.to_le_bytes()).collect(),
            PointCacheFormat::Mdd => numbers.flat_map(|x| x.to_be_bytes()).collect(),
        };
        self.file.write_all(&bytes).map_err(|error| Error::io(&self.path, error))?;
        self.written += 1;
        Ok(())
    }

    /// Completes the file and gives it its name.
    ///
    /// # Errors
    /// If frames are missing, or the file cannot be renamed.
    pub fn finish(self) -> Result<()> {
        if self.written != self.frames {
            return Err(Error::argument(format!(
                "point cache: {} of {} frames were written",
                self.written, self.frames
            )));
        }
        self.file.commit()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::PointCache;

    fn write(path: &Path, format: PointCacheFormat) {
        let mut writer = PointCacheWriter::create(path, format, [3, 2], 24.0).unwrap();
        for frame in 0..3 {
            let x = frame as f32;
            writer.push(&[[x, 1.0, 2.0], [3.0, 4.0, x]]).unwrap();
        }
        assert!(writer.push(&[[0.0; 3]; 2]).is_err());
        writer.finish().unwrap();
    }

    #[test]
    fn headers_are_those_of_the_formats() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.pc2");
        write(&path, PointCacheFormat::Pc2);
        let bytes = std::fs::read(&path).unwrap();
        let mut expected = b"POINTCACHE2\0\x01\0\0\0\x02\0\0\0".to_vec();
        expected.extend(b"\0\0\0\0\0\0\x80\x3f\x03\0\0\0");
        for x in [0.0_f32, 1.0, 2.0, 3.0, 4.0, 0.0] {
            expected.extend(x.to_le_bytes());
        }
        assert_eq!((&bytes[..56], bytes.len()), (&expected[..], 32 + 72));
        write(&path, PointCacheFormat::Mdd);
        let bytes = std::fs::read(&path).unwrap();
        assert_eq!(&bytes[..12], b"\0\0\0\x03\0\0\0\x02\0\0\0\0");
        assert_eq!((&bytes[20..28], bytes.len()), (&b"\0\0\0\0\x3f\x80\0\0"[..], 8 + 12 + 72));
    }

    #[test]
    fn caches_are_read_back() {
        let directory = tempfile::tempdir().unwrap();
        for (name, format) in [("a.pc2", PointCacheFormat::Pc2), ("a.mdd", PointCacheFormat::Mdd)] {
            let path = directory.path().join(name);
            write(&path, format);
            let cache = PointCache::read(&path).unwrap();
            assert_eq!(cache.positions.dim(), (3, 2, 3));
            assert_eq!((cache.positions[[2, 0, 0]], cache.positions[[2, 1, 2]]), (2.0, 2.0));
            let rate = cache.frame_rate.map(|rate| (1000.0 * rate).round());
            assert_eq!(rate, (format == PointCacheFormat::Mdd).then_some(24_000.0));
        }
        let path = directory.path().join("none.pc2");
        assert!(PointCacheWriter::create(&path, PointCacheFormat::Pc2, [0, 1], 30.0).is_err());
        let writer = PointCacheWriter::create(&path, PointCacheFormat::Pc2, [1, 1], 30.0).unwrap();
        assert!(writer.finish().is_err() && !path.exists());
    }
}
