use ndarray::{Array1, array};

use super::*;
use crate::smpl::test_model::random_model;

fn write(path: &Path, model: &SmplModel, change: impl Fn(&mut NpzWriter, &str) -> bool) {
    let mut npz = NpzWriter::create(path).unwrap();
    let tree = array![[u32::MAX, 0, 0, 2], [0, 1, 2, 3]];
    for name in
        ["v_template", "shapedirs", "posedirs", "J_regressor", "weights", "kintree_table", "f"]
    {
        if change(&mut npz, name) {
            continue;
        }
        match name {
            "v_template" => npz.add(name, &model.v_template),
            "shapedirs" => npz.add(name, &model.shapedirs),
            "posedirs" => npz.add(name, &model.posedirs),
            "J_regressor" => npz.add(name, &model.joint_regressor),
            "weights" => npz.add(name, &model.weights),
            "kintree_table" => npz.add(name, &tree),
            _ => npz.add(name, &Array2::from(model.faces.clone())),
        }
        .unwrap();
    }
    npz.add("J", &array![1.0]).unwrap();
    npz.finish().unwrap();
}

#[test]
fn a_body_round_trips() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("body.npz");
    let model = random_model();
    model.save(&path).unwrap();
    assert_eq!(SmplModel::load(&path).unwrap(), model);
}

#[test]
fn documented_variants_are_read() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("body.npz");
    let model = random_model();
    let (j, v) = model.joint_regressor.dim();
    write(&path, &model, |npz, name| {
        match name {
            "posedirs" => {
                let flat = model.posedirs.to_shape((3 * v, 27)).unwrap();
                npz.add(name, &flat).unwrap();
            }
            "J_regressor" => {
                let dense: Array1<f64> = model.joint_regressor.iter().copied().collect();
                let columns = Array1::from_iter((0..j * v).map(|at| (at % v) as i64));
                let starts = Array1::from_iter((0..=j).map(|row| (row * v) as i64));
                npz.add("J_regressor_data", &dense).unwrap();
                npz.add("J_regressor_indices", &columns).unwrap();
                npz.add("J_regressor_indptr", &starts).unwrap();
                npz.add("J_regressor_shape", &array![j as i64, v as i64]).unwrap();
            }
            _ => return false,
        }
        true
    });
    assert_eq!(SmplModel::load(&path).unwrap(), model);
}

#[test]
fn every_fault_names_its_array() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("body.npz");
    let model = random_model();
    let v = model.vertices();
    let cases: [(&str, Option<ArrayD<f64>>, &str); 11] = [
        ("v_template", None, "missing array"),
        ("v_template", Some(Array2::zeros((v, 4)).into_dyn()), "expected [_, 3]"),
        ("shapedirs", Some(Array3::zeros((v - 1, 3, 2)).into_dyn()), "expected [12, 3, _]"),
        ("posedirs", Some(Array3::zeros((v, 3, 26)).into_dyn()), "expected [12, 3, 27]"),
        ("J_regressor", Some(Array2::zeros((3, v)).into_dyn()), "expected [4, 12]"),
        ("weights", Some(Array2::from_elem((v, 4), f64::NAN).into_dyn()), "not finite"),
        (
            "kintree_table",
            Some(array![[-1., 0., 3., 2.], [0., 1., 2., 3.]].into_dyn()),
            "joint 2 has parent 3",
        ),
        (
            "kintree_table",
            Some(array![[0., 0., 0., 2.], [0., 1., 2., 3.]].into_dyn()),
            "joint 0 has parent 0",
        ),
        (
            "kintree_table",
            Some(array![[-1., 0., 0., 2.], [0., 2., 1., 3.]].into_dyn()),
            "numbered 2",
        ),
        ("f", Some(array![[0., 1., 12.]].into_dyn()), "there are 12 vertices"),
        ("f", Some(array![[0., 1., -1.]].into_dyn()), "does not fit u32"),
    ];
    for (field, replacement, expected) in cases {
        write(&path, &model, |npz, name| {
            if name == field
                && let Some(array) = &replacement
            {
                npz.add(name, array).unwrap();
            }
            name == field
        });
        let message = SmplModel::load(&path).unwrap_err().to_string();
        let field = format!("`{field}`");
        assert!(message.contains(expected) && message.contains(&field), "{message}");
    }
}

