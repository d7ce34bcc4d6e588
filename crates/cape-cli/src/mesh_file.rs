use std::path::Path;

use cape_core::{Mesh, SmplModel};
use cape_graph::Surface;

use crate::error::Result;

/// True if the file's extension is `expected`, in upper or lower case.
pub(crate) fn has_extension(path: &Path, expected: &str) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case(expected))
}

/// True if the file's extension is that of a mesh.
#[cfg(feature = "view")]
pub(crate) fn is_mesh(path: &Path) -> bool {
    cape_core::MESH_EXTENSIONS.iter().any(|extension| has_extension(path, extension))
}

/// Reads a mesh file, or the template of a body file.
pub(crate) fn read_surface(path: &Path) -> Result<Surface> {
    if is_body(path) {
        return Ok(Surface::from(&SmplModel::load(path)?));
    }
    Ok(Surface::from(&Mesh::load(path)?))
}

/// Reads a mesh in single precision.
#[cfg(feature = "view")]
pub(crate) fn read_mesh(path: &Path) -> Result<Mesh> {
    Ok(if is_body(path) { SmplModel::load(path)?.mesh() } else { Mesh::load(path)? })
}

fn is_body(path: &Path) -> bool {
    has_extension(path, "npz") || has_extension(path, "pkl")
}
