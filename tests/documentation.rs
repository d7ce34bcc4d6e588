//! Every public type has an example, or says where there is one.

use std::{
    fs,
    path::{Path, PathBuf},
};

/// Crates whose types all have examples.
const CRATES: [&str; 7] = [
    "cape-core",
    "cape-fit",
    "cape-graph",
    "cape-layer",
    "cape-model",
    "cape-render",
    "cape-train",
];

/// Whether a file is source other than tests.
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

/// The name of the public type that a line of source declares; results of operations aside.
fn declared(line: &str) -> Option<&str> {
    let mut words = line.strip_prefix("pub ")?.splitn(2, ' ');
    if !matches!(words.next()?, "struct" | "enum" | "union" | "trait" | "type") {
        return None;
    }
    let rest = words.next()?;
    let end = rest.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(rest.len());
    Some(&rest[..end]).filter(|&name| name != "Result")
}

/// Whether documentation has an example that is compiled, or a link to one.
fn is_exemplified(documentation: &[&str]) -> bool {
    let mut inside = false;
    documentation.iter().any(|line| {
        let text = line.trim_start_matches(['/', '!']).trim();
        let Some(language) = text.strip_prefix("```") else {
            return text.starts_with("See [`") && text.ends_with("for an example.");
        };
        inside = !inside;
        inside && matches!(language, "" | "no_run" | "should_panic")
    })
}

/// Names of the public types of a source file that have no example.
fn lacking(source: &str) -> Vec<String> {
    let (mut documentation, mut names) = (Vec::new(), Vec::new());
    for line in source.lines() {
        if line.starts_with("///") {
            documentation.push(line);
            continue;
        }
        if let Some(name) = declared(line)
            && !is_exemplified(&documentation)
        {
            names.push(name.to_owned());
        }
        // Attributes, on several lines too, stand between a type and its documentation.
        if line.is_empty() || line == "}" || declared(line).is_some() {
            documentation.clear();
        }
    }
    names
}

#[test]
fn every_public_type_has_an_example() {
    let mut complaints = Vec::new();
    for name in CRATES {
        let root = Path::new("crates").join(name).join("src");
        for path in sources(&root) {
            let source = fs::read_to_string(&path).unwrap();
            complaints.extend(
                lacking(&source).into_iter().map(|name| format!("{}: {name}", path.display())),
            );
        }
        let library = fs::read_to_string(root.join("lib.rs")).unwrap();
        let lines: Vec<&str> = library.lines().filter(|line| line.starts_with("//!")).collect();
        if !is_exemplified(&lines) {
            complaints.push(format!("{name}: the crate itself"));
        }
    }
    complaints.sort();
    assert!(complaints.is_empty(), "without an example:\n{}", complaints.join("\n"));
}

#[test]
fn types_without_examples_are_noticed() {
    let source = "/// One, as a table of TOML.\n///\n/// ```toml\n/// a = 1\n/// ```\npub struct T;\n\n/// One.\n///\n/// ```\n/// ```\n#[derive(\n    Debug,\n)]\npub struct A<T>(T);\n\n\
                  /// Two.\npub enum B {\n    C,\n}\n/// See [`A`] for an example.\npub trait D: E {}\n\
                  pub(crate) struct F;\npub type Result<T> = std::result::Result<T, B>;\n";
    assert_eq!(lacking(source), ["T", "B"]);
}
