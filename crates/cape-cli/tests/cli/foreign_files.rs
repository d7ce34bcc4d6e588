//! Files that other programs wrote, or that are not what their names say.

use std::{fs, path::Path};

use cape::core::{
    MeshFile, SmplModel,
    npy::NpzWriter,
    obj::{self, Uv},
};
use ndarray::{Array2, Array3};

use crate::support::{Packed, Ran, VERTICES, run, small_body, trained};

fn info(path: &Path) -> Ran {
    run(["info", "--json", &path.display().to_string()])
}

#[test]
fn what_is_not_a_body_or_mesh_is_named() {
    let place = tempfile::tempdir().unwrap();
    let html = b"<!DOCTYPE html><title>Sign in</title>".to_vec();
    let pointer = b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n".to_vec();
    for name in ["SMPL_MALE.pkl", "body.npz", "scan.ply", "scan.obj", "a.npy", "a.safetensors"] {
        let path = place.path().join(name);
        for (content, expected) in [
            (&html, "web page"),
            (&pointer, "git lfs pull"),
            (&vec![0; 999], "zeros"),
            (&vec![], "empty"),
        ] {
            fs::write(&path, content).unwrap();
            info(&path).failed_saying(&[name, expected]);
        }
    }
}

#[test]
fn bodies_of_star_are_named() {
    let place = tempfile::tempdir().unwrap();
    let body = small_body();
    let path = place.path().join("star.npz");
    let mut file = NpzWriter::create(&path).unwrap();
    file.add("v_template", &body.v_template).unwrap();
    file.add("shapedirs", &body.shapedirs).unwrap();
    file.add("posedirs", &Array3::<f64>::zeros((VERTICES, 3, 93))).unwrap();
    file.add("J_regressor", &body.joint_regressor).unwrap();
    file.add("weights", &body.weights).unwrap();
    let tree = Array2::from_shape_fn((2, 24), |(row, joint)| match row {
        0 => body.parents[joint].map_or(-1, |parent| parent as i64),
        _ => joint as i64,
    });
    file.add("kintree_table", &tree).unwrap();
    file.add("f", &Array2::from(body.faces.clone())).unwrap();
    file.finish().unwrap();
    info(&path).failed_saying(&["is a STAR body, expected SMPL's own body"]);
}

#[test]
fn meshes_of_every_dialect_are_described() {
    let place = tempfile::tempdir().unwrap();
    let cube = (0..8).map(|i| format!("v {} {} {}\n", i & 1, i >> 1 & 1, i >> 2));
    let cube = cube.collect::<Vec<_>>().concat();
    let faces = "f 1 3 4 2\nf 5 6 8 7\nf 1 2 6 5\nf 3 7 8 4\nf 1 5 7 3\nf 2 4 8 6\n";
    let off_faces = "4 0 2 3 1\n4 4 5 7 6\n4 0 1 5 4\n4 2 6 7 3\n4 0 4 6 2\n4 1 3 7 5\n";
    let off = format!("OFF8 6 0\n{}{off_faces}", cube.replace("v ", ""));
    for (name, text, skipped) in [
        ("mark.obj", format!("\u{feff}{cube}{faces}"), 0),
        ("edge.obj", format!("{cube}f 1 2\n{faces}"), 1),
        ("twice.obj", format!("{cube}f 4 4 5\n{faces}"), 1),
        ("comment.obj", format!("{cube}{}", faces.replace('\n', " # a side\n")), 0),
        ("macintosh.obj", format!("{cube}{faces}").replace('\n', "\r"), 0),
        ("modelnet.off", off.clone(), 0),
        ("named.ply", off, 0),
    ] {
        let path = place.path().join(name);
        fs::write(&path, text).unwrap();
        let found = info(&path).json();
        assert_eq!((&found["vertices"], &found["faces"]), (&8.into(), &12.into()), "{name}");
        assert_eq!(found["faces of fewer than 3 corners, left out"], skipped, "{name}");
    }
    let path = place.path().join("comma.obj");
    fs::write(&path, "v 0,1 0,2 0,3\n").unwrap();
    info(&path).failed_saying(&["line 1", "`0,1`", "decimal comma"]);
    // What this program writes is read again, skeleton and all.
    let run_path = trained().at("run").display().to_string();
    let out = place.path().join("samples").display().to_string();
    run([
        "sample",
        &run_path,
        "--outfit",
        "longlong",
        "--format",
        "glb",
        "--no-picture",
        "--out",
        &out,
    ])
    .succeeded();
    let glb = fs::read_dir(&out).unwrap().map(|entry| entry.unwrap().path());
    let glb = glb.into_iter().find(|path| path.extension().is_some_and(|e| e == "glb")).unwrap();
    let mesh = MeshFile::read(glb).unwrap().mesh;
    assert_eq!(mesh.faces, small_body().faces);
}

#[test]
fn texture_coordinates_of_other_triangles_are_taken() {
    let data = Packed::new();
    data.train().succeeded();
    let mesh = SmplModel::load(data.at("run/body.npz")).unwrap().mesh();
    let coordinates: Vec<[f32; 2]> =
        (0..VERTICES).map(|v| [v as f32 / VERTICES as f32, 0.5]).collect();
    let write = |name: &str, faces: Vec<[u32; 3]>| {
        let other = cape::core::Mesh { faces: faces.clone(), ..mesh.clone() };
        let uv = Uv { coordinates: coordinates.clone(), faces };
        obj::write(data.at(name), &other, Some(&uv)).unwrap();
    };
    write("same.obj", mesh.faces.clone());
    write("turned.obj", mesh.faces.iter().map(|&[a, b, c]| [b, c, a]).collect());
    write("back.obj", mesh.faces.iter().rev().copied().collect());
    let sample = |name: &str| {
        let options = "--outfit longlong --no-picture";
        data.run(&format!("sample @/run {options} --uv @/{name}.obj --out @/with-{name}"))
    };
    let read = |name: &str| obj::read(data.at(&format!("with-{name}/longlong_001.obj"))).unwrap();
    for name in ["same", "turned", "back"] {
        sample(name).succeeded();
        assert_eq!(read(name), read("same"), "{name}");
    }
    assert_eq!(read("same").uv.unwrap().faces, mesh.faces);
    let mut other = mesh.faces.clone();
    other[5] = [0, 1, VERTICES as u32 - 1];
    write("other.obj", other);
    sample("other").failed_saying(&["other.obj", "face 5", "same mesh"]);
    let few = cape::core::Mesh { vertices: mesh.vertices[..50].to_vec(), faces: vec![[0, 1, 2]] };
    let uv = Uv { coordinates, faces: few.faces.clone() };
    obj::write(data.at("few.obj"), &few, Some(&uv)).unwrap();
    sample("few").failed_saying(&["50 vertices", &VERTICES.to_string()]);
}
