/// Result of this crate's operations.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What can go wrong when drawing.
///
/// ```
/// use cape_render::{Error, Image};
///
/// let directory = tempfile::tempdir()?;
/// let path = directory.path().join("notes.png");
/// std::fs::write(&path, "no picture at all")?;
/// let Err(Error::File(reason)) = Image::load(&path) else { panic!("a text was read") };
/// assert!(reason.to_string().contains("notes.png"));
/// assert!(matches!(Image::new(0, 480, [0; 4]), Err(Error::Argument(_))));
/// # Ok::<(), std::io::Error>(())
/// ```
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
