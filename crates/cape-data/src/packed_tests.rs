use cape_core::npy::write_npy;
use ndarray::{Array, Dimension, s};

use super::*;
use cape_core::silent;

const VERTICES: usize = 3;

fn numbers<D: Dimension>(shape: impl ndarray::ShapeBuilder<Dim = D>) -> Array<f64, D> {
    let mut next = 0.0;
    Array::from_shape_simple_fn(shape, || {
        next += 1.0;
        (next * 0.77f64).sin()
    })
}

/// A training set as the official scripts write it.
fn official(frames: usize) -> tempfile::TempDir {
    let root = tempfile::tempdir().unwrap();
    fs::create_dir(root.path().join("train")).unwrap();
    write(&root, "disp", &numbers((frames, VERTICES, 3)));
    write(&root, "pose", &numbers((frames, 72)));
    write(&root, "rot", &numbers((frames, 216)));
    let label = Array2::from_shape_fn((frames, 4), |(row, i)| f64::from(row % 4 == i));
    write(&root, "clo_label", &label);
    root
}

fn path(root: &tempfile::TempDir, what: &str) -> PathBuf {
    root.path().join(format!("train/train_{what}.npy"))
}

fn write<D: Dimension>(root: &tempfile::TempDir, what: &str, array: &Array<f64, D>) {
    write_npy(path(root, what), array).unwrap();
}

fn open(root: &tempfile::TempDir) -> Result<PackedSet> {
    PackedSet::open(root.path(), Split::Train)
}

#[test]
fn batches_hold_what_was_packed() {
    let root = official(6);
    let set = open(&root).unwrap();
    assert_eq!((set.frames(), set.vertices()), (6, VERTICES));
    assert!(set.origins().is_none());
    let frames = [4, 0, 4];
    let batch = set.batch(&frames, None).unwrap();
    let (disp, rot) = (numbers((6, VERTICES, 3)), numbers((6, 216)));
    for (row, &frame) in frames.iter().enumerate() {
        let want = disp.slice(s![frame, .., ..]).mapv(|x| x as f32);
        assert_eq!(batch.displacement.slice(s![row, .., ..]), want);
        // Joints 1 and 19 are the first and the last of the clothing-related ones.
        assert_eq!(batch.pose_feature[[row, 0]], rot[[frame, 9]] as f32);
        assert_eq!(batch.pose_feature[[row, 125]], rot[[frame, 19 * 9 + 8]] as f32);
        let label = set.vocabulary().one_hot(Outfit::PAPER[frame % 4]).unwrap();
        assert_eq!(batch.outfit.row(row).to_vec(), label);
    }
    assert_eq!(batch.frames, frames);
    assert_eq!(set.pose(5).unwrap()[71], numbers((6, 72))[[5, 71]] as f32);
    assert!(set.batch(&[6], None).unwrap_err().to_string().contains("frame 6 of a set of 6"));
    assert_eq!(set.batch(&[], None).unwrap().displacement.dim(), (0, VERTICES, 3));
}

#[test]
fn float32_and_preloaded_sets_give_the_same_batches() {
    let root = official(5);
    let statistics = DisplacementStatistics::from_packed(root.path(), &mut silent).unwrap();
    let batch = |set: &PackedSet| set.batch(&[3, 1], Some(&statistics)).unwrap();
    let mut set = open(&root).unwrap();
    let expected = batch(&set);
    let mut calls = 0;
    set.preload(&mut |_, _| calls += 1).unwrap();
    assert_eq!((batch(&set), calls), (expected.clone(), 5));
    write_npy(path(&root, "disp"), &numbers((5, VERTICES, 3)).mapv(|x| x as f32)).unwrap();
    assert_eq!(batch(&open(&root).unwrap()), expected);
}