#[test]
fn compressed_rows_out_of_range_are_refused() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("body.npz");
    let model = random_model();
    for (column, starts, expected) in
        [(12i64, [0i64, 1, 1, 1, 1], "less than 12"), (0, [0, 2, 1, 1, 1], "row starts")]
    {
        write(&path, &model, |npz, name| {
            if name == "J_regressor" {
                npz.add("J_regressor_data", &array![1.0]).unwrap();
                npz.add("J_regressor_indices", &array![column]).unwrap();
                npz.add("J_regressor_indptr", &Array1::from(starts.to_vec())).unwrap();
            }
            name == "J_regressor"
        });
        let message = SmplModel::load(&path).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
}

#[test]
fn bodies_of_other_families_are_named() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("body.npz");
    let model = random_model();
    let v = model.vertices();
    let said = |replaced: &str, array: ArrayD<f64>| {
        write(&path, &model, |npz, name| {
            if name == replaced {
                npz.add(name, &array).unwrap();
            }
            if name == "f" && !["kintree_table", "posedirs"].contains(&replaced) {
                npz.add(replaced, &array).unwrap();
            }
            name == replaced
        });
        SmplModel::load(&path).unwrap_err().to_string()
    };
    // STAR's pose directions of 4 numbers for each joint but the root, and one more.
    let star = said("posedirs", Array3::zeros((v, 3, 13)).into_dyn());
    assert!(star.contains("is a STAR body, expected SMPL's own body"), "{star}");
    for (joints, family) in [(52, "SMPL-H"), (55, "SMPL-X"), (16, "MANO"), (5, "FLAME")] {
        let tree = Array2::from_shape_fn((2, joints), |(row, joint)| {
            if row == 1 { joint as f64 } else { joint as f64 - 1.0 }
        });
        let message = said("kintree_table", tree.into_dyn());
        assert!(message.contains(&format!("is a {family}")), "{message}");
    }
    for (array, family) in
        [("hands_components", "MANO"), ("lmk_faces_idx", "SMPL-X"), ("hands_componentsl", "SMPL-H")]
    {
        let message = said(array, Array1::zeros(3).into_dyn());
        assert!(message.contains(family), "{message}");
    }
}

#[test]
fn files_that_are_no_bodies_are_named() {
    let directory = tempfile::tempdir().unwrap();
    let at = |name: &str| directory.path().join(name);
    random_model().save(at("body.npz")).unwrap();
    let whole = std::fs::read(at("body.npz")).unwrap();
    let html = b"<!DOCTYPE html>\n<html><title>Sign in</title></html>";
    let pointer = b"version https://git-lfs.github.com/spec/v1\noid sha256:1\nsize 39\n";
    let cut = &whole[..whole.len() - 100];
    for name in ["SMPL_MALE.pkl", "body.npz"] {
        for (content, expected) in [
            (&html[..], "web page"),
            (&pointer[..], "git lfs pull"),
            (&[0; 5000], "zeros"),
            (&[], "empty"),
            (cut, "end of the archive is missing"),
            (&b"\x1f\x8b\x08\0\0\0\0\0"[..], "gunzip"),
        ] {
            std::fs::write(at(name), content).unwrap();
            let message = SmplModel::load(at(name)).unwrap_err().to_string();
            assert!(message.contains(expected) && message.contains(name), "{message}");
        }
    }
    // A download of the whole package.
    let mut package = zip::ZipWriter::new(std::fs::File::create(at("SMPL_python.zip")).unwrap());
    package
        .start_file("smpl/models/basicmodel_m.pkl", zip::write::SimpleFileOptions::default())
        .unwrap();
    package.finish().unwrap();
    let message = SmplModel::load(at("SMPL_python.zip")).unwrap_err().to_string();
    assert!(
        message.contains("`smpl/models/basicmodel_m.pkl`") && message.contains("unpack"),
        "{message}"
    );
    // A pickle that ends early.
    let body = std::fs::read("fixtures/pickles/body_protocol0.pkl").unwrap();
    std::fs::write(at("cut.pkl"), &body[..body.len() / 2]).unwrap();
    assert!(SmplModel::load(at("cut.pkl")).is_err());
}

#[test]
fn pickles_of_protocol_0_with_line_ends_of_windows_are_read() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("body.pkl");
    for name in ["body_protocol0.pkl", "body_chumpy_python2_protocol0.pkl"] {
        let source = Path::new("fixtures/pickles").join(name);
        let expected = SmplModel::load(&source).unwrap();
        let text = std::fs::read(&source).unwrap();
        let windows: Vec<u8> =
            text.split(|&byte| byte == b'\n').collect::<Vec<_>>().join(&b"\r\n"[..]);
        std::fs::write(&path, windows).unwrap();
        assert_eq!(SmplModel::load(&path).unwrap(), expected, "{name}");
    }
}
