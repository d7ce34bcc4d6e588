//! Stanford PLY files: reads text and binary, writes binary little-endian.

#[cfg(test)]
mod tests;

use std::{
    io::{self, Write},
    path::Path,
};

use crate::{
    Error, Mesh, Result,
    mesh::{Geometry, fan, read_bytes, strip, text},
    write_atomically,
};

/// Mesh and, if the file has them, vertex normals `[vertices, 3]` of any length.
///
/// ```
/// let file = std::env::temp_dir().join(format!("normals-{}.ply", std::process::id()));
/// let text = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n\
///     property float z\nproperty float nx\nproperty float ny\nproperty float nz\nend_header\n\
///     1 2 3 0 0 1\n";
/// std::fs::write(&file, text)?;
/// let (mesh, normals) = cape_core::ply::read_with_normals(&file)?;
/// assert_eq!((mesh.vertices, normals), (vec![[1.0, 2.0, 3.0]], Some(vec![[0.0, 0.0, 1.0]])));
/// # std::fs::remove_file(&file)?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub type MeshWithNormals = (Mesh, Option<Vec<[f32; 3]>>);

/// Reads a PLY file. Polygons are triangulated as fans, and faces of fewer than three different
/// corners are left out; properties other than vertex positions and vertex indices are ignored.
pub fn read(path: impl AsRef<Path>) -> Result<Mesh> {
    Ok(read_with_normals(path)?.0)
}

/// [`read()`] with the vertex normals `nx`, `ny`, `nz`, if the file has them.
///
/// # Errors
/// If the file cannot be read or is not a valid PLY file.
pub fn read_with_normals(path: impl AsRef<Path>) -> Result<MeshWithNormals> {
    let path = path.as_ref();
    let Geometry { mesh, normals, .. } =
        parse(&read_bytes(path)?).map_err(|message| Error::format(path, message))?;
    let finite = |vertex: &[f32; 3]| vertex.iter().all(|x| x.is_finite());
    match mesh.vertices.iter().enumerate().find(|(_, vertex)| !finite(vertex)) {
        None => Ok((mesh, normals)),
        Some((index, vertex)) => {
            Err(Error::format(path, format!("vertex {index} is not finite: {vertex:?}")))
        }
    }
}

/// Writes a binary little-endian PLY file, atomically, with RGB vertex colours `[vertices, 3]` if
/// given.
pub fn write(path: impl AsRef<Path>, mesh: &Mesh, colours: Option<&[[u8; 3]]>) -> Result<()> {
    check_colours(mesh, colours)?;
    write_atomically(path, |file| write_to(file, mesh, colours))
}

/// Writes a mesh in binary little-endian PLY format to `sink`, with RGB vertex colours
/// `[vertices, 3]` if given.
///
/// # Errors
/// If there are not as many colours as vertices, or `sink` fails.
pub fn write_to(mut sink: impl Write, mesh: &Mesh, colours: Option<&[[u8; 3]]>) -> io::Result<()> {
    check_colours(mesh, colours).map_err(io::Error::other)?;
    write!(sink, "ply\nformat binary_little_endian 1.0\nelement vertex {}\n", mesh.vertices.len())?;
    sink.write_all(b"property float x\nproperty float y\nproperty float z\n")?;
    if colours.is_some() {
        sink.write_all(b"property uchar red\nproperty uchar green\nproperty uchar blue\n")?;
    }
    writeln!(sink, "element face {}", mesh.faces.len())?;
    sink.write_all(b"property list uchar uint vertex_indices\nend_header\n")?;
    for (index, vertex) in mesh.vertices.iter().enumerate() {
        for coordinate in vertex {
            sink.write_all(&coordinate.to_le_bytes())?;
        }
        if let Some(colour) = colours.and_then(|colours| colours.get(index)) {
            sink.write_all(colour)?;
        }
    }
    for face in &mesh.faces {
        sink.write_all(&[3])?;
        for corner in face {
            sink.write_all(&corner.to_le_bytes())?;
        }
    }
    Ok(())
}

