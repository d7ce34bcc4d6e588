//! Priors fitted after training, and samples drawn from them and measured.

use std::fs;

use serde_json::Value;

use crate::support::Packed;

fn codes(data: &Packed, out: &str) -> Vec<Value> {
    let lines = fs::read_to_string(data.at(out).join("samples.jsonl")).unwrap();
    lines.lines().map(|line| serde_json::from_str::<Value>(line).unwrap()["code"].take()).collect()
}

#[test]
fn a_fitted_prior_is_sampled_from_and_says_when_it_is_missing() {
    let data = Packed::new();
    data.train().succeeded();
    let sample = |out: &str, options: &str| {
        data.run(&format!("sample @/run --out @/{out} --outfit all --no-picture {options}"))
    };
    // Training ends with a mixture, which is drawn from by default.
    sample("own", "--seed 3").succeeded();
    sample("own_gmm", "--seed 3 --prior gmm").succeeded();
    sample("normal", "--seed 3 --prior normal").succeeded();
    assert_eq!(codes(&data, "own"), codes(&data, "own_gmm"));
    assert_ne!(codes(&data, "own"), codes(&data, "normal"));
    let normal = codes(&data, "normal");
    assert!(normal.iter().all(|code| *code == normal[0]));
    fs::remove_file(data.at("run/prior-gmm.npz")).unwrap();
    sample("without", "--seed 3").succeeded();
    assert_eq!(codes(&data, "without"), normal);
    sample("none", "--prior gmm").failed_saying(&["prior-gmm.npz", "cape model prior"]);
    assert!(!data.at("none").exists());

    let report = data.run("model prior @/run --json").json();
    assert!(report["codes"].as_u64().unwrap() > 0);
    let groups = report["groups"].as_array().unwrap();
    assert!(groups.iter().all(|group| group["components"].as_u64().unwrap() >= 1));
    data.run("model prior @/run --kind kde --joint").succeeded();
    data.run("model prior @/run --kind kde --components 3").failed_saying(&["--components"]);

    sample("gmm", "--prior gmm --n 2 --seed 3").succeeded();
    sample("again", "--prior gmm --n 2 --seed 3").succeeded();
    sample("kde", "--prior kde").succeeded();
    assert_eq!(codes(&data, "gmm"), codes(&data, "again"));
    assert_eq!(codes(&data, "gmm").len(), 8);
    // Without temperature a mixture of one component gives its mean, whatever the seed.
    data.run("model prior @/run --components 1").succeeded();
    sample("mean", "--prior gmm --temperature 0 --seed 1").succeeded();
    sample("other", "--prior gmm --temperature 0 --seed 2").succeeded();
    assert_eq!(codes(&data, "mean"), codes(&data, "other"));
    sample("cold", "--temperature=-1").failed_saying(&["--temperature"]);

    fs::write(data.at("run/prior-kde.npz"), "no archive").unwrap();
    sample("broken", "--prior kde").failed_saying(&["prior-kde.npz"]);
}

#[test]
fn samples_are_measured_against_held_out_frames() {
    let data = Packed::new();
    data.train().succeeded();
    data.run("model prior @/run").succeeded();
    let of = |options: &str| data.run(&format!("eval samples @/run --json {options}")).json();
    let report = of("--prior gmm");
    for share in ["coverage", "nearest_neighbour_accuracy", "outfit_consistency"] {
        let share = report[share].as_f64().unwrap();
        assert!((0.0..=1.0).contains(&share), "{report}");
    }
    assert!(report["minimum_matching_mm"].as_f64().unwrap() > 0.0);
    assert_eq!(report, of("--prior gmm"));
    assert_eq!(of("--prior normal --temperature 0")["diversity_mm"][0][1], 0.0);
    for set in ["held_out", "training", "principal", "principal_held_out", "principal_training"] {
        let accuracy = report[set]["nearest_neighbour_accuracy"].as_f64().unwrap();
        assert!((0.0..=1.0).contains(&accuracy), "{report}");
    }
    let transfer = &report["pose_transfer"];
    let mm = |name: &str| transfer[name].as_f64().unwrap();
    assert!(mm("reconstructed_mm") > 0.0 && mm("transferred_mm") > 0.0, "{report}");
    // The change between the two frames of a pair is the error of offsets that stay.
    assert_eq!(mm("fixed_offsets_mm"), mm("true_change_mm"));
    assert!(data.at("run/samples.json").exists());
    let text = data.run("eval samples @/run").succeeded();
    assert!(text.contains("coverage") && text.contains("held-out frames"), "{text}");
}

#[test]
fn the_pose_moves_the_clothes_and_numbers_say_how_much() {
    let data = Packed::new();
    data.train().succeeded();
    let line = "eval pose @/run --pose-b squats --out @/effect --json";
    let report = data.run(line).json();
    let number = |key: &str| report[key].as_f64().unwrap();
    assert!(number("mean_mm") > 0.0 && number("largest_mm") >= number("mean_mm"));
    assert!(number("posed_mean_mm") > 0.0);
    for name in ["pose_effect.png", "pose_effect.json", "change.ply"] {
        assert!(data.at("effect").join(name).exists(), "{name}");
    }
    let still = data.run("eval pose @/run --pose-b a-pose --out @/still --json").json();
    assert_eq!(still["mean_mm"], 0.0);
    data.run("eval pose @/run --pose-b somersault --out @/none").failed_saying(&["somersault"]);
}

#[test]
fn a_movement_becomes_pictures_meshes_or_one_file() {
    let data = Packed::new();
    data.train().succeeded();
    let animate = |out: &str, options: &str| {
        data.run(&format!("animate @/run --seconds 0.4 --fps 10 --out @/{out} --json {options}"))
    };
    let report = animate("png", "--size 64").json();
    assert_eq!(report["frames"], 4);
    assert!(report["acceleration"].as_f64().unwrap() >= 0.0);
    for name in ["frame-00003.png", "animation.png", "animation.json"] {
        assert!(data.at("png").join(name).exists(), "{name}");
    }
    animate("glb", "--format glb").succeeded();
    assert!(fs::read(data.at("glb/animation.glb")).unwrap().starts_with(b"glTF"));
    animate("ply", "--format ply").succeeded();
    assert!(data.at("ply/frame-00000.ply").exists());
    let row = vec!["0.1"; 72].join(",");
    fs::write(data.at("dance.csv"), format!("{row}\n{row}\n")).unwrap();
    let line = format!("--motion {} --format obj", data.at("dance.csv").display());
    assert_eq!(animate("csv", &line).json()["frames"], 2);
    animate("csv", "").failed_saying(&["csv"]);
}
