use proptest::prelude::*;

use super::*;
use crate::mesh::tests::cube;

fn file(mesh: &Mesh, colours: Option<&[[u8; 3]]>) -> Vec<u8> {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("a.ply");
    write(&path, mesh, colours).unwrap();
    assert_eq!(read(&path).unwrap(), *mesh);
    std::fs::read(&path).unwrap()
}

#[test]
fn files_round_trip_with_colours() {
    let bytes = file(&cube(), Some(&[[1, 2, 3]; 8]));
    assert_eq!(bytes.len(), file(&cube(), None).len() + 8 * 3 + 60);
    assert!(write("a.ply", &cube(), Some(&[])).is_err());
    let mut written = Vec::new();
    write_to(&mut written, &cube(), Some(&[[1, 2, 3]; 8])).unwrap();
    assert_eq!(written, bytes);
    assert!(write_to(&mut written, &cube(), Some(&[])).is_err());
}

#[test]
fn text_and_big_endian_are_read() {
    let header = |format: &str| {
        format!(
            "ply\r\nformat {format} 1.0\ncomment made by hand\nelement other 1\n\
             property list uchar short a\nelement vertex 4\nproperty double x\n\
             property float y\nproperty uchar quality\nproperty float z\nelement face 1\n\
             property uchar flag\nproperty list uchar int vertex_index\nend_header\n"
        )
    };
    let expected = Mesh {
        vertices: vec![[0., 0., 0.5], [1., 0., 0.5], [1., 1., 0.5], [0., 1., 0.5]],
        faces: vec![[0, 1, 2], [0, 2, 3]],
    };
    let text = header("ascii") + "2 7 -8\n0 0 9 .5\n1 0 9 .5 1 1 9 .5\n0 1 9 5e-1\n1 4 0 1 2 3";
    assert_eq!(parse(text.as_bytes()).unwrap().mesh, expected);
    let mut binary = header("binary_big_endian").into_bytes();
    binary.extend([1, 0, 7]);
    for [x, y, z] in &expected.vertices {
        binary.extend(f64::from(*x).to_be_bytes());
        binary.extend(y.to_be_bytes());
        binary.push(9);
        binary.extend(z.to_be_bytes());
    }
    binary.extend([1, 4]);
    binary.extend([0i32, 1, 2, 3].iter().flat_map(|i| i.to_be_bytes()));
    assert_eq!(parse(&binary).unwrap().mesh, expected);
}

#[test]
fn normals_of_vertices_are_read() {
    let properties = ["x", "nx", "ny", "nz", "y", "z"].map(|p| format!("property float {p}\n"));
    let header = |properties: &[String]| {
        let properties = properties.concat();
        format!("ply\nformat ascii 1.0\nelement vertex 1\n{properties}end_header\n1 2 3 4 5 6\n")
    };
    let Geometry { mesh, normals, .. } = parse(header(&properties).as_bytes()).unwrap();
    assert_eq!((mesh.vertices[0], normals), ([1.0, 5.0, 6.0], Some(vec![[2.0, 3.0, 4.0]])));
    let text = header(&properties).replace(" nz", " weight");
    assert_eq!(parse(text.as_bytes()).unwrap().normals, None);
}

