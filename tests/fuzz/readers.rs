//! Every reader of files, behind one function.

use std::path::Path;

use cape::{
    core::{
        MeshFile, PointCache, SmplModel,
        motion::{MotionOptions, read_motion},
        npy::{Npz, npy_header, read_f64, read_i64, read_objects},
        obj,
        pickle::Pickle,
        ply,
        smpl::ClothingMask,
    },
    data::{DisplacementStatistics, SplitSpec, raw},
    eval::table2::FigureFrames,
    fit::{
        PosePrior,
        keypoints::{KeypointOptions, read_keypoints_with},
        scan::KnownJoints,
        silhouette::{Mask, read_annotated_mask},
    },
    graph::MeshPyramid,
    infer::{ModelFile, RunConfig, prior::Prior},
    layer::regress::Regressor,
    model::{
        release::{ReleaseCheckpoint, infer},
        tensorflow::TensorFlowCheckpoint,
        weights,
    },
    render::Image,
    stats::pca::Pca,
    train::release::check_settings,
};

/// Kinds of files, each with the name its reader wants.
pub const KINDS: [(&str, &str); 22] = [
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
    ("smpl", "a.smpl"),
    ("matlab", "a.mat"),
    ("csv", "a.csv"),
    ("json", "a.json"),
    ("png", "a.png"),
    ("jpeg", "a.jpg"),
    ("model", "a.model.safetensors"),
    ("tensorflow index", "a.index"),
    ("tensorflow data", "a.data-00000-of-00001"),
];

/// Reads `path` with every reader of its kind, and what it holds; how many took it.
pub fn read(kind: &str, path: &Path) -> usize {
    let took = match kind {
        "pickle" => {
            let _ = (motion(path), PosePrior::load(path));
            [SmplModel::load(path).is_ok(), Pickle::open(path).is_ok_and(|p| pickle(&p))]
        }
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
                PosePrior::load(path),
                Prior::load(path),
                Pca::load(path),
                FigureFrames::load(path),
                Regressor::load(path),
                motion(path),
            );
            [npz(path), raw::read_frame(path, None).is_ok()]
        }
        "obj" => [obj::read(path).is_ok(), MeshFile::read(path).is_ok()],
        "ply" => [ply::read(path).is_ok(), MeshFile::read(path).is_ok()],
        "stl" | "off" | "glb" => [MeshFile::read(path).is_ok(), false],
        "pc2" | "mdd" => [PointCache::read(path).is_ok(), false],
        "safetensors" => [weights::load(path).is_ok(), false],
        "smpl" | "matlab" | "csv" => [motion(path), false],
        "json" => [motion(path) || KnownJoints::load(path).is_ok(), people(path)],
        "png" | "jpeg" => [Image::load(path).is_ok(), Mask::load(path).is_ok()],
        "model" => [ModelFile::load(path).is_ok(), false],
        "toml" => [RunConfig::load(path).is_ok(), SplitSpec::from_file(path).is_ok()],
        "yaml" => [check_settings(path).is_ok(), false],
        _ => [tensorflow(path), false],
    };
    took.into_iter().filter(|took| *took).count()
}

fn motion(path: &Path) -> bool {
    read_motion(path, &MotionOptions::default()).is_ok()
}

fn people(path: &Path) -> bool {
    let options = KeypointOptions { size: Some([64, 48]), ..KeypointOptions::default() };
    let Ok(people) = read_keypoints_with(path, &options) else { return false };
    for person in people.all().iter().take(4) {
        if let Ok(keypoints) = &person.keypoints {
            let _ = read_annotated_mask(path, keypoints, &options);
        }
    }
    true
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
