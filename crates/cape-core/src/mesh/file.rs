//! Mesh files of all formats, told apart by their content.

use std::{collections::HashMap, fs, path::Path};

use super::{Mesh, off, polygon::is_face, stl, text};
use crate::{Error, Result, gltf, obj, ply, unexpected_content};

/// Format of a mesh file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MeshFormat {
    /// Wavefront OBJ.
    Obj,
    /// Stanford PLY.
    Ply,
    /// Stereolithography, STL.
    Stl,
    /// Object file format, OFF.
    Off,
    /// glTF 2.0 binary.
    Glb,
}

/// Extensions of the mesh files that are read, without the dot.
pub const MESH_EXTENSIONS: [&str; 5] = ["obj", "ply", "stl", "off", "glb"];

/// Points, triangles and normals of a mesh file, as they are: points that are not finite are kept.
///
/// ```
/// use cape_core::{MeshFile, MeshFormat};
///
/// let directory = tempfile::tempdir()?;
/// // The content decides, not the name.
/// let path = directory.path().join("tetrahedron.obj");
/// std::fs::write(&path, "OFF\n4 1 0\n0 0 0\n1 0 0\n0 1 0\nnan 0 1\n3 0 1 2\n")?;
/// let mut file = MeshFile::read(&path)?;
/// assert_eq!((file.format, file.mesh.vertices.len()), (MeshFormat::Off, 4));
/// assert!(file.mesh.vertices[3][0].is_nan());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct MeshFile {
    /// Format of the content.
    pub format: MeshFormat,
    /// Points and triangles; polygons are triangulated as fans.
    pub mesh: Mesh,
    /// Normals of the vertices, of any length, `[vertices, 3]`, if the file has them.
    pub normals: Option<Vec<[f32; 3]>>,
    /// Number of faces that were left out, since they have fewer than three different corners.
    pub skipped_faces: usize,
}

/// Content of a mesh file while it is read.
#[derive(Debug, Default)]
pub(crate) struct Geometry {
    pub(crate) mesh: Mesh,
    pub(crate) normals: Option<Vec<[f32; 3]>>,
    /// Number of faces left out.
    pub(crate) skipped: usize,
}

impl MeshFile {
    /// Reads an OBJ, PLY, STL, OFF or `.glb` file, whose content selects the format.
    ///
    /// # Errors
    /// If the file cannot be read, is of no known format, or is malformed.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let bytes = read_bytes(path)?;
        let format = MeshFormat::of(path, &bytes)?;
        let fault = |message: String| Error::format(path, message);
        let Geometry { mesh, normals, skipped } = match format {
            MeshFormat::Obj => obj::geometry(path, &bytes)?,
            MeshFormat::Ply => ply::parse(&bytes).map_err(fault)?,
            MeshFormat::Stl => stl::parse(&bytes).map_err(fault)?,
            MeshFormat::Off => off::parse(&bytes).map_err(fault)?,
            MeshFormat::Glb => {
                let file = gltf::GltfFile::parse(path, bytes)?;
                let vertices = file.vertices(None)?;
                weld_by(&[vertices], &file.faces()?)
            }
        };
        Ok(Self { format, mesh, normals, skipped_faces: skipped })
    }

    /// The mesh.
    ///
    /// # Errors
    /// If a vertex is not finite; `path` is named.
    pub(super) fn finite(self, path: &Path) -> Result<Mesh> {
        let broken = |vertex: &&[f32; 3]| !vertex.iter().all(|x| x.is_finite());
        match self.mesh.vertices.iter().enumerate().find(|(_, vertex)| broken(vertex)) {
            None => Ok(self.mesh),
            Some((index, vertex)) => {
                Err(Error::format(path, format!("vertex {index} is not finite: {vertex:?}")))
            }
        }
    }
}