#[test]
fn dialects_are_read() {
    let expected = cube();
    let vertex = "property float x\nproperty float y\nproperty float z\n";
    let points = expected.vertices.iter().map(|[x, y, z]| format!("{x} {y} {z}\n"));
    let points = points.collect::<Vec<_>>().concat();
    let header = |elements: &str| {
        format!("ply\nformat ascii 1.0\nelement vertex 8\n{vertex}{elements}end_header\n{points}")
    };
    let list = "property list uchar int vertex_indices\n";
    let triangles = expected.faces.iter().map(|[a, b, c]| format!("3 {a} {b} {c}\n"));
    let triangles = triangles.collect::<Vec<_>>().concat();
    let full = format!("{}{triangles}", header(&format!("element face 12\n{list}")));
    // A face of two corners, one of repeated corners, one of none.
    let more =
        format!("{}{triangles}2 0 1\n3 4 4 5\n0\n", header(&format!("element face 15\n{list}")));
    for (name, text) in [
        ("byte-order mark", format!("\u{feff}{full}")),
        ("lone carriage returns", full.replace('\n', "\r")),
        ("line ends of Windows", full.replace('\n', "\r\n")),
        ("faces of fewer corners", more.clone()),
    ] {
        assert_eq!(parse(text.as_bytes()).unwrap().mesh, expected, "{name}");
    }
    assert_eq!(parse(more.as_bytes()).unwrap().skipped, 3);
    for text in [header(&format!("element face 0\n{list}")), header("element face 0\n"), header("")]
    {
        let found = parse(text.as_bytes()).unwrap().mesh;
        assert_eq!((found.vertices.len(), found.faces.len()), (8, 0));
    }
    // Two strips in one list, separated by −1.
    let strips = format!(
        "{}9 0 1 2 3 -1 4 5 6 7\n",
        header("element tristrips 1\nproperty list int int vertex_indices\n")
    );
    let faces = parse(strips.as_bytes()).unwrap().mesh.faces;
    assert_eq!(faces, [[0, 1, 2], [2, 1, 3], [4, 5, 6], [6, 5, 7]]);
    let windows = header("").replacen("0 0 0", "-nan(ind) 1.#QNAN -1.#IND", 1);
    let found = parse(windows.as_bytes()).unwrap().mesh;
    assert!(found.vertices[0].iter().all(|x| x.is_nan()));
    assert_eq!(found.vertices[1..], expected.vertices[1..]);
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("a.ply");
    std::fs::write(&path, windows).unwrap();
    assert!(read(&path).unwrap_err().to_string().contains("vertex 0 is not finite"));
}

#[test]
fn faults_say_what_is_wrong() {
    let vertex = "property float x\nproperty float y\nproperty float z\n";
    let face = "property list uchar int vertex_indices\n";
    let cases = [
        ("plyx\n".to_owned(), "not a PLY file"),
        ("ply\nformat ascii 1.0\n".to_owned(), "does not end"),
        ("ply\nelement vertex 0\nend_header\n".to_owned(), "no `format`"),
        ("ply\nformat ascii 1.0\nend_header\n".to_owned(), "no element `vertex`"),
        (
            format!(
                "ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\n{vertex}end_header\n"
            ),
            "declares 4000000000",
        ),
        (
            format!(
                "ply\nformat ascii 1.0\nelement vertex 1\n{vertex}element face 1\n{face}end_header\n0 0 0\n3 0 2 1\n"
            ),
            "out of range for 1 vertices",
        ),
        (
            format!(
                "ply\nformat ascii 1.0\nelement vertex 1\n{vertex}element face 1\nend_header\n0 0 0\n"
            ),
            "no list property `vertex_indices`",
        ),
        (
            format!("ply\nformat ascii 1.0\nelement vertex 1\n{vertex}end_header\n0,5 0 0\n"),
            "decimal comma",
        ),
    ];
    for (text, expected) in cases {
        let message = parse(text.as_bytes()).err().unwrap();
        assert!(message.contains(expected), "{message}");
    }
    let mut bytes = file(&cube(), None);
    bytes.pop();
    assert!(parse(&bytes).err().unwrap().contains("unexpected end"));
}

proptest! {
    #[test]
    fn no_bytes_make_the_reader_panic(
        bytes: Vec<u8>,
        at: prop::sample::Index,
        value: u8,
        keep: prop::sample::Index,
    ) {
        let _ = parse(&bytes);
        let mut changed = file(&cube(), None);
        let position = at.index(changed.len());
        changed[position] = value;
        let _ = parse(&changed);
        changed.truncate(keep.index(changed.len()));
        let _ = parse(&changed);
    }
}
