use std::path::PathBuf;

/// Result of this crate's operations.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What can go wrong with meshes, their pyramids and the pyramids' files.
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
        /// How many vertices it has.
        vertices: usize,
    },
    /// A mesh has fewer than four vertices.
    #[error("mesh: {vertices} vertices: at least 4 are needed")]
    TooFewVertices {
        /// How many vertices it has.
        vertices: usize,
    },
    /// A vertex coordinate is NaN or infinite.
    #[error("mesh: vertex {vertex} is at {position:?}: every coordinate must be finite")]
    NonFinite {
        /// The vertex.
        vertex: usize,
        /// Where it is.
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
        /// How many vertices there are.
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
        /// How many there are.
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
    /// A factor asks for fewer than four vertices.
    #[error(
        "pyramid: simplifying {vertices} vertices to {target}: a level needs at least 4, use fewer \
         levels or smaller factors"
    )]
    Target {
        /// Vertices before.
        vertices: usize,
        /// Vertices asked for.
        target: usize,
    },
    /// Simplification ran out of edges, or the surface vanished, before the target.
    #[error(
        "pyramid: simplifying {vertices} vertices to {target} left {reached} vertices and {faces} \
         faces: small separate pieces vanish before large ones shrink; remove them or use smaller \
         factors"
    )]
    Collapsed {
        /// Vertices before.
        vertices: usize,
        /// Vertices asked for.
        target: usize,
        /// Vertices left.
        reached: usize,
        /// Faces left.
        faces: usize,
    },
    /// A given matrix or list does not fit the others.
    #[error("pyramid: `{name}`: {message}")]
    Part {
        /// The matrix or list, with its level (`A0`, `D2`, `faces 3`).
        name: String,
        /// What was found, and what was expected.
        message: String,
    },
    /// A file cannot be read or written, or is not what it must be.
    #[error(transparent)]
    File(#[from] cape_core::Error),
    /// A directory cannot be made.
    #[error("{}: {source}", path.display())]
    Directory {
        /// The directory.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
}

impl Error {
    pub(crate) fn part(name: impl Into<String>, message: impl Into<String>) -> Self {
        Self::Part { name: name.into(), message: message.into() }
    }
}