impl MeshFormat {
    /// Format of a file by its content, or, where that says nothing, by its extension.
    fn of(path: &Path, bytes: &[u8]) -> Result<Self> {
        let text = text::without_mark(bytes).trim_ascii_start();
        let is = |name| path.extension().is_some_and(|found| found.eq_ignore_ascii_case(name));
        if bytes.starts_with(b"glTF") {
            return Ok(Self::Glb);
        }
        if text.starts_with(b"ply") && text.get(3).is_some_and(u8::is_ascii_whitespace) {
            return Ok(Self::Ply);
        }
        if off::header(bytes).is_some() {
            return Ok(Self::Off);
        }
        if stl::is_binary(bytes) || stl::is_text(bytes) {
            return Ok(Self::Stl);
        }
        if let Some(found) = unexpected_content(&bytes[..bytes.len().min(4096)], bytes.len() as u64)
        {
            return Err(Error::format(path, found));
        }
        let other = if text.starts_with(b"{") {
            "a glTF or other JSON file: expected binary glTF, export it as .glb"
        } else if bytes.starts_with(b"Kaydara FBX") || text.starts_with(b"; FBX") {
            "an FBX file is not read: convert it to .glb, with Blender for example"
        } else if bytes.starts_with(b"PK\x03\x04") {
            "a ZIP archive: expected a mesh, unpack the archive"
        } else if is("obj") || is_obj(text) {
            return Ok(Self::Obj);
        } else if is("ply") {
            return Ok(Self::Ply);
        } else if is("stl") {
            return Ok(Self::Stl);
        } else if is("off") {
            return Ok(Self::Off);
        } else {
            "unknown mesh format: expected .obj, .ply, .stl, .off or .glb"
        };
        Err(Error::format(path, other))
    }
}

/// True if the first line that is not a comment is one of OBJ.
fn is_obj(text: &[u8]) -> bool {
    let end = text::line_end(&text[..text.len().min(4096)]);
    let first = text
        .split(|&byte| byte == end)
        .map(<[u8]>::trim_ascii)
        .find(|line| !line.is_empty() && !line.starts_with(b"#"));
    let keyword = first.and_then(|line| line.split(u8::is_ascii_whitespace).next());
    keyword.is_some_and(|keyword| {
        let known: [&[u8]; 9] = [b"v", b"vt", b"vn", b"f", b"o", b"g", b"s", b"mtllib", b"usemtl"];
        known.contains(&keyword)
    })
}

/// Bytes of a mesh file.
pub(crate) fn read_bytes(path: &Path) -> Result<Vec<u8>> {
    if path.is_dir() {
        return Err(Error::format(path, "is a directory, expected a file"));
    }
    fs::read(path).map_err(|source| Error::io(path, source))
}

/// Triangles whose corners are `corners`, three for each, with one vertex for each place.
pub(super) fn weld(corners: &[[f32; 3]]) -> Geometry {
    let faces: Vec<[u32; 3]> =
        (0..corners.len() as u32 / 3).map(|face| [3 * face, 3 * face + 1, 3 * face + 2]).collect();
    weld_by(&[corners.to_vec()], &faces)
}

/// A mesh with one vertex for all that lie at the same place in every one of `frames`, in the order
/// of their first appearance; positions are those of the first frame.
pub(crate) fn weld_by(frames: &[Vec<[f32; 3]>], faces: &[[u32; 3]]) -> Geometry {
    let (kept, number) = places(frames);
    let first = frames.first().map_or(&[][..], Vec::as_slice);
    let vertices = kept.iter().map(|&vertex| first[vertex]).collect();
    let all = faces.iter().map(|face| face.map(|corner| number[corner as usize]));
    let kept: Vec<[u32; 3]> = all.filter(|&face| is_face(face)).collect();
    let skipped = faces.len() - kept.len();
    Geometry { mesh: Mesh { vertices, faces: kept }, normals: None, skipped }
}

/// Vertices of different places over all `frames`, and the index of its place for each vertex.
pub(crate) fn places(frames: &[Vec<[f32; 3]>]) -> (Vec<usize>, Vec<u32>) {
    let count = frames.first().map_or(0, Vec::len);
    let (mut kept, mut number) = (Vec::new(), Vec::with_capacity(count));
    let mut known = HashMap::new();
    for vertex in 0..count {
        // Adding zero makes −0 and 0 the same place.
        let place: Vec<u32> =
            frames.iter().flat_map(|frame| frame[vertex].map(|x| (x + 0.0).to_bits())).collect();
        let next = kept.len() as u32;
        let index = *known.entry(place).or_insert(next);
        if index == next {
            kept.push(vertex);
        }
        number.push(index);
    }
    (kept, number)
}
