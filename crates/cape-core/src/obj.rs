//! Wavefront OBJ files. Vertices keep the order of the file, so that per-vertex data (displacements,
//! masks, blend weights) stay valid.

use std::{
    io::{self, Write},
    path::Path,
};

use crate::{
    Error, Mesh, Result,
    mesh::{Geometry, is_face, read_bytes, text},
    write_atomically,
};

pub use crate::uv::Uv;

/// Contents of an OBJ file.
///
/// ```
/// use cape_core::{Mesh, obj::{self, Obj, Uv}};
///
/// let mesh = Mesh {
///     vertices: vec![[0., 0., 0.], [1., 0., 0.], [0., 1., 0.]],
///     faces: vec![[0, 1, 2]],
/// };
/// let uv = Uv { coordinates: vec![[0., 0.], [1., 0.], [0., 1.]], faces: vec![[0, 1, 2]] };
/// let directory = tempfile::tempdir()?;
/// let path = directory.path().join("triangle.obj");
/// obj::write(&path, &mesh, Some(&uv))?;
/// assert_eq!(obj::read(&path)?, Obj { mesh, uv: Some(uv) });
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Obj {
    /// Triangles of all objects and groups.
    pub mesh: Mesh,
    /// Texture coordinates; `None` unless every face corner has them.
    pub uv: Option<Uv>,
}

/// Reads an OBJ file. Polygons are triangulated as fans, and faces of fewer than three different
/// corners are left out; normals, materials, groups, lines and curves are ignored.
pub fn read(path: impl AsRef<Path>) -> Result<Obj> {
    let path = path.as_ref();
    let parsed = parse(&read_bytes(path)?).map_err(|fault| fault.within(path))?;
    match parsed.not_finite {
        None => Ok(parsed.obj),
        Some(fault) => Err(fault.within(path)),
    }
}

/// The mesh in `bytes`, whose vertices may be not finite; errors name `path`.
pub(crate) fn geometry(path: &Path, bytes: &[u8]) -> Result<Geometry> {
    let Parsed { obj, skipped, .. } = parse(bytes).map_err(|fault| fault.within(path))?;
    Ok(Geometry { mesh: obj.mesh, normals: None, skipped })
}

/// Writes an OBJ file, atomically, with texture coordinates if given.
pub fn write(path: impl AsRef<Path>, mesh: &Mesh, uv: Option<&Uv>) -> Result<()> {
    write_with(path, mesh, uv, None)
}

/// [`write()`] with a material: the name of its `.mtl` file, and its name in that file.
pub fn write_with(
    path: impl AsRef<Path>,
    mesh: &Mesh,
    uv: Option<&Uv>,
    material: Option<(&str, &str)>,
) -> Result<()> {
    check_uv(mesh, uv)?;
    write_atomically(path, |file| write_to(file, mesh, uv, material))
}

/// Writes a mesh in OBJ format to `sink`, with texture coordinates and a material (see
/// [`write_with`]) if given.
///
/// # Errors
/// If there are not as many faces with texture coordinates as faces, or `sink` fails.
pub fn write_to(
    mut sink: impl Write,
    mesh: &Mesh,
    uv: Option<&Uv>,
    material: Option<(&str, &str)>,
) -> io::Result<()> {
    check_uv(mesh, uv).map_err(io::Error::other)?;
    if let Some((library, _)) = material {
        writeln!(sink, "mtllib {library}")?;
    }
    for [x, y, z] in &mesh.vertices {
        writeln!(sink, "v {x} {y} {z}")?;
    }
    for [u, v] in uv.iter().flat_map(|uv| &uv.coordinates) {
        writeln!(sink, "vt {u} {v}")?;
    }
    if let Some((_, name)) = material {
        writeln!(sink, "usemtl {name}")?;
    }
    for (index, face) in mesh.faces.iter().enumerate() {
        let [a, b, c] = face.map(|corner| u64::from(corner) + 1);
        match uv.and_then(|uv| uv.faces.get(index)) {
            None => writeln!(sink, "f {a} {b} {c}")?,
            Some(points) => {
                let [p, q, r] = points.map(|point| u64::from(point) + 1);
                writeln!(sink, "f {a}/{p} {b}/{q} {c}/{r}")?;
            }
        }
    }
    Ok(())
}

