//! Crate roots and entry points have an example.
//!
//! `#![warn(missing_docs)]` requires documentation of every public item; here are the items that a user
//! meets first, which need a compiled example too.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

/// Entry points of each crate.
const ENTRY_POINTS: [(&str, &[&str]); 18] = [
    ("cape-body", &["Assets", "make_body"]),
    ("cape-cloth", &["Cloth", "Garment"]),
    (
        "cape-core",
        &[
            "ClothedSmpl",
            "Mesh",
            "Outfit",
            "OutfitVocabulary",
            "Smpl",
            "SmplModel",
            "SubjectBodies",
            "SurfaceIndex",
        ],
    ),
    ("cape-data", &["Loader", "PackedSet", "SplitSpec"]),
    ("cape-eval", &["ComparisonTable", "EvalOptions", "ResultStore"]),
    ("cape-fit", &["DressedBody", "Keypoints", "PinholeCamera", "PosePrior", "Smplify"]),
    ("cape-graph", &["DevicePyramid", "MeshPyramid", "SparseMatrix", "Surface"]),
    ("cape-infer", &["GarmentColours", "Prior", "Run", "RunConfig"]),
    ("cape-layer", &["Association", "Layer", "LayerSet", "UnposedSet"]),
    ("cape-model", &["Cape", "CapeConfig"]),
    ("cape-onnx", &["OnnxModel", "export_body", "export_decoder", "export_encoder"]),
    ("cape-render", &["Camera", "Image", "Object", "Plot", "Style"]),
    ("cape-stats", &["ErrorStats", "Mixture", "PairedComparison", "Pca"]),
    ("cape-study", &["StudyDesign", "StudyScore"]),
    (
        "cape-synth",
        &["CaptureGenerator", "Motion", "SynthSpec", "Wardrobe", "embedded_body", "synthetic_body"],
    ),
    ("cape-train", &["Collective", "Evaluation", "Launch", "Trainer"]),
    ("cape-wardrobe", &["OutfitCut", "SimulatedCaptures", "SurfaceTransfer"]),
    ("cape-weights", &["pretrained"]),
];

/// True for a source file other than tests.
fn is_source(path: &Path) -> bool {
    let stem = path.file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
    path.extension().is_some_and(|extension| extension == "rs") && !stem.ends_with("tests")
}

fn sources(directory: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(directory).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(sources(&path));
        } else if is_source(&path) {
            found.push(path);
        }
    }
    found
}

/// Name of the public type or function that a line of source declares.
fn declared(line: &str) -> Option<&str> {
    let mut words = line.strip_prefix("pub ")?.splitn(2, ' ');
    if !matches!(words.next()?, "struct" | "enum" | "union" | "trait" | "type" | "fn") {
        return None;
    }
    let rest = words.next()?;
    let end = rest.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(rest.len());
    Some(&rest[..end])
}

/// True if documentation has a compiled example.
fn has_example(documentation: &[&str]) -> bool {
    let mut inside = false;
    documentation.iter().any(|line| {
        let text = line.trim_start_matches(['/', '!']).trim();
        let Some(language) = text.strip_prefix("```") else { return false };
        inside = !inside;
        inside && matches!(language, "" | "no_run" | "should_panic")
    })
}

/// Public types and functions of a source file, and whether each has an example.
fn items(source: &str) -> Vec<(&str, bool)> {
    let (mut documentation, mut items) = (Vec::new(), Vec::new());
    for line in source.lines() {
        if line.starts_with("///") {
            documentation.push(line);
            continue;
        }
        if let Some(name) = declared(line) {
            items.push((name, has_example(&documentation)));
        }
        // Attributes, also of several lines, are between an item and its documentation.
        if line.is_empty() || line == "}" || declared(line).is_some() {
            documentation.clear();
        }
    }
    items
}

#[test]
fn crate_roots_have_an_example() {
    let mut missing = Vec::new();
    for (name, _) in ENTRY_POINTS {
        let library = Path::new("crates").join(name).join("src/lib.rs");
        let library = fs::read_to_string(library).unwrap();
        let lines: Vec<&str> = library.lines().filter(|line| line.starts_with("//!")).collect();
        if !has_example(&lines) {
            missing.push(name);
        }
    }
    assert!(missing.is_empty(), "crate roots without an example: {}", missing.join(", "));
}

#[test]
fn entry_points_have_an_example() {
    let mut missing = Vec::new();
    for (name, entry_points) in ENTRY_POINTS {
        let mut with_example: BTreeMap<String, bool> = BTreeMap::new();
        for path in sources(&Path::new("crates").join(name).join("src")) {
            let source = fs::read_to_string(&path).unwrap();
            for (item, example) in items(&source) {
                *with_example.entry(item.to_owned()).or_default() |= example;
            }
        }
        for &item in entry_points {
            match with_example.get(item) {
                Some(true) => {}
                Some(false) => missing.push(format!("{name}: {item} has no example")),
                None => missing.push(format!("{name}: {item} does not exist")),
            }
        }
    }
    assert!(missing.is_empty(), "{}", missing.join("\n"));
}

#[test]
fn all_library_crates_are_listed() {
    let mut crates: Vec<String> = fs::read_dir("crates")
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .filter(|name| Path::new("crates").join(name).join("src/lib.rs").exists())
        .filter(|name| !["cape-cli", "cape-py"].contains(&name.as_str()))
        .collect();
    crates.sort();
    assert_eq!(crates, ENTRY_POINTS.map(|(name, _)| name));
}

#[test]
fn items_without_examples_are_noticed() {
    let source = "/// One, as a table of TOML.\n///\n/// ```toml\n/// a = 1\n/// ```\npub struct T;\n\n/// One.\n///\n/// ```\n/// ```\n#[derive(\n    Debug,\n)]\npub struct A<T>(T);\n\n\
                  /// Two.\npub enum B {\n    C,\n}\n/// ```\n/// f();\n/// ```\npub fn f() {}\n\
                  pub(crate) struct F;\n";
    assert_eq!(items(source), [("T", false), ("A", true), ("B", false), ("f", true)]);
}
