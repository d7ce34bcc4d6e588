/// Result of this crate's operations.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Errors of the export.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file or body is invalid.
    #[error(transparent)]
    Core(#[from] cape_core::Error),
    /// A weight does not fit into half precision.
    #[error("weight {value} of `{name}` is too large for half precision: use single precision")]
    Overflow {
        /// Name of the table.
        name: String,
        /// The weight.
        value: f32,
    },
}