fn check_uv(mesh: &Mesh, uv: Option<&Uv>) -> Result<()> {
    let faces = mesh.faces.len();
    match uv {
        Some(uv) if uv.faces.len() != faces => Err(Error::Mesh(format!(
            "texture coordinates of {} faces, expected {faces}",
            uv.faces.len()
        ))),
        _ => Ok(()),
    }
}

struct ParseError {
    line: usize,
    message: String,
}

impl ParseError {
    fn within(self, path: &Path) -> Error {
        Error::field(path, format!("line {}", self.line), self.message)
    }
}

#[derive(Default)]
struct Parsed {
    obj: Obj,
    /// Number of faces left out.
    skipped: usize,
    /// First vertex that is not finite.
    not_finite: Option<ParseError>,
}

/// Indices of vertex and texture coordinate of a face corner.
type Corner = (u32, Option<u32>);

fn parse(bytes: &[u8]) -> Result<Parsed, ParseError> {
    let bytes = text::without_mark(bytes);
    let end = text::line_end(bytes);
    let mut parsed = Parsed::default();
    let Parsed { obj, skipped, not_finite } = &mut parsed;
    let mut uv = Uv::default();
    // Largest index of a vertex and of a texture coordinate, with its line.
    let mut largest = [(0, 0); 2];
    let mut lines = bytes.split(|&byte| byte == end).enumerate();
    while let Some((index, first)) = lines.next() {
        let at = |message: String| ParseError { line: index + 1, message };
        // Names and comments may be in any encoding; numbers are ASCII.
        let mut line = String::from_utf8_lossy(first).trim_end().to_owned();
        while line.ends_with('\\') {
            line.pop();
            let Some((_, next)) = lines.next() else { break };
            line.push(' ');
            line.push_str(String::from_utf8_lossy(next).trim_end());
        }
        let mut words = text::words(&line);
        match words.next() {
            Some("v") => {
                let vertex: [f32; 3] = numbers(words).map_err(at)?;
                if not_finite.is_none() && !vertex.iter().all(|x| x.is_finite()) {
                    *not_finite = Some(at(format!("the vertex is not finite: {vertex:?}")));
                }
                obj.mesh.vertices.push(vertex);
            }
            Some("vt") => {
                let point: [f32; 2] = numbers(words).map_err(at)?;
                if !point.iter().all(|x| x.is_finite()) {
                    return Err(at(format!("the texture coordinate is not finite: {point:?}")));
                }
                uv.coordinates.push(point);
            }
            Some("f") => {
                let counts = (obj.mesh.vertices.len(), uv.coordinates.len());
                let corners: Vec<Corner> =
                    words.map(|word| corner(word, counts)).collect::<Result<_, _>>().map_err(at)?;
                for &(vertex, point) in &corners {
                    for (largest, found) in largest.iter_mut().zip([Some(vertex), point]) {
                        *largest =
                            found.map_or(*largest, |found| (*largest).max((found, index + 1)));
                    }
                }
                let before = obj.mesh.faces.len();
                for pair in corners.get(1..).unwrap_or_default().windows(2) {
                    let triangle = [corners[0], pair[0], pair[1]];
                    let face = triangle.map(|(vertex, _)| vertex);
                    if !is_face(face) {
                        continue;
                    }
                    obj.mesh.faces.push(face);
                    if let [(_, Some(p)), (_, Some(q)), (_, Some(r))] = triangle {
                        uv.faces.push([p, q, r]);
                    }
                }
                *skipped += usize::from(obj.mesh.faces.len() == before);
            }
            _ => {}
        }
    }
    if obj.mesh.vertices.is_empty()
        && let Some(index) = bytes
            .split(|&byte| byte == end)
            .position(|line| !matches!(line.trim_ascii_start(), [] | [b'#', ..]))
    {
        let message = "no vertex in the file, expected lines `v x y z`".to_owned();
        return Err(ParseError { line: index + 1, message });
    }
    // A face may come before its vertices.
    let counts = [obj.mesh.vertices.len(), uv.coordinates.len()];
    for (((index, line), count), kind) in largest.into_iter().zip(counts).zip(KINDS) {
        if line > 0 && index as usize >= count {
            let index = u64::from(index) + 1;
            return Err(ParseError { line, message: out_of_range(kind, index as i64, count) });
        }
    }
    if !uv.faces.is_empty() && uv.faces.len() == obj.mesh.faces.len() {
        obj.uv = Some(uv);
    }
    Ok(parsed)
}

