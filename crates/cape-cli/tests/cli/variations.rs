//! Variations of samples, registrations in other clothes, and bodies in bulk.

use std::fs;

use cape::{
    core::{Mesh, npy::Npz},
    render::Image,
};
use serde_json::Value;

use crate::support::{Packed, VERTICES, contents, trained};

fn lines(data: &Packed, path: &str) -> Vec<Value> {
    let text = fs::read_to_string(data.at(path)).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// The trained run, with a directory for what is made of it.
fn place() -> (Packed, String) {
    (Packed::new(), trained().at("run").display().to_string())
}

#[test]
fn one_thing_changes_and_the_rest_is_fixed() {
    let (data, run) = place();
    let vary = |out: &str, options: &str| {
        data.run(&format!("vary {run} --out @/{out} {options}")).succeeded();
        lines(&data, &format!("{out}/variations.jsonl"))
    };
    let differ = |bodies: &[Value], field: &str| {
        bodies.windows(2).filter(|pair| pair[0][field] != pair[1][field]).count()
    };
    for (by, count, changing) in
        [("code", 3, "code"), ("pose", 3, "pose"), ("outfit", 4, "outfit"), ("shape", 3, "betas")]
    {
        let bodies = vary(by, &format!("--by {by} --columns 3 --same-code"));
        assert_eq!(bodies.len(), count);
        for field in ["code", "pose", "outfit", "betas"] {
            let expected = if field == changing { count - 1 } else { 0 };
            assert_eq!(differ(&bodies, field), expected, "{by}: {field}");
        }
        let picture = Image::load(data.at(&format!("{by}/variations.png"))).unwrap();
        assert!(picture.width() as usize > count * 240);
        let file = bodies[0]["file"].as_str().unwrap();
        assert_eq!(Mesh::load(data.at(&format!("{by}/{file}"))).unwrap().vertices.len(), VERTICES);
    }
    // Moved to its place among the codes of each outfit; those of the standard normal prior are of none.
    let moved = vary("moved", "--by outfit --no-meshes --outfit shortshort");
    assert_eq!((differ(&moved, "code"), differ(&moved, "outfit")), (3, 3));
    let same = vary("same", "--by outfit --no-meshes --outfit shortshort --same-code");
    let own = |bodies: &[Value]| {
        bodies.iter().find(|body| body["outfit"] == "shortshort").unwrap()["code"].clone()
    };
    assert_eq!(own(&moved), own(&same));
    assert_eq!(differ(&vary("normal", "--by outfit --no-meshes --prior normal"), "code"), 0);
    // A held-out frame has an outfit.
    let frame = vary("frame", "--by outfit --no-meshes --codes frame:1");
    let encoded = vary("encoded", "--by outfit --no-meshes --codes frame:1 --same-code");
    let worn =
        |bodies: &[Value]| bodies.iter().map(|body| body["code"].clone()).collect::<Vec<_>>();
    let equal = worn(&frame).iter().zip(worn(&encoded)).filter(|(a, b)| *a == b).count();
    assert_eq!(equal, 1);
    assert_eq!(vary("direction", "--by direction --rows 2 --columns 3 --no-meshes").len(), 6);
    assert!(!data.at("direction/000.ply").exists());
}

#[test]
fn unknown_outfits_are_refused_with_those_of_the_run() {
    let (data, run) = place();
    let known =
        "unknown outfit `poloshort`: expected one of shortlong, shortshort, longshort, longlong";
    for command in [
        "sample {} --outfit poloshort --out @/none",
        "vary {} --outfit poloshort --out @/none",
        "animate {} --outfit poloshort --out @/none",
        "redress {} frame:1 --outfit longlong,poloshort --out @/none",
        "redress {} frame:1 --was poloshort --out @/none",
        "data generate {} --outfit poloshort --out @/none",
    ] {
        data.run(&command.replace("{}", &run)).failed_saying(&[known]);
        assert!(!data.at("none").exists(), "{command}");
    }
    let line = format!("sample {run} --outfit polo_short --out @/none");
    data.run(&line).misused(&["expected a name"]);
}

#[test]
fn codes_are_named_added_and_gone_between() {
    let (data, run) = place();
    let vary = |out: &str, options: &[&str]| {
        let mut words = vec!["vary".to_owned(), run.clone(), "--out".into()];
        words.push(data.at(out).display().to_string());
        words.extend(options.iter().map(ToString::to_string));
        crate::support::run(words)
    };
    vary("between", &["--by", "between", "--codes", "seed:1,frame:0", "--columns", "3"])
        .succeeded();
    let between = lines(&data, "between/variations.jsonl");
    let code = |body: &Value| -> Vec<f64> {
        body["code"].as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
    };
    let source = format!("{}:2", data.at("between/variations.jsonl").display());
    vary("sum", &["--by", "sum", "--sum", &format!("seed:1 - {source} + mean")]).succeeded();
    let sum = lines(&data, "sum/variations.jsonl");
    assert_eq!(sum.len(), 4);
    let (a, b) = (code(&between[0]), code(&between[2]));
    for (i, found) in code(&sum[3]).into_iter().enumerate() {
        assert!((found - (a[i] - b[i])).abs() < 1e-5);
    }
    vary("walk", &["--by", "walk", "--columns", "5", "--no-meshes"]).succeeded();
    assert!(data.at("walk/walk.png").exists());
    for (options, said) in [
        (vec!["--by", "sum"], "--sum"),
        (vec!["--by", "sum", "--sum", "seed:1 seed:2"], "expected codes with + or -"),
        (vec!["--codes", "frame:9999"], "frame 9999"),
        (vec!["--codes", "nonsense"], "unknown code"),
        (vec!["--by", "between", "--codes", "mean"], "expected 2, found 1"),
    ] {
        let columns = if options.contains(&"--codes") { vec!["--columns", "1"] } else { vec![] };
        let all: Vec<&str> = options.into_iter().chain(columns).collect();
        let ran = vary("wrong", &all);
        assert_ne!(ran.code, Some(0));
        assert!(ran.err.contains(said), "{}", ran.err);
    }
}

#[test]
fn a_registration_is_given_other_clothes_and_poses() {
    let (data, run) = place();
    let frame = "@/raw/sequences/ann/longlong_jump/longlong_jump.000002.npz";
    let found = contents(&data.at("raw/sequences/ann/longlong_jump"));
    let frame = frame.replace("longlong_jump.000002.npz", &found[1].0.display().to_string());
    let report =
        data.run(&format!("redress {run} {frame} --pose t-pose --out @/new --json")).json();
    assert_eq!(report["outfit"], "longlong");
    // The reconstruction, three other outfits and one other pose beside the registration.
    assert_eq!(report["files"].as_array().unwrap().len(), 6);
    assert!(report["error_mm"].as_f64().unwrap() < 100.0);
    assert!(report["residual_mm"].as_f64().unwrap() < 1e-3);
    for file in report["files"].as_array().unwrap() {
        assert!(data.at("new").join(file.as_str().unwrap()).exists());
    }
    let packed = data.run(&format!("redress {run} frame:1 --outfit shortshort --out @/two --json"));
    assert!(packed.json()["files"].as_array().unwrap().len() >= 2);
    data.run(&format!("redress {run} frame:77777 --out @/no")).failed_saying(&["frame 77777"]);
    fs::copy(data.at("raw/body.npz"), data.at("lost.npz")).unwrap();
    data.run(&format!("redress {run} @/lost.npz --out @/no")).failed_saying(&["--was"]);
    assert!(!data.at("no").exists());
}

#[test]
fn bodies_in_bulk_are_the_same_however_often_it_was_interrupted() {
    let (data, run) = place();
    let generate = |out: &str, options: &str| {
        data.run(&format!("data generate {run} --out @/{out} --seed 5 --json {options}"))
    };
    assert_eq!(generate("all", "--n 130").json()["made_now"], 130);
    let index = lines(&data, "all/index.jsonl");
    assert_eq!(index.len(), 130);
    let mut archive = Npz::open(data.at("all/bodies-000001.npz")).unwrap();
    assert_eq!(archive.f64("vertices").unwrap().shape(), [64, VERTICES, 3]);
    assert_eq!(index[64]["file"], "bodies-000001.npz");
    let outfits: std::collections::BTreeSet<_> =
        index.iter().map(|line| line["outfit"].to_string()).collect();
    assert_eq!(outfits.len(), 4);

    generate("parts", "--n 70").succeeded();
    fs::remove_file(data.at("parts/bodies-000000.npz")).unwrap();
    generate("parts", "--n 130").succeeded();
    assert_eq!(contents(&data.at("all")), contents(&data.at("parts")));
    generate("all", "--n 130 --temperature 0.5").failed_saying(&["other settings"]);

    generate("ply", "--n 3 --format ply").succeeded();
    assert!(Mesh::load(data.at("ply/body-000002.ply")).unwrap().vertices.len() == VERTICES);
}
