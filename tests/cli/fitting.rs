//! Clothed bodies from images.

use std::fs;

use cape::render::Image;

use crate::support::{Packed, trained};

#[test]
fn held_out_frames_are_fitted_and_measured() {
    let (data, run) = (Packed::new(), trained().at("run").display().to_string());
    let options = "--frames 2 --size 128 --noise 1 --dropped 0.1 --ragged 0.1";
    let report = data.run(&format!("fit-benchmark {run} {options} --out @/fits --json")).json();
    assert_eq!(report["cases"].as_array().unwrap().len(), 2);
    for kind in ["bare", "clothed"] {
        assert!(report[kind]["squared"].as_f64().unwrap() > 0.0, "{report}");
        assert!(report[kind]["intersection_over_union"].as_f64().unwrap() <= 1.0);
    }
    assert!(data.at("fits/fits.png").exists() && data.at("fits/benchmark.json").exists());
    data.run(&format!("fit-benchmark {run} --dropped 2 --out @/no")).failed_saying(&["--dropped"]);
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
        data.run(&format!("fit {run} @/{keypoints} --mask @/{mask} --outfit longlong --out @/no"))
    };
    fit("unseen.json", "empty.png").failed_saying(&["mask is empty"]);
    fit("broken.json", "half.png").failed_saying(&["broken.json"]);
    fit("nobody.json", "half.png").failed_saying(&["nobody.json"]);
    fit("unseen.json", "half.png").failed_saying(&["joint"]);
    fit("two.json", "half.png").failed_saying(&["two.json", "choose one"]);
    assert!(!data.at("no").exists());
}
