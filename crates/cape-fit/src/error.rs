use std::path::Path;

/// Result of this crate's operations.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What can go wrong when a body is fitted.
///
/// ```
/// use cape_fit::{Detector, Error, Keypoints};
///
/// // No keypoint, where the detector has 25.
/// let nothing = Keypoints::new(Detector::Body25, Vec::new());
/// assert!(matches!(nothing, Err(Error::Observation(message)) if message.contains("25")));
/// ```
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file, body or argument is not what it must be.
    #[error(transparent)]
    Core(#[from] cape_core::Error),
    /// A trained model cannot be used.
    #[error(transparent)]
    Train(#[from] cape_infer::Error),
    /// A picture cannot be read, written or drawn.
    #[error(transparent)]
    Render(#[from] cape_render::Error),
    /// What was observed does not determine a body; the message says what is missing.
    #[error("{0}")]
    Observation(String),
    /// The fit went nowhere; the message says why.
    #[error("{0}")]
    Failed(String),
}

impl Error {
    /// The operating system refused to open, read or write `path`.
    pub fn io(path: impl AsRef<Path>, source: std::io::Error) -> Self {
        cape_core::Error::io(path, source).into()
    }

    /// The array, key or entry `field` of `path` is not what it must be.
    pub fn field(
        path: impl AsRef<Path>,
        field: impl Into<String>,
        message: impl Into<String>,
    ) -> Self {
        cape_core::Error::field(path, field, message).into()
    }

    /// `path` as a whole is not of the expected format.
    pub fn format(path: impl AsRef<Path>, message: impl Into<String>) -> Self {
        cape_core::Error::format(path, message).into()
    }

    /// An argument is out of its domain.
    pub fn argument(message: impl Into<String>) -> Self {
        cape_core::Error::Argument(message.into()).into()
    }
}
