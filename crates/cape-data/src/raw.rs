//! The release's raw layout: one file a frame, one minimal shape a subject.
//!
//! ```text
//! sequences/<subject>/<outfit>_<sequence>/<frame>.npz    v_cano, v_posed, pose, transl
//! minimal_body_shape/<subject>/<subject>_minimal.npy     [V, 3]
//! ```
//!
//! Beside them, at the root, data that are not the release's own bring their `body.npz`,
//! `clothing_verts_idx.npy` and `split.toml`.

use std::{
    fs,
    path::{Path, PathBuf},
};

use cape_core::{
    Outfit,
    npy::{Npz, NpzWriter, read_f64, write_npy},
};
use ndarray::{Array1, Array2, ArrayD, Ix2};

use crate::{Error, Result};

/// The body the data are registered to, in SMPL's layout.
pub const BODY_FILE: &str = "body.npz";
/// Indices of the vertices that clothing covers.
pub const CLOTHING_FILE: &str = "clothing_verts_idx.npy";
/// How the data are meant to be split.
pub const SPLIT_FILE: &str = "split.toml";

/// One registered frame. Metres and radians.
///
/// ```
/// use cape_core::Outfit;
/// use cape_data::raw;
/// use ndarray::Array2;
///
/// let directory = tempfile::tempdir()?;
/// let frame = raw::RawFrame {
///     v_cano: Array2::from_elem((5, 3), 0.5),
///     v_posed: Array2::from_elem((5, 3), 1.5),
///     pose: [0.0; 72],
///     transl: [0.0, 1.0, 0.0],
/// };
/// let path = raw::write_frame(directory.path(), "anna", Outfit::LongLong, "hips", 1, &frame)?;
/// assert!(path.ends_with("anna/longlong_hips/longlong_hips.000001.npz"));
/// assert_eq!(raw::read_frame(&path, Some(5))?, frame);
///
/// // What displacements need, and the rest where it is there.
/// let (canonical, posed) = raw::read_any(&path)?;
/// assert_eq!(canonical, raw::read_canonical(&path, 5)?);
/// assert_eq!(posed, Some((frame.v_posed, frame.transl)));
/// assert!(raw::read_frame(&path, Some(6890)).is_err());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct RawFrame {
    /// Clothed vertices, unposed, `[V, 3]`.
    pub v_cano: Array2<f64>,
    /// Clothed vertices, posed, `[V, 3]`.
    pub v_posed: Array2<f64>,
    /// Axis-angle rotations of 24 joints, `[72]`.
    pub pose: [f64; 72],
    /// Translation of the posed body, `[3]`.
    pub transl: [f64; 3],
}

/// The part of a frame that displacements come from.
#[derive(Debug, Clone, PartialEq)]
pub struct CanonicalFrame {
    /// Clothed vertices, unposed, `[V, 3]`.
    pub v_cano: Array2<f64>,
    /// Axis-angle rotations of 24 joints, `[72]`.
    pub pose: [f64; 72],
}

/// Posed vertices `[V, 3]` and the body's translation, metres.
pub type PosedVertices = (Array2<f64>, [f64; 3]);

/// Directory of one capture: a subject in an outfit performing a sequence.
pub fn capture_dir(root: &Path, subject: &str, outfit: Outfit, sequence: &str) -> PathBuf {
    root.join("sequences").join(subject).join(format!("{outfit}_{sequence}"))
}

/// File of a subject's minimal shape.
pub fn minimal_path(root: &Path, subject: &str) -> PathBuf {
    root.join("minimal_body_shape").join(subject).join(format!("{subject}_minimal.npy"))
}

/// The directories in one, by name, without hidden ones.
pub fn directories(path: &Path) -> Result<Vec<PathBuf>> {
    let fail = |error| Error::io(path, error);
    let mut found = Vec::new();
    for entry in fs::read_dir(path).map_err(fail)? {
        let path = entry.map_err(fail)?.path();
        if path.is_dir() && !name_of(&path).starts_with('.') {
            found.push(path);
        }
    }
    found.sort_unstable();
    Ok(found)
}

