//! The viewer as a folder of files, with the model in it: no server answers, the page computes.

use std::{collections::BTreeMap, io::Write, path::Path};

use base64::{Engine, engine::general_purpose::STANDARD};
use cape_core::{StagingDirectory, gltf::joint_influences};
use cape_infer::{
    GarmentColours, GarmentTables, Run, SKIN_COLOUR, TROUSERS_COLOUR, prior::Density, shirt_colour,
};
use cape_onnx::{JAVASCRIPT, OnnxModel, WeightPrecision, export_body, export_decoder};
use cape_stats::density::Mixture;
use flate2::{Compression, write::GzEncoder};
use serde_json::{Value, json};

use super::{
    assets::{self, SITE_FILES},
    bundle::bundle,
    source::RunSource,
    wire::MotionRequest,
};
use crate::{
    error::{Error, Result},
    files,
    priors::PriorName,
};

/// Length, seconds, and frame rate of the motions in the folder: those that the page asks for.
const MOTION: (f64, f64) = (2.0, 15.0);
/// Script of the page in `assets::PAGE`, and those in its place.
const SCRIPT: &str = "<script type=\"module\" src=\"main.js\"></script>";
const SCRIPTS: &str = "<script defer src=\"model.js\"></script>\n  <script defer src=\"worker.js\"></script>\n  \
                       <script defer src=\"viewer.js\"></script>";
/// Differences from `cape view`, for the page's help.
const NOTES: [&str; 2] = [
    "This page computes everything itself, also without a network.",
    "It has the registrations that were put in by cape view --export SITE --registrations N; cape view \
     shows all that are held out.",
];

/// Writes the folder, which must be empty or missing, with a number of registrations, and returns the sizes of
/// its files, bytes.
pub(super) fn export(
    source: &RunSource,
    out: &Path,
    registrations: usize,
) -> Result<BTreeMap<String, usize>> {
    files::require_empty_as(out, "--export")?;
    let written = [
        ("index.html", page()?),
        ("viewer.css", asset("viewer.css").unwrap_or_default().to_owned()),
        ("viewer.js", format!("(() => {{\n{}}})();\n", bundle("site.js", &asset)?)),
        ("worker.js", format!("function capeWorker() {{\n{}}}\n", bundle("worker.js", &asset)?)),
        ("model.js", format!("globalThis.capeModel = {};\n", model(source, registrations)?)),
    ];
    let staging = StagingDirectory::create(out)?;
    for (name, text) in &written {
        files::write_text(&staging.path.join(name), text)?;
    }
    staging.commit(out)?;
    Ok(written.into_iter().map(|(name, text)| (name.to_owned(), text.len())).collect())
}

/// A module or style sheet by its name.
fn asset(name: &str) -> Option<&'static str> {
    let own = SITE_FILES.iter().chain(&JAVASCRIPT).find(|(known, _)| *known == name);
    own.map(|&(_, text)| text).or_else(|| assets::find(name).map(|(_, text)| text))
}

fn page() -> Result<String> {
    if !assets::PAGE.contains(SCRIPT) {
        return Err(Error::message("internal error: the page has no script"));
    }
    Ok(assets::PAGE.replace(SCRIPT, SCRIPTS))
}

/// All that the page needs to know.
fn model(source: &RunSource, registrations: usize) -> Result<Value> {
    let run = source.run();
    let colours = GarmentColours::new(run.body(), run.mask()).tables();
    let mut scene = source.scene()?;
    let mut motions = BTreeMap::new();
    for name in scene["model"]["motions"].as_array().into_iter().flatten() {
        let name = name.as_str().unwrap_or_default().to_owned();
        let request = MotionRequest { name: name.clone(), seconds: MOTION.0, fps: MOTION.1 };
        let poses: Vec<Vec<f32>> =
            source.poses(&request)?.iter().map(|pose| pose.to_vec()).collect();
        motions.insert(name, json!({"poses": poses, "fps": MOTION.1}));
    }
    let Densities { named: densities, points } = Densities::of(run)?;
    let (registrations, displacements) = source.registrations(registrations)?;
    scene["model"]["truth"] = json!(registrations.len());
    scene["notes"] = json!(NOTES);

    let faces: Vec<u8> =
        run.body().faces.as_flattened().iter().flat_map(|i| i.to_le_bytes()).collect();
    let CodeMaps { named: transports, numbers: maps } = CodeMaps::of(run)?;
    let influences = joint_influences(run.body()).concat().concat();
    let outfits = || run.outfits().iter();
    let shirts: BTreeMap<_, _> =
        outfits().map(|&outfit| (outfit.name().to_owned(), shirt_colour(outfit))).collect();
    let mut garments = json!(colours);
    garments["skin"] = json!(SKIN_COLOUR);
    garments["trousers"] = json!(TROUSERS_COLOUR);
    garments["shirts"] = json!(shirts);
    let streams: BTreeMap<_, _> =
        outfits().map(|outfit| (outfit.name().to_owned(), outfit.stream())).collect();
    Ok(json!({
        "scene": scene,
        "tables": {
            "latent": run.latent(),
            "vertices": run.body().vertices(),
            "outfits": run.outfits(),
            "streams": streams,
            "densities": densities,
            "transports": transports,
            "registrations": registrations,
            "parents": run.body().parents,
            "motions": motions,
            "garments": garments,
        },
        "parts": {
            "decoder": pack(&graph(|precision| export_decoder(run, precision))?.encode())?,
            "body": pack(
                &graph(|precision| export_body(run.body(), run.mask(), precision))?.encode()
            )?,
            "faces": pack(&faces)?,
            "flags": pack(&flags(&colours))?,
            "shares": pack(&floats(colours.trousers.iter().copied()))?,
            "joints": pack(&influences.iter().map(|&(joint, _)| joint).collect::<Vec<_>>())?,
            "weights": pack(&floats(influences.iter().map(|&(_, weight)| weight)))?,
            "registrations": pack(&floats(displacements.into_iter()))?,
            "points": pack(&floats(points.into_iter()))?,
            "maps": pack(&floats(maps.into_iter()))?,
        },
    }))
}

