use std::path::PathBuf;

use super::{tests::cube, *};
use crate::gltf;

struct Files(tempfile::TempDir);

impl Files {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn write(&self, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
        let path = self.0.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    }

    fn read(&self, name: &str, bytes: impl AsRef<[u8]>) -> MeshFile {
        MeshFile::read(self.write(name, bytes)).unwrap()
    }

    fn message(&self, name: &str, bytes: impl AsRef<[u8]>) -> String {
        Mesh::load(self.write(name, bytes)).unwrap_err().to_string()
    }
}

/// Corners of the triangles of a mesh, in order.
fn corners(mesh: &Mesh) -> Vec<[[f32; 3]; 3]> {
    mesh.faces.iter().map(|face| face.map(|corner| mesh.vertices[corner as usize])).collect()
}

fn binary_stl(header: &[u8], mesh: &Mesh) -> Vec<u8> {
    let mut bytes = header.to_vec();
    bytes.resize(80, b' ');
    bytes.extend((mesh.faces.len() as u32).to_le_bytes());
    for corners in corners(mesh) {
        bytes.extend([0; 12]);
        bytes.extend(corners.as_flattened().iter().flat_map(|x| x.to_le_bytes()));
        bytes.extend([0; 2]);
    }
    bytes
}

fn text_stl(name: &str, mesh: &Mesh) -> String {
    let facet = |corners: [[f32; 3]; 3]| {
        let vertices = corners.map(|[x, y, z]| format!("vertex {x} {y} {z}\n")).concat();
        format!("facet normal 0 0 0\nouter loop\n{vertices}endloop\nendfacet\n")
    };
    let facets: String = corners(mesh).into_iter().map(facet).collect();
    format!("solid {name}\n{facets}endsolid {name}\n")
}

fn off(header: &str, mesh: &Mesh, of_vertex: &str) -> String {
    let vertices = mesh.vertices.iter().map(|[x, y, z]| format!("{x} {y} {z}{of_vertex}\n"));
    let faces = mesh.faces.iter().map(|[a, b, c]| format!("3 {a} {b} {c} 255 0 0\n"));
    format!("{header}8 12 0\n{}", vertices.chain(faces).collect::<String>())
}

#[test]
fn stl_is_welded_to_the_mesh_that_was_written() {
    let (files, cube) = (Files::new(), cube());
    // SolidWorks and others begin binary files with `solid`.
    for (name, bytes) in [
        ("binary", binary_stl(b"made by a test", &cube)),
        ("solid", binary_stl(b"solid base facet", &cube)),
        ("text", text_stl("cube", &cube).into_bytes()),
        ("windows", text_stl("cube", &cube).replace('\n', "\r\n").into_bytes()),
        ("old Macintosh", text_stl("cube", &cube).replace('\n', "\r").into_bytes()),
        ("a name of 300 letters", text_stl(&"/".repeat(300), &cube).into_bytes()),
    ] {
        let found = files.read("a.stl", bytes);
        assert_eq!(found.format, MeshFormat::Stl, "{name}");
        assert_eq!(found.mesh.vertices.len(), 8, "{name}");
        assert_eq!(corners(&found.mesh), corners(&cube), "{name}");
        assert_eq!(found.mesh.validate(), MeshReport::default(), "{name}");
    }
    let mut cut = binary_stl(b"", &cube);
    cut.truncate(300);
    assert!(files.message("a.stl", cut).contains("declares 12 triangles, 600 bytes, but 216"));
    let two =
        "solid a\nfacet normal 0 0 0\nouter loop\nvertex 0 0 0\nvertex 0 1 0\nendfacet\nendsolid\n";
    assert!(files.message("a.stl", two).contains("facet 0 has 2 vertices"));
}