fn check_colours(mesh: &Mesh, colours: Option<&[[u8; 3]]>) -> Result<()> {
    let vertices = mesh.vertices.len();
    match colours {
        Some(colours) if colours.len() != vertices => {
            Err(Error::Mesh(format!("{} vertex colours, expected {vertices}", colours.len())))
        }
        _ => Ok(()),
    }
}

#[derive(Clone, Copy)]
enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn parse(name: &str) -> Result<Self, String> {
        Ok(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return Err(format!("unknown property type `{name}`")),
        })
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// Decodes the little-endian number in `raw`.
    fn decode(self, raw: [u8; 8]) -> f64 {
        let [a, b, c, d, ..] = raw;
        match self {
            Self::I8 => i8::from_le_bytes([a]).into(),
            Self::U8 => a.into(),
            Self::I16 => i16::from_le_bytes([a, b]).into(),
            Self::U16 => u16::from_le_bytes([a, b]).into(),
            Self::I32 => i32::from_le_bytes([a, b, c, d]).into(),
            Self::U32 => u32::from_le_bytes([a, b, c, d]).into(),
            Self::F32 => f32::from_le_bytes([a, b, c, d]).into(),
            Self::F64 => f64::from_le_bytes(raw),
        }
    }
}

struct Property<'a> {
    name: &'a str,
    /// Type of the length of a list property.
    length: Option<Scalar>,
    scalar: Scalar,
}

struct Element<'a> {
    name: &'a str,
    count: usize,
    properties: Vec<Property<'a>>,
}

#[derive(Clone, Copy)]
enum Encoding {
    Text,
    LittleEndian,
    BigEndian,
}

/// Mesh and normals in `bytes`; vertices may be not finite.
pub(crate) fn parse(bytes: &[u8]) -> Result<Geometry, String> {
    let (encoding, elements, rest) = header(text::without_mark(bytes))?;
    let mut body = Payload { encoding, rest };
    let mut found = Geometry::default();
    let mut vertices_seen = false;
    for element in &elements {
        body.check_count(element)?;
        match element.name {
            "vertex" => {
                vertices_seen = true;
                (found.mesh.vertices, found.normals) = vertices(&mut body, element)?;
            }
            "face" => faces(&mut body, element, &mut found)?,
            "tristrips" => strips(&mut body, element, &mut found)?,
            _ if element.properties.is_empty() => {}
            _ => {
                for _ in 0..element.count {
                    body.item(element, |_, _| {})?;
                }
            }
        }
    }
    if !vertices_seen {
        return Err("the header has no element `vertex`".into());
    }
    let Mesh { vertices, faces } = &found.mesh;
    let outside = |face: &&[u32; 3]| face.iter().any(|&c| c as usize >= vertices.len());
    if let Some(face) = faces.iter().find(outside) {
        return Err(format!("face {face:?} is out of range for {} vertices", vertices.len()));
    }
    Ok(found)
}

