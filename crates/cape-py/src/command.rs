//! The command line.

use std::ffi::OsString;

use pyo3::prelude::*;

/// Run the command line on arguments, of which the first is the program's name, and return its exit
/// code.
#[pyfunction]
pub(crate) fn main(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
    py.detach(|| cape_cli::run(arguments))
}
