use std::path::PathBuf;

/// Result of this crate's operations.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Errors of models and their files.
///
/// ```
/// use cape_model::{CapeConfig, Error, weights};
///
/// let directory = tempfile::tempdir()?;
/// let path = directory.path().join("model.safetensors");
/// std::fs::write(&path, "no weights")?;
/// match weights::load(&path) {
///     Err(Error::File { path: file, message }) => {
///         assert_eq!(file, path);
///         assert!(!message.is_empty());
///     }
///     other => panic!("{other:?}"),
/// }
/// assert!(matches!(CapeConfig::preset("large"), Err(Error::Config { .. })));
/// # Ok::<(), std::io::Error>(())
/// ```
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A configuration value is out of range.
    #[error("configuration: `{field}` {message}")]
    Config {
        /// Name of the field.
        field: String,
        /// Value found and values allowed.
        message: String,
    },
    /// The mesh pyramid does not match the configuration.
    #[error("pyramid: {0}")]
    Pyramid(String),
    /// A set of weights does not match the configuration.
    #[error("weights: `{name}`: {message}")]
    Weight {
        /// Name of the parameter.
        name: String,
        /// Value found and value expected.
        message: String,
    },
    /// A mesh or a file was refused.
    #[error(transparent)]
    Core(#[from] cape_core::Error),
    /// The operating system refused to open, read or write a file.
    #[error("{}: {source}", path.display())]
    Io {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// A file has an unexpected content.
    #[error("{}: {message}", path.display())]
    File {
        /// Path of the file.
        path: PathBuf,
        /// Value found and value expected.
        message: String,
    },
}
