//! Clothed bodies from images.

use std::fs;

use cape::{core::npy::NpzWriter, render::Image};
use ndarray::Array2;
use serde_json::Value;

use crate::support::{FEW_STEPS, Packed, contents, remove_seconds, trained, truncate};

#[test]
fn held_out_frames_are_fitted_and_measured() {
    let (data, run) = (Packed::new(), trained().at("run").display().to_string());
    fs::write(data.at("few.toml"), FEW_STEPS).unwrap();
    let options = "--frames 2 --size 128 --noise 1 --dropped 0.1 --ragged 0.1 --config @/few.toml";
    let command = format!("fit benchmark image {run} {options} --out @/fits");
    let report = data.run(&format!("{command} --json")).json();
    assert_eq!(report["cases"].as_array().unwrap().len(), 2);
    for kind in ["bare", "clothed"] {
        assert!(report[kind]["squared"]["mean"].as_f64().unwrap() > 0.0, "{report}");
        assert!(report[kind]["intersection_over_union"]["most"].as_f64().unwrap() <= 1.0);
    }
    assert_eq!(report["squared"]["images"], 2);
    let p = report["squared"]["wilcoxon"].as_f64().unwrap();
    assert!((0.0..=1.0).contains(&p), "{p}");
    let inputs = ["best/keypoints.json", "best/mask.png", "worst/image.png"];
    for name in ["fits.png", "errors.png", "results.json", "settings.json"].iter().chain(&inputs) {
        assert!(data.at("fits").join(name).exists(), "{name}");
    }

    // What is missing is made, what is there is kept.
    let frames = contents(&data.at("fits/frames"));
    assert_eq!(frames.len(), 2);
    let results = fs::read(data.at("fits/results.json")).unwrap();
    fs::remove_file(data.at("fits/results.json")).unwrap();
    fs::remove_file(data.at("fits/frames").join(&frames[1].0)).unwrap();
    let text = data.run(&command).succeeded();
    assert!(text.contains("SMPLify") && text.contains("2 images"), "{text}");
    assert_eq!(contents(&data.at("fits/frames"))[0], frames[0]);
    let again = fs::read(data.at("fits/results.json")).unwrap();
    assert_eq!(without_times(&again), without_times(&results));
    data.run(&command.replace("--noise 1", "--noise 2")).failed_saying(&[
        "settings.json",
        "`settings.options.noise`",
        "--overwrite",
        "--out",
    ]);
    let item = data.at("fits/frames").join(&frames[0].0);
    truncate(&item);
    data.run(&command).failed_saying(&[item.to_str().unwrap(), "remove this file"]);
    fs::write(&item, &frames[0].1).unwrap();
    let train = "train --data @/packed --out @/other --preset tiny --epochs 1 --batch 4 --seed 5";
    data.run(train).succeeded();
    let other = command.replace(&run, "@/other");
    data.run(&other).failed_saying(&["`inputs.checkpoint`", "SHA-256", "`inputs.run_config`"]);
    assert!(contents(&data.at("fits/frames")).contains(&frames[0]));
    data.run(&format!("{other} --overwrite")).succeeded();
    assert!(!contents(&data.at("fits/frames")).contains(&frames[0]));
    let earlier = data.at("earlier");
    fs::create_dir(&earlier).unwrap();
    fs::write(earlier.join("settings.json"), r#"{"version": "0.1.0", "data": "packed"}"#).unwrap();
    data.run(&command.replace("@/fits", "@/earlier")).failed_saying(&[
        "earlier/settings.json",
        "lacks `kind`",
        "`inputs`",
        "--overwrite",
    ]);

    // Subjects' own bodies; their files belong to the settings, no others do.
    let own = "--bodies @/raw/minimal_body_shape";
    data.run(&format!("{command} {own}")).failed_saying(&["`inputs.bodies`"]);
    let own = command.replace("@/fits", "@/own") + " " + own;
    assert_ne!(data.run(&format!("{own} --json")).json()["bare"], report["bare"]);
    fs::write(data.at("raw/minimal_body_shape/notes.txt"), "").unwrap();
    data.run(&own).succeeded();
    let none = format!("fit benchmark image {run} --out @/no");
    data.run(&format!("{none} --bodies @/packed")).failed_saying(&["_minimal.npy"]);
    // The set has fewer frames than the benchmark takes.
    data.run(&format!("{none} --tuning")).failed_saying(&["no test frames beside those"]);
    data.run(&format!("fit benchmark image {run} --dropped 2 --out @/no")).misused(&["--dropped"]);
    fs::write(data.at("few.toml"), "[clothed]\ncode = -1").unwrap();
    data.run(&command).failed_saying(&["few.toml", "code"]);
    assert!(!data.at("no").exists());
}

fn without_times(results: &[u8]) -> Value {
    let mut results: Value = serde_json::from_slice(results).unwrap();
    remove_seconds(&mut results);
    results
}

/// Files of [`person`] as arguments of `cape fit image`.
const SEEN: &str = "@/seen/best/keypoints.json --mask @/seen/best/mask.png";

/// Writes keypoints and mask of a person to seen/best, and few.toml with few steps.
pub(crate) fn person(data: &Packed, run: &str) {
    fs::write(data.at("few.toml"), FEW_STEPS).unwrap();
    let options = "--frames 1 --size 128 --config @/few.toml --out @/seen";
    data.run(&format!("fit benchmark image {run} {options}")).succeeded();
}

#[test]
fn a_person_is_fitted_to_an_image() {
    let (data, run) = (Packed::new(), trained().at("run").display().to_string());
    person(&data, &run);
    fs::write(data.at("few.toml"), FEW_STEPS.replace("explained = 0.0", "explained = 0.3"))
        .unwrap();
    let fit = |rest: &str| data.run(&format!("fit image {run} {SEEN} --config @/few.toml {rest}"));
    let report = fit("--image @/seen/best/image.png --out @/fit --json").json();
    // The other two are given up after the first level.
    assert_eq!(report["outfits"].as_array().unwrap().len(), 2);
    assert_eq!(report["clothed"]["outfit"], report["outfits"][0]["outfit"]);
    let files = ["bare.ply", "clothed.ply", "clothed.glb", "code.npy", "pose.npy", "overlay.png"];
    for name in files.into_iter().chain(["energy.png", "fit.json"]) {
        assert!(data.at("fit").join(name).exists(), "{name}");
    }
    // Its pose and code go on to other commands.
    let code = "@/fit/code.npy";
    data.run(&format!("vary {run} --by outfit --codes {code} --pose @/fit/pose.npy --out @/more"))
        .succeeded();
    data.run(&format!("animate {run} --code {code} --motion walk --seconds 0.2 --out @/walk"))
        .succeeded();

    // Someone who wears what explains the image worst is told so.
    let all = fit("--outfit longlong --compare-outfits --out @/all --json").json();
    assert_eq!(all["outfits"].as_array().unwrap().len(), 4);
    let worst = all["outfits"][3]["outfit"].as_str().unwrap();
    let ran = fit(&format!("--outfit {worst} --compare-outfits --out @/other"));
    assert!(ran.err.contains("has a lower energy"), "{}", ran.err);

    // A fit that is unreliable is written, and is an error.
    fs::write(data.at("few.toml"), FEW_STEPS.replace("inside = 0.0", "inside = 1.1")).unwrap();
    fit("--outfit longlong --out @/failed")
        .failed_saying(&["is unreliable", "expected at least 110 %"]);
    assert!(data.at("failed/fit.json").exists());
}

#[test]
fn pose_priors_are_fitted_and_used() {
    let (data, run) = (Packed::new(), trained().at("run").display().to_string());
    let report = data.run("fit pose-prior @/packed --components 2 --out @/prior.npz --json").json();
    assert_eq!(report["components"], 2);
    person(&data, &run);
    data.run(&format!(
        "fit image {run} {SEEN} --outfit longlong --config @/few.toml \
         --pose-prior @/prior.npz --out @/fit"
    ))
    .succeeded();
    data.run("fit pose-prior @/nowhere.npz --out @/no.npz").failed_saying(&["nowhere.npz"]);
    data.run("fit pose-prior @/packed --out @/no.pkl").failed_saying(&["no.pkl", ".npz"]);
    data.run(&format!("fit image {run} {SEEN} --pose-prior @/few.toml --out @/no"))
        .failed_saying(&["few.toml"]);
}

#[test]
fn what_cannot_be_fitted_is_said() {
    let (data, run) = (Packed::new(), trained().at("run").display().to_string());
    let black = Image::new(64, 64, [0, 0, 0, 255]).unwrap();
    black.save(data.at("empty.png")).unwrap();
    let mut half = black.clone();
    half.pixels_mut()[..2000].fill([255; 4]);
    half.save(data.at("half.png")).unwrap();
    let points = vec!["0"; 75].join(",");
    let person = |points: &str| format!(r#"{{"pose_keypoints_2d":[{points}]}}"#);
    let people = |list: &[String]| format!(r#"{{"people":[{}]}}"#, list.join(","));
    fs::write(data.at("nobody.json"), people(&[])).unwrap();
    fs::write(data.at("unseen.json"), people(&[person(&points)])).unwrap();
    let seen = vec!["10,10,0.9"; 25].join(",");
    fs::write(data.at("two.json"), people(&[person(&seen), person(&seen)])).unwrap();
    fs::write(data.at("broken.json"), "{").unwrap();
    let fit = |keypoints: &str, mask: &str| {
        data.run(&format!(
            "fit image {run} @/{keypoints} --mask @/{mask} --outfit longlong --out @/no"
        ))
    };
    fit("unseen.json", "empty.png").failed_saying(&["mask is empty"]);
    // Where there is no silhouette, or another's.
    let standing: Vec<String> =
        (0..25).map(|at| format!("{},{},0.9", 20 + at % 3, 2 * at + 5)).collect();
    fs::write(data.at("standing.json"), people(&[person(&standing.join(","))])).unwrap();
    let far: Vec<String> =
        (0..25).map(|at| format!("{},{},0.9", 220 + at % 3, 20 * at + 5)).collect();
    fs::write(data.at("far.json"), people(&[person(&far.join(","))])).unwrap();
    let mut lower = black.clone();
    lower.pixels_mut()[3500..].fill([255; 4]);
    lower.save(data.at("lower.png")).unwrap();
    fit("far.json", "half.png").failed_saying(&["joints are on the mask", "another size"]);
    fit("standing.json", "lower.png").failed_saying(&["joints are on the mask"]);
    let mut file = NpzWriter::create(data.at("infinite.npz")).unwrap();
    file.add("keypoints", &Array2::from_elem((25, 3), f64::INFINITY)).unwrap();
    file.finish().unwrap();
    fit("infinite.npz", "half.png").failed_saying(&["infinite.npz", "nobody"]);
    data.run(&format!(
        "fit image {run} @/two.json --person 5 --mask @/half.png --outfit longlong --out @/no"
    ))
    .failed_saying(&["two.json", "person 5"]);
    fit("broken.json", "half.png").failed_saying(&["broken.json"]);
    fit("nobody.json", "half.png").failed_saying(&["nobody.json"]);
    fit("unseen.json", "half.png").failed_saying(&["joint"]);
    fit("two.json", "half.png").failed_saying(&["two.json", "choose one"]);
    assert!(!data.at("no").exists());
}
