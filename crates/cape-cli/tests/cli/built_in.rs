//! The built-in model and model files.

use std::fs;

use crate::support::{Packed, run_line, trained};

#[test]
fn commands_without_run_use_the_built_in_model() {
    let data = Packed::new();
    let report = data.run("sample --outfit shortlong --pose walk --out @/built-in --json").json();
    assert_eq!(report["files"].as_array().map(Vec::len), Some(1), "{report}");
    let text = fs::read_to_string(data.at("built-in/shortlong_001.obj")).unwrap();
    assert_eq!(text.lines().filter(|line| line.starts_with("v ")).count(), 6890);
    // The same bytes by the file of its own.
    data.run("model pack --out @/model.safetensors").succeeded();
    data.run("sample @/model.safetensors --outfit shortlong --pose walk --out @/again").succeeded();
    assert_eq!(fs::read_to_string(data.at("again/shortlong_001.obj")).unwrap(), text);
    // Files of bytes are the same whenever they are made.
    for name in ["bytes", "again"] {
        data.run(&format!("model pack --bytes --out @/{name}.safetensors")).succeeded();
    }
    let report = data.run("info @/bytes.safetensors --json").json().to_string();
    assert!(report.contains("model file") && report.contains("3279527"), "{report}");
    let bytes = |name: &str| fs::read(data.at(name)).unwrap();
    assert_eq!(bytes("bytes.safetensors"), bytes("again.safetensors"));
    assert!(bytes("bytes.safetensors").len() < 4_000_000);
    data.run("model pack --bytes --single --out @/both.safetensors").misused(&["--single"]);
}

#[test]
fn the_argument_in_the_place_of_a_run_may_be_the_next_one() {
    let data = Packed::new();
    fs::write(data.at("keypoints.json"), "{}").unwrap();
    data.run("fit image @/keypoints.json --out @/fit").failed_saying(&["keypoints.json"]);
    data.run("fit image @/typo.json --out @/fit").failed_saying(&["typo.json", "No such file"]);
    data.run("model encode @/typo.ply --out @/codes").failed_saying(&["typo.ply"]);
    data.run("fit image --out @/fit").failed_saying(&["KEYPOINTS", "missing"]);
    data.run("model encode --out @/codes").failed_saying(&["REGISTRATION", "missing"]);
    data.run("redress frame:0 --out @/redressed")
        .failed_saying(&["built-in model", "training data"]);
    data.run("model prior").failed_saying(&["built-in model", "training data"]);
    data.run("model export --npz @/weights.npz").failed_saying(&["RUN", "directory"]);
    data.run("sample @/none --out @/samples").failed_saying(&["none", "config.toml"]);
}

#[test]
fn models_are_exported_as_onnx_graphs() {
    let data = trained();
    let report = data.run("model export @/run --onnx @/graphs --half --json").json();
    let graphs = report["graphs"].as_array().unwrap();
    for (graph, name) in graphs.iter().zip(["decoder.onnx", "encoder.onnx", "smpl.onnx"]) {
        let size = fs::metadata(data.at("graphs").join(name)).unwrap().len();
        assert_eq!(graph["bytes"], size, "{report}");
    }
    assert_eq!(graphs[0]["inputs"][1], "pose [batch, 72]", "{report}");
    let said = data.run("model export --onnx @/built-in").succeeded();
    assert!(said.contains("code [batch, 32]") && said.contains("smpl.onnx"), "{said}");
    data.run("model export --half --npz @/weights.npz").misused(&["--onnx"]);
    data.run("model export").misused(&["--onnx", "--npz", "--safetensors"]);
}

#[test]
fn model_files_are_checked() {
    let data = trained();
    data.run("model pack @/run --out @/model.safetensors").failed_saying(&["built-in", "body"]);
    data.run("model pack --out @/model.bin").failed_saying(&["--out", ".safetensors"]);
    data.run("model pack --note licence --out @/model.safetensors")
        .failed_saying(&["--note licence", "NAME=TEXT"]);
    fs::write(data.at("cut.safetensors"), [7; 100]).unwrap();
    data.run("sample @/cut.safetensors --out @/samples")
        .failed_saying(&["cut.safetensors", "model file"]);
    assert!(run_line("sample --help").succeeded().contains("built-in model"));
}
