use std::{fs::File, io::Read, path::Path};

use cape_core::{
    Mesh, MeshFile, Outfit, PointCache, SmplModel,
    motion::{MotionOptions, read_motions},
    npy::{Npz, npy_header, read_objects},
    pickle::Pickle,
};
use cape_data::{DisplacementStatistics, SplitSpec, raw};
use cape_graph::{Level, MeshPyramid, Surface};
use cape_infer::{ModelFile, RunConfig};
use cape_model::{tensorflow::TensorFlowCheckpoint, weights};
use ndarray::Array2;

use super::FileSummary;
use crate::{
    body_source::BuiltinBody,
    error::{Error, Result},
    mesh_file::has_extension,
};

/// Start of the format's name in the header of a model file.
const MODEL_FORMAT: &[u8] = b"cape-model ";
/// Largest number of listed objects of an array.
const MOST_OBJECTS: usize = 32;
/// Largest number of listed entries of a pickled dictionary.
const MOST_KEYS: usize = 200;

pub(super) fn describe(path: &Path) -> Result<FileSummary> {
    let known = [
        "npz",
        "npy",
        "pkl",
        "smpl",
        "json",
        "csv",
        "obj",
        "ply",
        "stl",
        "off",
        "glb",
        "pc2",
        "pc16",
        "mdd",
        "safetensors",
        "toml",
        "index",
    ];
    match known.into_iter().find(|extension| has_extension(path, extension)) {
        Some("npz") => archive(path),
        Some("npy") => array(path),
        Some("pkl") => pickle(path),
        Some("smpl" | "json" | "csv") => motion(path),
        Some("pc2" | "pc16" | "mdd") => point_cache(path),
        Some("index") => tensorflow(path),
        Some("obj" | "ply" | "stl" | "off" | "glb") => mesh(path),
        Some("safetensors") => parameters(path),
        Some("toml") => settings(path),
        _ => Err(Error::message(format!(
            "{}: unknown kind of file: expected .{}",
            path.display(),
            known.join(", .")
        ))),
    }
}

fn archive(path: &Path) -> Result<FileSummary> {
    let archive = Npz::open(path)?;
    let has = |names: &[&str]| names.iter().all(|name| archive.contains(name));
    if has(&["v_template", "shapedirs"]) {
        return body(path);
    }
    if has(&["version", "weighting", "v0"]) {
        let pyramid = MeshPyramid::load(path)?;
        let vertices: Vec<usize> = pyramid.levels().iter().map(Level::vertex_count).collect();
        return Ok(FileSummary::new("mesh pyramid")
            .with("levels", vertices.len())
            .with("vertices", vertices)
            .with("weighting", pyramid.weighting().name()));
    }
    if has(&["mean", "std"]) {
        let statistics = DisplacementStatistics::load(path)?;
        return Ok(FileSummary::new("normalisation statistics")
            .with("vertices", statistics.vertices())
            .with("validation frames", statistics.validation())
            .with("mean of |mean|, mm", rounded(mean_of(statistics.mean().mapv(f64::abs))))
            .with("mean of std, mm", rounded(mean_of(statistics.std().clone()))));
    }
    if has(&["v_cano", "v_posed", "pose", "transl"]) {
        let frame = raw::read_frame(path, None)?;
        return Ok(FileSummary::new("captured frame")
            .with("vertices", frame.v_cano.nrows())
            .with("transl", frame.transl.to_vec()));
    }
    if let Ok(facts) = motion(path) {
        return Ok(facts);
    }
    let mut archive = archive;
    let mut facts = FileSummary::new("NumPy archive");
    for name in archive.names() {
        let shape = archive.f64(&name).map(|array| format!("{:?}", array.shape()));
        facts = facts.with(name, shape.unwrap_or_else(|_| "not numeric".into()));
    }
    Ok(facts)
}

fn mean_of(metres: Array2<f64>) -> f64 {
    1000.0 * metres.mean().unwrap_or(f64::NAN)
}

fn rounded(value: f64) -> f64 {
    (1000.0 * value).round() / 1000.0
}

