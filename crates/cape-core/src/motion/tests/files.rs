//! Builders of files as other programs write them.

use std::path::{Path, PathBuf};

use ndarray::{Array2, ArrayD, ArrayRef, Dimension, IxDyn};
use tempfile::TempDir;

use crate::npy::{NpyHeader, NpzWriter};

/// Number of frames of every builder.
pub(super) const FRAMES: usize = 6;

/// A person who stands with y up and swings arms and a leg, `[FRAMES, 72]`.
pub(super) fn poses() -> Array2<f64> {
    let mut poses = Array2::zeros((FRAMES, 72));
    for frame in 0..FRAMES {
        let t = frame as f64 / 30.0;
        poses[(frame, 3 * 16 + 2)] = -1.0 + 0.3 * (6.0 * t).sin();
        poses[(frame, 3 * 17 + 2)] = 1.0 - 0.3 * (6.0 * t).sin();
        poses[(frame, 3)] = 0.4 * (5.0 * t).sin();
        poses[(frame, 1)] = 0.2 * t;
    }
    poses
}

/// Poses of other numbers of joints: the first 22 of [`poses`], and zeros.
pub(super) fn padded(width: usize) -> Array2<f64> {
    let mut wide = Array2::zeros((FRAMES, width));
    let used = width.min(66);
    wide.slice_mut(ndarray::s![.., ..used]).assign(&poses().slice(ndarray::s![.., ..used]));
    wide
}

/// Rotation matrices `[FRAMES, 24, 3, 3]` of [`poses`].
pub(super) fn matrices() -> ArrayD<f64> {
    let rows: Vec<f64> = poses()
        .rows()
        .into_iter()
        .flat_map(|pose| crate::joints::pose_rotations(&pose.to_vec()).unwrap())
        .flat_map(|rotation| rotation.into_iter().flatten())
        .collect();
    ArrayD::from_shape_vec(IxDyn(&[FRAMES, 24, 3, 3]), rows).unwrap()
}

/// [`poses`] with the body's orientation before `turn` is undone: `turn` · R.
pub(super) fn turned(turn: glam::DQuat) -> Array2<f64> {
    let mut poses = poses();
    for mut pose in poses.rows_mut() {
        let root = glam::DVec3::new(pose[0], pose[1], pose[2]);
        let orientation = (turn * glam::DQuat::from_scaled_axis(root)).to_scaled_axis();
        for axis in 0..3 {
            pose[axis] = orientation[axis];
        }
    }
    poses
}

/// A directory for the files of a test.
pub(super) struct Files(TempDir);

impl Files {
    pub(super) fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    pub(super) fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub(super) fn bytes(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.path(name);
        std::fs::write(&path, bytes).unwrap();
        path
    }

    pub(super) fn npz(&self, name: &str, fill: impl FnOnce(&mut Arrays)) -> PathBuf {
        let path = self.path(name);
        let mut arrays = Arrays(NpzWriter::create(&path).unwrap());
        fill(&mut arrays);
        arrays.0.finish().unwrap();
        path
    }
}

/// Arrays of an archive.
pub(super) struct Arrays(NpzWriter);

impl Arrays {
    pub(super) fn add<D: Dimension>(&mut self, name: &str, array: &ArrayRef<f64, D>) -> &mut Self {
        self.0.add(name, array).unwrap();
        self
    }

    pub(super) fn number(&mut self, name: &str, number: f64) -> &mut Self {
        self.add(name, &ndarray::arr0(number))
    }

    pub(super) fn text(&mut self, name: &str, text: &str) -> &mut Self {
        self.0.add_text(name, text).unwrap();
        self
    }
}

/// A `.npy` file of a 0-dimensional array of one pickled object.
pub(super) fn object_npy(path: &Path, pickled: Vec<u8>) {
    let mut bytes = NpyHeader::bytes("|O", &[]);
    bytes.extend(pickled);
    std::fs::write(path, bytes).unwrap();
}

/// Python object to be pickled.
pub(super) enum Py {
    None,
    Int(i64),
    Text(&'static str),
    Float(f64),
    Array(ArrayD<f64>),
    List(Vec<Py>),
    Dict(Vec<(Py, Py)>),
    /// `collections.defaultdict(dict, …)`.
    DefaultDict(Vec<(Py, Py)>),
}

impl Py {
    pub(super) fn array<D: Dimension>(array: &ArrayRef<f64, D>) -> Self {
        Self::Array(array.to_owned().into_dyn())
    }

