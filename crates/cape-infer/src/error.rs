use std::path::Path;

/// Result of this crate's operations.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Errors of models, training runs and their files.
///
/// ```
/// use cape_infer::RunConfig;
/// use cape_infer::Error;
///
/// let directory = tempfile::tempdir()?;
/// let path = directory.path().join("run.toml");
/// std::fs::write(&path, "[train]\nepochs = 'many'\n")?;
/// match RunConfig::load(&path) {
///     Err(Error::Core(cape_core::Error::Format { path: file, message })) => {
///         assert_eq!(file, path);
///         assert!(message.contains("epochs"));
///     }
///     other => panic!("{other:?}"),
/// }
/// # Ok::<(), std::io::Error>(())
/// ```
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file, mesh, body or argument is invalid.
    #[error(transparent)]
    Core(#[from] cape_core::Error),
    /// A mesh pyramid is invalid.
    #[error(transparent)]
    Graph(#[from] cape_graph::Error),
    /// A configuration or a set of weights is invalid.
    #[error(transparent)]
    Model(#[from] cape_model::Error),
    /// Another process of the same training failed, which reports its own error; or the processes do not
    /// form a group.
    #[error("{0}")]
    Processes(String),
}

impl Error {
    /// An input or output error of `path`.
    pub fn io(path: impl AsRef<Path>, source: std::io::Error) -> Self {
        cape_core::Error::io(path, source).into()
    }

    /// The array, key or line `field` of `path` is invalid.
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

    /// A data set as a whole cannot be used.
    pub fn data(message: impl Into<String>) -> Self {
        cape_core::Error::Data(message.into()).into()
    }
}
