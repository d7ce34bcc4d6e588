//! Checkpoints, frames and settings that are not what they were.

use std::{fs, path::PathBuf};

use cape::infer::RunConfig;

use crate::{
    job::lasting,
    support::{Packed, contents, truncate},
};

const LINE: &str = "train --data @/packed --out @/run --preset tiny --epochs 6 --batch 4 \
                    --checkpoint-steps 3 --keep 3";

/// Checkpoints of a run, oldest first.
fn checkpoints(data: &Packed) -> Vec<PathBuf> {
    let entries = fs::read_dir(data.at("run/checkpoints")).unwrap();
    let mut found: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    found.retain(|path| path.file_name().unwrap().to_string_lossy().starts_with("step-"));
    found.sort();
    found
}

#[test]
fn a_damaged_checkpoint_is_found_and_the_one_before_is_used() {
    let data = Packed::new();
    data.run(LINE).succeeded();
    let expected = lasting(&data.at("run"));
    let newest = checkpoints(&data).pop().unwrap();
    let names: Vec<PathBuf> = contents(&newest).into_iter().map(|(name, _)| name).collect();
    assert!(names.len() >= 5 && names.iter().any(|name| name.ends_with("SHA256SUMS")));
    for name in &names {
        for kind in ["cut", "flipped", "lost"] {
            let path = newest.join(name);
            let whole = fs::read(&path).unwrap();
            match kind {
                "cut" => truncate(&path),
                "lost" if name.ends_with("SHA256SUMS") => continue,
                "lost" => fs::remove_file(&path).unwrap(),
                _ => {
                    let mut bytes = whole.clone();
                    let middle = bytes.len() / 2;
                    bytes[middle] ^= 4;
                    fs::write(&path, bytes).unwrap();
                }
            }
            let ran = data.run("train --out @/run --resume");
            let said = format!("{}, {kind}: {}", name.display(), ran.err);
            assert!(ran.err.contains("damaged-step-"), "{said}");
            assert!(ran.err.contains("resumes from step"), "{said}");
            ran.succeeded();
            let aside: Vec<PathBuf> = fs::read_dir(data.at("run/checkpoints"))
                .unwrap()
                .map(|entry| entry.unwrap().path())
                .filter(|path| path.to_string_lossy().contains("damaged-step-"))
                .collect();
            assert_eq!(aside.len(), 1, "{said}");
            fs::remove_dir_all(&aside[0]).unwrap();
            let found = lasting(&data.at("run"));
            assert!(found.keys().eq(expected.keys()), "{said}: {:?}", found.keys());
            for (file, bytes) in &found {
                assert!(*bytes == expected[file], "{said}: {file} differs");
            }
        }
    }
    // A model is not silently another one.
    let paths = checkpoints(&data);
    for path in &paths {
        let model = path.join("model.safetensors");
        let mut bytes = fs::read(&model).unwrap();
        let last = bytes.len() - 1;
        bytes[last] ^= 1;
        fs::write(&model, bytes).unwrap();
    }
    data.run("eval run @/run --data @/packed").failed_saying(&["model.safetensors", "SHA-256"]);
    data.run("train --out @/run --resume").failed_saying(&["model.safetensors", "to start over"]);
    assert_eq!(checkpoints(&data), paths);
}

#[test]
fn a_checkpoint_without_sums_is_read() {
    let data = Packed::new();
    data.run(LINE).succeeded();
    for path in checkpoints(&data) {
        fs::remove_file(path.join("SHA256SUMS")).unwrap();
    }
    data.run("eval run @/run --data @/packed").succeeded();
    data.run("train --out @/run --resume").succeeded();
}

#[test]
fn a_frame_that_is_no_number_is_named_and_nothing_is_lost() {
    let data = Packed::new();
    let path = data.at("packed/train/train_disp.npy");
    let whole = fs::read(&path).unwrap();
    let mut bytes = whole.clone();
    // Of the last float64 before the validation frames.
    let frames = cape::data::PackedSet::open(data.at("packed"), cape::data::Split::Train).unwrap();
    let row = (bytes.len() - 128) / frames.frames();
    let at = 128 + 5 * row;
    bytes[at..at + 8].copy_from_slice(&f64::NAN.to_le_bytes());
    fs::write(&path, bytes).unwrap();
    data.run(LINE).failed_saying(&["train_disp.npy", "frame 5", "not finite"]);
    fs::write(&path, whole).unwrap();
    let begun = data.at("run/config.toml").exists();
    data.run(if begun { "train --out @/run --resume" } else { LINE }).succeeded();
}

#[test]
fn settings_that_change_no_weight_may_change() {
    let data = Packed::new();
    data.run(LINE).succeeded();
    let expected = lasting(&data.at("run"));
    fs::remove_dir_all(data.at("run")).unwrap();
    data.run(&LINE.replace("--epochs 6", "--epochs 6 --threads 1")).succeeded();
    let newest = checkpoints(&data).pop().unwrap();
    fs::remove_dir_all(newest).unwrap();
    data.run("train --out @/run --resume --threads 2 --checkpoint-steps 2 --log-steps 3 --keep 1 --preload")
        .succeeded();
    let config = RunConfig::load(&data.at("run/config.toml")).unwrap().train;
    assert_eq!((config.checkpoint_steps, config.log_steps, config.keep), (2, 3, 1));
    assert!(config.preload);
    let found = lasting(&data.at("run"));
    let last = |files: &std::collections::BTreeMap<String, Vec<u8>>| {
        let mut models = files.iter().filter(|(name, _)| name.ends_with("model.safetensors"));
        models.next_back().map(|(name, bytes)| (name.clone(), bytes.clone())).unwrap()
    };
    assert!(last(&found) == last(&expected));
    data.run("train --out @/run --resume --batch 8").failed_saying(&["`train.batch`"]);
}
