//! Outputs that cannot be written, runs that do not match, devices that are not there.

use std::{fs, process::Command};

use crate::support::{Packed, Ran, contents, run_line, trained};

#[test]
fn output_below_a_file() {
    let data = Packed::new();
    fs::write(data.at("file"), "").unwrap();
    for line in [
        "data synth --out @/file/raw --subjects 1 --frames-per-sequence 1",
        "data pack @/raw --out @/file/packed",
        "model pyramid @/packed/body.npz --factors 1.5 --out @/file/levels",
        "train --data @/packed --out @/file/run --preset tiny",
    ] {
        data.run(line).failed_saying(&["file", "Not a directory"]);
    }
    let line = format!(
        "sample {}/run --out {}/file/samples",
        trained().root().display(),
        data.root().display()
    );
    run_line(&line).failed_saying(&["file/samples", "Not a directory"]);
}

#[test]
fn output_that_exists() {
    let data = Packed::new();
    data.run("data synth --out @/raw").failed_saying(&["raw already exists"]);
    data.run("data pack @/raw --out @/packed").failed_saying(&["packed already exists"]);
    data.run("train --data @/packed --out @/raw --preset tiny")
        .failed_saying(&["raw", "not empty"]);
    data.run("demo --out @/raw --minutes 1").failed_saying(&["raw already exists"]);
    let line = format!("sample {}/run --out {}", trained().root().display(), data.root().display());
    run_line(&line).failed_saying(&["already exists"]);
}

/// Runs a command line under a limit on the size of files, of which a full disk is a special case:
/// a write fails half-way.
fn with_small_files(data: &Packed, line: &str) -> Ran {
    let root = data.root().to_str().unwrap();
    let script = format!(
        "trap '' XFSZ; ulimit -f 16; exec {} {}",
        env!("CARGO_BIN_EXE_cape"),
        line.replace('@', root)
    );
    Command::new("sh").args(["-c", &script]).output().unwrap().into()
}

#[cfg(unix)]
#[test]
fn a_full_disk_leaves_no_half_checkpoint_and_keeps_the_last_good_one() {
    let data = Packed::new();
    let line = "train --data @/packed --out @/run --preset tiny --epochs 2 --batch 8";
    with_small_files(&data, line).failed_saying(&[".safetensors", "File too large"]);
    assert_eq!(fs::read_dir(data.at("run/checkpoints")).unwrap().count(), 0);
    data.run("eval run @/run --data @/packed").failed_saying(&["no checkpoint yet"]);
    let again = data.run("train --out @/run --resume");
    assert!(
        again.err.contains("interrupted before its first checkpoint: starts over"),
        "{}",
        again.err
    );
    again.succeeded();

    // The same again, with one good checkpoint to fall back on.
    fs::remove_dir_all(data.at("run")).unwrap();
    data.run(line).succeeded();
    let checkpoints = data.at("run/checkpoints");
    let mut steps: Vec<_> =
        fs::read_dir(&checkpoints).unwrap().map(|entry| entry.unwrap().path()).collect();
    steps.sort();
    let whole = contents(&steps[1]);
    fs::remove_dir_all(&steps[1]).unwrap();
    let good = contents(&steps[0]);
    with_small_files(&data, "train --out @/run --resume").failed_saying(&["File too large"]);
    assert_eq!(contents(&checkpoints).len(), good.len());
    assert_eq!(contents(&steps[0]), good);
    data.run("train --out @/run --resume").succeeded();
    let weights = |files: &[(std::path::PathBuf, Vec<u8>)]| -> Vec<_> {
        files.iter().filter(|(path, _)| path.ends_with("model.safetensors")).cloned().collect()
    };
    assert_eq!(weights(&contents(&steps[1])), weights(&whole));
}

#[test]
fn runs_of_another_configuration_are_not_resumed() {
    let run = trained().at("run");
    let line = |rest: &str| format!("train --out {} --resume {rest}", run.display());
    run_line(&line("--batch 8"))
        .failed_saying(&["of another configuration", "`train.batch` is 4, but the options say 8"]);
    run_line(&line("--preset narrow")).failed_saying(&["of another configuration", "`model."]);
    run_line(&line("--seed 9")).failed_saying(&["`train.seed` is 1, but the options say 9"]);
    run_line(&line("--preset tiny --batch 4")).succeeded();
}

#[test]
fn runs_on_other_data_are_not_resumed_or_evaluated() {
    let other = Packed::with_frames(9);
    let run = trained().at("run");
    run_line(&format!(
        "train --out {} --resume --data {}/packed",
        run.display(),
        other.root().display()
    ))
    .failed_saying(&["resuming", "training frames"]);
    run_line(&format!(
        "train --out {} --resume --data {}/gone",
        run.display(),
        other.root().display()
    ))
    .failed_saying(&["gone", "No such file"]);
}

#[test]
fn directories_that_are_no_runs() {
    let packed = trained().at("packed");
    let packed = packed.display();
    run_line(&format!("eval run {packed} --data {packed}")).failed_saying(&["config.toml"]);
    run_line(&format!("sample {packed} --out unused")).failed_saying(&["config.toml"]);
    run_line(&format!("train --out {packed} --resume")).failed_saying(&["config.toml"]);
}

#[test]
fn a_run_with_other_weights() {
    let data = Packed::new();
    data.train().succeeded();
    let config = data.at("run/config.toml");
    let text = fs::read_to_string(&config).unwrap();
    fs::write(&config, text.replace("latent = 6", "latent = 5")).unwrap();
    let said = ["does not suit", "shape"];
    data.run("sample @/run --out @/samples").failed_saying(&said);
    data.run("train --out @/run --resume").failed_saying(&said);
    fs::write(&config, text.replace("latent = 6", "latent = six")).unwrap();
    data.run("sample @/run --out @/samples").failed_saying(&["config.toml", "line"]);
}

#[test]
fn devices() {
    let run = trained().at("run");
    let line = |device: &str| format!("eval run {} --data unused --device {device}", run.display());
    run_line(&line("tpu")).failed_saying(&["unknown device `tpu`", "expected flex"]);
    run_line(&line("flex:1")).failed_saying(&["flex takes no index"]);
    for name in ["ndarray", "wgpu", "cuda"] {
        if !cape::core::DEVICES.contains(&name) {
            run_line(&line(name))
                .failed_saying(&["not compiled in", &format!("--features {name}")]);
        }
    }
}
