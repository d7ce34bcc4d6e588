//! Data that are derived from CAPE or like it, in layouts of other projects.

use std::{
    fmt,
    path::{Path, PathBuf},
};

use cape_core::npy::Npz;

use crate::raw;

/// Depth of directories that are searched.
const DEPTH: usize = 3;

/// Layout of another project that is recognised and not packed. Recognition follows public descriptions
/// of the layouts.
///
/// ```
/// use cape_data::ForeignData;
///
/// let directory = tempfile::tempdir()?;
/// std::fs::create_dir_all(directory.path().join("00122_shortlong/Take2/Meshes_pkl"))?;
/// let found = ForeignData::recognise(directory.path());
/// assert_eq!(found, Some(ForeignData::FourDDress));
/// assert!(found.map_or_else(String::new, |data| data.to_string()).contains("cape fit scan"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ForeignData {
    /// Packed point clouds of SCALE and POP, and ReSynth.
    Pop,
    /// Scans with poses of SCANimate.
    Scanimate,
    /// Test set of ICON and ECON: scans with SMPL fits.
    Icon,
    /// Frames of MetaAvatar.
    MetaAvatar,
    /// Scans of 4D-DRESS.
    FourDDress,
}

impl fmt::Display for ForeignData {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Pop => {
                "packed point clouds of SCALE, POP or ReSynth: posed scans without registrations, which \
                 cannot be packed; `cape fit scan --scan FILE.npz --free-displacement` registers one"
            }
            Self::Scanimate => {
                "scans of SCANimate: register them by `cape fit scan --scan FILE.ply \
                 --free-displacement`, then pack the raw tree that it writes"
            }
            Self::Icon => {
                "the CAPE test set of ICON and ECON: scans with SMPL fits; register a scan by `cape fit \
                 scan --scan FILE.obj`, or fit its keypoints and mask by `cape fit image`"
            }
            Self::MetaAvatar => {
                "frames of MetaAvatar, which have no displacements of SMPL's vertices: use the release \
                 of CAPE that they were made from"
            }
            Self::FourDDress => {
                "scans of 4D-DRESS: convert each Meshes_pkl/*.pkl to .ply or .obj and register it by \
                 `cape fit scan --scan FILE --free-displacement`, then pack the raw tree that it writes"
            }
        })
    }
}

impl ForeignData {
    /// The layout of a file or directory; `None` if it is none of these.
    pub fn recognise(path: impl AsRef<Path>) -> Option<Self> {
        let path = path.as_ref();
        if path.is_file() { Self::of_file(path) } else { Self::of_directory(path, DEPTH) }
    }

    fn of_file(path: &Path) -> Option<Self> {
        let archive = path.extension().is_some_and(|extension| extension == "npz");
        let archive = archive.then(|| Npz::open(path).ok())??;
        let has = |name: &str| archive.contains(name);
        let maps = archive.names().iter().any(|name| name.starts_with("posmap"));
        if has("scan_pc") || maps && has("body_verts") {
            return Some(Self::Pop);
        }
        (has("minimal_shape") && has("Jtr")).then_some(Self::MetaAvatar)
    }

    fn of_directory(path: &Path, depth: usize) -> Option<Self> {
        let has = |name: &str| path.join(name).is_dir();
        if has("Meshes_pkl") {
            return Some(Self::FourDDress);
        }
        if has("minimal_body") {
            return Some(Self::Scanimate);
        }
        if has("fits") && (has("scans") || has("cape_3views")) {
            return Some(Self::Icon);
        }
        let frames = raw::frame_files(path).map(|(frames, _)| frames).unwrap_or_default();
        if let Some(found) = frames.first().and_then(|frame| Self::of_file(frame)) {
            return Some(found);
        }
        let directories: Vec<PathBuf> = raw::directories(path).unwrap_or_default();
        // A few, since a tree of something else may be large.
        let few = directories.iter().take(8);
        if depth == 0 {
            None
        } else {
            few.into_iter().find_map(|d| Self::of_directory(d, depth - 1))
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use cape_core::npy::NpzWriter;
    use ndarray::Array2;

    use super::*;

    type Build<'a> = &'a dyn Fn(&Path);

    #[test]
    fn layouts_are_told_by_their_directories_and_arrays() {
        let archive = |path: &Path, names: &[&str]| {
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            let mut file = NpzWriter::create(path).unwrap();
            for name in names {
                file.add(name, &Array2::<f32>::zeros((4, 3))).unwrap();
            }
            file.finish().unwrap();
        };
        let builds: [(Option<ForeignData>, Build); 6] = [
            (Some(ForeignData::Pop), &|root| {
                archive(&root.join("packed/00032_shortlong/train/a.npz"), &["posmap32", "scan_pc"]);
            }),
            (Some(ForeignData::MetaAvatar), &|root| {
                archive(&root.join("00032/longlong_hips/000001.npz"), &["minimal_shape", "Jtr"]);
            }),
            (Some(ForeignData::Scanimate), &|root| {
                fs::create_dir_all(root.join("00032_shortlong/minimal_body")).unwrap();
            }),
            (Some(ForeignData::Icon), &|root| {
                fs::create_dir_all(root.join("cape/fits")).unwrap();
                fs::create_dir_all(root.join("cape/scans")).unwrap();
            }),
            (Some(ForeignData::FourDDress), &|root| {
                fs::create_dir_all(root.join("00122/Inner/Take2/Meshes_pkl")).unwrap();
            }),
            (None, &|root| archive(&root.join("a/b.npz"), &["v_cano", "pose"])),
        ];
        for (expected, build) in builds {
            let root = tempfile::tempdir().unwrap();
            build(root.path());
            assert_eq!(ForeignData::recognise(root.path()), expected);
        }
    }
}
