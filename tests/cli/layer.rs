//! A clothing layer of its own topology: simulated, learnt, predicted.

use std::fs;

use cape::core::Mesh;

use crate::support::run_line;

#[test]
fn a_skirt_is_simulated_learnt_and_predicted() {
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name).display().to_string();
    let (set, learnt, predicted) = (at("set"), at("learnt"), at("predicted"));
    let options = "--garment skirt --exercises march --frames 8 --resolution 50";
    let report = run_line(&format!("layer synth {options} --out {set} --json")).json();
    assert_eq!((&report["sequences"], &report["frames"]), (&1.into(), &8.into()));

    let report =
        run_line(&format!("layer learn {set} --components 3 --out {learnt} --json")).json();
    let errors = report["reconstruction"][0]["errors"].as_array().unwrap();
    let means: Vec<f64> = errors.iter().map(|e| e["mean_mm"].as_f64().unwrap()).collect();
    assert!(means.windows(2).all(|pair| pair[1] <= pair[0]), "{means:?}");
    assert!(*means.last().unwrap() < 1e-3, "{means:?}");
    let clothing = Mesh::load(format!("{learnt}/clothing.ply")).unwrap();

    let layer = format!("{learnt}/layer.npz");
    let parameters = "--parameters 1,1,1,0,0,0,0,0";
    run_line(&format!("layer predict {layer} --seconds 0.1 --out {predicted} --json {parameters}"))
        .succeeded();
    let frame = Mesh::load(format!("{predicted}/frame-00002.ply")).unwrap();
    assert_eq!(frame.vertices.len(), clothing.vertices.len());
    assert_eq!(fs::read_dir(&predicted).unwrap().count(), 3);

    run_line(&format!("layer predict {layer} --out {predicted}"))
        .failed_saying(&["exists already"]);
    run_line(&format!("layer predict {layer} --out {}", at("other")))
        .failed_saying(&["semantic parameters"]);
    run_line(&format!("layer learn {learnt} --out {}", at("other"))).failed_saying(&["learnt"]);
}