/// The last part of a path.
pub fn name_of(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// The frames of a capture, by name; `None` if there is no such capture.
pub fn frame_paths(directory: &Path) -> Result<Option<Vec<PathBuf>>> {
    if !directory.is_dir() {
        return Ok(None);
    }
    let fail = |e| Error::io(directory, e);
    let mut paths = Vec::new();
    for entry in fs::read_dir(directory).map_err(fail)? {
        let path = entry.map_err(fail)?.path();
        // Names that start with a dot are what file managers and archivers leave behind.
        let hidden = path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'));
        if path.extension().is_some_and(|extension| extension == "npz") && !hidden {
            paths.push(path);
        }
    }
    paths.sort_unstable();
    Ok(Some(paths))
}

/// Refuses a file that a link brings in from outside of `root`: an archive from elsewhere could
/// name any file of the machine so.
pub fn require_inside(root: &Path, path: &Path) -> Result<()> {
    let whole = |path: &Path| fs::canonicalize(path).map_err(|source| Error::io(path, source));
    let target = whole(path)?;
    if target.starts_with(whole(root)?) {
        return Ok(());
    }
    let message = format!("links to {}, outside of {}", target.display(), root.display());
    Err(Error::format(path, message))
}

/// Reads a subject's minimal shape, metres, `[V, 3]`.
pub fn read_minimal(root: &Path, subject: &str) -> Result<Array2<f64>> {
    let path = minimal_path(root, subject);
    vertices(&path, "minimal shape", read_f64(&path)?, None)
}

/// Reads a frame of `vertices` vertices (any number if `None`).
pub fn read_frame(path: &Path, vertex_count: Option<usize>) -> Result<RawFrame> {
    let mut file = Npz::open(path)?;
    let CanonicalFrame { v_cano, pose } = canonical(path, &mut file, vertex_count)?;
    let (v_posed, transl) = posed(path, &mut file, v_cano.nrows())?;
    Ok(RawFrame { v_cano, v_posed, pose, transl })
}

/// Reads a posed frame of `vertex_count` vertices whose canonical vertices are not known yet, and
/// are left empty; a missing translation is zero.
pub fn read_posed(path: &Path, vertex_count: usize) -> Result<RawFrame> {
    let mut file = Npz::open(path)?;
    let v_posed = vertices(path, "v_posed", file.f64("v_posed")?, Some(vertex_count))?;
    let pose = numbers(path, "pose", &file.f64("pose")?)?;
    let transl = if file.contains("transl") {
        numbers(path, "transl", &file.f64("transl")?)?
    } else {
        [0.0; 3]
    };
    Ok(RawFrame { v_cano: Array2::zeros((0, 3)), v_posed, pose, transl })
}

/// Reads what displacements need of a frame, and the rest where it is there.
pub fn read_any(path: &Path) -> Result<(CanonicalFrame, Option<PosedVertices>)> {
    let mut file = Npz::open(path)?;
    let frame = canonical(path, &mut file, None)?;
    let posed = posed(path, &mut file, frame.v_cano.nrows()).ok();
    Ok((frame, posed))
}

/// Posed vertices and translation.
fn posed(path: &Path, file: &mut Npz, count: usize) -> Result<PosedVertices> {
    let v_posed = vertices(path, "v_posed", file.f64("v_posed")?, Some(count))?;
    Ok((v_posed, numbers(path, "transl", &file.f64("transl")?)?))
}

/// Reads what displacements need of a frame of `vertices` vertices; the rest may be missing.
pub fn read_canonical(path: &Path, vertex_count: usize) -> Result<CanonicalFrame> {
    canonical(path, &mut Npz::open(path)?, Some(vertex_count))
}

fn canonical(path: &Path, file: &mut Npz, count: Option<usize>) -> Result<CanonicalFrame> {
    let v_cano = vertices(path, "v_cano", file.f64("v_cano")?, count)?;
    let pose = numbers(path, "pose", &file.f64("pose")?)?;
    Ok(CanonicalFrame { v_cano, pose })
}

fn vertices(
    path: &Path,
    field: &str,
    array: ArrayD<f64>,
    count: Option<usize>,
) -> Result<Array2<f64>> {
    let agrees = |found: &[usize]| match (found, count) {
        ([n, 3], Some(count)) => *n == count,
        ([n, 3], None) => *n > 0,
        _ => false,
    };
    if !agrees(array.shape()) {
        let expected = count.map_or("vertices".to_owned(), |n| n.to_string());
        let message = format!("shape {:?}, expected [{expected}, 3]", array.shape());
        return Err(Error::field(path, field, message));
    }
    if let Some(at) = array.iter().position(|x| !x.is_finite()) {
        let coordinate = ["x", "y", "z"][at % 3];
        let message = format!("vertex {} has a {coordinate} that is not finite", at / 3);
        return Err(Error::field(path, field, message));
    }
    array.into_dimensionality::<Ix2>().map_err(|e| Error::field(path, field, e.to_string()))
}

fn numbers<const N: usize>(path: &Path, field: &str, array: &ArrayD<f64>) -> Result<[f64; N]> {
    if let Some(at) = array.iter().position(|x| !x.is_finite()) {
        return Err(Error::field(path, field, format!("number {at} is not finite")));
    }
    match array.as_slice().map(<[f64; N]>::try_from) {
        Some(Ok(numbers)) if array.ndim() == 1 => Ok(numbers),
        _ => {
            let message = format!("shape {:?}, expected [{N}]", array.shape());
            Err(Error::field(path, field, message))
        }
    }
}

/// Writes a subject's minimal shape, metres, `[V, 3]`.
pub fn write_minimal(root: &Path, subject: &str, vertices: &Array2<f64>) -> Result<()> {
    let path = minimal_path(root, subject);
    create_parent(&path)?;
    Ok(write_npy(&path, vertices)?)
}

/// Writes frame `number` of a capture as `<outfit>_<sequence>.<number, six digits>.npz` and
/// returns its path.
pub fn write_frame(
    root: &Path,
    subject: &str,
    outfit: Outfit,
    sequence: &str,
    number: usize,
    frame: &RawFrame,
) -> Result<PathBuf> {
    let directory = capture_dir(root, subject, outfit, sequence);
    let path = directory.join(format!("{outfit}_{sequence}.{number:06}.npz"));
    write_frame_at(&path, frame)?;
    Ok(path)
}

/// Writes a frame as that file.
pub fn write_frame_at(path: &Path, frame: &RawFrame) -> Result<()> {
    create_parent(path)?;
    let mut file = NpzWriter::create(path)?;
    file.add("v_cano", &frame.v_cano)?;
    file.add("v_posed", &frame.v_posed)?;
    file.add("pose", &Array1::from_iter(frame.pose))?;
    file.add("transl", &Array1::from_iter(frame.transl))?;
    Ok(file.finish()?)
}

fn create_parent(path: &Path) -> Result<()> {
    match path.parent() {
        Some(parent) => fs::create_dir_all(parent).map_err(|e| Error::io(parent, e)),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use ndarray::array;

    use super::*;

    fn frame() -> RawFrame {
        RawFrame {
            v_cano: array![[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]],
            v_posed: array![[0.5, 1.0, 2.0], [3.0, 4.0, -5.0]],
            pose: std::array::from_fn(|i| i as f64 * 0.01),
            transl: [1.0, 2.0, 3.0],
        }
    }

    fn read_written(frame: &RawFrame) -> (tempfile::TempDir, PathBuf) {
        let root = tempfile::tempdir().unwrap();
        let path = write_frame(root.path(), "a", Outfit::LongLong, "walk", 7, frame).unwrap();
        (root, path)
    }

    #[test]
    fn the_layout_is_the_releases() {
        let (root, path) = read_written(&frame());
        assert_eq!(
            path.strip_prefix(root.path()).unwrap(),
            Path::new("sequences/a/longlong_walk/longlong_walk.000007.npz")
        );
        assert_eq!(read_frame(&path, Some(2)).unwrap(), frame());
        assert_eq!(read_frame(&path, None).unwrap(), frame());
        assert_eq!(read_canonical(&path, 2).unwrap().pose, frame().pose);
        let directory = capture_dir(root.path(), "a", Outfit::LongLong, "walk");
        fs::write(directory.join("._longlong_walk.000008.npz"), "x").unwrap();
        fs::write(directory.join("notes.txt"), "x").unwrap();
        let early = write_frame(root.path(), "a", Outfit::LongLong, "walk", 3, &frame()).unwrap();
        assert_eq!(frame_paths(&directory).unwrap().unwrap(), [early, path]);
        assert!(frame_paths(&root.path().join("none")).unwrap().is_none());
        write_minimal(root.path(), "a", &frame().v_cano).unwrap();
        assert!(root.path().join("minimal_body_shape/a/a_minimal.npy").is_file());
        assert_eq!(read_minimal(root.path(), "a").unwrap(), frame().v_cano);
    }

    #[test]
    fn bad_frames_are_named() {
        let check = |change: &dyn Fn(&mut RawFrame), expected: &str| {
            let mut bad = frame();
            change(&mut bad);
            let (_root, path) = read_written(&bad);
            let message = read_frame(&path, Some(2)).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
            assert!(message.contains("longlong_walk.000007.npz"), "{message}");
        };
        check(&|f| f.v_cano[[1, 2]] = f64::NAN, "`v_cano`: vertex 1 has a z");
        check(&|f| f.v_posed[[0, 1]] = f64::INFINITY, "`v_posed`: vertex 0 has a y");
        check(&|f| f.pose[30] = f64::NAN, "`pose`: number 30");
        check(&|f| f.transl[2] = f64::NEG_INFINITY, "`transl`: number 2");
        check(&|f| f.v_cano = Array2::zeros((3, 3)), "`v_cano`: shape [3, 3], expected [2, 3]");
        check(&|f| f.v_posed = Array2::zeros((2, 2)), "`v_posed`: shape [2, 2]");
        let (_root, path) = read_written(&RawFrame { v_cano: Array2::zeros((0, 3)), ..frame() });
        assert!(read_frame(&path, None).unwrap_err().to_string().contains("[vertices, 3]"));
    }

    #[test]
    fn missing_and_truncated_files_are_errors() {
        let (_root, path) = read_written(&frame());
        let bytes = fs::read(&path).unwrap();
        for length in [0, 10, bytes.len() / 2, bytes.len() - 1] {
            fs::write(&path, &bytes[..length]).unwrap();
            assert!(read_frame(&path, Some(2)).is_err(), "{length} bytes");
        }
        let mut file = NpzWriter::create(&path).unwrap();
        file.add("v_cano", &frame().v_cano).unwrap();
        file.finish().unwrap();
        assert!(read_frame(&path, None).unwrap_err().to_string().contains("pose"));
        assert!(read_minimal(Path::new("/nonexistent"), "a").is_err());
    }
}
