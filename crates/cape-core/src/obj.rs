//! Wavefront OBJ files. Vertices keep the order of the file, so that per-vertex data (displacements,
//! masks, blend weights) stay valid.

use std::{
    io::{self, Write},
    path::Path,
};

use crate::{Error, Mesh, Result, mesh::read_bytes, write_atomically};

/// Texture coordinates of a mesh.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Uv {
    /// Texture coordinates (u, v), origin at the bottom left, `[points, 2]`.
    pub coordinates: Vec<[f32; 2]>,
    /// Index into `coordinates` for each corner of each face, `[faces, 3]`.
    pub faces: Vec<[u32; 3]>,
}

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

/// Reads an OBJ file. Polygons are triangulated as fans; normals, materials, groups, lines and
/// curves are ignored.
pub fn read(path: impl AsRef<Path>) -> Result<Obj> {
    let path = path.as_ref();
    parse(&read_bytes(path)?)
        .map_err(|ParseError { line, message }| Error::field(path, format!("line {line}"), message))
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

fn parse(bytes: &[u8]) -> Result<Obj, ParseError> {
    let mut obj = Obj::default();
    let mut uv = Uv::default();
    let mut lines = bytes.split(|&byte| byte == b'\n').enumerate();
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
        let mut words = line.split_whitespace();
        match words.next() {
            Some("v") => obj.mesh.vertices.push(numbers(words).map_err(at)?),
            Some("vt") => uv.coordinates.push(numbers(words).map_err(at)?),
            Some("f") => {
                let counts = (obj.mesh.vertices.len(), uv.coordinates.len());
                let corners: Vec<(u32, Option<u32>)> =
                    words.map(|word| corner(word, counts)).collect::<Result<_, _>>().map_err(at)?;
                let [first, rest @ ..] = corners.as_slice() else {
                    return Err(at("face without vertices".into()));
                };
                if rest.len() < 2 {
                    return Err(at(format!(
                        "face of {} vertices, expected at least 3",
                        corners.len()
                    )));
                }
                for pair in rest.windows(2) {
                    let triangle = [*first, pair[0], pair[1]];
                    obj.mesh.faces.push(triangle.map(|(vertex, _)| vertex));
                    if let [(_, Some(p)), (_, Some(q)), (_, Some(r))] = triangle {
                        uv.faces.push([p, q, r]);
                    }
                }
            }
            _ => {}
        }
    }
    if !uv.faces.is_empty() && uv.faces.len() == obj.mesh.faces.len() {
        obj.uv = Some(uv);
    }
    Ok(obj)
}

fn numbers<'a, const N: usize>(words: impl Iterator<Item = &'a str>) -> Result<[f32; N], String> {
    let mut values = [0.0f32; N];
    let mut found = 0;
    for (slot, word) in values.iter_mut().zip(words) {
        *slot = word.parse().map_err(|_| format!("`{word}` is not a number"))?;
        if !slot.is_finite() {
            return Err(format!("`{word}` is not a finite number"));
        }
        found += 1;
    }
    if found == N { Ok(values) } else { Err(format!("{found} numbers, expected {N}")) }
}

/// Vertex and texture indices of a face corner `v`, `v/vt`, `v//vn` or `v/vt/vn`; negative numbers
/// count from the end.
fn corner(word: &str, (vertices, points): (usize, usize)) -> Result<(u32, Option<u32>), String> {
    let index = |text: &str, count: usize, kind: &str| {
        let number: i64 =
            text.parse().map_err(|_| format!("`{word}` is not v, v/vt, v//vn or v/vt/vn"))?;
        let position =
            if number < 0 { number.checked_add(count as i64) } else { number.checked_sub(1) };
        position
            .and_then(|position| u32::try_from(position).ok())
            .filter(|&position| (position as usize) < count)
            .ok_or_else(|| format!("{kind} {number} is out of range: {count} defined so far"))
    };
    let mut parts = word.split('/');
    let vertex = index(parts.next().unwrap_or_default(), vertices, "vertex")?;
    let point = match parts.next() {
        None | Some("") => None,
        Some(text) => Some(index(text, points, "texture coordinate")?),
    };
    Ok((vertex, point))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::mesh::tests::cube;

    fn message(text: &str) -> String {
        let fault = parse(text.as_bytes()).err().unwrap();
        format!("{}: {}", fault.line, fault.message)
    }

    #[test]
    fn polygons_are_triangulated_with_texture_coordinates() {
        let text = "# a comment\r\nmtllib a.mtl\nv 0 0 0\nv 1 0 0 1\nv 1 1 0 0.5 0.5 0.5\nv 0 1 0\n\
                    v 9 9 9\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 0 0 1\ng \u{e9}\n\
                    f 1/1/1 2/2/1 \\\n 3/3/1 4/4/1\nf -5/-4 -3/-2 -2/-1\n";
        let obj = parse(text.as_bytes()).ok().unwrap();
        // The isolated vertex keeps its index.
        assert_eq!(obj.mesh.vertices.len(), 5);
        assert_eq!(obj.mesh.faces, [[0, 1, 2], [0, 2, 3], [0, 2, 3]]);
        let uv = obj.uv.unwrap();
        assert_eq!(uv.coordinates[3], [0.0, 1.0]);
        assert_eq!(uv.faces, [[0, 1, 2], [0, 2, 3], [0, 2, 3]]);
        let partly = format!("{text}f 1 2 3\n");
        assert_eq!(parse(partly.as_bytes()).ok().unwrap().uv, None);
    }

    #[test]
    fn faults_name_their_line() {
        assert_eq!(message("v 1 2\n"), "1: 2 numbers, expected 3");
        assert_eq!(message("\nv 1 2 x\n"), "2: `x` is not a number");
        assert_eq!(message("v 1 nan 2\n"), "1: `nan` is not a finite number");
        assert_eq!(message("v 1 1 1\nf 1 1 2\n"), "2: vertex 2 is out of range: 1 defined so far");
        assert_eq!(message("v 1 1 1\nf 1 1 0\n"), "2: vertex 0 is out of range: 1 defined so far");
        assert_eq!(message("v 1 1 1\nf 1 1\n"), "2: face of 2 vertices, expected at least 3");
        assert_eq!(message("f a b c\n"), "1: `a` is not v, v/vt, v//vn or v/vt/vn");
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