fn header(bytes: &[u8]) -> Result<(Encoding, Vec<Element<'_>>, &[u8]), String> {
    let mut rest = bytes;
    // Old Macintosh programs end lines with a carriage return alone.
    let last = match bytes {
        [_, _, _, b'\r', next, ..] if *next != b'\n' => b'\r',
        _ => b'\n',
    };
    let mut next_line = || {
        let end = rest
            .iter()
            .position(|&byte| byte == last)
            .ok_or("the header does not end with `end_header`")?;
        let (line, after) = rest.split_at(end);
        rest = &after[1..];
        std::str::from_utf8(line)
            .map(|line| (line.trim(), rest))
            .map_err(|_| "the header is not ASCII text")
    };
    if next_line()?.0 != "ply" {
        return Err("not a PLY file (expected `ply` in the first line)".into());
    }
    let mut encoding = None;
    let mut elements: Vec<Element> = Vec::new();
    loop {
        let (line, after) = next_line()?;
        let words: Vec<&str> = line.split_whitespace().collect();
        match words.as_slice() {
            ["end_header"] => {
                let encoding = encoding.ok_or("the header has no `format` line")?;
                return Ok((encoding, elements, after));
            }
            ["format", name, _] => {
                encoding = Some(match *name {
                    "ascii" => Encoding::Text,
                    "binary_little_endian" => Encoding::LittleEndian,
                    "binary_big_endian" => Encoding::BigEndian,
                    _ => return Err(format!("unknown format `{name}`")),
                });
            }
            ["element", name, count] => {
                let count =
                    count.parse().map_err(|_| format!("`{line}`: expected an element count"))?;
                elements.push(Element { name, count, properties: Vec::new() });
            }
            ["property", definition @ ..] => {
                let property = match definition {
                    ["list", length, scalar, name] => Property {
                        name,
                        length: Some(Scalar::parse(length)?),
                        scalar: Scalar::parse(scalar)?,
                    },
                    [scalar, name] => {
                        Property { name, length: None, scalar: Scalar::parse(scalar)? }
                    }
                    _ => {
                        return Err(format!(
                            "`{line}`: expected `property TYPE NAME` or `property list TYPE TYPE NAME`"
                        ));
                    }
                };
                let element =
                    elements.last_mut().ok_or("property line before the first element line")?;
                element.properties.push(property);
            }
            [] | ["comment" | "obj_info", ..] => {}
            _ => return Err(format!("unknown header line `{line}`")),
        }
    }
}

/// Vertex positions and, if the file has them, normals.
type Vertices = (Vec<[f32; 3]>, Option<Vec<[f32; 3]>>);

fn vertices(body: &mut Payload, element: &Element) -> Result<Vertices, String> {
    let position =
        |axis: &str| element.properties.iter().position(|p| p.name == axis && p.length.is_none());
    let axis =
        |name| position(name).ok_or_else(|| format!("element `vertex` has no property `{name}`"));
    let axes = [axis("x")?, axis("y")?, axis("z")?];
    let normal_axes = match ["nx", "ny", "nz"].map(position) {
        [Some(x), Some(y), Some(z)] => Some([x, y, z]),
        _ => None,
    };
    let mut vertices = Vec::with_capacity(element.count);
    let mut normals = normal_axes.map(|_| Vec::with_capacity(element.count));
    for _ in 0..element.count {
        let (mut vertex, mut normal) = ([0.0f32; 3], [0.0f32; 3]);
        body.item(element, |property, values| {
            let [value] = values else { return };
            let slots = vertex.iter_mut().zip(axes);
            let slots = slots.chain(normal.iter_mut().zip(normal_axes.unwrap_or([usize::MAX; 3])));
            for (slot, _) in slots.filter(|&(_, axis)| axis == property) {
                *slot = *value as f32;
            }
        })?;
        vertices.push(vertex);
        if let Some(normals) = &mut normals {
            normals.push(normal);
        }
    }
    Ok((vertices, normals))
}

/// Position of the list of vertex indices among the properties of `element`.
fn index_list(element: &Element) -> Result<usize, String> {
    let is_corners =
        |p: &Property| ["vertex_indices", "vertex_index"].contains(&p.name) && p.length.is_some();
    element
        .properties
        .iter()
        .position(is_corners)
        .ok_or_else(|| format!("element `{}` has no list property `vertex_indices`", element.name))
}

