use super::*;
use crate::{
    PointCacheFormat, PointCacheWriter,
    gltf::{self, Keyframe, SkinnedMesh},
    npy::{NpzWriter, write_npy},
    smpl::test_model::random_model,
};

const FACES: [[u32; 3]; 2] = [[0, 1, 2], [0, 2, 3]];

fn mesh(frame: usize) -> Mesh {
    let square = [[0.0f32, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
    let vertices = square.iter().map(|&[x, y]| [x, y, frame as f32 / 4.0]).collect();
    Mesh { vertices, faces: FACES.to_vec() }
}

fn read(path: &Path) -> Result<MeshSequence> {
    MeshSequence::read(path, &MeshSequenceOptions::default())
}

#[test]
fn directories_are_read_in_natural_order_without_hidden_files() {
    let place = tempfile::tempdir().unwrap();
    // Without leading zeros, among the files of a second sequence and of a file manager.
    for frame in 0..12 {
        mesh(frame).save(place.path().join(format!("f{frame}_cloth.obj"))).unwrap();
        let body = Mesh { vertices: vec![[0.0; 3]; 3], faces: vec![[0, 1, 2]] };
        body.save(place.path().join(format!("f{frame}_body.obj"))).unwrap();
    }
    std::fs::write(place.path().join("._f3_cloth.obj"), b"\0\x05\x16\x07").unwrap();
    let options = MeshSequenceOptions { files: Some("*_cloth.obj".into()), ..Default::default() };
    let found = MeshSequence::read(place.path(), &options).unwrap();
    assert_eq!((found.faces.as_slice(), found.positions.dim()), (&FACES[..], (12, 4, 3)));
    for frame in 0..12 {
        assert_eq!(found.positions[(frame, 2, 2)], frame as f64 / 4.0);
    }
    let both = read(place.path()).unwrap_err().to_string();
    assert!(both.contains("pattern of its file names"), "{both}");
    let none = MeshSequenceOptions { files: Some("x*".into()), ..Default::default() };
    let none = MeshSequence::read(place.path(), &none).unwrap_err().to_string();
    assert!(none.contains("no meshes named `x*`"), "{none}");
}

#[test]
fn caches_and_arrays_take_the_triangles_of_a_mesh() {
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name);
    let expected = Array3::from_shape_fn((3, 4, 3), |(frame, vertex, axis)| {
        f64::from(mesh(frame).vertices[vertex][axis])
    });
    for (name, format) in [("a.pc2", PointCacheFormat::Pc2), ("a.mdd", PointCacheFormat::Mdd)] {
        let mut cache = PointCacheWriter::create(at(name), format, [3, 4], 25.0).unwrap();
        for frame in 0..3 {
            cache.push(&mesh(frame).vertices).unwrap();
        }
        cache.finish().unwrap();
    }
    write_npy(at("a.npy"), &expected).unwrap();
    let alone = read(&at("a.pc2")).unwrap_err().to_string();
    assert!(alone.contains("has no triangles"), "{alone}");
    mesh(0).save(at("a.obj")).unwrap();
    for (name, rate) in [("a.pc2", None), ("a.mdd", Some(25.0)), ("a.npy", None)] {
        let found = read(&at(name)).unwrap();
        assert_eq!((found.faces.as_slice(), &found.positions), (&FACES[..], &expected), "{name}");
        assert_eq!(found.frame_rate.map(|rate| (1e3 * rate).round() / 1e3), rate, "{name}");
    }
    let mut few = mesh(0);
    few.vertices.pop();
    few.faces.pop();
    few.save(at("few.ply")).unwrap();
    let options = MeshSequenceOptions { topology: Some(at("few.ply")), ..Default::default() };
    let other = MeshSequence::read(at("a.pc2"), &options).unwrap_err().to_string();
    assert!(other.contains("4 points, but") && other.contains("has 3 vertices"), "{other}");
}

#[test]
fn archives_hold_vertices_and_faces() {
    let place = tempfile::tempdir().unwrap();
    let path = place.path().join("a.npz");
    let positions = Array3::from_shape_fn((2, 4, 3), |(f, v, k)| (f + v + k) as f64);
    let mut archive = NpzWriter::create(&path).unwrap();
    archive.add("vertices", &positions).unwrap();
    archive.add("faces", &Array2::from(vec![[0i64, 1, 2], [0, 2, 3]])).unwrap();
    archive.add("fps", &ndarray::arr1(&[50.0])).unwrap();
    archive.finish().unwrap();
    let found = read(&path).unwrap();
    assert_eq!((found.faces.as_slice(), found.frame_rate), (&FACES[..], Some(50.0)));
    assert_eq!(found.positions, positions);
    let mut archive = NpzWriter::create(&path).unwrap();
    archive.add("poses", &Array2::<f64>::zeros((2, 72))).unwrap();
    archive.finish().unwrap();
    let message = read(&path).unwrap_err().to_string();
    assert!(message.contains("expected vertices, clothing") && message.contains("it has poses"));
}

#[test]
fn animated_gltf_is_sampled() {
    let body = random_model();
    let skinned = SkinnedMesh {
        name: "moving",
        body: &body,
        rest: body.v_template.clone(),
        joints: body.rest_joints(&body.v_template).unwrap(),
        colours: None,
        texture: None,
        targets: Vec::new(),
    };
    let size = 3 * body.joints();
    let pose =
        |step: usize| -> Vec<f64> { (0..size).map(|k| 0.3 * ((k + step) as f64).sin()).collect() };
    let clothing = |step: usize| {
        Array2::from_shape_fn(body.v_template.dim(), |(v, k)| 0.01 * (v * k * step) as f64)
    };
    let transl = |step: usize| [0.5 * step as f64, 0.0, 1.0];
    let keyframe = |step: usize| Keyframe {
        time: step as f32 / 10.0,
        pose: pose(step),
        transl: transl(step),
        offset: Some(body.pose_offsets(&pose(step)).unwrap() + clothing(step)),
    };
    let keyframes: Vec<Keyframe> = (0..3).map(keyframe).collect();
    let place = tempfile::tempdir().unwrap();
    let path = place.path().join("a.glb");
    gltf::write(&path, &skinned, &keyframes).unwrap();
    let found = read(&path).unwrap();
    assert_eq!((found.frames(), found.faces.clone()), (3, body.faces.clone()));
    assert!((found.frame_rate.unwrap() - 10.0).abs() < 1e-4);
    for step in 0..3 {
        let clothing = clothing(step);
        let posed =
            body.pose_shape(&body.v_template, &pose(step), transl(step), Some(&clothing)).unwrap();
        let frame = found.positions.index_axis(Axis(0), step);
        for (a, b) in frame.iter().zip(&posed.vertices) {
            assert!((a - b).abs() < 1e-4, "frame {step}: {a} {b}");
        }
    }
    let options = MeshSequenceOptions { frame_rate: Some(20.0), ..Default::default() };
    assert_eq!(MeshSequence::read(&path, &options).unwrap().frames(), 5);
    gltf::write(&path, &skinned, &keyframes[..1]).unwrap();
    assert!(read(&path).unwrap_err().to_string().contains("no animation"));
}

#[test]
fn sequences_are_resampled_and_moved() {
    let positions = Array3::from_shape_fn((5, 2, 3), |(f, v, k)| (f * f + v + k) as f64);
    let sequence = MeshSequence { faces: Vec::new(), positions, frame_rate: None };
    let half = sequence.resampled(20.0, 10.0).unwrap();
    assert_eq!((half.frames(), half.positions[(1, 0, 0)]), (3, 4.0));
    let double = sequence.resampled(20.0, 40.0).unwrap();
    assert_eq!((double.frames(), double.positions[(3, 0, 0)]), (9, 2.5));
    assert!(sequence.resampled(0.0, 30.0).is_err());
    assert!(sequence.resampled(1e-6, 1e6).is_err());
    let place = DAffine3::from_scale(DVec3::splat(0.01));
    assert_eq!(sequence.moved(place).positions[(4, 1, 2)], 0.19);
}

#[test]
fn patterns_of_file_names() {
    for (pattern, name, fits) in [
        ("*", "", true),
        ("a*.obj", "a.obj", true),
        ("a*.obj", "ab.c.obj", true),
        ("a?.obj", "a.obj", false),
        ("*_cloth*", "f1_cloth.ply", true),
        ("*a*b", "aab", true),
        ("*a*b", "aabc", false),
        ("", "a", false),
    ] {
        assert_eq!(matches(pattern, name), fits, "{pattern} {name}");
    }
}