fn body(path: &Path) -> Result<FileSummary> {
    Ok(body_facts("body in SMPL's layout", &SmplModel::load(path)?))
}

/// Describes a body of the program with its source.
pub(super) fn describe_builtin(body: BuiltinBody) -> Result<FileSummary> {
    let facts = body_facts("built-in body in SMPL's layout", &body.load()?);
    Ok(facts.with("source", body.provenance()?))
}

fn body_facts(kind: &'static str, body: &SmplModel) -> FileSummary {
    FileSummary::new(kind)
        .with("vertices", body.vertices())
        .with("faces", body.faces.len())
        .with("joints", body.joints())
        .with("shape directions", body.betas())
        .maybe("height, m", height(&body.mesh()))
}

fn height(mesh: &Mesh) -> Option<f64> {
    let [low, high] = mesh.bounding_box()?;
    Some(rounded(f64::from(high[1] - low[1])))
}

fn array(path: &Path) -> Result<FileSummary> {
    let header = npy_header(path)?;
    if let Ok(facts) = motion(path) {
        return Ok(facts);
    }
    if header.dtype.is_object() {
        return objects(path);
    }
    Ok(FileSummary::new("NumPy array")
        .with("shape", format!("{:?}", header.shape))
        .with("type", header.dtype.to_string()))
}

/// Poses of one person or several.
fn motion(path: &Path) -> Result<FileSummary> {
    let people = read_motions(path, &MotionOptions::default())?;
    let mut facts = FileSummary::new("motion");
    if people.len() > 1 {
        let names = people.iter().filter_map(|person| person.person.clone());
        facts = facts.with("people", names.collect::<Vec<_>>());
    }
    for person in &people {
        let of = |what: &str| match &person.person {
            Some(name) => format!("{name}: {what}"),
            None => what.to_owned(),
        };
        facts = facts
            .with(of("frames"), person.frames())
            .maybe(of("frames per second"), person.frame_rate)
            .with(of("joints"), person.joints)
            .with(of("up"), person.up.name())
            .with(of("translations"), person.translations.is_some())
            .with(of("betas"), person.betas.len())
            .maybe(of("gender"), person.gender.clone())
            .maybe(of("displacements"), person.offsets.as_ref().map(ndarray::ArrayBase::nrows));
        if !person.notes.is_empty() {
            facts = facts.with(of("notes"), person.notes.join("; "));
        }
    }
    Ok(facts)
}

fn point_cache(path: &Path) -> Result<FileSummary> {
    let cache = PointCache::read(path)?;
    let (frames, points, _) = cache.positions.dim();
    Ok(FileSummary::new("point cache")
        .with("frames", frames)
        .with("points", points)
        .maybe("frames per second", cache.frame_rate))
}

fn pickle(path: &Path) -> Result<FileSummary> {
    if let Ok(facts) = motion(path) {
        return Ok(facts);
    }
    let pickle = Pickle::open(path)?;
    let root = pickle.root();
    if root.get("v_template").is_some() {
        return body(path);
    }
    let mut facts = FileSummary::new("pickle").maybe("class", root.class());
    for key in root.keys().into_iter().take(MOST_KEYS) {
        let value = root.get(&key);
        let shape = value.and_then(|value| value.array::<f64>().ok());
        let shape = shape.map_or("not numeric".into(), |array| format!("{:?}", array.shape()));
        facts = facts.with(key, shape);
    }
    Ok(facts)
}

/// A TensorFlow checkpoint, given by its directory, prefix or .index file.
pub(super) fn tensorflow(path: &Path) -> Result<FileSummary> {
    let checkpoint = TensorFlowCheckpoint::open(path)?;
    let mut facts = FileSummary::new("TensorFlow checkpoint")
        .with("prefix", checkpoint.prefix().display().to_string())
        .with("variables", checkpoint.variables().len());
    for variable in checkpoint.variables() {
        let said = format!("{:?} {:?}", variable.element, variable.shape).to_lowercase();
        facts = facts.with(variable.name.clone(), said);
    }
    Ok(facts)
}

