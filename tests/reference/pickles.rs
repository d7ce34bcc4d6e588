//! `smpl_pickles/`: body files as they are found in the wild.

use std::{
    fs,
    path::{Path, PathBuf},
};

use burn::tensor::Device;
use cape::core::{SmplModel, npy::Npz, pickle::Pickle};

/// Names of files that must be refused start so.
const BAD: [&str; 8] =
    ["bad", "bomb", "broken", "evil", "malicious", "missing", "truncated", "wrong"];

/// Every good file must equal `expected.npz`, every bad one must be refused and create nothing.
pub(crate) fn check(directory: &Path, _: &Device, report: &mut dyn FnMut(String)) {
    let expected = SmplModel::load(directory.join("expected.npz")).unwrap();
    let mut paths: Vec<PathBuf> =
        fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    let (mut good, mut bad) = (0, 0);
    for path in &paths {
        let name = path.file_name().unwrap().to_str().unwrap();
        let kind = path.extension().and_then(|extension| extension.to_str());
        if !matches!(kind, Some("pkl" | "npz" | "pickle")) {
            continue;
        }
        if BAD.iter().any(|start| name.starts_with(start)) {
            let before = places();
            let message = SmplModel::load(path).unwrap_err().to_string();
            assert!(message.contains(name), "{name}: not named in {message}");
            assert_eq!(places(), before, "{name}: created something");
            report(format!("refused: {}", message.rsplit('/').next().unwrap_or_default()));
            bad += 1;
            continue;
        }
        let found = SmplModel::load(path).unwrap_or_else(|error| panic!("{error}"));
        same(name, &found, &expected);
        good += 1;
    }
    assert!(good > 1 && bad > 0, "{good} good files and {bad} bad ones");
    report(format!("{good} files equal expected.npz, {bad} refused"));
    joints(directory, report);
}

/// A file with more shape directions than the expected ones may have others.
fn same(name: &str, found: &SmplModel, expected: &SmplModel) {
    let more = found.betas() > expected.betas();
    // The arrays themselves are too long to be shown.
    for (array, equal) in [
        ("v_template", found.v_template == expected.v_template),
        ("shapedirs", more || found.shapedirs == expected.shapedirs),
        ("posedirs", found.posedirs == expected.posedirs),
        ("J_regressor", found.joint_regressor == expected.joint_regressor),
        ("weights", found.weights == expected.weights),
        ("kintree_table", found.parents == expected.parents),
        ("f", found.faces == expected.faces),
    ] {
        assert!(equal, "{name}: `{array}` differs");
    }
}

/// `J` is no part of a body, but shows that other arrays are read too.
fn joints(directory: &Path, report: &mut dyn FnMut(String)) {
    let mut npz = Npz::open(directory.join("expected.npz")).unwrap();
    if !npz.contains("J") {
        return;
    }
    let expected = npz.f64("J").unwrap();
    let mut checked = 0;
    for entry in fs::read_dir(directory).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|extension| extension == "pkl")
            && let Ok(pickle) = Pickle::open(&path)
            && let Some(found) = pickle.root().get("J")
            && let Ok(found) = found.array::<f64>()
        {
            assert_eq!(found, expected, "{}", path.display());
            checked += 1;
        }
    }
    report(format!("`J` the same in {checked} pickles"));
}

/// Path that a malicious file would write to.
fn places() -> Vec<PathBuf> {
    let here = std::env::current_dir().unwrap();
    let mut found: Vec<PathBuf> = [Path::new("/tmp"), &here]
        .into_iter()
        .flat_map(|directory| fs::read_dir(directory).unwrap())
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.to_string_lossy().to_lowercase().contains("pwn"))
        .collect();
    found.sort();
    found
}
