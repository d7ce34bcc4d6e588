/// Result of this crate's operations.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What can go wrong when drawing.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A picture cannot be read or written.
    #[error(transparent)]
    File(#[from] cape_core::Error),
    /// What is to be drawn is unusable; the message names the element and what was expected.
    #[error("{0}")]
    Argument(String),
}