/// A graph with weights in half precision, unless they are too large for it.
fn graph(
    export: impl Fn(WeightPrecision) -> cape_onnx::Result<OnnxModel>,
) -> cape_onnx::Result<OnnxModel> {
    match export(WeightPrecision::Half) {
        Err(cape_onnx::Error::Overflow { .. }) => export(WeightPrecision::Single),
        exported => exported,
    }
}

/// Densities of codes.
#[derive(Default)]
struct Densities {
    /// By the prior's name and the outfit's, or `all`: the components of a mixture, or the place among the
    /// points and the bandwidth of a kernel density.
    named: BTreeMap<&'static str, BTreeMap<String, Value>>,
    /// Points of the kernel densities, `[points, latent]`.
    points: Vec<f32>,
}

impl Densities {
    fn of(run: &Run) -> Result<Self> {
        let mut densities = Self::default();
        for name in [PriorName::Gmm, PriorName::Kde].map(PriorName::name) {
            let Some(prior) = run.prior_of_kind(name)? else { continue };
            for (outfit, density) in prior.groups() {
                let outfit = outfit.map_or("all".to_owned(), |outfit| outfit.name().to_owned());
                let described = match density {
                    Density::Mixture(mixture) => components(mixture),
                    Density::Kernel(kernels) => {
                        let first = densities.points.len() / run.latent();
                        densities.points.extend(kernels.points().iter().map(|&x| x as f32));
                        let (count, bandwidth) = (kernels.points().nrows(), kernels.bandwidth());
                        json!({"first": first, "count": count, "bandwidth": bandwidth})
                    }
                };
                densities.named.entry(name).or_default().insert(outfit, described);
            }
        }
        Ok(densities)
    }
}

fn components(mixture: &Mixture) -> Value {
    let (weights, means, covariances) = (mixture.weights(), mixture.means(), mixture.covariances());
    let components = weights.iter().zip(means.outer_iter()).zip(covariances.outer_iter());
    let components = components.map(|((weight, mean), covariance)| {
        let rows: Vec<Vec<f64>> = covariance.outer_iter().map(|row| row.to_vec()).collect();
        json!({"weight": weight, "mean": mean.to_vec(), "covariance": rows})
    });
    json!({"components": components.collect::<Vec<_>>()})
}

/// Maps of codes from one outfit to another.
#[derive(Default)]
struct CodeMaps {
    /// Number of the map from an outfit to another, by their names.
    named: BTreeMap<String, BTreeMap<String, usize>>,
    /// Matrices row by row, each followed by its offset.
    numbers: Vec<f32>,
}

impl CodeMaps {
    fn of(run: &Run) -> Result<Self> {
        let mut maps = Self::default();
        let Some(prior) = run.prior()? else { return Ok(maps) };
        let mut count = 0;
        for from in run.outfits() {
            for to in run.outfits() {
                let Some(map) = prior.transport(*from, *to)? else { continue };
                maps.numbers.extend(map.matrix.iter().chain(&map.offset).map(|&x| x as f32));
                maps.named.entry(from.to_string()).or_default().insert(to.to_string(), count);
                count += 1;
            }
        }
        Ok(maps)
    }
}

fn floats(values: impl Iterator<Item = f32>) -> Vec<u8> {
    values.flat_map(f32::to_le_bytes).collect()
}

/// For each vertex 1 if it is covered, 2 if it is of the trunk and 4 if its share of trousers is known.
fn flags(tables: &GarmentTables) -> Vec<u8> {
    let vertices = tables.covered.iter().zip(&tables.trunk).zip(&tables.known);
    vertices
        .map(|((&covered, &trunk), &known)| {
            u8::from(covered) | u8::from(trunk) << 1 | u8::from(known) << 2
        })
        .collect()
}

/// Compressed, as text.
fn pack(bytes: &[u8]) -> Result<String> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
    let packed = encoder.write_all(bytes).and_then(|()| encoder.finish());
    Ok(STANDARD.encode(packed.map_err(|error| Error::io("compression", error))?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_and_its_scripts_are_complete() {
        for script in ["model.js", "worker.js", "viewer.js"] {
            assert!(page().unwrap().contains(&format!("src=\"{script}\"")), "{script}");
        }
        for entry in ["site.js", "worker.js"] {
            let script = bundle(entry, &asset).unwrap();
            let modules = script
                .lines()
                .filter(|line| line.starts_with("import ") || line.starts_with("export "));
            assert_eq!(modules.collect::<Vec<_>>(), [""; 0], "{entry}");
        }
    }
}