fn objects(path: &Path) -> Result<FileSummary> {
    let pickle = read_objects(path)?;
    let (shape, objects) = pickle.root().objects()?;
    let mut facts =
        FileSummary::new("NumPy array of Python objects").with("shape", format!("{shape:?}"));
    for (index, object) in objects.iter().enumerate().take(MOST_OBJECTS) {
        let said = match object.sparse() {
            Ok(matrix) => format!("sparse {:?}, {} entries", matrix.shape, matrix.values.len()),
            Err(_) => object.class().unwrap_or("data").to_owned(),
        };
        facts = facts.with(index.to_string(), said);
    }
    Ok(facts)
}

fn mesh(path: &Path) -> Result<FileSummary> {
    let MeshFile { format, mesh, skipped_faces, .. } = MeshFile::read(path)?;
    let report = mesh.validate();
    let facts = FileSummary::new("mesh")
        .with("format", format!("{format:?}").to_uppercase())
        .with("vertices", mesh.vertices.len())
        .with("faces", mesh.faces.len())
        .with("faces of fewer than 3 corners, left out", skipped_faces);
    let edges = Surface::from(&mesh).edge_counts();
    Ok(facts
        .with("edges", edges.edges)
        .with("boundary edges", edges.boundary)
        .with("non-manifold edges", edges.non_manifold)
        .with("degenerate faces", report.degenerate.len())
        .with("isolated vertices", report.isolated.len())
        .with("vertices with non-finite coordinates", report.non_finite.len())
        .maybe("height, m", height(&mesh)))
}

fn parameters(path: &Path) -> Result<FileSummary> {
    // The header tells a model file from weights.
    let mut start = Vec::new();
    let file = File::open(path).map_err(|error| Error::io(path, error))?;
    file.take(4096).read_to_end(&mut start).map_err(|error| Error::io(path, error))?;
    if start.windows(MODEL_FORMAT.len()).any(|found| found == MODEL_FORMAT) {
        let model = ModelFile::load(path)?;
        let facts = FileSummary::new("model file")
            .with("body", model.body())
            .with("parameters", model.numbers());
        let facts =
            model.about().iter().fold(facts, |facts, (name, text)| facts.with(name, text.clone()));
        return Ok(run_config(facts, model.config()));
    }
    let weights = weights::load(path)?;
    let count: usize = weights.values().map(|array| array.values.len()).sum();
    let broken = weights.values().filter(|array| array.values.iter().any(|x| !x.is_finite()));
    Ok(FileSummary::new("weights")
        .with("tensors", weights.len())
        .with("parameters", count)
        .with("tensors with non-finite values", broken.count()))
}

fn settings(path: &Path) -> Result<FileSummary> {
    match RunConfig::load(path) {
        Ok(config) => Ok(run_config(FileSummary::new("configuration of a run"), &config)),
        Err(run) => match SplitSpec::from_file(path) {
            Ok(split) => Ok(FileSummary::new("split into training and test sequences")
                .with("subjects", split.subjects)
                .with("outfits", split.outfits.iter().map(Outfit::name).collect::<Vec<_>>())
                .with("training sequences", split.train.sequences.len())
                .with("test sequences", split.test.sequences.len())
                .with("validation sequences", split.validation.sequences.len())),
            // The sections tell a split from a configuration.
            Err(split) => {
                let text = std::fs::read_to_string(path).unwrap_or_default();
                Err(if text.contains("subjects") { split.into() } else { run.into() })
            }
        },
    }
}

pub(super) fn run_config(facts: FileSummary, config: &RunConfig) -> FileSummary {
    let RunConfig { model, train, weighting, .. } = config;
    facts
        .with("filters", model.filters.clone())
        .with("factors", model.factors.clone())
        .with("latent", model.latent)
        .with("outfits", model.outfits.iter().map(Outfit::name).collect::<Vec<_>>())
        .with("decoder", format!("{:?}", model.decoder).to_lowercase())
        .with("discriminator", model.discriminator.is_some())
        .with("weighting", weighting.name())
        .with("epochs", train.epochs)
        .with("batch", train.batch)
        .with("seed", train.seed)
}
