//! Raw layout of the release: one file per frame, one minimal shape per subject.
//!
//! ```text
//! sequences/<subject>/<outfit>_<sequence>/<frame>.npz    v_cano, v_posed, pose, transl
//! minimal_body_shape/<subject>/<subject>_minimal.npy     [V, 3]
//! ```
//!
//! Data of other sources have `body.npz`, `clothing_verts_idx.npy` and `split.toml` at the root, or with
//! bodies by gender `body_male.npz`, `split_male.toml`, `body_female.npz` and `split_female.toml`.

use std::{
    fs,
    path::{Path, PathBuf},
    time::UNIX_EPOCH,
};

pub use cape_core::smpl::BODY_FILE;
use cape_core::{
    Outfit, list_files,
    npy::{Npz, NpzWriter, read_f64, write_npy},
    smpl::Gender,
};
use ndarray::{Array1, Array2, ArrayD, Ix2};

use crate::{Error, Result};

/// File name of the indices of clothing vertices.
pub const CLOTHING_FILE: &str = "clothing_verts_idx.npy";
/// File name of the split.
pub const SPLIT_FILE: &str = "split.toml";

/// File name of the split of the subjects of a gender, in data that have both.
pub const fn gender_split_file(gender: Gender) -> &'static str {
    match gender {
        Gender::Male => "split_male.toml",
        Gender::Female => "split_female.toml",
        Gender::Neutral => "split_neutral.toml",
    }
}

/// Registered frame, in metres and radians.
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
/// let path = raw::write_frame(directory.path(), "anna", Outfit::LONG_LONG, "hips", 1, &frame)?;
/// assert!(path.ends_with("anna/longlong_hips/longlong_hips.000001.npz"));
/// assert_eq!(raw::read_frame(&path, Some(5))?, frame);
///
/// // The canonical part, and the posed part if it is there.
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
    /// Translation of the posed body, `[3]`, metres.
    pub transl: [f64; 3],
}

/// Canonical part of a frame, from which displacements are computed.
#[derive(Debug, Clone, PartialEq)]
pub struct CanonicalFrame {
    /// Clothed vertices, unposed, `[V, 3]`.
    pub v_cano: Array2<f64>,
    /// Axis-angle rotations of 24 joints, `[72]`.
    pub pose: [f64; 72],
}

/// Posed vertices `[V, 3]` and the body's translation, metres.
pub type PosedVertices = (Array2<f64>, [f64; 3]);

/// Directory of a capture: a subject performing a sequence in an outfit.
pub fn capture_dir(
    root: impl AsRef<Path>,
    subject: &str,
    outfit: Outfit,
    sequence: &str,
) -> PathBuf {
    let root = root.as_ref();
    root.join("sequences").join(subject).join(format!("{outfit}_{sequence}"))
}

/// File of the minimal shape of a subject.
pub fn minimal_path(root: impl AsRef<Path>, subject: &str) -> PathBuf {
    let root = root.as_ref();
    root.join("minimal_body_shape").join(subject).join(format!("{subject}_minimal.npy"))
}

/// Directories in `path`, sorted by name, without hidden ones and those of archivers.
pub fn directories(path: impl AsRef<Path>) -> Result<Vec<PathBuf>> {
    let path = path.as_ref();
    let fail = |error| Error::io(path, error);
    let mut found = Vec::new();
    for entry in fs::read_dir(path).map_err(fail)? {
        let path = entry.map_err(fail)?.path();
        let name = name_of(&path);
        if path.is_dir() && !name.starts_with('.') && name != "__MACOSX" {
            found.push(path);
        }
    }
    found.sort_unstable();
    Ok(found)
}

