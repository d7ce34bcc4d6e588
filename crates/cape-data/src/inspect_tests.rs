use std::fs;

use cape_core::npy::write_npy;
use ndarray::{Array1, s};

use super::*;
use crate::{
    PackOptions, SequenceList, SplitSpec, pack,
    raw::{RawFrame, write_frame, write_minimal},
};
use cape_core::silent;

/// A box of the size of a person: eight clothing vertices at the corners and two vertices of bare
/// skin.
fn shape() -> Array2<f64> {
    Array2::from_shape_fn((10, 3), |(v, axis)| match (v, axis) {
        (8.., 1) => 1.6,
        (8.., _) => 0.0,
        (_, 1) => {
            if v & 1 == 0 {
                0.0
            } else {
                1.7
            }
        }
        (_, axis) => {
            if v >> axis & 1 == 0 {
                -0.2
            } else {
                0.2
            }
        }
    })
}

fn frame(clothes: f64, bare: f64, turn: f64) -> RawFrame {
    let v_cano = shape()
        + Array2::from_shape_fn((10, 3), |(v, axis)| match (v, axis) {
            (8.., 0) => bare,
            (_, 0) => clothes,
            _ => 0.0,
        });
    RawFrame {
        v_posed: &v_cano + 1.0,
        v_cano,
        pose: std::array::from_fn(|i| if i == 12 { turn } else { 0.0 }),
        transl: [0.0, 3.0, 4.0],
    }
}

fn tree(scale: f64, make: impl Fn(Outfit) -> RawFrame) -> tempfile::TempDir {
    let root = tempfile::tempdir().unwrap();
    write_minimal(root.path(), "a", &(shape() * scale)).unwrap();
    for outfit in [Outfit::SHORT_LONG, Outfit::LONG_LONG] {
        for sequence in ["walk", "hips"] {
            for number in 0..6 {
                let frame = make(outfit);
                write_frame(root.path(), "a", outfit, sequence, number, &frame).unwrap();
            }
        }
    }
    let clothing: Array1<i64> = (0..8).collect();
    write_npy(root.path().join(CLOTHING_FILE), &clothing).unwrap();
    root
}

fn options() -> InspectOptions {
    InspectOptions { frames: 2, ..InspectOptions::default() }
}

fn look(root: &Path) -> Inspection {
    inspect(root, &options(), &mut silent).unwrap()
}

#[test]
fn sound_data_raise_no_warning() {
    let root = tree(1.0, |_| frame(0.015, 0.001, 1.0));
    let found = look(root.path());
    assert_eq!(found.warnings, Vec::<String>::new());
    assert_eq!((found.frames, found.examined, found.vertices), (24, 8, 10));
    assert_eq!(found.captures.len(), 4);
    let worn = found.clothing_mm.unwrap();
    assert!((worn.mean - 15.0).abs() < 1e-9 && (worn.max - 15.0).abs() < 1e-9);
    assert!((found.elsewhere_mm.unwrap().mean - 1.0).abs() < 1e-9);
    assert_eq!(found.height_m, Some([1.7, 1.7]));
    assert_eq!((found.largest_rotation, found.largest_translation_m), (Some(1.0), Some(5.0)));

    let split = SplitSpec {
        subjects: vec!["a".into()],
        outfits: vec![Outfit::SHORT_LONG, Outfit::LONG_LONG],
        train: SequenceList { sequences: vec!["walk".into()], exclude: Vec::new() },
        test: SequenceList { sequences: vec!["hips".into()], exclude: Vec::new() },
        ..SplitSpec::default()
    };
    let packed = root.path().join("packed");
    pack(root.path(), &packed, &split, PackOptions::default(), &mut silent).unwrap();
    let found = look(&packed);
    assert_eq!(found.warnings, Vec::<String>::new());
    assert_eq!((found.kind, found.frames, found.examined), ("packed", 8, 8));
    assert!((found.clothing_mm.unwrap().mean - 15.0).abs() < 1e-9);
    // Rotations of another pose.
    let path = packed.join("train/train_pose.npy");
    let poses = cape_core::npy::read_f64(&path).unwrap() * 2.0;
    write_npy(&path, &poses).unwrap();
    assert!(look(&packed).warnings.concat().contains("not those of the pose"));
}

