//! Running the command, and small data to run it on.

use std::{
    ffi::OsStr,
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
    sync::OnceLock,
};

use cape::{
    core::{Outfit, SmplModel, joints::PARENTS, npy::write_npy},
    data::{
        PackOptions, SequenceList, SplitSpec, pack,
        raw::{self, RawFrame},
    },
};
use ndarray::{Array1, Array2, Array3};
use serde_json::Value;
use tempfile::TempDir;

pub(crate) const SIDES: usize = 8;
pub(crate) const RINGS: usize = 12;
pub(crate) const VERTICES: usize = RINGS * SIDES + 2;

/// The command with its arguments, ready to run.
pub(crate) fn cape<S: AsRef<OsStr>>(arguments: impl IntoIterator<Item = S>) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_cape"));
    command.args(arguments);
    command
}

/// Exit code and output of a command.
pub(crate) struct Ran {
    pub(crate) code: Option<i32>,
    pub(crate) out: String,
    pub(crate) err: String,
}

impl From<Output> for Ran {
    fn from(output: Output) -> Self {
        Self {
            code: output.status.code(),
            out: String::from_utf8(output.stdout).unwrap(),
            err: String::from_utf8(output.stderr).unwrap(),
        }
    }
}

pub(crate) fn run<S: AsRef<OsStr>>(arguments: impl IntoIterator<Item = S>) -> Ran {
    cape(arguments).output().unwrap().into()
}

/// Runs a command line of words without spaces.
pub(crate) fn run_line(line: &str) -> Ran {
    run(line.split_whitespace())
}

impl Ran {
    /// Asserts success and returns standard output.
    #[track_caller]
    pub(crate) fn succeeded(self) -> String {
        assert_eq!(self.code, Some(0), "{}", self.err);
        self.out
    }

    /// Asserts success and returns standard output as JSON.
    #[track_caller]
    pub(crate) fn json(self) -> Value {
        serde_json::from_str(&self.succeeded()).unwrap()
    }

    /// Asserts an error with exit code 1, nothing on standard output, and all of `parts` said.
    #[track_caller]
    pub(crate) fn failed_saying(self, parts: &[&str]) {
        let Self { code, out, err } = self;
        assert_eq!(code, Some(1), "{err}");
        assert_eq!(out, "");
        let said = err.lines().find(|line| line.starts_with("error: "));
        assert!(said.is_some(), "{err}");
        for part in parts {
            assert!(err.contains(part), "`{part}` is not in:\n{err}");
        }
        assert!(!err.contains("panicked"), "{err}");
    }
}

impl Ran {
    /// Asserts exit code 2, nothing on standard output, and all of `parts` said.
    #[track_caller]
    pub(crate) fn misused(self, parts: &[&str]) {
        let Self { code, out, err } = self;
        assert_eq!((code, out.as_str()), (Some(2), ""), "{err}");
        assert!(parts.iter().all(|part| err.contains(part)), "{err}");
    }
}

/// A body of 24 joints in a stack, closed, small.
pub(crate) fn small_body() -> SmplModel {
    let height = |ring: usize| 1.6 * ring as f64 / (RINGS - 1) as f64;
    let mut vertices = Vec::new();
    for ring in 0..RINGS {
        for side in 0..SIDES {
            let angle = std::f64::consts::TAU * (side as f64 + 0.1 * ring as f64) / SIDES as f64;
            let radius = 0.15 + 0.05 * (ring as f64).sin();
            vertices.extend([radius * angle.sin(), height(ring), radius * angle.cos()]);
        }
    }
    vertices.extend([0.0, -0.08, 0.0, 0.0, 1.68, 0.0]);
    let at = |ring: usize, side: usize| (ring * SIDES + side % SIDES) as u32;
    let (bottom, top) = ((VERTICES - 2) as u32, (VERTICES - 1) as u32);
    let mut faces = Vec::new();
    for side in 0..SIDES {
        for ring in 0..RINGS - 1 {
            let [a, b] = [at(ring, side), at(ring, side + 1)];
            let [c, d] = [at(ring + 1, side), at(ring + 1, side + 1)];
            faces.extend([[a, b, d], [a, d, c]]);
        }
        faces.push([at(0, side + 1), at(0, side), bottom]);
        faces.push([at(RINGS - 1, side), at(RINGS - 1, side + 1), top]);
    }
    let v_template = Array2::from_shape_vec((VERTICES, 3), vertices).unwrap();
    let joint_of = |vertex: usize| (v_template[[vertex, 1]].clamp(0.0, 1.59) * 15.0) as usize;
    let weights = Array2::from_shape_fn((VERTICES, 24), |(vertex, joint)| {
        f64::from(joint_of(vertex) == joint)
    });
    let joint_regressor = Array2::from_shape_fn((24, VERTICES), |(joint, vertex)| {
        f64::from(vertex / SIDES == joint / 2) / SIDES as f64
    });
    let shapedirs =
        Array3::from_shape_fn((VERTICES, 3, 2), |(vertex, axis, direction)| match direction {
            0 => 0.05 * v_template[[vertex, axis]],
            _ => 0.02 * f64::from(axis != 1) * v_template[[vertex, axis]],
        });
    let posedirs = Array3::from_shape_fn((VERTICES, 3, 207), |(vertex, axis, blend)| {
        1e-4 * ((vertex + 3 * axis + 7 * blend) % 11) as f64
    });
    SmplModel {
        v_template,
        shapedirs,
        posedirs,
        joint_regressor,
        weights,
        parents: PARENTS.to_vec(),
        faces,
    }
}