/// Elements that a face corner refers to.
const KINDS: [&str; 2] = ["vertex", "texture coordinate"];

fn out_of_range(kind: &str, number: i64, count: usize) -> String {
    format!("{kind} {number} is out of range: there are {count}")
}

fn numbers<'a, const N: usize>(words: impl Iterator<Item = &'a str>) -> Result<[f32; N], String> {
    let mut values = [0.0f32; N];
    let mut found = 0;
    for (slot, word) in values.iter_mut().zip(words) {
        *slot = text::number(word)?;
        found += 1;
    }
    if found == N { Ok(values) } else { Err(format!("{found} numbers, expected {N}")) }
}

/// Vertex and texture indices of a face corner `v`, `v/vt`, `v//vn` or `v/vt/vn`; negative numbers
/// count back from the `counts` of vertices and texture coordinates so far.
fn corner(word: &str, counts: (usize, usize)) -> Result<Corner, String> {
    let index = |text: &str, count: usize, kind: &str| {
        let number: i64 =
            text.parse().map_err(|_| format!("`{word}` is not v, v/vt, v//vn or v/vt/vn"))?;
        let position =
            if number < 0 { number.checked_add(count as i64) } else { number.checked_sub(1) };
        position
            .and_then(|position| u32::try_from(position).ok())
            .ok_or_else(|| out_of_range(kind, number, count))
    };
    let mut parts = word.split('/');
    let vertex = index(parts.next().unwrap_or_default(), counts.0, KINDS[0])?;
    let point = match parts.next() {
        None | Some("") => None,
        Some(text) => Some(index(text, counts.1, KINDS[1])?),
    };
    Ok((vertex, point))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::mesh::tests::cube;

    fn message(text: &str) -> String {
        let fault = match parse(text.as_bytes()) {
            Ok(parsed) => parsed.not_finite.unwrap(),
            Err(fault) => fault,
        };
        format!("{}: {}", fault.line, fault.message)
    }

    fn read_text(text: impl AsRef<[u8]>) -> Obj {
        parse(text.as_ref()).ok().unwrap().obj
    }

    #[test]
    fn polygons_are_triangulated_with_texture_coordinates() {
        let text = "# a comment\r\nmtllib a.mtl\nv 0 0 0\nv 1 0 0 1\nv 1 1 0 0.5 0.5 0.5\nv 0 1 0\n\
                    v 9 9 9\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 0 0 1\ng \u{e9}\n\
                    f 1/1/1 2/2/1 \\\n 3/3/1 4/4/1\nf -5/-4 -3/-2 -2/-1\n";
        let obj = read_text(text);
        // The isolated vertex keeps its index.
        assert_eq!(obj.mesh.vertices.len(), 5);
        assert_eq!(obj.mesh.faces, [[0, 1, 2], [0, 2, 3], [0, 2, 3]]);
        let uv = obj.uv.unwrap();
        assert_eq!(uv.coordinates[3], [0.0, 1.0]);
        assert_eq!(uv.faces, [[0, 1, 2], [0, 2, 3], [0, 2, 3]]);
        let partly = format!("{text}f 1 2 3\n");
        assert_eq!(read_text(partly).uv, None);
    }

    #[test]
    fn faults_name_their_line() {
        assert_eq!(message("v 1 2\n"), "1: 2 numbers, expected 3");
        assert_eq!(message("\nv 1 2 x\n"), "2: `x` is not a number");
        assert_eq!(message("v 1 nan 2\n"), "1: the vertex is not finite: [1.0, NaN, 2.0]");
        assert_eq!(message("v 1 1 1\nf 1 1 2\n"), "2: vertex 2 is out of range: there are 1");
        assert_eq!(message("v 1 1 1\nf 1 1 0\n"), "2: vertex 0 is out of range: there are 1");
        assert_eq!(message("v 1 1 1\nf 1 1 -2\n"), "2: vertex -2 is out of range: there are 1");
        assert!(message("v 0,1 0,2 0,3\n").contains("decimal comma"));
        assert_eq!(message("f a b c\n"), "1: `a` is not v, v/vt, v//vn or v/vt/vn");
    }

    /// A cube of quadrilaterals, its vertices and its faces.
    fn cube_text() -> (String, String) {
        let vertices = (0..8).map(|i| format!("v {} {} {}\n", i & 1, i >> 1 & 1, i >> 2));
        let faces = "f 1 3 4 2\nf 5 6 8 7\nf 1 2 6 5\nf 3 7 8 4\nf 1 5 7 3\nf 2 4 8 6\n";
        (vertices.collect::<Vec<_>>().concat(), faces.to_owned())
    }

    #[test]
    fn dialects_are_read() {
        let (vertices, faces) = cube_text();
        let plain = format!("{vertices}{faces}");
        let expected = cube();
        let marked = format!("\u{feff}{plain}");
        let relative = (1..=8)
            .rev()
            .fold(faces.clone(), |text, k| text.replace(&format!(" {k}"), &format!(" -{}", 9 - k)));
        let windows = plain.replace('\n', "\r\n");
        let commented = format!("{vertices}{}", faces.replace('\n', " # a side\n"));
        for (name, text) in [
            ("byte-order mark", marked),
            ("relative indices", format!("\u{feff}{vertices}{relative}")),
            ("lone carriage returns", format!("# by hand\r{}", plain.replace('\n', "\r"))),
            ("line ends of Windows", windows),
            ("comments after faces", commented),
            ("faces of two corners", format!("{vertices}f 1 2\n{faces}f 3\nf\n")),
            ("repeated corners", format!("{vertices}f 4 4 5\n{faces}")),
            ("faces before vertices", format!("{faces}{vertices}")),
            ("tabs", plain.replace(' ', "\t")),
        ] {
            assert_eq!(read_text(&text).mesh, expected, "{name}");
        }
        let skipped = |text: String| parse(text.as_bytes()).ok().unwrap().skipped;
        assert_eq!(skipped(format!("{vertices}f 1 2\nf 4 4 5\n{faces}")), 2);
        assert_eq!(skipped(plain), 0);
        assert_eq!(read_text(format!("\u{feff}{vertices}")).mesh.vertices, expected.vertices);
    }

    #[test]
    fn latin_1_and_faces_of_many_corners_are_read() {
        let text =
            b"# \xe9\r\nmtllib a.mtl\r\nv\t0 0 +0\r\nv 1. 0 0 1\r\nv 1 1 0 .5 .5 .5\r\nv 0 1 0\r\n\
            v 0.5 2e0 0\r\nvn 0 0 1\r\nusemtl \xfc\r\ng a b\r\ns off\r\nf 1// 2// 3// 4//\r\n\
            f -5//1 -4//1 \\\r\n -3//1 -2//1\r\nf 1 2 3 5 4\r\nl 1 2\r\n";
        let mesh = read_text(text).mesh;
        assert_eq!((mesh.vertices.len(), mesh.faces.len()), (5, 7));
    }

    #[test]
    fn files_round_trip() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.obj");
        let mut mesh = cube();
        mesh.vertices[3] = [0.1, -1e-9, 12345.678];
        write(&path, &mesh, None).unwrap();
        assert_eq!(read(&path).unwrap(), Obj { mesh: mesh.clone(), uv: None });
        let uv = Uv { coordinates: vec![[0.25, 0.75]], faces: vec![[0; 3]; 12] };
        write(&path, &mesh, Some(&uv)).unwrap();
        assert_eq!(read(&path).unwrap(), Obj { mesh: mesh.clone(), uv: Some(uv) });
        let mut bytes = Vec::new();
        write_to(
            &mut bytes,
            &mesh,
            Some(&Uv { coordinates: vec![[0.25, 0.75]], faces: vec![[0; 3]; 12] }),
            None,
        )
        .unwrap();
        assert_eq!(bytes, std::fs::read(&path).unwrap());
        assert!(write_to(&mut bytes, &mesh, Some(&Uv::default()), None).is_err());
        assert!(write(&path, &mesh, Some(&Uv::default())).is_err());
        std::fs::write(&path, "v 1\n").unwrap();
        let message = read(&path).unwrap_err().to_string();
        assert!(message.contains("a.obj") && message.contains("line 1"), "{message}");
    }

    proptest! {
        #[test]
        fn no_text_makes_the_reader_panic(bytes: Vec<u8>, text in "([vf]t? ?[-0-9/. \\\\a]{0,9}\n){0,9}") {
            let _ = parse(&bytes);
            let _ = parse(text.as_bytes());
        }
    }
}
