/// Result of this crate's operations.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What can go wrong with clothing layers.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use cape_layer::{AssociateOptions, Error};
///
/// // The clothing is further away than the rays reach.
/// let apart = AssociateOptions::default().associate(&octahedron(0.1), &octahedron(2.0));
/// assert!(matches!(apart, Err(Error::NoHits { rays: 6, .. })));
/// # Ok(())
/// # }
/// ```
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file, mesh, body or argument is not what it must be.
    #[error(transparent)]
    Core(#[from] cape_core::Error),
    /// An argument is out of its domain; the message names it, its value and what was expected.
    #[error("{0}")]
    Argument(String),
    /// A mesh is unusable; the message names the element and the remedy.
    #[error("{mesh}: {message}")]
    Mesh {
        /// Which mesh: the body, the clothing, a garment.
        mesh: &'static str,
        /// What was found, and what would help.
        message: String,
    },
    /// No ray from the body met the clothing.
    #[error(
        "association: none of {rays} rays from the body met the clothing within {reach} m: are \
         both in metres, in the same frame and place?"
    )]
    NoHits {
        /// Rays cast.
        rays: usize,
        /// Their length, metres.
        reach: f64,
    },
    /// More rays met the clothing when cast into the body than when cast out of it.
    #[error(
        "association: {ahead} rays met the clothing along the body's normals and {behind} against \
         them: the body's faces are flipped, or the clothing is inside the body"
    )]
    FlippedBody {
        /// Hits along the normals.
        ahead: usize,
        /// Hits against the normals.
        behind: usize,
    },
    /// A blend of transforms cannot be undone.
    #[error(
        "clothing vertex {vertex} cannot be unposed: its blended transform is nearly singular \
         (determinant {determinant:.2e}): use fewer body vertices for each clothing vertex"
    )]
    Singular {
        /// The clothing vertex.
        vertex: usize,
        /// Determinant of its blended rotation, 1 for a rigid motion.
        determinant: f64,
    },
    /// A sequence does not fit its set, or its own parts do not fit together.
    #[error("sequence `{name}`: {message}")]
    Sequence {
        /// The sequence's name.
        name: String,
        /// What was found, and what was expected.
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
