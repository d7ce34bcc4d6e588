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

#[test]
fn a_grid_of_sizes_and_materials_is_simulated_and_goes_on() {
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name).display().to_string();
    let options = "--garment shorts --exercises jump --frames 2 --resolution 50 --steps 10 \
                   --subjects=-1,1 --lengths 1,1.2 --friction 1,2";
    let (whole, halted) = (at("whole"), at("halted"));
    let synth = |out: &str| run_line(&format!("layer synth {options} --out {out} --json"));
    let report = synth(&whole).json();
    assert_eq!((&report["sequences"], &report["simulated_now"]), (&8.into(), &8.into()));
    for simulation in report["simulations"].as_array().unwrap() {
        assert!(simulation["penetration_mm"].as_f64().unwrap() < 5.0, "{simulation}");
        assert!(simulation["strain"].as_f64().unwrap() < 0.35, "{simulation}");
        assert!(simulation["crossings"].is_u64(), "{simulation}");
    }

    // As after an interruption: some are done, one is written but not noted.
    fs::create_dir(&halted).unwrap();
    let copy =
        |name: &str| fs::copy(format!("{whole}/{name}"), format!("{halted}/{name}")).unwrap();
    for file in fs::read_dir(&whole).unwrap() {
        let name = file.unwrap().file_name().into_string().unwrap();
        if !name.starts_with("s01") {
            copy(&name);
        }
    }
    for (name, kept) in [("set.json", 4), ("simulation.json", 3)] {
        let text = fs::read(format!("{whole}/{name}")).unwrap();
        let mut lines: Vec<serde_json::Value> = serde_json::from_slice(&text).unwrap();
        lines.truncate(kept);
        fs::write(format!("{halted}/{name}"), serde_json::to_vec_pretty(&lines).unwrap()).unwrap();
    }
    assert_eq!(synth(&halted).json()["simulated_now"], 5);
    for file in fs::read_dir(&whole).unwrap() {
        let name = file.unwrap().file_name().into_string().unwrap();
        let [one, other] =
            [&whole, &halted].map(|place| fs::read(format!("{place}/{name}")).unwrap());
        assert!(one == other, "{name} differs after an interruption");
    }
    assert_eq!(synth(&halted).json()["simulated_now"], 0);
    run_line(&format!("layer synth --garment skirt --out {halted}"))
        .failed_saying(&["other settings"]);
}

#[test]
fn clothing_may_include_the_body() {
    let place = tempfile::tempdir().unwrap();
    let set = place.path().join("set").display().to_string();
    let options = "--garment tshirt --exercises squat --frames 2 --resolution 50 --steps 10";
    let report = run_line(&format!("layer synth {options} --with-body --out {set} --json")).json();
    let set = cape::layer::LayerSet::load(&set).unwrap();
    assert!(set.vertices() > 6890);
    assert_eq!(report["vertices"], set.vertices());
    assert!(set.faces.iter().flatten().any(|&v| v as usize == set.vertices() - 1));

    let bad = format!("layer synth --widths 0.5 --out {}", place.path().join("bad").display());
    run_line(&bad).failed_saying(&["width"]);
}
