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
