//! Output and files of each command on valid input, and the parsing of arguments.

use std::fs;

use cape::core::{
    Mesh,
    npy::{Npz, write_npy},
};
use ndarray::Array2;
use serde_json::Value;

use crate::support::{Packed, VERTICES, contents, pose_of, run, run_line, trained};

#[test]
fn every_command_explains_itself() {
    explains_itself(&cape_cli::command(), &[]);
    assert!(run(["--version"]).succeeded().contains(env!("CARGO_PKG_VERSION")));
}

/// Checks the help of a command and of all below it.
fn explains_itself(command: &clap::Command, path: &[&str]) {
    let help = |option: &str| run(path.iter().copied().chain([option])).succeeded();
    let text = help("--help");
    assert_eq!(text, help("-h"), "{path:?}");
    let words = ["cape"].iter().chain(path).copied().collect::<Vec<_>>().join(" ");
    assert!(text.contains("Example") && text.contains(&format!("{words} ")), "{text}");
    assert!(text.contains("--device") && text.contains("--json"), "{text}");
    for inner in command.get_subcommands() {
        explains_itself(inner, &[path, &[inner.get_name()]].concat());
    }
}

#[test]
fn completions_and_man_pages_are_written() {
    for shell in ["bash", "zsh", "fish"] {
        assert!(run(["completions", shell]).succeeded().contains("table2"), "{shell}");
    }
    let root = tempfile::tempdir().unwrap();
    run(["man", root.path().to_str().unwrap()]).succeeded();
    for page in ["cape.1", "cape-data-synth.1", "cape-fit-benchmark-image.1"] {
        let text = fs::read_to_string(root.path().join(page)).unwrap();
        assert!(text.contains("SYNOPSIS"), "{page}");
    }
}

#[test]
fn arguments_that_cannot_be_understood_exit_with_2() {
    for line in [
        "",
        "dance",
        "train --out run",
        "data pack raw",
        "data pack raw --out packed --preset male --split split.toml",
        "data pack raw --out packed --preset children",
        "train --data packed --out run --preset huge",
        "eval run run --data packed --posterior median",
        "eval compare --data packed",
        "sample run --out samples --outfit short_long",
        "sample run --out samples --n 0",
        "sample run --out samples --fps 0",
        "fit benchmark image run --out fits --dropped 2",
        "fit benchmark scan run --out scans --holes -1",
        "animate run --out moved --seconds nan",
        "model pyramid mesh.obj --out levels --factors 2,two",
        "demo --minutes -1",
        "info . --threads 0",
        "eval speed --threads 0",
        "eval speed --batch 0",
        "eval speed --preset huge",
    ] {
        let ran = run_line(line);
        assert_eq!(ran.code, Some(2), "{line}: {}", ran.err);
        assert_eq!(ran.out, "");
        assert!(!ran.err.is_empty());
    }
}

#[test]
fn synthetic_captures_are_repeatable_and_pack() {
    let root = tempfile::tempdir().unwrap();
    let at = |name: &str| root.path().join(name).display().to_string();
    let synth = |name: &str, seed: &str| {
        let out = at(name);
        let words =
            ["data", "synth", "--out", &out, "--subjects", "1", "--frames-per-sequence", "5"];
        let report = run(words.into_iter().chain(["--seed", seed, "--json"])).json();
        assert_eq!(report["vertices"], 6890);
        assert_eq!(report["frames"].as_u64(), report["sequences"].as_u64().map(|n| 5 * n));
    };
    synth("one", "7");
    synth("two", "7");
    synth("three", "8");
    let one = contents(&root.path().join("one"));
    assert!(one == contents(&root.path().join("two")));
    assert!(one != contents(&root.path().join("three")));

    let report = run(["data", "pack", &at("one"), "--out", &at("packed"), "--json"]).json();
    assert_eq!(report["broken"], Value::Array(Vec::new()));
    assert_eq!(report["missing"], Value::Array(Vec::new()));
    assert!(report["test_frames"].as_u64() > Some(0), "{report}");
    let said = run(["info", &at("packed")]).succeeded();
    assert!(said.starts_with("packed set") && said.contains("train frames"), "{said}");
}

