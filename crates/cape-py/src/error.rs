//! Errors of the libraries as Python exceptions with the same text.

use pyo3::{PyErr, create_exception, exceptions::PyValueError};

create_exception!(cape, CapeError, PyValueError, "An argument or a mesh is not as expected.");
create_exception!(cape, FileError, CapeError, "A file cannot be read or is not as expected.");

/// Exception about an argument.
pub(crate) fn argument(message: String) -> PyErr {
    CapeError::new_err(message)
}

/// Exception of an error of `cape-core`.
pub(crate) fn core(error: cape_core::Error) -> PyErr {
    use cape_core::Error;
    match error {
        Error::Io { .. } | Error::Field { .. } | Error::Format { .. } => {
            FileError::new_err(error.to_string())
        }
        _ => CapeError::new_err(error.to_string()),
    }
}

/// Exception of an error of `cape-graph`.
pub(crate) fn graph(error: cape_graph::Error) -> PyErr {
    CapeError::new_err(error.to_string())
}

/// Exception of an error of `cape-infer`.
pub(crate) fn infer(error: cape_infer::Error) -> PyErr {
    match error {
        cape_infer::Error::Core(error) => core(error),
        error => CapeError::new_err(error.to_string()),
    }
}

/// Exception of an error of `cape-render`.
pub(crate) fn render(error: cape_render::Error) -> PyErr {
    CapeError::new_err(error.to_string())
}
