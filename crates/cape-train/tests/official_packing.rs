//! Training on a set of the official packing tool and on our own packing of the same frames.

use std::{
    fs,
    ops::ControlFlow,
    path::{Path, PathBuf},
};

use burn::tensor::Device;
use cape_core::{Outfit, SmplModel, npy::write_npy, silent};
use cape_data::{
    PackOptions, PackedSet, SequenceList, Split, SplitSpec, pack,
    raw::{self, RawFrame},
};
use cape_infer::{RunConfig, TrainConfig, checkpoint};
use cape_model::CapeConfig;
use cape_synth::synthetic_body;
use cape_train::{TrainEvent, Trainer, TrainerOptions};
use ndarray::{Array2, Array3, Axis, stack};

const SUBJECTS: [&str; 2] = ["03284", "00032"];
const SEQUENCES: [&str; 2] = ["hips", "walk"];
const FRAMES: usize = 7;
const STEPS: u64 = 10;

fn split() -> SplitSpec {
    let list = |names: &[&str]| SequenceList {
        sequences: names.iter().map(ToString::to_string).collect(),
        exclude: Vec::new(),
    };
    SplitSpec {
        subjects: SUBJECTS.map(String::from).to_vec(),
        // The official order of packing.
        outfits: ["shortlong", "longshort", "shortshort", "longlong"]
            .map(|name| name.parse().unwrap())
            .to_vec(),
        train: list(&SEQUENCES),
        test: list(&["soccer"]),
        ..SplitSpec::default()
    }
}

fn minimal(body: &SmplModel, subject: usize) -> Array2<f64> {
    body.v_template.mapv(|x| x * (1.0 + 0.01 * subject as f64))
}

/// A frame of any capture; `seed` tells it from all others.
fn frame(minimal: &Array2<f64>, seed: usize) -> RawFrame {
    let wave = Array2::from_shape_fn(minimal.dim(), |(vertex, axis)| {
        0.01 * ((vertex * 3 + axis + 17 * seed) as f64 * 0.37).sin()
    });
    let v_cano = minimal + &wave;
    let pose = std::array::from_fn(|i| 0.4 * ((i + seed) as f64 * 0.7).cos());
    RawFrame { v_posed: v_cano.clone(), v_cano, pose, transl: [0.0; 3] }
}

/// All frames in the order of packing: subject, sequence, outfit, name.
fn captures(part: Split) -> Vec<(usize, &'static str, Outfit, usize)> {
    let sequences: &[&str] = if part == Split::Train { &SEQUENCES } else { &["soccer"] };
    let mut found = Vec::new();
    for subject in 0..SUBJECTS.len() {
        for &sequence in sequences {
            for outfit in split().outfits {
                // Sums of letters differ between the sequences.
                let letters: usize = sequence.bytes().map(usize::from).sum();
                let place = Outfit::PAPER.iter().position(|&known| known == outfit).unwrap();
                found.push((subject, sequence, outfit, 1000 * subject + 10 * letters + place));
            }
        }
    }
    found
}

/// Rotation matrix of an axis-angle, by Rodrigues' formula.
fn rotation(angles: &[f64]) -> [f64; 9] {
    let angle = angles.iter().map(|x| x * x).sum::<f64>().sqrt();
    let [x, y, z] = [0, 1, 2].map(|i| angles[i] / angle);
    let (s, c) = angle.sin_cos();
    let t = 1.0 - c;
    [
        c + x * x * t,
        x * y * t - z * s,
        x * z * t + y * s,
        y * x * t + z * s,
        c + y * y * t,
        y * z * t - x * s,
        z * x * t - y * s,
        z * y * t + x * s,
        c + z * z * t,
    ]
}