#[test]
fn clothing_of_each_subject_is_that_of_its_body() {
    // The body of the male subject is all clothing, that of the female subject all skin.
    let root = tree(1.0, |_| frame(0.015, 0.001, 1.0));
    for (index, outfit) in [Outfit::SHORT_LONG, Outfit::LONG_LONG].into_iter().enumerate() {
        for number in 0..6 {
            let frame = frame(0.01 * (1 + index) as f64, 0.001, 1.0);
            write_frame(root.path(), "b", outfit, "walk", number, &frame).unwrap();
        }
    }
    write_minimal(root.path(), "b", &shape()).unwrap();
    fs::remove_file(root.path().join(CLOTHING_FILE)).unwrap();
    for (gender, joint) in [(Gender::Male, 3), (Gender::Female, 15)] {
        let mut body = cape_synth::synthetic_body();
        body.v_template = shape();
        body.shapedirs = body.shapedirs.slice(s![..10, .., ..]).to_owned();
        body.posedirs = body.posedirs.slice(s![..10, .., ..]).to_owned();
        body.joint_regressor = Array2::from_elem((24, 10), 0.1);
        body.weights = Array2::from_shape_fn((10, 24), |(_, j)| f64::from(j == joint));
        body.faces = vec![[0, 1, 2]];
        body.save(root.path().join(gender.body_file())).unwrap();
    }
    let genders = [("a", Gender::Male), ("b", Gender::Female)];
    let genders = genders.map(|(name, gender)| (name.to_owned(), gender)).into();
    cape_core::smpl::write_genders(root.path(), &genders).unwrap();
    let found = look(root.path());
    assert_eq!(found.release, ["female: b", "male: a"]);
    // Eight corners of ten vertices move.
    assert!((found.clothing_mm.unwrap().mean - 0.8 * 15.0 - 0.2 * 1.0).abs() < 1e-9, "{found:?}");
    assert!((found.elsewhere_mm.unwrap().mean - 0.8 * 15.0 - 0.2 * 1.0).abs() < 1e-9, "{found:?}");
    assert!((found.clothing_mm.unwrap().max - 15.0).abs() < 1e-9, "{found:?}");
    assert!((found.elsewhere_mm.unwrap().max - 20.0).abs() < 1e-9, "{found:?}");
}

#[test]
fn common_mistakes_give_warnings() {
    let warns = |root: &tempfile::TempDir, expected: &str| {
        let warnings = look(root.path()).warnings;
        assert!(warnings.iter().any(|warning| warning.contains(expected)), "{warnings:?}");
    };
    warns(&tree(1000.0, |_| frame(0.015, 0.0, 1.0)), "millimetres");
    warns(&tree(100.0, |_| frame(0.015, 0.0, 1.0)), "centimetres");
    warns(&tree(1.0, |_| frame(0.5, 0.0, 1.0)), "too large for clothing");
    warns(&tree(1.0, |_| frame(0.0, 0.0, 1.0)), "no clothing");
    warns(&tree(1.0, |_| frame(0.015, 0.02, 1.0)), "head, hands and feet");
    warns(&tree(1.0, |_| frame(0.015, 0.0, 90.0)), "degrees");
    warns(&tree(1.0, |_| frame(0.015, 0.0, 0.0)), "are zero");
    let posed = |_| {
        let frame = frame(0.015, 0.0, 1.0);
        RawFrame { v_posed: frame.v_cano.clone(), ..frame }
    };
    warns(&tree(1.0, posed), "unpose the meshes first");

    let root = tree(1.0, |_| frame(0.015, 0.0, 1.0));
    fs::create_dir_all(root.path().join("sequences/a/coat_walk")).unwrap();
    fs::create_dir_all(root.path().join("sequences/b")).unwrap();
    fs::create_dir_all(root.path().join("sequences/a/longlong_run")).unwrap();
    let broken = root.path().join("sequences/a/longlong_walk/longlong_walk.000001.npz");
    fs::write(broken, "x").unwrap();
    warns(&root, "coat_walk");
    warns(&root, "b: no minimal shape");
    warns(&root, "a/longlong_run: 0 frames");
    warns(&root, "1 of 8 examined frames cannot be used");
    fs::remove_file(crate::raw::minimal_path(root.path(), "a")).unwrap();
    warns(&root, "a: no minimal shape");
    fs::remove_file(root.path().join(CLOTHING_FILE)).unwrap();
    warns(&root, "clothing vertices are unknown");
    let empty = tempfile::tempdir().unwrap();
    let message = inspect(empty.path(), &options(), &mut silent).unwrap_err().to_string();
    assert!(message.contains("neither raw data"), "{message}");
}
