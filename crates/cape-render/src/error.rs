/// Result of this crate's operations.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Error of rendering, and of image files.
///
/// ```
/// use cape_render::{Error, Image};
///
/// let directory = tempfile::tempdir()?;
/// let path = directory.path().join("notes.png");
/// std::fs::write(&path, "not an image")?;
/// let Err(Error::File(reason)) = Image::load(&path) else { panic!("expected an error") };
/// assert!(reason.to_string().contains("notes.png"));
/// assert!(matches!(Image::new(0, 480, [0; 4]), Err(Error::Argument(_))));
/// # Ok::<(), std::io::Error>(())
/// ```
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// An image file cannot be read or written.
    #[error(transparent)]
    File(#[from] cape_core::Error),
    /// An argument is invalid; the message names it and what was expected.
    #[error("{0}")]
    Argument(String),
}