#[test]
fn off_is_read_in_its_dialects() {
    let (files, cube) = (Files::new(), cube());
    for (name, text) in [
        ("plain", off("OFF\n", &cube, "")),
        // ModelNet has the counts on the first line, partly without a space.
        ("counts on the first line", off("OFF ", &cube, "")),
        ("counts behind the word", off("OFF", &cube, "")),
        ("comments and empty lines", off("# a\nOFF\n\n# b\n", &cube, " # c\n")),
        ("colours without COFF", off("OFF\n", &cube, " 0.5 0.5 0.5 1")),
        ("colours", off("COFF\n", &cube, " 255 0 0 255")),
        ("byte-order mark", format!("\u{feff}{}", off("OFF\r\n", &cube, ""))),
    ] {
        let found = files.read("a.off", text);
        assert_eq!((found.format, &found.mesh), (MeshFormat::Off, &cube), "{name}");
    }
    let normals = files.read("a.off", off("NOFF\n", &cube, " 0 0 1")).normals.unwrap();
    assert_eq!(normals, [[0.0, 0.0, 1.0]; 8]);
    let quad = files.read("a.off", "OFF\n4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n2 0 1\n");
    assert_eq!((quad.mesh.faces.len(), quad.skipped_faces), (2, 1));
    let said = |text: &str| files.message("a.off", text);
    assert!(said("OFF\n").contains("no line with the numbers"));
    assert!(said("OFF\n1000000 9 0\n").contains("declares 1000000 vertices"));
    assert!(said("OFF\n1 0 0\n0 x 0\n").contains("line 3: `x` is not a number"));
    assert!(said("OFF\n1 1 0\n0 0 0\n3 0 0 1\n").contains("vertex 1 is out of range"));
    assert!(said("OFF BINARY\n").contains("binary OFF"));
}

#[test]
fn text_without_vertices_is_no_empty_mesh() {
    let files = Files::new();
    let text: String = "\u{feff}v 0 0 0\nv 1 0 0\n".into();
    let wide: Vec<u8> = text.encode_utf16().flat_map(u16::to_le_bytes).collect();
    assert!(files.message("powershell.obj", wide).contains("UTF-16"));
    let message = files.message("semicolons.obj", "# points\n\nv;0;0;0\nv;1;0;0\n");
    assert!(
        message.contains("line 3") && message.contains("expected lines `v x y z`"),
        "{message}"
    );
    // Nothing but comments is an OBJ of no vertices.
    assert_eq!(files.read("empty.obj", "# no vertices\n").mesh.vertices.len(), 0);
}

#[test]
fn the_content_decides_the_format() {
    let (files, cube) = (Files::new(), cube());
    let path = files.0.path().join("cube.ply");
    cube.save(&path).unwrap();
    let ply = std::fs::read(&path).unwrap();
    let found = files.read("named.obj", &ply);
    assert_eq!((found.format, found.mesh), (MeshFormat::Ply, cube.clone()));
    cube.save(path.with_extension("obj")).unwrap();
    let obj = std::fs::read(path.with_extension("obj")).unwrap();
    assert_eq!(files.read("named.stl", &obj).format, MeshFormat::Obj);
    assert_eq!(files.read("no-extension", &obj).mesh, cube);
    let said = |bytes: &[u8]| files.message("scan.obj", bytes);
    assert!(said(b"<!DOCTYPE html><html>").contains("web page"));
    assert!(said(b"version https://git-lfs.github.com/spec/v1\n").contains("git lfs pull"));
    assert!(said(&[0; 100]).contains("zeros"));
    assert!(said(b"").contains("empty"));
    assert!(said(b"PK\x03\x04abc").contains("ZIP"));
    assert!(said(b"Kaydara FBX Binary  \0").contains("FBX"));
    assert!(said(b"{\"asset\": {}}").contains("export it as .glb"));
    assert!(files.message("a.xyz", "1 2 3\n").contains("expected .obj, .ply, .stl, .off or .glb"));
    assert!(Mesh::load(files.0.path()).unwrap_err().to_string().contains("directory"));
}

