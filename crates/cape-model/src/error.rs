use std::path::PathBuf;

/// Result of this crate's operations.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What can go wrong with models and their files.
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
    /// A configuration value is out of its domain.
    #[error("configuration: `{field}` {message}")]
    Config {
        /// The field.
        field: String,
        /// What is wrong with it.
        message: String,
    },
    /// The mesh pyramid does not suit the configuration.
    #[error("pyramid: {0}")]
    Pyramid(String),
    /// A set of weights does not suit the configuration.
    #[error("weights: `{name}`: {message}")]
    Weight {
        /// The parameter.
        name: String,
        /// What was found, and what was expected.
        message: String,
    },
    /// A mesh or a file was refused.
    #[error(transparent)]
    Core(#[from] cape_core::Error),
    /// The operating system refused to open, read or write a file.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A file's contents are not what they must be.
    #[error("{}: {message}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What was found, and what was expected.
        message: String,
    },
}
