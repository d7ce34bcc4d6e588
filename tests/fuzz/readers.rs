//! Every reader of files, behind one function.

use std::path::Path;

use cape::{
    core::{
        MeshFile, PointCache, SmplModel,
        npy::{Npz, npy_header, read_f64, read_i64, read_objects},
        obj,
        pickle::Pickle,
        ply,
        smpl::ClothingMask,
    },
    data::{DisplacementStatistics, SplitSpec, raw},
    graph::MeshPyramid,
    infer::RunConfig,
    model::{
        release::{ReleaseCheckpoint, infer},
        tensorflow::TensorFlowCheckpoint,
        weights,
    },
    train::release::check_settings,
};

/// Kinds of files, each with the name its reader wants.
pub const KINDS: [(&str, &str); 15] = [
    ("pickle", "a.pkl"),
    ("npy", "a.npy"),
    ("npz", "a.npz"),
    ("obj", "a.obj"),
    ("ply", "a.ply"),
    ("stl", "a.stl"),
    ("off", "a.off"),
    ("glb", "a.glb"),
    ("pc2", "a.pc2"),
    ("mdd", "a.mdd"),
    ("safetensors", "a.safetensors"),
    ("toml", "a.toml"),
    ("yaml", "a.yaml"),
    ("tensorflow index", "a.index"),
    ("tensorflow data", "a.data-00000-of-00001"),
];

/// Reads `path` with every reader of its kind, and what it holds; how many took it.
pub fn read(kind: &str, path: &Path) -> usize {
    let took = match kind {
        "pickle" => [SmplModel::load(path).is_ok(), Pickle::open(path).is_ok_and(|p| pickle(&p))],
        "npy" => {
            let objects = read_objects(path).is_ok_and(|p| pickle(&p));
            let _ = (npy_header(path), read_i64(path), ClothingMask::load(path, 100));
            [read_f64(path).is_ok(), objects]
        }
        "npz" => {
            let _ = (
                SmplModel::load(path),
                DisplacementStatistics::load(path),
                MeshPyramid::load(path),
            );
            [npz(path), raw::read_frame(path, None).is_ok()]
        }
        "obj" => [obj::read(path).is_ok(), MeshFile::read(path).is_ok()],
        "ply" => [ply::read(path).is_ok(), MeshFile::read(path).is_ok()],
        "stl" | "off" | "glb" => [MeshFile::read(path).is_ok(), false],
        "pc2" | "mdd" => [PointCache::read(path).is_ok(), false],
        "safetensors" => [weights::load(path).is_ok(), false],
        "toml" => [RunConfig::load(path).is_ok(), SplitSpec::from_file(path).is_ok()],
        "yaml" => [check_settings(path).is_ok(), false],
        _ => [tensorflow(path), false],
    };
    took.into_iter().filter(|took| *took).count()
}

fn npz(path: &Path) -> bool {
    let Ok(mut npz) = Npz::open(path) else { return false };
    let names = npz.names();
    names.iter().all(|name| npz.f64(name).is_ok() || npz.objects(name).is_ok_and(|p| pickle(&p)))
}

fn pickle(pickle: &Pickle) -> bool {
    let root = pickle.root();
    let _ = (root.array::<f64>(), root.sparse(), root.objects());
    for key in root.keys().iter().take(32) {
        if let Some(value) = root.get(key) {
            let _ = (value.array::<f64>(), value.array::<i64>(), value.sparse(), value.text());
            let _ = (value.matrix([3, 5]), value.elements().map(|elements| elements.len()));
        }
    }
    true
}

fn tensorflow(path: &Path) -> bool {
    let Ok(checkpoint) = TensorFlowCheckpoint::open(path) else { return false };
    for variable in checkpoint.variables() {
        let _ = (checkpoint.floats(variable), checkpoint.integers(variable));
    }
    ReleaseCheckpoint::read(&checkpoint).is_ok_and(|released| infer(&released.shapes()).is_ok())
}
