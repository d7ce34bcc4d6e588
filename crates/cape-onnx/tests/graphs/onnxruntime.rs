//! ONNX Runtime.

use std::{fs, path::Path, process::Command};

use cape_core::npy::NpzWriter;
use cape_onnx::export_model;

use crate::{
    BATCHES,
    models::{cases, expected},
};

#[test]
fn graphs_give_the_same_results_in_onnxruntime() {
    let Some(python) = std::env::var_os("CAPE_ONNX_PYTHON") else {
        println!("SKIPPED: CAPE_ONNX_PYTHON names no Python with onnx and onnxruntime");
        return;
    };
    let place = tempfile::tempdir().unwrap();
    let cases = cases();
    for (name, model, precision) in &cases {
        let directory = place.path().join(name);
        fs::create_dir(&directory).unwrap();
        export_model(model, &directory, *precision).unwrap();
        for n in BATCHES {
            let mut file = NpzWriter::create(directory.join(format!("batch-{n}.npz"))).unwrap();
            for (name, array) in expected(model, n) {
                file.add(name, &array).unwrap();
            }
            file.finish().unwrap();
        }
    }
    let script =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/graphs/clients/onnxruntime_check.py");
    let ran = Command::new(python).arg(script).arg(place.path()).output().unwrap();
    let said = String::from_utf8_lossy(&ran.stdout);
    println!("{said}");
    assert!(ran.status.success(), "{said}\n{}", String::from_utf8_lossy(&ran.stderr));
    assert_eq!(said.lines().filter(|line| line.starts_with("ok ")).count(), 3 * cases.len());
}