/// Writes the frames as the official tool does: float64, labels of int64, the first and last two
/// frames of a sequence left out, and nothing else.
fn write_official(root: &Path, body: &SmplModel, rotations: bool) {
    for part in [Split::Train, Split::Test] {
        fs::create_dir_all(root.join(part.name())).unwrap();
        let (mut disp, mut pose, mut rot, mut label) = (vec![], vec![], vec![], vec![]);
        for (subject, _, outfit, seed) in captures(part) {
            let minimal = minimal(body, subject);
            for number in 2..FRAMES - 2 {
                let frame = frame(&minimal, seed + number);
                disp.push(frame.v_cano - &minimal);
                rot.extend(frame.pose.chunks(3).flat_map(rotation));
                pose.extend(frame.pose);
                label.extend(Outfit::PAPER.map(|known| i64::from(known == outfit)));
            }
        }
        let count = disp.len();
        let views: Vec<_> = disp.iter().map(|frame| frame.view()).collect();
        let disp: Array3<f64> = stack(Axis(0), &views).unwrap();
        write_npy(part.path(root, "disp"), &disp).unwrap();
        let pose = Array2::from_shape_vec((count, 72), pose).unwrap();
        write_npy(part.path(root, "pose"), &pose).unwrap();
        if rotations {
            let rot = Array2::from_shape_vec((count, 216), rot).unwrap();
            write_npy(part.path(root, "rot"), &rot).unwrap();
        }
        let label = Array2::from_shape_vec((count, 4), label).unwrap();
        write_npy(part.path(root, "clo_label"), &label).unwrap();
    }
}

/// Weights and momenta after ten steps.
fn trained(run: &Path, options: TrainerOptions) -> Vec<Vec<u8>> {
    let mut trainer = Trainer::create(run, options, &Device::default()).unwrap();
    trainer
        .run(&mut |event| match event {
            TrainEvent::Step { total_step, .. } if *total_step == STEPS => ControlFlow::Break(()),
            _ => ControlFlow::Continue(()),
        })
        .unwrap();
    let (step, newest) = checkpoint::list(&run.join("checkpoints")).unwrap().pop().unwrap();
    assert_eq!(step, STEPS);
    let mut files: Vec<PathBuf> =
        fs::read_dir(&newest).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.retain(|path| path.extension().is_some_and(|extension| extension == "safetensors"));
    files.sort();
    assert_eq!(files.len(), 3, "{files:?}");
    files.iter().map(|path| fs::read(path).unwrap()).collect()
}

fn options(data: PathBuf, body: Option<SmplModel>) -> TrainerOptions {
    let config = RunConfig {
        model: CapeConfig { filters: vec![4, 8], factors: vec![1, 2], ..CapeConfig::tiny() },
        train: TrainConfig { batch: 2, epochs: 1, warmup_epochs: 0.5, ..TrainConfig::default() },
        ..RunConfig::default()
    };
    TrainerOptions { body, ..TrainerOptions::new(data, config) }
}

#[test]
fn both_packings_train_alike() {
    let directory = tempfile::tempdir().unwrap();
    let at = |name: &str| directory.path().join(name);
    let body = synthetic_body();
    for (subject, name) in SUBJECTS.into_iter().enumerate() {
        raw::write_minimal(at("raw"), name, &minimal(&body, subject)).unwrap();
    }
    for part in [Split::Train, Split::Test] {
        for (subject, sequence, outfit, seed) in captures(part) {
            let minimal = minimal(&body, subject);
            for number in 0..FRAMES {
                let frame = frame(&minimal, seed + number);
                raw::write_frame(at("raw"), SUBJECTS[subject], outfit, sequence, number, &frame)
                    .unwrap();
            }
        }
    }
    body.save(at("body.npz")).unwrap();
    pack(at("raw"), at("packed"), &split(), PackOptions::default(), &mut silent).unwrap();
    write_official(&at("official"), &body, true);
    write_official(&at("without"), &body, false);

    let own = PackedSet::open(at("packed"), Split::Test).unwrap();
    let official = PackedSet::open(at("official"), Split::Test).unwrap();
    assert_eq!(own.outfits(), official.outfits());
    assert_eq!((official.origins(), official.capture(0)), (None, None));

    let error = Trainer::create(at("none"), options(at("official"), None), &Device::default());
    let message = error.map(drop).unwrap_err().to_string();
    assert!(message.contains("no body of its own") && message.contains("--body"), "{message}");

    let expected = trained(&at("a"), options(at("packed"), Some(body.clone())));
    for (name, run) in [("official", "b"), ("without", "c")] {
        let found = trained(&at(run), options(at(name), Some(body.clone())));
        assert!(found == expected, "{name}: other weights after {STEPS} steps");
    }
}