#[test]
fn a_pyramid_is_written_for_other_programs() {
    let data = trained();
    let out = data.root().join("levels");
    let report =
        data.run("model pyramid @/packed/body.npz --factors 1,1.5,2 --out @/levels --json").json();
    let levels = report["levels"].as_array().unwrap();
    let vertices: Vec<u64> = levels.iter().map(|l| l["vertices"].as_u64().unwrap()).collect();
    assert_eq!(vertices, [98, 98, 66, 33]);
    for (level, count) in vertices.iter().enumerate() {
        let mesh = Mesh::load(out.join(format!("level_{level}.obj"))).unwrap();
        assert_eq!(mesh.vertices.len() as u64, *count);
    }
    let mut up = Npz::open(out.join("U_1.npz")).unwrap();
    assert_eq!(up.i64("shape").unwrap().into_raw_vec_and_offset().0, [98, 66]);
    assert!(data.run("info @/levels").succeeded().contains("98 98 66 33"));
    assert!(
        data.run("model pyramid @/levels/level_1.obj --factors 2 --out @/more")
            .succeeded()
            .contains("49")
    );
}

#[test]
fn evaluation_is_repeatable_and_kept() {
    let data = trained();
    let mean = data.run("eval run @/run --data @/packed --posterior mean --json").json();
    let text = fs::read_to_string(data.at("run/eval.json")).unwrap();
    assert_eq!(serde_json::from_str::<Value>(&text).unwrap(), mean);
    assert_eq!(mean["frames"], 16);
    let overall = &mean["model"]["overall"];
    assert!(overall["mean"].as_f64().unwrap() > 0.0, "{overall}");
    assert_eq!(overall["count"], 16 * 7 * 8);
    assert_eq!(mean["model"]["outfits"].as_object().unwrap().len(), 4);
    assert!(mean["model"]["sequences"]["jump"]["median"].is_number());

    let sample = |seed: u64| {
        data.run(&format!("eval run @/run --data @/packed --batch 5 --seed {seed} --json")).json()
    };
    assert_eq!(sample(1), sample(1));
    assert_ne!(sample(1)["model"], sample(2)["model"]);
    assert_eq!(sample(1)["mean_shape"], sample(2)["mean_shape"]);
    let table = data.run("eval run @/run --data @/packed").succeeded();
    for word in ["all", "longlong", "jump", "mean shape", "±"] {
        assert!(table.contains(word), "{table}");
    }
}

#[test]
fn samples_are_repeatable_meshes() {
    let data = trained();
    let poses = Array2::from_shape_fn((2, 72), |(frame, i)| pose_of(frame)[i]);
    write_npy(data.at("dance.npy"), &poses).unwrap();
    let sample = |out: &str, more: &str| {
        data.run(&format!("sample @/run --out @/{out} --pose @/dance.npy --n 2 {more} --json"))
            .json()
    };
    let report = sample("one", "--betas -1,0.5");
    assert_eq!(report["files"].as_array().unwrap().len(), 4 * 2 * 2);
    sample("two", "--betas -1,0.5");
    let one = contents(&data.at("one"));
    assert_eq!(one.len(), 16 + 2);
    assert!(one == contents(&data.at("two")));
    sample("three", "--betas -1,0.5 --seed 2 --no-picture");
    let three = contents(&data.at("three"));
    assert_eq!(three.len(), 16 + 1);
    assert!(one[1].1 != three[0].1);

    let mesh = Mesh::load(data.at("one/longlong_002_00001.obj")).unwrap();
    assert_eq!(mesh.vertices.len(), VERTICES);
    let lines = fs::read_to_string(data.at("one/samples.jsonl")).unwrap();
    let line: Value = serde_json::from_str(lines.lines().next().unwrap()).unwrap();
    assert_eq!(line["file"], "shortlong_001_00000.obj");
    assert_eq!(line["code"].as_array().unwrap().len(), 6);
}

