//! Extension module `cape._cape`; the package around it is `python/cape`.

mod error;
mod model;
mod pyramid;
mod smpl;

/// Bodies, clothing models and mesh pyramids of cape; imported through the package `cape`.
#[pyo3::pymodule]
mod _cape {
    #[pymodule_export]
    use super::{
        error::{CapeError, FileError},
        model::Model,
        pyramid::MeshPyramid,
        smpl::SmplModel,
    };
}
