use std::path::{Path, PathBuf};

/// Result of this crate's operations.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Error of mesh, body and file operations.
///
/// Errors about files name the file, the field or line, and what was expected:
///
/// ```
/// use cape_core::{Error, Mesh};
///
/// let directory = tempfile::tempdir()?;
/// let path = directory.path().join("broken.obj");
/// std::fs::write(&path, "v 0 0 0\nv 1 0\n")?;
/// match Mesh::load(&path) {
///     Err(Error::Field { path: file, field, message }) => {
///         assert_eq!((file, field.as_str()), (path, "line 2"));
///         assert_eq!(message, "2 numbers, expected 3");
///     }
///     other => panic!("{other:?}"),
/// }
/// assert!(matches!(Mesh::load("nowhere.obj"), Err(Error::Io { .. })));
/// # Ok::<(), std::io::Error>(())
/// ```
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The operating system refused to open, read or write a file.
    #[error("{}: {source}", path.display())]
    Io {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// A field of a file is missing or malformed.
    #[error("{}: `{field}`: {message}", path.display())]
    Field {
        /// Path of the file.
        path: PathBuf,
        /// Name of the array or key, or number of the line.
        field: String,
        /// Found and expected content.
        message: String,
    },
    /// A file as a whole is not of the expected format.
    #[error("{}: {message}", path.display())]
    Format {
        /// Path of the file.
        path: PathBuf,
        /// Found and expected content.
        message: String,
    },
    /// A mesh is inconsistent; the message names the element and the remedy.
    #[error("mesh: {0}")]
    Mesh(String),
    /// An argument is out of its domain; the message names it, its value and what was expected.
    #[error("{0}")]
    Argument(String),
    /// A data set cannot be used; the message names the reason and the remedy.
    #[error("{0}")]
    Data(String),
}

impl Error {
    /// An [`Error::Io`] about `path`.
    pub fn io(path: impl AsRef<Path>, source: std::io::Error) -> Self {
        Self::Io { path: path.as_ref().to_owned(), source }
    }

    /// An [`Error::Field`] about `field` of `path`.
    pub fn field(
        path: impl AsRef<Path>,
        field: impl Into<String>,
        message: impl Into<String>,
    ) -> Self {
        Self::Field { path: path.as_ref().to_owned(), field: field.into(), message: message.into() }
    }

    /// An [`Error::Format`] about `path`.
    pub fn format(path: impl AsRef<Path>, message: impl Into<String>) -> Self {
        Self::Format { path: path.as_ref().to_owned(), message: message.into() }
    }

    /// An [`Error::Argument`].
    pub fn argument(message: impl Into<String>) -> Self {
        Self::Argument(message.into())
    }

    /// An [`Error::Argument`] about the surface `name`.
    pub(crate) fn surface(name: &str, message: impl std::fmt::Display) -> Self {
        Self::Argument(format!("{name}: {message}"))
    }
}

/// Checks that all `numbers` are finite; the error gives `name` and the index of the first NaN or
/// infinite one.
///
/// ```
/// use cape_core::expect_finite;
///
/// assert!(expect_finite("betas", &[0.5, -1.0]).is_ok());
/// let error = expect_finite("betas", &[0.5, f64::NAN]).unwrap_err();
/// assert_eq!(error.to_string(), "betas: number 1 is not finite");
/// ```
pub fn expect_finite<'a>(
    name: impl std::fmt::Display,
    numbers: impl IntoIterator<Item = &'a f64>,
) -> Result<()> {
    match numbers.into_iter().position(|x| !x.is_finite()) {
        None => Ok(()),
        Some(at) => Err(Error::Argument(format!("{name}: number {at} is not finite"))),
    }
}
