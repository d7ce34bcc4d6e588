use std::path::Path;

use cape_core::{Mesh, SmplModel};
use cape_graph::Surface;

use crate::{body_source::BuiltinBody, error::Result};

/// True if the file's extension is `expected`, in upper or lower case.
pub(crate) fn has_extension(path: &Path, expected: &str) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case(expected))
}

/// True if the file's extension is that of a mesh.
#[cfg(feature = "view")]
pub(crate) fn is_mesh(path: &Path) -> bool {
    cape_core::MESH_EXTENSIONS.iter().any(|extension| has_extension(path, extension))
}

/// Reads a mesh file, or the template of a body: a file or the name of a built-in one.
pub(crate) fn read_surface(path: &Path) -> Result<Surface> {
    Ok(match body(path)? {
        Some(body) => Surface::from(&body),
        None => Surface::from(&Mesh::load(path)?),
    })
}

/// The same in single precision.
#[cfg(feature = "view")]
pub(crate) fn read_mesh(path: &Path) -> Result<Mesh> {
    Ok(match body(path)? {
        Some(body) => body.mesh(),
        None => Mesh::load(path)?,
    })
}

/// The body of that name or file; `None` if it is neither.
fn body(path: &Path) -> Result<Option<SmplModel>> {
    if let Some(body) = BuiltinBody::named(path) {
        return body.load().map(Some);
    }
    let is_body = has_extension(path, "npz") || has_extension(path, "pkl");
    Ok(if is_body { Some(SmplModel::load(path)?) } else { None })
}
