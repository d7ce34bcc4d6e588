//! Simulated sets for a report without sets.

use std::path::Path;

use cape_cloth::{ClothMaterial, Garment, GarmentKind, SIMULATOR_VERSION};
use cape_core::SmplModel;
use cape_eval::store::{ResultStore, StoreOptions, StoreSettings};
use cape_layer::{
    BodyIdentity, LayerSet,
    synth::{Design, Exercise},
};
use rayon::prelude::*;
use serde_json::json;

use crate::{body_source::BodySource, console::Console, error::Result};

/// Size of the simulated sets.
#[derive(Debug, Clone, Copy)]
pub(super) struct SetSize {
    /// True for few subjects, motions, fabrics and sizes.
    pub(super) quick: bool,
    /// Frames per sequence.
    pub(super) frames: usize,
    /// Edge length of triangles, metres.
    pub(super) resolution: f64,
    /// Random styles of each synthetic motion; none if quick.
    pub(super) styles: u64,
}

/// Fabrics: density in kg/m²; stiffness in stretch and in bending, and damping, relative to cotton;
/// friction against the body.
const FABRICS: [[f64; 5]; 8] = [
    [0.06, 1.2, 0.2, 2.0, 0.25], // chiffon
    [0.08, 1.5, 0.3, 0.7, 0.15], // silk
    [0.20, 0.3, 0.8, 1.0, 0.30], // jersey
    [0.14, 1.0, 1.0, 1.0, 0.35], // cotton
    [0.19, 1.5, 2.0, 1.2, 0.40], // linen
    [0.28, 0.6, 1.5, 1.8, 0.50], // wool
    [0.40, 3.0, 4.0, 1.5, 0.55], // denim
    [0.60, 4.0, 8.0, 2.2, 0.60], // leather
];

fn fabric([density, stretch, bend, damping, friction]: [f64; 5]) -> ClothMaterial {
    let cotton = ClothMaterial::default();
    ClothMaterial {
        density,
        stretch: cotton.stretch.scaled(stretch),
        bend: bend * cotton.bend,
        damping: damping * cotton.damping,
        friction,
        ..cotton
    }
}

/// Names and designs: one garment in five motions of two subjects (ten sequences, for tables 1 and 2), in
/// eight fabrics, in eight sizes, and in all synthetic motions in random styles (new motions).
fn designs(size: SetSize, kind: GarmentKind) -> Vec<(&'static str, Design)> {
    let garment = Garment { resolution: size.resolution, ..Garment::new(kind) };
    let plain = Design { frames: size.frames, ..Design::new(garment) };
    let few = if size.quick { 3 } else { 8 };
    let lengths = [1.0, 0.75, 1.2, 0.9].into_iter();
    let widths = [0.97, 1.09];
    let sizes = lengths.flat_map(|length| {
        widths.map(|width| Garment {
            length: garment.length * length,
            width: garment.width * width,
            ..garment
        })
    });
    let subjects = vec![vec![0.0, 0.0], vec![1.5, -1.0]];
    let exercises =
        if size.quick { vec![Exercise::March, Exercise::Squat] } else { Exercise::ALL.to_vec() };
    let one = |exercise| Design { exercises: vec![exercise], ..plain.clone() };
    let designs = vec![
        ("moves", Design { subjects, exercises, ..plain.clone() }),
        (
            "materials",
            Design {
                materials: FABRICS.into_iter().take(few).map(fabric).collect(),
                ..one(Exercise::Swing)
            },
        ),
        (
            "motions",
            Design {
                exercises: if size.quick { Vec::new() } else { Exercise::styled(size.styles) },
                ..plain.clone()
            },
        ),
        ("fits", Design { sizes: sizes.take(few).collect(), ..one(Exercise::March) }),
    ];
    designs.into_iter().filter(|(_, design)| !design.exercises.is_empty()).collect()
}

/// Sets with their names, each a store in `out`; missing sequences are simulated.
pub(super) fn simulated(
    (model, body): (&SmplModel, &BodySource),
    out: &Path,
    (size, kind): (SetSize, GarmentKind),
    overwrite: bool,
    console: Console,
) -> Result<Vec<(String, LayerSet)>> {
    let designs = designs(size, kind);
    // All are checked before the first is simulated.
    let stores = designs
        .iter()
        .map(|(name, design)| store(&out.join(name), design, body, overwrite))
        .collect::<Result<Vec<_>>>()?;
    let mut sets = Vec::new();
    let identity = body.identity(model);
    for ((name, design), store) in designs.into_iter().zip(&stores) {
        store.begin()?;
        let set = console.while_showing(name, "sequences", |progress| {
            simulate((model, &identity), store, &design, progress)
        })?;
        sets.push((name.to_owned(), set));
    }
    Ok(sets)
}

/// The store of a simulated set.
fn store(
    directory: &Path,
    design: &Design,
    body: &BodySource,
    overwrite: bool,
) -> Result<ResultStore> {
    let Design { subjects, sizes, materials, exercises, frames, frame_rate, simulation } = design;
    let settings = json!({
        "subjects": subjects,
        "sizes": sizes,
        "materials": materials,
        "exercises": exercises.iter().map(|exercise| exercise.name()).collect::<Vec<_>>(),
        "frames": frames,
        "frame_rate": frame_rate,
        "simulation": format!("{simulation:?}"),
        "simulator": SIMULATOR_VERSION,
    });
    let settings = StoreSettings::new("layer report, simulated set", &settings)?;
    let settings = body.input_of(settings)?;
    let options =
        StoreOptions { overwrite, earlier: &["design.txt", "set.json"], ..StoreOptions::default() };
    Ok(ResultStore::open(directory, settings, options)?)
}

/// The design's set; each sequence is saved when it is finished.
fn simulate(
    (model, identity): (&SmplModel, &BodyIdentity),
    store: &ResultStore,
    design: &Design,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<LayerSet> {
    let directory = store.root();
    let takes = design.cells();
    let done = if directory.join("set.json").exists() {
        LayerSet::load(directory)?.sequences
    } else {
        Vec::new()
    };
    let left = &takes[done.len().min(takes.len())..];
    if !left.is_empty() {
        let sewn = design.sew(model)?;
        // As many side by side as there are threads; each is the same alone.
        for (chunk, some) in left.chunks(rayon::current_num_threads()).enumerate() {
            progress(done.len() + chunk * rayon::current_num_threads(), takes.len());
            let results: Vec<_> =
                some.par_iter().map(|&take| design.simulate(model, &sewn, take)).collect();
            for result in results {
                let (sequence, _) = result?;
                store.list("set.json")?;
                store.list(&format!("{}.npz", sequence.name))?;
                LayerSet::add(directory, identity, &sewn.surface.faces, &sequence)?;
            }
        }
    }
    // As it will be read from now on, to the last digit.
    Ok(LayerSet::load(directory)?)
}
