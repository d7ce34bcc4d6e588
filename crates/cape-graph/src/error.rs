use std::path::PathBuf;

/// Result of this crate's operations.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Error of meshes, pyramids and files of pyramids.
///
/// ```
/// use cape_graph::{Error, MeshPyramid, Surface, Weighting};
///
/// let surface = Surface { vertices: vec![[0.0; 3]; 4], faces: vec![[0, 1, 9]] };
/// match MeshPyramid::build(surface, &[2.0], Weighting::Barycentric) {
///     Err(Error::FaceOutOfRange { face, vertex, .. }) => assert_eq!((face, vertex), (0, 9)),
///     other => panic!("{other:?}"),
/// }
///
/// let directory = tempfile::tempdir()?;
/// let path = directory.path().join("pyramid.npz");
/// std::fs::write(&path, "no archive")?;
/// let Err(Error::File(reason)) = MeshPyramid::load(&path) else { panic!("a text was read") };
/// assert!(reason.to_string().contains("pyramid.npz"));
/// # Ok::<(), std::io::Error>(())
/// ```
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A mesh has no faces.
    #[error("mesh: no faces ({vertices} vertices): a triangle mesh is needed, not a point cloud")]
    NoFaces {
        /// Number of vertices.
        vertices: usize,
    },
    /// A mesh has fewer than four vertices.
    #[error("mesh: {vertices} vertices: at least 4 are needed")]
    TooFewVertices {
        /// Number of vertices.
        vertices: usize,
    },
    /// A vertex coordinate is NaN or infinite.
    #[error("mesh: vertex {vertex} is at {position:?}: every coordinate must be finite")]
    NonFinite {
        /// The vertex.
        vertex: usize,
        /// Its position, metres.
        position: [f64; 3],
    },
    /// A face names a vertex that does not exist.
    #[error(
        "mesh: face {face} uses vertex {vertex}, but there are only {vertices} (indices start at 0)"
    )]
    FaceOutOfRange {
        /// The face.
        face: usize,
        /// The vertex it names.
        vertex: u32,
        /// Number of vertices.
        vertices: usize,
    },
    /// A face repeats a vertex or has no area.
    #[error(
        "mesh: face {face} {corners:?} repeats a vertex or has no area: remove it, or merge the \
         vertices that coincide"
    )]
    DegenerateFace {
        /// The face.
        face: usize,
        /// Its vertices.
        corners: [u32; 3],
    },
    /// Vertices that no face uses.
    #[error(
        "mesh: {count} vertices belong to no face, the first is {vertex}: remove them or add their \
         faces"
    )]
    IsolatedVertex {
        /// The first such vertex.
        vertex: usize,
        /// Number of such vertices.
        count: usize,
    },
    /// A simplification factor is not a finite number of at least 1.
    #[error(
        "pyramid: factor {index} is {value}: every factor must be finite and at least 1 (1 keeps \
         the level as it is)"
    )]
    Factor {
        /// Its position in the list.
        index: usize,
        /// Its value.
        value: f64,
    },
    /// A factor leads to fewer than four vertices.
    #[error(
        "pyramid: simplifying {vertices} vertices to {target}: a level needs at least 4, use fewer \
         levels or smaller factors"
    )]
    Target {
        /// Number of vertices before.
        vertices: usize,
        /// Requested number of vertices.
        target: usize,
    },
    /// No edges or no faces were left before simplification reached its target.
    #[error(
        "pyramid: simplifying {vertices} vertices to {target} left {reached} vertices and {faces} \
         faces: small separate components vanish before large ones are simplified; remove them or \
         use smaller factors"
    )]
    Collapsed {
        /// Number of vertices before.
        vertices: usize,
        /// Requested number of vertices.
        target: usize,
        /// Number of remaining vertices.
        reached: usize,
        /// Number of remaining faces.
        faces: usize,
    },
    /// A matrix or list is invalid or does not fit the others.
    #[error("pyramid: `{name}`: {message}")]
    Part {
        /// The matrix or list, with its level (`A0`, `D2`, `faces 3`).
        name: String,
        /// Found and expected content.
        message: String,
    },
    /// A file cannot be read or written, or has unexpected content.
    #[error(transparent)]
    File(#[from] cape_core::Error),
    /// A directory cannot be created.
    #[error("cannot create directory {}: {source}", path.display())]
    Directory {
        /// The directory.
        path: PathBuf,
        /// Cause reported by the system.
        source: std::io::Error,
    },
}

impl Error {
    pub(crate) fn part(name: impl Into<String>, message: impl Into<String>) -> Self {
        Self::Part { name: name.into(), message: message.into() }
    }
}
