//! Poses from files, for fitting a [`PosePrior`](crate::PosePrior).

use std::path::{Path, PathBuf};

use cape_core::motion::{MotionFile, MotionOptions, read_motions};
use cape_data::{PackedSet, Split};
use ndarray::Array2;

use crate::{Error, Result};

/// Extensions of files that may contain poses.
const EXTENSIONS: [&str; 7] = ["npz", "npy", "csv", "pkl", "pickle", "json", "smpl"];

/// Poses of several files.
///
/// ```
/// use cape_core::npy::write_npy;
/// use cape_fit::PoseCollection;
/// use ndarray::Array2;
///
/// let directory = tempfile::tempdir()?;
/// write_npy(directory.path().join("walk.npy"), &Array2::<f64>::zeros((5, 72)))?;
/// let poses = PoseCollection::read(&[directory.path().to_owned()], &mut |_, _| {})?;
/// assert_eq!((poses.len(), poses.files), (5, 1));
/// // Poses for fitting a prior, and others for testing it.
/// let [fitted, tested] = poses.spread(2);
/// assert_eq!((fitted.dim(), tested.dim()), ((2, 72), (2, 72)));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Default)]
pub struct PoseCollection {
    poses: Vec<[f64; 72]>,
    /// Number of files with poses.
    pub files: usize,
    /// Files in directories without poses, with the reason.
    pub skipped: Vec<(PathBuf, String)>,
}

impl PoseCollection {
    /// Reads each of `sources`: a file of any format of [`cape_core::motion`], of all of whose
    /// people the poses are used, a packed set, of which the training poses are used, or a directory, which is searched for pose
    /// files. `progress` is called with the number of files read and of all.
    ///
    /// # Errors
    /// If a named file has no poses, or no source has any.
    pub fn read(sources: &[PathBuf], progress: &mut dyn FnMut(usize, usize)) -> Result<Self> {
        let mut collection = Self::default();
        let mut files: Vec<(PathBuf, bool)> = Vec::new();
        for source in sources {
            if !source.is_dir() {
                files.push((source.clone(), true));
            } else if Split::Train.exists(source) {
                collection.add_packed(source)?;
            } else {
                files.extend(below(source)?.into_iter().map(|file| (file, false)));
            }
        }
        for (index, (file, named)) in files.iter().enumerate() {
            match read_motions(file, &MotionOptions::default()) {
                Ok(people) => {
                    collection.files += 1;
                    for person in people {
                        collection.add(&person)?;
                    }
                }
                Err(error) if *named => return Err(error.into()),
                Err(error) => collection.skipped.push((file.clone(), error.to_string())),
            }
            progress(index + 1, files.len());
        }
        if collection.poses.is_empty() {
            let names: Vec<String> = sources.iter().map(|s| s.display().to_string()).collect();
            return Err(Error::argument(format!("{}: no poses found", names.join(", "))));
        }
        Ok(collection)
    }

    fn add(&mut self, person: &MotionFile) -> Result<()> {
        let poses = person.upright_poses()?;
        self.poses.extend(poses.iter().map(|pose| pose.map(f64::from)));
        Ok(())
    }

    fn add_packed(&mut self, root: &Path) -> Result<()> {
        let set = PackedSet::open(root, Split::Train)?;
        for frame in 0..set.frames() {
            let pose = set.pose(frame)?;
            let mut values = [0.0; 72];
            values.iter_mut().zip(pose).for_each(|(value, angle)| *value = angle.into());
            self.poses.push(values);
        }
        self.files += 1;
        Ok(())
    }

    /// Number of poses, at least 1.
    pub fn len(&self) -> usize {
        self.poses.len()
    }

    /// True if there is no pose.
    pub fn is_empty(&self) -> bool {
        self.poses.is_empty()
    }

    /// At most `most` evenly spaced poses for fitting, radians, `[n, 72]`, and at most as many
    /// between them for testing.
    pub fn spread(&self, most: usize) -> [Array2<f64>; 2] {
        let count = self.poses.len();
        let wanted = most.clamp(1, count);
        let chosen: Vec<usize> = (0..wanted).map(|index| index * count / wanted).collect();
        let next = chosen.iter().skip(1).copied().chain([count]);
        let between: Vec<usize> = chosen
            .iter()
            .zip(next)
            .filter(|(at, next)| **at + 1 < *next)
            .map(|(&at, next)| at + (next - at) / 2)
            .collect();
        [chosen, between].map(|rows| {
            Array2::from(rows.into_iter().map(|row| self.poses[row]).collect::<Vec<_>>())
        })
    }
}

/// Files with a known extension in a directory and below, in order of their paths.
fn below(directory: &Path) -> Result<Vec<PathBuf>> {
    let mut open = vec![directory.to_owned()];
    let mut found = Vec::new();
    while let Some(directory) = open.pop() {
        let entries = std::fs::read_dir(&directory).map_err(|e| Error::io(&directory, e))?;
        for entry in entries {
            let entry = entry.map_err(|e| Error::io(&directory, e))?;
            let kind = entry.file_type().map_err(|e| Error::io(entry.path(), e))?;
            let path = entry.path();
            if entry.file_name().to_string_lossy().starts_with('.') {
                continue;
            }
            let extension = path.extension().unwrap_or_default();
            if kind.is_dir() {
                open.push(path);
            } else if EXTENSIONS.iter().any(|e| extension.eq_ignore_ascii_case(e)) {
                found.push(path);
            }
        }
    }
    found.sort();
    Ok(found)
}

#[cfg(test)]
mod tests {
    use cape_core::npy::{NpzWriter, write_npy};
    use ndarray::{Array1, Array2};

    use super::*;

    #[test]
    fn directories_are_searched_and_files_read() {
        let root = tempfile::tempdir().unwrap();
        let inner = root.path().join("subject");
        std::fs::create_dir(&inner).unwrap();
        let mut amass = NpzWriter::create(inner.join("walk.npz")).unwrap();
        amass.add("poses", &Array2::from_elem((5, 156), 0.25)).unwrap();
        amass.finish().unwrap();
        write_npy(root.path().join("one.npy"), &Array1::from_elem(72, 0.5)).unwrap();
        write_npy(inner.join("shape.npy"), &Array1::from_elem(10, 0.5)).unwrap();
        std::fs::write(inner.join("readme.txt"), "").unwrap();
        let read = |paths: &[PathBuf]| PoseCollection::read(paths, &mut |_, _| {});
        let found = read(&[root.path().to_owned()]).unwrap();
        assert_eq!((found.len(), found.files, found.skipped.len()), (6, 2, 1));
        assert!(found.skipped[0].0.ends_with("shape.npy"));
        let [fitted, tested] = found.spread(3);
        assert_eq!((fitted.dim(), tested.dim()), ((3, 72), (3, 72)));
        // The first joint is turned upright, the others are as they are.
        assert_eq!((fitted[[0, 3]], fitted[[2, 3]]), (0.5, 0.25));
        let [fitted, tested] = found.spread(100);
        assert_eq!((fitted.nrows(), tested.nrows()), (6, 0));
        let message = read(&[inner.join("shape.npy")]).unwrap_err().to_string();
        assert!(message.contains("shape.npy"), "{message}");
        let empty = root.path().join("empty");
        std::fs::create_dir(&empty).unwrap();
        assert!(read(&[empty]).unwrap_err().to_string().contains("no poses"));
    }
}