fn faces(body: &mut Payload, element: &Element, found: &mut Geometry) -> Result<(), String> {
    if element.count == 0 {
        return Ok(());
    }
    let corners = index_list(element)?;
    found.mesh.faces.reserve(element.count);
    for index in 0..element.count {
        let mut whole = true;
        body.item(element, |property, values| {
            if property != corners {
                return;
            }
            let corner = |&value: &f64| {
                let whole = value.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&value);
                whole.then_some(value as u32)
            };
            let values: Option<Vec<u32>> = values.iter().map(corner).collect();
            whole = values.is_some();
            let before = found.mesh.faces.len();
            found.mesh.faces.extend(fan(&values.unwrap_or_default()));
            found.skipped += usize::from(found.mesh.faces.len() == before);
        })?;
        if !whole {
            return Err(format!("face {index} has a vertex index that is not a whole number"));
        }
    }
    Ok(())
}

/// Triangle strips; an index below 0 ends one.
fn strips(body: &mut Payload, element: &Element, found: &mut Geometry) -> Result<(), String> {
    if element.count == 0 {
        return Ok(());
    }
    let corners = index_list(element)?;
    for _ in 0..element.count {
        body.item(element, |property, values| {
            if property != corners {
                return;
            }
            for run in values.split(|&value| value < 0.0) {
                let run: Vec<u32> = run.iter().map(|&value| value as u32).collect();
                found.mesh.faces.extend(strip(&run));
            }
        })?;
    }
    Ok(())
}

/// Unread bytes after the header.
struct Payload<'a> {
    encoding: Encoding,
    rest: &'a [u8],
}

impl Payload<'_> {
    /// Rejects an element count that exceeds the remaining bytes, before memory is allocated.
    fn check_count(&self, element: &Element) -> Result<(), String> {
        let min_size = |property: &Property| match self.encoding {
            Encoding::Text => 2,
            _ => property.length.unwrap_or(property.scalar).size(),
        };
        let each: usize = element.properties.iter().map(min_size).sum();
        // The last number of a text file needs no separator after it.
        if element.count.saturating_mul(each) > self.rest.len() + 1 {
            return Err(format!(
                "the header declares {} elements `{}`, but only {} bytes follow",
                element.count,
                element.name,
                self.rest.len()
            ));
        }
        Ok(())
    }

    /// Reads one item of `element` and calls `take` with each property's index and values.
    fn item(
        &mut self,
        element: &Element,
        mut take: impl FnMut(usize, &[f64]),
    ) -> Result<(), String> {
        for (position, property) in element.properties.iter().enumerate() {
            match property.length {
                None => take(position, &[self.number(property.scalar)?]),
                Some(length) => {
                    let length = self.number(length)?;
                    if !(0.0..=self.rest.len() as f64).contains(&length) {
                        return Err(format!(
                            "list of {length} numbers in element `{}`, longer than the rest of the file",
                            element.name
                        ));
                    }
                    let values: Vec<f64> = (0..length as usize)
                        .map(|_| self.number(property.scalar))
                        .collect::<Result<_, _>>()?;
                    take(position, &values);
                }
            }
        }
        Ok(())
    }

    fn number(&mut self, scalar: Scalar) -> Result<f64, String> {
        let big_endian = match self.encoding {
            Encoding::Text => return self.word(),
            Encoding::LittleEndian => false,
            Encoding::BigEndian => true,
        };
        let (bytes, rest) =
            self.rest.split_at_checked(scalar.size()).ok_or("unexpected end of data")?;
        self.rest = rest;
        let mut raw = [0; 8];
        raw[..bytes.len()].copy_from_slice(bytes);
        if big_endian {
            raw[..bytes.len()].reverse();
        }
        Ok(scalar.decode(raw))
    }

    fn word(&mut self) -> Result<f64, String> {
        let start = self.rest.iter().position(|byte| !byte.is_ascii_whitespace());
        let text = &self.rest[start.ok_or("unexpected end of data")?..];
        let end = text.iter().position(u8::is_ascii_whitespace).unwrap_or(text.len());
        let (word, rest) = text.split_at(end);
        self.rest = rest;
        text::number(&String::from_utf8_lossy(word))
    }
}