    pub(super) fn dict<const N: usize>(entries: [(&'static str, Py); N]) -> Self {
        Self::Dict(entries.into_iter().map(|(name, value)| (Py::Text(name), value)).collect())
    }
}

/// `pickle.dumps` or, for arrays as joblib writes them, `joblib.dump`, protocol 4.
pub(super) fn pickle(object: &Py, joblib: bool) -> Vec<u8> {
    let mut bytes = vec![0x80, 4];
    write(object, joblib, &mut bytes);
    bytes.push(b'.');
    bytes
}

fn text(text: &str, out: &mut Vec<u8>) {
    out.extend([0x8c, text.len() as u8]);
    out.extend(text.as_bytes());
}

fn global(module: &str, name: &str, out: &mut Vec<u8>) {
    text(module, out);
    text(name, out);
    out.push(0x93);
}

fn int(number: i64, out: &mut Vec<u8>) {
    out.push(b'J');
    out.extend((number as i32).to_le_bytes());
}

/// `dtype('f8')`, little-endian.
fn dtype(out: &mut Vec<u8>) {
    global("numpy", "dtype", out);
    text("f8", out);
    out.extend([0x89, 0x88, 0x87, b'R', b'(', b'K', 3]);
    text("<", out);
    out.extend([b'N', b'N', b'N']);
    int(-1, out);
    int(-1, out);
    out.extend([b'K', 0, b't', b'b']);
}

fn shape(shape: &[usize], out: &mut Vec<u8>) {
    out.push(b'(');
    for &axis in shape {
        int(axis as i64, out);
    }
    out.push(b't');
}

fn entries(entries: &[(Py, Py)], joblib: bool, out: &mut Vec<u8>) {
    out.push(b'(');
    for (key, value) in entries {
        write(key, joblib, out);
        write(value, joblib, out);
    }
    out.push(b'u');
}

fn write(object: &Py, joblib: bool, out: &mut Vec<u8>) {
    match object {
        Py::None => out.push(b'N'),
        Py::Int(number) => int(*number, out),
        Py::Float(number) => {
            out.push(b'G');
            out.extend(number.to_be_bytes());
        }
        Py::Text(content) => text(content, out),
        Py::List(elements) => {
            out.extend(b"](");
            for element in elements {
                write(element, joblib, out);
            }
            out.push(b'e');
        }
        Py::Dict(inner) => {
            out.push(b'}');
            entries(inner, joblib, out);
        }
        Py::DefaultDict(inner) => {
            global("collections", "defaultdict", out);
            global("builtins", "dict", out);
            out.extend([0x85, b'R']);
            entries(inner, joblib, out);
        }
        Py::Array(array) if joblib => joblib_array(array, out),
        Py::Array(array) => {
            let data: Vec<u8> = array.iter().flat_map(|x| x.to_le_bytes()).collect();
            global("numpy.core.multiarray", "_reconstruct", out);
            global("numpy", "ndarray", out);
            out.extend([b'K', 0, 0x85, b'C', 1, b'b', 0x87, b'R', b'(', b'K', 1]);
            shape(array.shape(), out);
            dtype(out);
            out.extend([0x89, b'B']);
            out.extend((data.len() as u32).to_le_bytes());
            out.extend(data);
            out.extend(b"tb");
        }
    }
}

/// The description of an array, padding, and the array's bytes.
fn joblib_array(array: &ArrayD<f64>, out: &mut Vec<u8>) {
    global("joblib.numpy_pickle", "NumpyArrayWrapper", out);
    out.extend([b')', 0x81, b'}', b'(']);
    text("subclass", out);
    global("numpy", "ndarray", out);
    text("shape", out);
    shape(array.shape(), out);
    text("order", out);
    text("C", out);
    text("dtype", out);
    dtype(out);
    text("allow_mmap", out);
    out.push(0x88);
    text("numpy_array_alignment_bytes", out);
    out.extend([b'K', 16, b'u', b'b']);
    let padding = 16 - (out.len() + 1) % 16;
    out.push(padding as u8);
    out.extend(vec![0xff; padding]);
    out.extend(array.iter().flat_map(|x| x.to_le_bytes()));
}
