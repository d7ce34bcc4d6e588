//! Names of runs.

use std::{
    collections::HashMap,
    fs,
    path::{Component, Path, PathBuf},
};

/// Names of the runs' directories, with as many parent directories as it takes to tell them apart.
pub(super) fn run_names(runs: &[PathBuf]) -> Vec<String> {
    let parts: Vec<Vec<String>> = runs.iter().map(|run| parts(run)).collect();
    let mut depths = vec![1; runs.len()];
    loop {
        let names: Vec<String> = parts
            .iter()
            .zip(&depths)
            .map(|(parts, &depth)| parts[parts.len().saturating_sub(depth)..].join("/"))
            .collect();
        let ambiguous = |name: &String, of: &Vec<String>| {
            names.iter().zip(&parts).any(|(other, parts)| other == name && parts != of)
        };
        let mut deeper = false;
        for ((name, parts), depth) in names.iter().zip(&parts).zip(&mut depths) {
            if ambiguous(name, parts) && *depth < parts.len() {
                *depth += 1;
                deeper = true;
            }
        }
        if !deeper {
            return numbered(names);
        }
    }
}

/// The directory's name and those above it, outermost first.
fn parts(run: &Path) -> Vec<String> {
    let whole = fs::canonicalize(run).unwrap_or_else(|_| run.to_owned());
    let name = |component: Component| match component {
        Component::Normal(name) => Some(name.to_string_lossy().into_owned()),
        _ => None,
    };
    let parts: Vec<String> = whole.components().filter_map(name).collect();
    if parts.is_empty() { vec![whole.display().to_string()] } else { parts }
}

/// A run that is named twice gets a number.
fn numbered(names: Vec<String>) -> Vec<String> {
    let mut seen: HashMap<String, usize> = HashMap::new();
    names
        .into_iter()
        .map(|name| {
            let count = seen.entry(name.clone()).or_default();
            *count += 1;
            if *count == 1 { name } else { format!("{name} ({count})") }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn from_paths(paths: &[&str]) -> Vec<String> {
        run_names(&paths.iter().map(PathBuf::from).collect::<Vec<_>>())
    }

    #[test]
    fn names_are_short_and_different() {
        assert_eq!(from_paths(&["/none/one", "/none/two/"]), ["one", "two"]);
        assert_eq!(
            from_paths(&["/none/a/seed-1/run", "/none/b/seed-1/run", "/none/b/other"]),
            ["a/seed-1/run", "b/seed-1/run", "other"]
        );
        assert_eq!(from_paths(&["/none/run", "/none/run", "/none/x"]), ["run", "run (2)", "x"]);
        assert_eq!(from_paths(&["/run", "/a/run"]), ["run", "a/run"]);
    }
}
