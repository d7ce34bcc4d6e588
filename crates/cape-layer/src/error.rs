/// Result of an operation on clothing layers.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Errors of clothing layers.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use cape_layer::{AssociateOptions, Error};
///
/// // The clothing is beyond the reach of the rays.
/// let apart = AssociateOptions::default().associate(&octahedron(0.1), &octahedron(2.0));
/// assert!(matches!(apart, Err(Error::NoHits { rays: 6, .. })));
/// # Ok(())
/// # }
/// ```
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// An error of files, meshes, bodies or statistics.
    #[error(transparent)]
    Core(#[from] cape_core::Error),
    /// An argument is out of range; the message has its name, its value and the expected range.
    #[error("{0}")]
    Argument(String),
    /// No ray from the body hit the clothing.
    #[error(
        "association: none of {rays} rays from the body hit the clothing within {reach} m: check \
         that both meshes are in metres and in the same coordinate frame"
    )]
    NoHits {
        /// Number of rays.
        rays: usize,
        /// Length of the rays, metres.
        reach: f64,
    },
    /// More rays hit the clothing against the body's outward normals than along them.
    #[error(
        "association: {ahead} rays hit the clothing along the body's normals and {behind} against \
         them: reverse the body's faces, or move the clothing out of the body"
    )]
    FlippedBody {
        /// Hits along the normals.
        ahead: usize,
        /// Hits against the normals.
        behind: usize,
    },
    /// A blended transform (eq. 3) has no inverse.
    #[error(
        "clothing vertex {vertex} cannot be unposed: its blended transform is nearly singular \
         (determinant {determinant:.2e}): use fewer body vertices for each clothing vertex"
    )]
    Singular {
        /// Index of the clothing vertex.
        vertex: usize,
        /// Determinant of the blended linear part; 1 for a rigid motion.
        determinant: f64,
    },
    /// A sequence is inconsistent, with its set or in itself.
    #[error("sequence `{name}`: {message}")]
    Sequence {
        /// Name of the sequence.
        name: String,
        /// The field, its value and the expected one.
        message: String,
    },
}

impl Error {
    pub(crate) fn argument(message: impl Into<String>) -> Self {
        Self::Argument(message.into())
    }

    pub(crate) fn sequence(name: &str, message: impl Into<String>) -> Self {
        Self::Sequence { name: name.to_owned(), message: message.into() }
    }
}