/// A `.glb` file of one document and its binary part.
fn glb(document: &serde_json::Value, binary: &[u8]) -> Vec<u8> {
    gltf::assemble(document, binary.to_vec()).unwrap()
}

/// A triangle and a quadrilateral in two nodes, the second of which is below the first.
fn scene() -> (serde_json::Value, Vec<u8>) {
    let positions = [[0f32, 0., 0.], [1., 0., 0.], [0., 1., 0.], [1., 1., 0.]];
    let mut binary: Vec<u8> =
        positions.as_flattened().iter().flat_map(|x| x.to_le_bytes()).collect();
    binary.extend([0u16, 1, 2, 0].iter().flat_map(|x| x.to_le_bytes()));
    let document = serde_json::json!({
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [
            {"mesh": 0, "translation": [0, 0, 5], "children": [1]},
            {"mesh": 1, "scale": [2, 2, 2], "rotation": [0, 0, HALF, HALF]},
        ],
        "meshes": [
            {"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]},
            {"primitives": [{"attributes": {"POSITION": 0}, "mode": 5}]},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 48},
            {"buffer": 0, "byteOffset": 48, "byteLength": 8},
        ],
        "buffers": [{"byteLength": 56}],
    });
    (document, binary)
}

/// Sine and cosine of 45°.
const HALF: f64 = std::f64::consts::FRAC_1_SQRT_2;

#[test]
fn glb_nodes_are_placed_in_the_scene() {
    let files = Files::new();
    let (document, binary) = scene();
    let found = files.read("a.glb", glb(&document, &binary));
    let mesh = found.mesh;
    assert_eq!((found.format, mesh.vertices.len()), (MeshFormat::Glb, 7));
    assert_eq!(mesh.faces.len(), 3);
    // The corner at the origin of both nodes is one vertex.
    assert_eq!(mesh.vertices[0], [0.0, 0.0, 5.0]);
    assert_eq!(mesh.faces[1][0], 0);
    // Turned by 90° about z and doubled.
    let [x, y, z] = mesh.vertices[mesh.faces[1][1] as usize];
    assert!(x.abs() < 1e-6 && (y - 2.0).abs() < 1e-6 && z == 5.0, "{x} {y} {z}");
}

#[test]
fn broken_and_compressed_glb_files_are_refused() {
    let files = Files::new();
    let (document, binary) = scene();
    let said = |change: &dyn Fn(&mut serde_json::Value)| {
        let mut changed = document.clone();
        change(&mut changed);
        files.message("a.glb", glb(&changed, &binary))
    };
    let draco = |d: &mut serde_json::Value| {
        d["extensionsRequired"] = serde_json::json!(["KHR_draco_mesh_compression"]);
    };
    assert!(said(&draco).contains("KHR_draco_mesh_compression): export it again without"));
    assert!(said(&|d| d["accessors"][0]["count"] = 5.into()).contains("beyond the 56 bytes"));
    let large = |d: &mut serde_json::Value| {
        d["accessors"][1] = serde_json::json!({
            "bufferView": 0, "byteOffset": 12, "componentType": 5125, "count": 3, "type": "SCALAR",
        });
    };
    assert!(said(&large).contains("vertex 1065353216 is out of range: the mesh has 4"));
    assert!(said(&|d| d["buffers"][0]["uri"] = "a.bin".into()).contains("outside of the file"));
    assert!(said(&|d| d["nodes"] = serde_json::json!([])).contains("no mesh"));
    let mut cyclic = document.clone();
    cyclic["nodes"][1]["children"] = serde_json::json!([0]);
    assert_eq!(files.read("a.glb", glb(&cyclic, &binary)).mesh.faces.len(), 3);
    let whole = glb(&document, &binary);
    assert!(files.message("a.glb", &whole[..whole.len() - 9]).contains("incomplete"));
    assert!(files.message("a.glb", b"glTF\x01\0\0\0").contains("version 1"));
}
