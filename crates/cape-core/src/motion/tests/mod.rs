//! Files as other programs write them, each with its outcome. Every builder holds the same movement.

mod amass;
mod dialects;
mod faults;
mod files;
mod layouts;
mod matlab;
mod movement;
mod people;

use std::{f64::consts::PI, path::Path};

use glam::{DQuat, DVec3};
use ndarray::{Array1, Array2, Array3, ArrayD, Axis, s, stack};

use self::files::{FRAMES, Files, Py, matrices, object_npy, padded, pickle, poses, turned};
use super::*;
use crate::{
    joints::rotation,
    npy::{NpzWriter, write_npy},
};

fn read(path: &Path) -> MotionFile {
    read_motion(path, &MotionOptions::default()).unwrap_or_else(|error| panic!("{error}"))
}

fn error(path: &Path) -> String {
    read_motion(path, &MotionOptions::default()).unwrap_err().to_string()
}

fn person(path: &Path, name: &str) -> MotionFile {
    let options = MotionOptions { person: Some(name.to_owned()), ..MotionOptions::default() };
    read_motion(path, &options).unwrap_or_else(|error| panic!("{error}"))
}

/// Asserts that two tables of axis-angles have the same rotations.
#[track_caller]
fn expect_poses(found: &Array2<f64>, expected: &Array2<f64>) {
    assert_eq!(found.dim(), expected.dim());
    for (a, b) in found.rows().into_iter().zip(expected.rows()) {
        for joint in 0..24 {
            let of = |row: &ndarray::ArrayView1<f64>| {
                rotation([0, 1, 2].map(|axis| row[3 * joint + axis]))
            };
            assert!(of(&a).abs_diff_eq(of(&b), 1e-9), "joint {joint}: {a} {b}");
        }
    }
}

/// The movement without hands, as of files of 22 body joints.
fn body() -> Array2<f64> {
    let mut expected = poses();
    expected.slice_mut(s![.., 66..]).fill(0.0);
    expected
}

fn notes(file: &MotionFile) -> String {
    file.notes.join("; ")
}
