//! Fits to all images of a directory and to the frames of a video.

use std::fs;

use serde_json::Value;

use crate::{
    fitting::person,
    support::{Packed, trained},
};

/// Directories poses and masks with the same person in images f1, f2 and f10, and a broken f3.
fn images() -> (Packed, String) {
    let (data, run) = (Packed::new(), trained().at("run").display().to_string());
    person(&data, &run);
    for directory in ["poses", "masks"] {
        fs::create_dir(data.at(directory)).unwrap();
    }
    for name in ["f1", "f2", "f10"] {
        let to = |path: String| data.at(&path);
        fs::copy(data.at("seen/best/keypoints.json"), to(format!("poses/{name}_keypoints.json")))
            .unwrap();
        fs::copy(data.at("seen/best/mask.png"), to(format!("masks/{name}.png"))).unwrap();
    }
    fs::write(data.at("poses/f3_keypoints.json"), "{").unwrap();
    fs::write(data.at("poses/._f1_keypoints.json"), "of a file manager").unwrap();
    fs::copy(data.at("masks/f1.png"), data.at("masks/f3.png")).unwrap();
    (data, run)
}

fn lines(text: &[u8]) -> Vec<Value> {
    let text = String::from_utf8(text.to_vec()).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn all_images_of_a_directory_are_fitted() {
    let (data, run) = images();
    let command = format!(
        "fit image {run} --keypoints @/poses --masks @/masks --outfit longlong --config @/few.toml \
         --out @/fits"
    );
    let ran = data.run(&format!("{command} --json"));
    assert!(ran.err.contains("f3: "), "{}", ran.err);
    let summary = ran.json();
    assert_eq!((&summary["images"], &summary["failed"]), (&4.into(), &1.into()), "{summary}");
    let first = fs::read(data.at("fits/fits.jsonl")).unwrap();
    let fits = lines(&first);
    let names: Vec<&str> = fits.iter().map(|fit| fit["image"].as_str().unwrap()).collect();
    assert_eq!(names, ["f1", "f2", "f3", "f10"]);
    assert_eq!(fits[2]["status"], "failed");
    let reason = fits[2]["reason"].as_str().unwrap();
    assert!(reason.contains("f3_keypoints.json") && reason.contains("not JSON"), "{reason}");
    // Equal images have equal fits, whichever thread they were fitted on, and as one image has.
    let single = "@/poses/f1_keypoints.json --mask @/masks/f1.png";
    data.run(&format!(
        "fit image {run} {single} --outfit longlong --config @/few.toml --out @/alone"
    ))
    .succeeded();
    let fitted = |place: &str| {
        let fit: Value = serde_json::from_slice(&fs::read(data.at(place)).unwrap()).unwrap();
        fit["clothed"].clone()
    };
    let alone = fitted("alone/fit.json");
    for name in ["f1", "f2", "f10"] {
        assert_eq!(fitted(&format!("fits/{name}/fit.json")), alone);
    }
    assert!(data.at("fits/fits.png").exists() && data.at("fits/f1/clothed.ply").exists());

    // What is finished is kept; changed and missing images are fitted.
    let kept = fs::metadata(data.at("fits/f1/fit.json")).unwrap().modified().unwrap();
    fs::remove_file(data.at("fits/fits.jsonl")).unwrap();
    fs::copy(data.at("poses/f1_keypoints.json"), data.at("poses/f3_keypoints.json")).unwrap();
    let text = data.run(&command).succeeded();
    assert!(text.contains("4 images") && text.contains("0 failed"), "{text}");
    assert_eq!(fs::metadata(data.at("fits/f1/fit.json")).unwrap().modified().unwrap(), kept);
    assert_eq!(lines(&fs::read(data.at("fits/fits.jsonl")).unwrap())[0], fits[0]);
    assert_eq!(fitted("fits/f3/fit.json"), alone);
    data.run(&command.replace("longlong", "shortlong")).failed_saying(&[
        "settings.json",
        "`settings.outfit`",
        "--out",
    ]);

    fs::remove_file(data.at("masks/f2.png")).unwrap();
    data.run(&command.replace("@/fits", "@/again")).succeeded();
    let fits = lines(&fs::read(data.at("again/fits.jsonl")).unwrap());
    assert!(fits[1]["reason"].as_str().unwrap().contains("no mask of this name"), "{}", fits[1]);
}

#[test]
fn videos_become_motions() {
    let (data, run) = images();
    let command = format!(
        "fit image {run} --keypoints @/poses --masks @/masks --outfit longlong --config @/few.toml \
         --sequence --fps 25"
    );
    let ran = data.run(&format!("{command} --out @/moving --json"));
    assert!(ran.err.contains("f3: left out"), "{}", ran.err);
    let report = ran.json();
    assert_eq!((&report["frames"], &report["frames_per_second"]), (&4.into(), &25.0.into()));
    let frames = lines(&fs::read(data.at("moving/fits.jsonl")).unwrap());
    let observed: Vec<bool> =
        frames.iter().map(|frame| frame["observed"].as_bool().unwrap()).collect();
    assert_eq!(observed, [true, true, false, true]);
    for name in ["motion.npz", "clothed.glb", "code.npy", "fits.png", "sequence.json"] {
        assert!(data.at("moving").join(name).exists(), "{name}");
    }
    // Other commands read the motion: its rate, its frames, its shape.
    let moved = data.run(&format!(
        "animate {run} --motion @/moving/motion.npz --code @/moving/code.npy:0 --format ply --out @/walk \
         --json"
    ));
    let moved = moved.json();
    assert_eq!((&moved["frames"], &moved["frames_per_second"]), (&4.into(), &25.0.into()));
    let betas = |report: &Value| report["betas"].as_array().unwrap().len();
    assert_eq!(betas(&moved), betas(&report["fit"]));

    data.run(&format!("{command} --compare-outfits --out @/no")).misused(&["--compare-outfits"]);
    data.run(&format!("fit image {run} --keypoints @/poses --fps 25 --out @/no"))
        .misused(&["--sequence"]);
}
