//! Data that are not what they must be: each is an error that names the file and what is wrong.

use std::fs;

use cape::core::npy::{NpzWriter, read_f64, write_npy};
use ndarray::{Array2, Array3, s};

use crate::support::{Packed, Ran, VERTICES, truncate, write_raw};

fn train(data: &Packed) -> Ran {
    data.run("train --data @/packed --out @/run --preset tiny --epochs 1 --batch 4 --quiet")
}

#[test]
fn missing_arrays() {
    for name in ["train_disp.npy", "train_pose.npy", "train_clo_label.npy"] {
        let data = Packed::new();
        fs::remove_file(data.at("packed/train").join(name)).unwrap();
        train(&data).failed_saying(&[name, "No such file"]);
        assert!(!data.at("run").exists());
    }
}

#[test]
fn truncated_arrays() {
    let data = Packed::new();
    truncate(&data.at("packed/train/train_disp.npy"));
    train(&data).failed_saying(&["train_disp.npy", "bytes"]);

    let data = Packed::new();
    truncate(&data.at("packed/stats.npz"));
    train(&data).failed_saying(&["stats.npz"]);

    let data = Packed::new();
    truncate(&data.at("packed/body.npz"));
    train(&data).failed_saying(&["body.npz", "archive"]);

    let data = Packed::new();
    fs::write(data.at("packed/train/train_rot.npy"), b"").unwrap();
    train(&data).failed_saying(&["train_rot.npy"]);
}

#[test]
fn wrong_shapes() {
    let data = Packed::new();
    let path = data.at("packed/train/train_pose.npy");
    let rows = read_f64(&path).unwrap().shape()[0];
    write_npy(&path, &Array2::<f64>::zeros((rows, 71))).unwrap();
    train(&data).failed_saying(&["train_pose.npy", "71", "72"]);
    write_npy(&path, &Array2::<f64>::zeros((rows - 1, 72))).unwrap();
    train(&data).failed_saying(&["train_pose.npy", "frames"]);

    let path = data.at("packed/train/train_disp.npy");
    write_npy(&path, &Array2::<f64>::zeros((rows, 3 * VERTICES))).unwrap();
    train(&data).failed_saying(&["train_disp.npy", "shape"]);
}

#[test]
fn wrong_types() {
    let data = Packed::new();
    let path = data.at("packed/train/train_disp.npy");
    for (descr, size) in [("<U2", 8), ("<c16", 16)] {
        let header =
            format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': (4, 2, 3), }}");
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend(((header.len() + 1) as u16).to_le_bytes());
        bytes.extend(header.as_bytes());
        bytes.push(b'\n');
        bytes.extend(vec![0; 24 * size]);
        fs::write(&path, bytes).unwrap();
        train(&data).failed_saying(&["train_disp.npy", descr]);
    }
}

#[test]
fn numbers_that_are_not_finite() {
    for bad in [f64::NAN, f64::INFINITY] {
        let data = Packed::new();
        let path = data.at("packed/train/train_disp.npy");
        let mut array = read_f64(&path).unwrap();
        array[[3, 5, 1]] = bad;
        write_npy(&path, &array).unwrap();
        train(&data).failed_saying(&["train_disp.npy"]);
    }
}

#[test]
fn raw_frames_that_cannot_be_used_are_left_out_or_refused() {
    for bad in [f64::NAN, f64::NEG_INFINITY] {
        let data = Packed::new();
        let frame = data.at("raw/sequences/ann/longlong_walk/longlong_walk.000004.npz");
        let mut vertices = Array2::<f64>::zeros((VERTICES, 3));
        vertices[[7, 2]] = bad;
        let mut file = NpzWriter::create(&frame).unwrap();
        file.add("v_cano", &vertices).unwrap();
        file.add("pose", &ndarray::Array1::<f64>::zeros(72)).unwrap();
        file.finish().unwrap();

        let report = data.run("data pack @/raw --out @/again --json").json();
        let reason = report["broken"][0]["reason"].as_str().unwrap();
        assert!(reason.contains("vertex 7") && reason.contains("not finite"), "{reason}");
        data.run("data pack @/raw --out @/strict --strict")
            .failed_saying(&["longlong_walk.000004.npz", "vertex 7"]);
        assert!(!data.at("strict").exists());

        truncate(&frame);
        let report = data.run("data pack @/raw --out @/third --json").json();
        assert_eq!(report["broken"].as_array().unwrap().len(), 1);
    }
}

#[test]
fn a_truncated_minimal_shape() {
    let data = Packed::new();
    truncate(&data.at("raw/minimal_body_shape/ann/ann_minimal.npy"));
    data.run("data pack @/raw --out @/again").failed_saying(&["ann_minimal.npy"]);
}

