//! Poses by name and from files.

use cape_core::motion::MotionOptions;
use numpy::{IntoPyArray, PyArray2};
use pyo3::prelude::*;

use crate::error::core;

/// Return a pose by its name (`t-pose`, `a-pose`, `walk` or a motion), or all poses of a file of
/// motions: axis-angles, radians, `[n, 72]`.
#[pyfunction]
pub(crate) fn load_poses<'py>(py: Python<'py>, text: &str) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let file = py
        .detach(|| cape_synth::poses::load_poses(text, &MotionOptions::default()))
        .map_err(core)?;
    Ok(file.poses.mapv(|angle| angle as f32).into_pyarray(py))
}