#[test]
fn statistics_are_computed_once_and_kept() {
    let root = official(20);
    let mut calls = Vec::new();
    let first =
        DisplacementStatistics::from_packed(root.path(), &mut |done, all| calls.push((done, all)));
    let first = first.unwrap();
    assert_eq!((calls.len(), calls.last()), (18, Some(&(18, 18))));
    assert_eq!((first.training_rows(20), first.validation_rows(20)), (0..18, 18..20));
    assert!(root.path().join(STATISTICS_FILE).is_file());
    let again =
        DisplacementStatistics::from_packed(root.path(), &mut |_, _| panic!("computed again"))
            .unwrap();
    assert_eq!(first, again);
    let disp = numbers((20, VERTICES, 3));
    let mean = (0..18).map(|row| disp[[row, 1, 2]]).sum::<f64>() / 18.0;
    assert!((first.mean()[[1, 2]] - mean).abs() < 1e-14);
    let rows: Vec<usize> = (0..18).collect();
    let normalised = open(&root).unwrap().batch(&rows, Some(&first)).unwrap().displacement;
    let column = normalised.slice(s![.., 1, 2]);
    assert!(column.mean().unwrap().abs() < 1e-6 && (column.std(0.0) - 1.0).abs() < 1e-6);
    let other =
        DisplacementStatistics::new(Array2::zeros((9, 3)), Array2::ones((9, 3)), 0).unwrap();
    let message = open(&root).unwrap().batch(&[0], Some(&other)).unwrap_err().to_string();
    assert!(message.contains("9 vertices do not fit frames of 3"), "{message}");
}

#[test]
fn inconsistent_files_are_named() {
    let check = |change: &dyn Fn(&tempfile::TempDir), expected: &[&str]| {
        let root = official(6);
        change(&root);
        let message = open(&root).unwrap_err().to_string();
        assert!(expected.iter().all(|part| message.contains(part)), "{message}");
    };
    check(&|r| write(r, "pose", &numbers((5, 72))), &["train_pose.npy", "5 frames", "6"]);
    check(&|r| write(r, "rot", &numbers((6, 24, 9))), &["train_rot.npy", "[6, 24, 9]"]);
    check(&|r| write(r, "disp", &numbers((6, VERTICES))), &["train_disp.npy", "[_, _, 3]"]);
    check(&|r| write(r, "disp", &numbers((0, VERTICES, 3))), &["train_disp.npy", "no frames"]);
    check(&|r| fs::remove_file(path(r, "clo_label")).unwrap(), &["train_clo_label.npy"]);
    check(
        &|r| {
            let bytes = fs::read(path(r, "disp")).unwrap();
            fs::write(path(r, "disp"), &bytes[..bytes.len() - 8]).unwrap();
        },
        &["train_disp.npy"],
    );
    for bad in [[0.0; 4], [1.0, 1.0, 0.0, 0.0], [0.0, 0.5, 0.0, 0.0], [0.0, 0.0, 2.0, 0.0]] {
        check(
            &|r| {
                let mut label = Array2::from_shape_fn((6, 4), |(row, i)| f64::from(row % 4 == i));
                label.row_mut(3).assign(&ndarray::arr1(&bad));
                write(r, "clo_label", &label);
            },
            &["train_clo_label.npy", "`row 3`", "one-hot"],
        );
    }
    let test = PackedSet::open(official(6).path(), Split::Test).unwrap_err().to_string();
    assert!(test.contains("test_disp.npy"), "{test}");
}

#[test]
fn bad_numbers_are_named_when_read() {
    for (what, bad) in [("disp", f64::NAN), ("rot", f64::INFINITY)] {
        let root = official(6);
        let mut array = numbers(if what == "disp" { (6, 9) } else { (6, 216) });
        array[[4, 2]] = bad;
        if what == "disp" {
            write(&root, what, &array.into_shape_with_order((6, 3, 3)).unwrap());
        } else {
            write(&root, what, &array);
        }
        let mut set = open(&root).unwrap();
        assert!(set.batch(&[3, 5], None).is_ok());
        let message = set.batch(&[3, 4], None).unwrap_err().to_string();
        let file = format!("train_{what}.npy");
        assert!(message.contains(&file) && message.contains("`frame 4`"), "{message}");
        assert!(set.preload(&mut silent).is_err());
    }
}

#[test]
fn origins_are_read_and_checked() {
    let root = official(2);
    let csv = root.path().join("train/train_frames.csv");
    fs::write(&csv, "subject,outfit,sequence,frame\na,longlong,walk,f,1\nb,longlong,hips,f2\n")
        .unwrap();
    let set = open(&root).unwrap();
    let origins = set.origins().unwrap();
    assert_eq!((origins[0].frame.as_str(), origins[1].sequence.as_str()), ("f,1", "hips"));
    for (text, expected) in [
        ("a,b\n", "first line"),
        ("subject,outfit,sequence,frame\na,b,c,d\n", "lists 1 frames"),
        ("subject,outfit,sequence,frame\na,b,c,d\na,b\n", "`line 3`"),
    ] {
        fs::write(&csv, text).unwrap();
        let message = open(&root).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
}