/// Last component of a path.
pub fn name_of(path: impl AsRef<Path>) -> String {
    let path = path.as_ref();
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Files of the frames of a capture, in natural order of their names, without hidden ones; `None` if the directory does not exist.
pub fn frame_paths(directory: impl AsRef<Path>) -> Result<Option<Vec<PathBuf>>> {
    let directory = directory.as_ref();
    if !directory.is_dir() {
        return Ok(None);
    }
    Ok(Some(frame_files(directory)?.0))
}

/// Files of the frames of a directory, and names of files that begin like frames but do not end with
/// `.npz`, in natural order.
pub(crate) fn frame_files(directory: &Path) -> Result<(Vec<PathBuf>, Vec<String>)> {
    let frames = list_files(directory, |path: &Path| is_frame_name(&name_of(path)))?;
    let misnamed = list_files(directory, |path: &Path| is_misnamed_frame(&name_of(path)))?;
    Ok((frames, misnamed.iter().map(name_of).collect()))
}

/// True for the name of a frame's file.
pub(crate) fn is_frame_name(name: &str) -> bool {
    Path::new(name).extension().is_some_and(|extension| extension == "npz")
}

/// True for a name that continues behind `.npz`, as interrupted writes of NumPy leave it.
pub(crate) fn is_misnamed_frame(name: &str) -> bool {
    name.contains(".npz") && !is_frame_name(name)
}

/// Size of a file, and the time of its last change, nanoseconds.
pub(crate) fn file_identity(path: &Path) -> Result<[u64; 2]> {
    let metadata = fs::metadata(path).map_err(|source| Error::io(path, source))?;
    let since = metadata.modified().ok().and_then(|time| time.duration_since(UNIX_EPOCH).ok());
    Ok([metadata.len(), since.map_or(0, |since| since.as_nanos() as u64)])
}

/// Checks that `path` does not link to a file outside `root`, as an untrusted archive could.
///
/// # Errors
/// If it does, or does not exist.
pub fn require_inside(root: impl AsRef<Path>, path: impl AsRef<Path>) -> Result<()> {
    let (root, path) = (root.as_ref(), path.as_ref());
    let whole = |path: &Path| fs::canonicalize(path).map_err(|source| Error::io(path, source));
    let target = whole(path)?;
    if target.starts_with(whole(root)?) {
        return Ok(());
    }
    let message = format!("links to {}, outside of {}", target.display(), root.display());
    Err(Error::format(path, message))
}

/// Reads the minimal shape of a subject, `[V, 3]`, metres.
pub fn read_minimal(root: impl AsRef<Path>, subject: &str) -> Result<Array2<f64>> {
    let root = root.as_ref();
    let path = minimal_path(root, subject);
    minimal_vertices(&path, read_f64(&path)?)
}

/// Checks the vertices of a minimal shape.
pub(crate) fn minimal_vertices(path: &Path, array: ArrayD<f64>) -> Result<Array2<f64>> {
    vertices(path, "minimal shape", array, None)
}

/// Reads a frame of `vertex_count` vertices; `None` is any number.
pub fn read_frame(path: impl AsRef<Path>, vertex_count: Option<usize>) -> Result<RawFrame> {
    let path = path.as_ref();
    frame_from(path, &mut Npz::open(path)?, vertex_count)
}

pub(crate) fn frame_from(path: &Path, file: &mut Npz, count: Option<usize>) -> Result<RawFrame> {
    let CanonicalFrame { v_cano, pose } = canonical(path, file, count)?;
    let (v_posed, transl) = posed(path, file, v_cano.nrows())?;
    Ok(RawFrame { v_cano, v_posed, pose, transl })
}

/// Reads the posed part of a frame of `vertex_count` vertices; canonical vertices are empty, and a
/// missing translation is zero.
pub fn read_posed(path: impl AsRef<Path>, vertex_count: usize) -> Result<RawFrame> {
    let path = path.as_ref();
    posed_from(path, &mut Npz::open(path)?, vertex_count)
}

pub(crate) fn posed_from(path: &Path, file: &mut Npz, count: usize) -> Result<RawFrame> {
    let v_posed = vertices(path, "v_posed", file.f64("v_posed")?, Some(count))?;
    let pose = numbers(path, "pose", &file.f64("pose")?)?;
    let transl = if file.contains("transl") {
        numbers(path, "transl", &file.f64("transl")?)?
    } else {
        [0.0; 3]
    };
    Ok(RawFrame { v_cano: Array2::zeros((0, 3)), v_posed, pose, transl })
}

/// Reads the canonical part of a frame, and the posed part if it is there.
pub fn read_any(path: impl AsRef<Path>) -> Result<(CanonicalFrame, Option<PosedVertices>)> {
    let path = path.as_ref();
    any_from(path, &mut Npz::open(path)?)
}

pub(crate) fn any_from(
    path: &Path,
    file: &mut Npz,
) -> Result<(CanonicalFrame, Option<PosedVertices>)> {
    let frame = canonical(path, file, None)?;
    let posed = posed(path, file, frame.v_cano.nrows()).ok();
    Ok((frame, posed))
}

/// Reads posed vertices and translation.
fn posed(path: &Path, file: &mut Npz, count: usize) -> Result<PosedVertices> {
    let v_posed = vertices(path, "v_posed", file.f64("v_posed")?, Some(count))?;
    Ok((v_posed, numbers(path, "transl", &file.f64("transl")?)?))
}

/// Reads the canonical part of a frame of `vertex_count` vertices.
pub fn read_canonical(path: impl AsRef<Path>, vertex_count: usize) -> Result<CanonicalFrame> {
    let path = path.as_ref();
    canonical(path, &mut Npz::open(path)?, Some(vertex_count))
}

pub(crate) fn canonical(
    path: &Path,
    file: &mut Npz,
    count: Option<usize>,
) -> Result<CanonicalFrame> {
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

/// Writes the minimal shape of a subject, `[V, 3]`, metres.
pub fn write_minimal(root: impl AsRef<Path>, subject: &str, vertices: &Array2<f64>) -> Result<()> {
    let root = root.as_ref();
    let path = minimal_path(root, subject);
    create_parent(&path)?;
    write_npy(&path, vertices)
}

/// Writes frame `number` of a capture as `<outfit>_<sequence>.<number, six digits>.npz`; returns
/// the path.
pub fn write_frame(
    root: impl AsRef<Path>,
    subject: &str,
    outfit: Outfit,
    sequence: &str,
    number: usize,
    frame: &RawFrame,
) -> Result<PathBuf> {
    let root = root.as_ref();
    let directory = capture_dir(root, subject, outfit, sequence);
    let path = directory.join(format!("{outfit}_{sequence}.{number:06}.npz"));
    write_frame_at(&path, frame)?;
    Ok(path)
}

/// Writes a frame to the file `path`.
pub fn write_frame_at(path: impl AsRef<Path>, frame: &RawFrame) -> Result<()> {
    let path = path.as_ref();
    create_parent(path)?;
    let mut file = NpzWriter::create(path)?;
    file.add("v_cano", &frame.v_cano)?;
    file.add("v_posed", &frame.v_posed)?;
    file.add("pose", &Array1::from_iter(frame.pose))?;
    file.add("transl", &Array1::from_iter(frame.transl))?;
    file.finish()
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
        let path = write_frame(root.path(), "a", Outfit::LONG_LONG, "walk", 7, frame).unwrap();
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
        let directory = capture_dir(root.path(), "a", Outfit::LONG_LONG, "walk");
        fs::write(directory.join("._longlong_walk.000008.npz"), "x").unwrap();
        fs::write(directory.join("notes.txt"), "x").unwrap();
        let early = write_frame(root.path(), "a", Outfit::LONG_LONG, "walk", 3, &frame()).unwrap();
        assert_eq!(frame_paths(&directory).unwrap().unwrap(), [early, path]);
        assert!(frame_paths(root.path().join("none")).unwrap().is_none());
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
