//! `train --check` and `train --find-rate`.

use std::fs;

use cape::render::Image;

use crate::support::{Packed, Ran};

#[test]
fn a_check_says_what_is_sound_and_leaves_nothing_behind() {
    let data = Packed::new();
    let line = "train --data @/packed --preset tiny --batch 4 --check --trial-steps 30";
    let Ran { code, out, err } = data.run(line);
    for what in
        ["overfits", "reconstruction loss falls", "discriminator learns", "pose net", "collapsed"]
    {
        assert!(out.contains(what), "`{what}` is not in:\n{out}{err}");
    }
    // Whether all of it passes is up to the data; the exit code says the same as the text.
    assert_eq!(code, Some(i32::from(!out.contains("all checks passed"))), "{out}{err}");
    assert!(!data.at("run").exists());
}

#[test]
fn a_recipe_that_cannot_work_does_not_pass() {
    let data = Packed::new();
    let line = "train --data @/packed --preset tiny --batch 4 --peak-rate 1e12 --warmup-epochs 0 \
                --check --trial-steps 20 --json";
    let Ran { code, out, .. } = data.run(line);
    assert_eq!(code, Some(1));
    let report: serde_json::Value = serde_json::from_str(&out).unwrap();
    assert_eq!(report["passed"], false);
    let findings = report["findings"].as_array().unwrap();
    assert!(findings.iter().any(|f| f["name"] == "losses and gradients are finite"), "{out}");
}

#[test]
fn a_learning_rate_is_suggested_below_the_one_that_explodes() {
    let data = Packed::new();
    let line = "train --data @/packed --preset tiny --batch 4 --find-rate --out @/rates --json";
    let report = data.run(line).json();
    let [suggested, lowest] = ["suggested", "lowest"].map(|key| report[key].as_f64().unwrap());
    assert!(1e-5 < suggested && suggested < lowest && lowest <= 1.0);
    if let Some(diverged) = report["diverged"].as_f64() {
        assert!(lowest <= diverged);
    }
    let csv = fs::read_to_string(data.at("rates/rates.csv")).unwrap();
    assert_eq!(csv.lines().count(), 1 + report["points"].as_array().unwrap().len());
    Image::load(data.at("rates/rates.png")).unwrap();
}

#[test]
fn tensorboard_gets_curves_histograms_and_pictures() {
    let data = Packed::new();
    data.run("train --data @/packed --out @/run --preset tiny --epochs 2 --batch 4").succeeded();
    let files = crate::support::contents(&data.at("run/tensorboard"));
    let [(_, events)] = files.as_slice() else { panic!("{} files", files.len()) };
    let holds = |text: &str| events.windows(text.len()).any(|part| part == text.as_bytes());
    for tag in [
        "train/gradient_norm_pose",
        "train/discriminator_accuracy",
        "validation/active_units",
        "validation/error_mm",
        "validation/reconstructions",
        "weights/generator.encoder.mean.weight",
        "PNG",
    ] {
        assert!(holds(tag), "`{tag}` is not there");
    }
}
