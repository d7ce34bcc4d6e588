//! Extension module `cape._cape`; the package around it is `python/cape`.

mod arrays;
mod command;
mod error;
mod model;
mod picture;
mod pose;
mod pyramid;
mod smpl;

/// Bodies, clothing models and mesh pyramids of cape; imported through the package `cape`.
#[pyo3::pymodule]
mod _cape {
    #[pymodule_export]
    use super::{
        command::main,
        error::{CapeError, FileError},
        model::Model,
        picture::{draw, encode_png, load_mesh, save_mesh},
        pose::load_poses,
        pyramid::MeshPyramid,
        smpl::SmplModel,
    };
}
