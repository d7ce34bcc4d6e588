use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
};

use cape_core::{Outfit, SmplModel, list_files, npy::npy_header, smpl::Gender};
use cape_data::{
    ForeignData, PackedSet, RawCapture, RawTree, STATISTICS_FILE, Split,
    raw::{BODY_FILE, CLOTHING_FILE, SPLIT_FILE, gender_split_file},
};
use cape_infer::RunConfig;

use super::{FileSummary, file::run_config};
use crate::{
    body_source,
    error::{Error, Result},
    mesh_file::has_extension,
};

pub(super) fn describe(path: &Path) -> Result<FileSummary> {
    let there = |name: &str| path.join(name).exists();
    if there("config.toml") {
        run(path)
    } else if there("train/train_disp.npy") || there("test/test_disp.npy") {
        packed(path)
    } else if RawTree::is_raw(path) {
        raw_tree(path)
    } else if there("A_0.npz") {
        pyramid(path)
    } else if entries(path)?.iter().any(|path| has_extension(path, "index")) {
        super::file::tensorflow(path)
    } else if let Some(data) = ForeignData::recognise(path) {
        Err(Error::message(format!("{}: {data}", path.display())))
    } else {
        Err(Error::message(format!(
            "{}: unknown kind of directory: expected raw data (sequences/), a packed set \
             (train/train_disp.npy), a run (config.toml), a pyramid (A_0.npz) or a TensorFlow checkpoint",
            path.display()
        )))
    }
}

fn run(path: &Path) -> Result<FileSummary> {
    let config = RunConfig::load(&path.join("config.toml"))?;
    let checkpoints: Vec<String> =
        entries(&path.join("checkpoints")).unwrap_or_default().iter().map(|p| name(p)).collect();
    let facts = FileSummary::new("run")
        .with("checkpoints", checkpoints)
        .maybe("body", body(path, BODY_FILE));
    let steps = fs::read_to_string(path.join("metrics.jsonl")).unwrap_or_default();
    let evaluated = path.join("eval.json").exists();
    Ok(run_config(facts, &config)
        .with("lines of metrics", steps.lines().count())
        .with("evaluated", evaluated))
}

/// The body in a file of a directory: a built-in one by its name, or the begin of its SHA-256; `None` without one.
fn body(directory: &Path, name: &str) -> Option<String> {
    let path = directory.join(name);
    if !path.exists() {
        return None;
    }
    Some(match SmplModel::load(&path) {
        Err(error) => error.to_string(),
        Ok(model) => body_source::describe(&model),
    })
}

fn raw_tree(path: &Path) -> Result<FileSummary> {
    let tree = RawTree::open(path)?;
    let names: Vec<String> = tree.subjects().map(str::to_owned).collect();
    let all = || names.iter().flat_map(|subject| tree.captures(subject));
    let sequences: BTreeSet<&str> = all().map(RawCapture::sequence).collect();
    let outfits: BTreeSet<Outfit> = all().map(RawCapture::outfit).collect();
    let frames: usize = all().map(|capture| capture.frames().len()).sum();
    let captures = all().count();
    let vertices = names.first().and_then(|subject| tree.minimal(subject, true).ok());
    let mut facts = FileSummary::new("raw captures")
        .with("subjects", names.clone())
        .with("outfits", outfits.iter().map(ToString::to_string).collect::<Vec<_>>())
        .with("sequences", sequences.len())
        .with("captures", captures)
        .with("frames", frames)
        .maybe("vertices", vertices.map(|shape| shape.nrows()))
        .maybe("body", body(path, BODY_FILE));
    let mut brought = brought(path, &[BODY_FILE, CLOTHING_FILE, SPLIT_FILE]);
    let genders = tree.genders()?;
    for gender in [Gender::Male, Gender::Female] {
        let of_gender = |name: &&String| genders.get(*name) == Some(&gender.to_string());
        let subjects: Vec<String> = names.iter().filter(of_gender).cloned().collect();
        if !subjects.is_empty() {
            facts = facts
                .with(format!("{gender} subjects"), subjects)
                .maybe(format!("{gender} body"), body(path, gender.body_file()));
        }
        brought.extend(self::brought(path, &[gender.body_file(), gender_split_file(gender)]));
    }
    Ok(facts.with("also contains", brought))
}

fn packed(path: &Path) -> Result<FileSummary> {
    let mut facts = FileSummary::new("packed set").maybe("body", body(path, BODY_FILE));
    for part in [Split::Train, Split::Test] {
        let displacement = path.join(part.name()).join(format!("{part}_disp.npy"));
        if !displacement.exists() {
            continue;
        }
        let set = PackedSet::open(path, part)?;
        let header = npy_header(&displacement)?;
        let outfits: BTreeSet<&str> = set.outfits().iter().map(Outfit::name).collect();
        facts = facts
            .with(format!("{part} frames"), set.frames())
            .with(format!("{part} outfits"), outfits.into_iter().collect::<Vec<_>>())
            .with(format!("{part} labels"), label_names(&set))
            .with(format!("{part} vertices"), set.vertices())
            .with(format!("{part} type"), header.dtype.to_string());
        if let Some(origins) = set.origins() {
            let subjects: BTreeSet<&str> = origins.iter().map(|o| o.subject.as_str()).collect();
            let sequences: BTreeSet<&str> = origins.iter().map(|o| o.sequence.as_str()).collect();
            facts = facts
                .with(format!("{part} subjects"), subjects.len())
                .with(format!("{part} sequences"), sequences.into_iter().collect::<Vec<_>>());
        }
    }
    Ok(facts.with(
        "also contains",
        brought(path, &[BODY_FILE, CLOTHING_FILE, SPLIT_FILE, STATISTICS_FILE]),
    ))
}

/// The outfits of the labels, in their order, and a note if the set does not name them.
fn label_names(set: &PackedSet) -> String {
    let names = set.vocabulary().to_string();
    match (set.names_outfits(), set.vocabulary().is_paper()) {
        (true, _) => names,
        (false, true) => format!("{names} (the paper's: the set has no {SPLIT_FILE})"),
        (false, false) => format!("{names} (not named: the set has no {SPLIT_FILE})"),
    }
}

fn pyramid(path: &Path) -> Result<FileSummary> {
    let mut vertices = Vec::new();
    loop {
        let file = path.join(format!("A_{}.npz", vertices.len()));
        if !file.exists() {
            break;
        }
        let shape = cape_core::npy::Npz::open(&file)?.i64("shape")?;
        vertices.push(shape.first().copied().unwrap_or_default());
    }
    Ok(FileSummary::new("mesh pyramid as SciPy matrices")
        .with("levels", vertices.len())
        .with("vertices", vertices))
}

/// The names among `names` of files in `path`.
fn brought(path: &Path, names: &[&str]) -> Vec<String> {
    names.iter().filter(|name| path.join(name).exists()).map(ToString::to_string).collect()
}

fn entries(path: &Path) -> Result<Vec<PathBuf>> {
    Ok(list_files(path, |_| true)?)
}

fn name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}
