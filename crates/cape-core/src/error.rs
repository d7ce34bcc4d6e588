use std::path::{Path, PathBuf};

/// Result of this crate's operations.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What can go wrong with meshes, bodies and their files.
///
/// Errors name the file and what is wrong in it:
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
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A file's contents are not what they must be.
    #[error("{}: `{field}`: {message}", path.display())]
    Field {
        /// The file.
        path: PathBuf,
        /// The array, key or line at fault.
        field: String,
        /// What was found, and what was expected.
        message: String,
    },
    /// A file as a whole is not of the expected format.
    #[error("{}: {message}", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// What was found, and what was expected.
        message: String,
    },
    /// A mesh is unusable; the message names the offending element and the remedy.
    #[error("mesh: {0}")]
    Mesh(String),
    /// An argument is out of its domain; the message names it, its value and what was expected.
    #[error("{0}")]
    Argument(String),
    /// A data set as a whole cannot be used; the message says why and what would help.
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

    /// An [`Error::Argument`] about the surface called `name`.
    pub(crate) fn surface(name: &str, message: impl std::fmt::Display) -> Self {
        Self::Argument(format!("{name}: {message}"))
    }
}

/// An error that names the first of `numbers` that is NaN or infinite; `name` is what they are.
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