pub(crate) fn pose_of(frame: usize) -> [f64; 72] {
    std::array::from_fn(|i| 0.3 * (i as f64 + 0.7 * frame as f64).sin())
}

/// A clothed frame: outfit, sequence and pose show in the displacement.
fn frame(body: &SmplModel, outfit: Outfit, sequence: usize, number: usize) -> RawFrame {
    let pose = pose_of(number + 10 * sequence);
    let displacement = Array2::from_shape_fn((VERTICES, 3), |(vertex, axis)| {
        let phase = vertex as f64 * 0.4 + sequence as f64 + axis as f64;
        0.01 * phase.sin() * pose[3 + axis] + 0.004 * outfit.stream() as f64
    });
    let v_cano = &body.v_template + &displacement;
    RawFrame { v_posed: v_cano.clone(), v_cano, pose, transl: [0.0; 3] }
}

pub(crate) fn split() -> SplitSpec {
    let sequences = |names: &[&str]| SequenceList {
        sequences: names.iter().map(ToString::to_string).collect(),
        exclude: Vec::new(),
    };
    SplitSpec {
        subjects: vec!["ann".into()],
        outfits: Outfit::PAPER.to_vec(),
        train: sequences(&["walk", "turn"]),
        test: sequences(&["jump"]),
        ..SplitSpec::default()
    }
}

/// Raw captures of `frames` frames a sequence.
pub(crate) fn write_raw(root: &Path, frames: usize) {
    let body = small_body();
    fs::create_dir_all(root).unwrap();
    body.save(root.join("body.npz")).unwrap();
    let clothing = Array1::from_iter((2 * SIDES..9 * SIDES).map(|vertex| vertex as i64));
    write_npy(root.join("clothing_verts_idx.npy"), &clothing).unwrap();
    raw::write_minimal(root, "ann", &body.v_template).unwrap();
    for outfit in Outfit::PAPER {
        for (index, sequence) in ["walk", "turn", "jump"].into_iter().enumerate() {
            for number in 0..frames {
                let frame = frame(&body, outfit, index, number);
                raw::write_frame(root, "ann", outfit, sequence, number + 1, &frame).unwrap();
            }
        }
    }
    fs::write(root.join("split.toml"), split().to_toml().unwrap()).unwrap();
}

/// A directory with a packed set in `packed`, for a test to spoil.
pub(crate) struct Packed(TempDir);

impl Packed {
    pub(crate) fn new() -> Self {
        Self::with_frames(8)
    }

    /// From sequences of `frames` frames, four of which are cut off.
    pub(crate) fn with_frames(frames: usize) -> Self {
        let root = tempfile::tempdir().unwrap();
        let raw = root.path().join("raw");
        write_raw(&raw, frames);
        let options = PackOptions { strict: true, ..PackOptions::default() };
        pack(&raw, root.path().join("packed"), &split(), options, &mut cape::core::silent).unwrap();
        Self(root)
    }

    pub(crate) fn root(&self) -> &Path {
        self.0.path()
    }

    /// A path inside the directory.
    pub(crate) fn at(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Runs a command line in which `@` stands for the directory.
    pub(crate) fn run(&self, line: &str) -> Ran {
        let root = self.0.path().to_str().unwrap();
        run(line.split_whitespace().map(|word| word.replace('@', root)))
    }

    /// A short training into `run`.
    pub(crate) fn train(&self) -> Ran {
        self.run("train --data @/packed --out @/run --preset tiny --epochs 2 --batch 4")
    }
}

/// A packed set and a run trained on it, shared by tests that only read them.
pub(crate) fn trained() -> &'static Packed {
    static TRAINED: OnceLock<Packed> = OnceLock::new();
    TRAINED.get_or_init(|| {
        let packed = Packed::new();
        packed.train().succeeded();
        packed
    })
}

/// Cuts a file to half its length.
pub(crate) fn truncate(path: &Path) {
    let bytes = fs::read(path).unwrap();
    fs::write(path, &bytes[..bytes.len() / 2]).unwrap();
}

/// Every file under `root` with its contents, by relative path.
pub(crate) fn contents(root: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut files = Vec::new();
    let mut open = vec![root.to_owned()];
    while let Some(directory) = open.pop() {
        for entry in fs::read_dir(directory).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
            } else {
                files.push((path.strip_prefix(root).unwrap().to_owned(), fs::read(path).unwrap()));
            }
        }
    }
    files.sort();
    files
}

/// Configuration of fits in few steps, for tests of the command and not of the method.
pub(crate) const FEW_STEPS: &str = "
[smplify]
accepted = 1e9
facing = [0.0]
stages = [{ pose = 20.0, shape = 10.0 }, {}]

[smplify.optimiser]
steps = 20

[clothed]
levels = [{ side = 64, rounds = 1, steps = 3 }]
inside = 0.0
explained = 0.0
";

/// Removes times from a report.
pub(crate) fn remove_seconds(value: &mut Value) {
    match value {
        Value::Object(map) => {
            map.retain(|key, _| !key.contains("seconds"));
            map.values_mut().for_each(remove_seconds);
        }
        Value::Array(list) => list.iter_mut().for_each(remove_seconds),
        _ => {}
    }
}
