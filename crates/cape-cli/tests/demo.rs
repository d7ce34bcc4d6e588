//! `cape demo`, shortened by its time limit: the whole way from nothing to pictures.

use std::{path::Path, process::Command};

use cape::{core::Mesh, render::Image};
use serde_json::Value;

/// Steps after which the model must be better than the mean displacement.
const ENOUGH_STEPS: u64 = 300;

fn demo(out: &Path) -> Value {
    let output = Command::new(env!("CARGO_BIN_EXE_cape"))
        .args(["demo", "--minutes", "1.5", "--json", "--out"])
        .arg(out)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn the_demo_goes_all_the_way() {
    let root = tempfile::tempdir().unwrap();
    let out = root.path().join("demo");
    let report = demo(&out);
    let mean = |whose: &str| report["evaluation"][whose]["overall"]["mean"].as_f64().unwrap();
    let steps = report["training"]["steps"].as_u64().unwrap();
    assert!(steps > 0, "{report}");
    // How far a training comes in its time depends on the machine.
    if steps >= ENOUGH_STEPS {
        assert!(mean("model") < mean("mean_shape"), "{report}");
    } else {
        println!("not judged after {steps} steps: {:.2} mm", mean("model"));
    }

    let bare = Mesh::load(out.join("bare.obj")).unwrap();
    for outfit in ["shortlong", "shortshort", "longshort", "longlong"] {
        let dressed = Mesh::load(out.join(format!("{outfit}.obj"))).unwrap();
        assert_eq!(dressed.faces, bare.faces);
        assert_ne!(dressed.vertices, bare.vertices);
    }
    assert_eq!(bare.vertices.len(), 6890);
    for name in ["built_in.png", "contact_sheet.png"] {
        let sheet = Image::load(out.join(name)).unwrap();
        assert!(sheet.width() > sheet.height());
    }
    Image::load(out.join("loss.png")).unwrap();
    assert!(out.join("run/eval.json").exists() && out.join("demo.json").exists());
}