#[test]
fn clothes_stay_where_clothes_go() {
    let data = trained();
    for (outfit, out) in [("longlong", "ll"), ("shortshort", "ss")] {
        let line =
            format!("sample @/run --out @/{out} --outfit {outfit} --pose t-pose --format ply");
        data.run(&line).succeeded();
    }
    let dressed = Mesh::load(data.at("ll/longlong_001.ply")).unwrap();
    let other = Mesh::load(data.at("ss/shortshort_001.ply")).unwrap();
    let body = cape::core::SmplModel::load(data.at("run/body.npz")).unwrap().mesh();
    let clothing = 2 * 8..9 * 8;
    for (index, bare) in body.vertices.iter().enumerate() {
        let same = (0..3).all(|i| (dressed.vertices[index][i] - bare[i]).abs() < 1e-6);
        assert_eq!(same, !clothing.contains(&index), "vertex {index}");
    }
    assert_ne!(dressed, other);
}

#[test]
fn bad_requests_for_samples() {
    let data = trained();
    let path = data.at("bad.npy");
    write_npy(&path, &Array2::<f64>::zeros((2, 69))).unwrap();
    for (rest, said) in [
        ("--pose handstand", "unknown pose `handstand`"),
        ("--pose @/bad.npy", "[2, 69]"),
        ("--pose @/gone.npy", "gone.npy"),
        ("--betas 1,2,3", "--betas: 3 coefficients, but the body has 2"),
        ("--betas nan", "not a finite number"),
    ] {
        data.run(&format!("sample @/run --out @/bad-samples {rest}")).failed_saying(&[said]);
        assert!(!data.at("bad-samples").exists(), "{rest}");
    }
}

#[test]
fn info_knows_what_things_are() {
    let data = Packed::new();
    data.train().succeeded();
    for (path, kind) in [
        ("raw", "raw captures"),
        ("packed", "packed set"),
        ("run", "run"),
        ("run/config.toml", "configuration of a run"),
        ("raw/split.toml", "split into training and test sequences"),
        ("run/body.npz", "body in SMPL's layout"),
        ("run/stats.npz", "normalisation statistics"),
        ("raw/sequences/ann/longlong_walk/longlong_walk.000001.npz", "captured frame"),
        ("packed/train/train_disp.npy", "NumPy array"),
    ] {
        assert_eq!(data.run(&format!("info @/{path} --json")).json()["kind"], kind);
        assert!(data.run(&format!("info @/{path}")).succeeded().starts_with(kind));
    }
    for path in ["raw", "packed", "run"] {
        let body = data.run(&format!("info @/{path} --json")).json()["body"].to_string();
        assert!(body.contains("vertices, SHA-256"), "{path}: {body}");
    }
    let few = "--subjects 1 --outfits longlong --motions squats --frames-per-sequence 1";
    data.run(&format!("data synth --body female --out @/own {few}")).succeeded();
    assert_eq!(data.run("info @/own --json").json()["body"], "female (built in)");
    let step = fs::read_dir(data.at("run/checkpoints")).unwrap().next().unwrap().unwrap().path();
    let weights = run(["info", step.join("model.safetensors").to_str().unwrap(), "--json"]).json();
    assert_eq!(weights["kind"], "weights");
    assert_eq!(weights["tensors with non-finite values"], 0);
    data.run("info @/nowhere").failed_saying(&["nowhere", "No such file"]);
    fs::write(data.at("notes.txt"), "").unwrap();
    data.run("info @/notes.txt").failed_saying(&["unknown kind of file"]);
}

#[test]
fn quiet_says_nothing_but_the_result() {
    let data = Packed::new();
    let ran = data.run("train --data @/packed --out @/run --preset tiny --epochs 1 --quiet");
    assert_eq!(ran.err, "");
    assert!(ran.succeeded().contains("best validation"));
    let ran = data.run("eval run @/run --data @/packed --json");
    assert_eq!(ran.err, "");
}
