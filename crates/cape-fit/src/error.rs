use std::path::Path;

/// Result of a fit or of reading its input.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Errors of fitting.
///
/// ```
/// use cape_fit::{KeypointLayout, Error, Keypoints};
///
/// // No keypoints; the detector has 25.
/// let nothing = Keypoints::new(KeypointLayout::Body25, Vec::new());
/// assert!(matches!(nothing, Err(Error::Observation(message)) if message.contains("25")));
/// ```
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// An error of files, bodies or arguments.
    #[error(transparent)]
    Core(#[from] cape_core::Error),
    /// An error of the trained model or its data.
    #[error(transparent)]
    Infer(#[from] cape_infer::Error),
    /// An error of reading, writing or rendering images.
    #[error(transparent)]
    Render(#[from] cape_render::Error),
    /// The observations do not determine a body; the message has the missing part.
    #[error("{0}")]
    Observation(String),
    /// The optimisation failed; the message has the reason.
    #[error("{0}")]
    Failed(String),
}

impl Error {
    /// An I/O error of `path`.
    pub fn io(path: impl AsRef<Path>, source: std::io::Error) -> Self {
        cape_core::Error::io(path, source).into()
    }

    /// The array, key or entry `field` of the file `path` is invalid.
    pub fn field(
        path: impl AsRef<Path>,
        field: impl Into<String>,
        message: impl Into<String>,
    ) -> Self {
        cape_core::Error::field(path, field, message).into()
    }

    /// The file `path` does not have the expected format.
    pub fn format(path: impl AsRef<Path>, message: impl Into<String>) -> Self {
        cape_core::Error::format(path, message).into()
    }

    /// An argument is out of range.
    pub fn argument(message: impl Into<String>) -> Self {
        cape_core::Error::Argument(message.into()).into()
    }
}