#[test]
fn empty_data() {
    let data = Packed::new();
    let mut raw = data.at("raw");
    raw.push("sequences/ann");
    fs::remove_dir_all(&raw).unwrap();
    fs::create_dir(&raw).unwrap();
    data.run("data pack @/raw --out @/again").failed_saying(&["raw"]);
    assert!(!data.at("again").exists());

    write_npy(data.at("packed/train/train_disp.npy"), &Array3::<f64>::zeros((0, VERTICES, 3)))
        .unwrap();
    train(&data).failed_saying(&["train_disp.npy", "no frames"]);

    fs::create_dir(data.at("nothing")).unwrap();
    data.run("data pack @/nothing --out @/again").failed_saying(&["no split.toml", "--preset"]);
    data.run("info @/nothing").failed_saying(&["unknown kind of directory"]);
}

#[test]
fn sequences_too_short_to_cut() {
    let root = tempfile::tempdir().unwrap();
    let raw = root.path().join("raw");
    write_raw(&raw, 4);
    let words = ["data", "pack", raw.to_str().unwrap(), "--out", "unused"];
    crate::support::run(words).failed_saying(&["raw"]);
}

#[test]
fn one_frame_is_enough_to_train_on() {
    let data = Packed::new();
    for name in ["disp", "pose", "rot", "clo_label"] {
        let path = data.at(&format!("packed/train/train_{name}.npy"));
        let first = read_f64(&path).unwrap().slice_axis(ndarray::Axis(0), (0..1).into()).to_owned();
        write_npy(&path, &first).unwrap();
    }
    fs::remove_file(data.at("packed/train/train_frames.csv")).unwrap();
    fs::remove_file(data.at("packed/stats.npz")).unwrap();
    train(&data).succeeded();
    data.run("eval run @/run --data @/packed").succeeded();
}

#[test]
fn labels_that_are_not_one_hot() {
    let data = Packed::new();
    let path = data.at("packed/train/train_clo_label.npy");
    for (bad, said) in [
        ([1.0, 1.0, 0.0, 0.0], "one-hot"),
        ([0.0; 4], "one-hot"),
        ([0.5, 0.5, 0.0, 0.0], "one-hot"),
        ([f64::NAN, 0.0, 0.0, 1.0], "not finite"),
    ] {
        let mut labels = read_f64(&path).unwrap();
        let good = labels.clone();
        labels.slice_mut(s![2, ..]).assign(&ndarray::arr1(&bad));
        write_npy(&path, &labels).unwrap();
        train(&data).failed_saying(&["train_clo_label.npy", " 2`", said]);
        write_npy(&path, &good).unwrap();
    }
}

#[test]
fn bodies_that_do_not_fit() {
    let data = Packed::new();
    let body = data.at("packed/body.npz");
    fs::copy(data.at("packed/stats.npz"), &body).unwrap();
    train(&data).failed_saying(&["body.npz", "v_template", "missing"]);
    fs::remove_file(&body).unwrap();
    train(&data).failed_saying(&["body.npz", "not found"]);
    data.run("train --data @/packed --out @/run --preset tiny --body @/raw/nobody.npz")
        .failed_saying(&["nobody.npz"]);
}

#[test]
fn meshes_that_cannot_be_simplified() {
    let root = tempfile::tempdir().unwrap();
    let path = root.path().join("mesh.obj");
    let corner = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nv 1 1 1\n";
    let faces = "f 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n";
    for (text, said) in [
        (String::new(), "mesh.obj"),
        (corner.to_owned(), "no faces"),
        (corner.replace("1 1 1", "nan 1 1") + faces + "f 2 3 5\n", "mesh.obj"),
        (corner.replace("1 1 1", "1 inf 1") + faces + "f 2 3 5\n", "mesh.obj"),
        (corner.to_owned() + faces, "vertices belong to no face"),
        (corner.to_owned() + faces + "f 2 3 9\n", "9"),
        (corner.to_owned() + faces + "f 2 3 5\n", "at least 4"),
    ] {
        fs::write(&path, &text).unwrap();
        let out = root.path().join("out");
        let words = ["model", "pyramid", path.to_str().unwrap(), "--out", out.to_str().unwrap()];
        let ran = crate::support::run(words);
        let said = if ran.err.contains("mesh: ") {
            said.replace("mesh.obj", "mesh: ")
        } else {
            said.into()
        };
        ran.failed_saying(&[&said]);
        assert!(!out.exists());
    }
}
