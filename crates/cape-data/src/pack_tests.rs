use std::cell::RefCell;

use cape_core::npy::{Npz, read_f64, write_npy};
use ndarray::Axis;

use super::*;
use crate::{
    DisplacementStatistics, MIN_STD, SequenceList,
    raw::{RawFrame, write_frame, write_minimal},
};
use cape_core::silent;

const VERTICES: usize = 5;

fn split() -> SplitSpec {
    let list = |names: &[&str]| SequenceList {
        sequences: names.iter().map(ToString::to_string).collect(),
        exclude: Vec::new(),
    };
    SplitSpec {
        subjects: vec!["b".into(), "a".into()],
        outfits: vec![Outfit::LONG_SHORT, Outfit::SHORT_LONG],
        cut: 1,
        train: list(&["walk", "hips"]),
        test: list(&["soccer"]),
        ..SplitSpec::default()
    }
}

fn vertices(seed: usize) -> Array2<f64> {
    Array2::from_shape_fn((VERTICES, 3), |(v, c)| ((seed * 31 + v * 3 + c) as f64).sin())
}

fn frame(seed: usize) -> RawFrame {
    RawFrame {
        v_cano: vertices(seed),
        v_posed: vertices(seed + 1),
        pose: std::array::from_fn(|i| ((seed + i) as f64 * 0.7).cos()),
        transl: [0.0; 3],
    }
}

/// Two subjects; frames are numbered downwards so that only sorting by name gives their order.
fn raw_tree() -> tempfile::TempDir {
    let root = tempfile::tempdir().unwrap();
    for (s, subject) in ["a", "b"].into_iter().enumerate() {
        write_minimal(root.path(), subject, &(vertices(1000 + s) * 0.5)).unwrap();
        for (q, sequence) in ["hips", "soccer", "walk"].into_iter().enumerate() {
            for (o, outfit) in [Outfit::SHORT_LONG, Outfit::LONG_SHORT].into_iter().enumerate() {
                for k in (0..5).rev() {
                    let seed = s * 1000 + q * 100 + o * 10 + k;
                    write_frame(root.path(), subject, outfit, sequence, k, &frame(seed)).unwrap();
                }
            }
        }
    }
    root
}

fn pack_to(root: &Path, out: &Path, split: &SplitSpec) -> Result<PackReport> {
    pack(root, out, split, PackOptions::default(), &mut silent)
}

fn capture(root: &Path, name: &str) -> PathBuf {
    root.join("sequences").join(name)
}

/// Expected rows, written out independently: subject, sequence, outfit, frame.
fn expected_train() -> Vec<(usize, usize, usize)> {
    let mut rows = Vec::new();
    for subject in [1, 0] {
        for sequence in [2, 0] {
            for outfit in [1, 0] {
                for k in 1..4 {
                    rows.push((subject, subject * 1000 + sequence * 100 + outfit * 10 + k, outfit));
                }
            }
        }
    }
    rows
}

#[test]
fn the_body_is_that_of_the_split() {
    let root = raw_tree();
    let split = SplitSpec { body: Some("body_female.npz".into()), ..split() };
    let out = root.path().join("packed");
    let message = pack_to(root.path(), &out, &split).unwrap_err().to_string();
    assert!(
        message.contains("body_female.npz") && message.contains("`body` of the split"),
        "{message}"
    );
    for name in [BODY_FILE, "body_female.npz"] {
        fs::write(root.path().join(name), name).unwrap();
    }
    pack_to(root.path(), &out, &split).unwrap();
    assert_eq!(fs::read_to_string(out.join(BODY_FILE)).unwrap(), "body_female.npz");
    // In the packed set it has the usual name.
    assert_eq!(SplitSpec::from_file(out.join(SPLIT_FILE)).unwrap().body, None);
    let outside = SplitSpec { body: Some("../body.npz".into()), ..split };
    let message = pack_to(root.path(), &root.path().join("other"), &outside).unwrap_err();
    assert!(message.to_string().contains("`body`"), "{message}");
}

#[test]
fn packs_the_releases_layout() {
    let root = raw_tree();
    fs::write(root.path().join(BODY_FILE), "body").unwrap();
    let out = root.path().join("packed");
    let calls = RefCell::new(Vec::new());
    let report = pack(
        root.path(),
        &out,
        &split(),
        PackOptions { strict: true, ..PackOptions::default() },
        &mut |done, all| {
            calls.borrow_mut().push((done, all));
        },
    )
    .unwrap();
    assert_eq!(calls.borrow().last(), Some(&(36, 36)));
    assert_eq!((report.train_frames, report.test_frames), (24, 12));
    assert_eq!((report.vertices, report.validation_frames), (VERTICES, 2));
    assert!(report.broken.is_empty() && report.missing.is_empty());

    let train = |what: &str| read_f64(out.join(format!("train/train_{what}.npy"))).unwrap();
    let (disp, pose, rot, label) = (train("disp"), train("pose"), train("rot"), train("clo_label"));
    let rows = expected_train();
    assert_eq!(disp.shape(), &[rows.len(), VERTICES, 3]);
    assert_eq!((rot.shape(), label.shape()), ([24, 216].as_slice(), [24, 4].as_slice()));
    for (row, &(subject, seed, outfit)) in rows.iter().enumerate() {
        let want = vertices(seed) - &(vertices(1000 + subject) * 0.5);
        assert_eq!(disp.index_axis(Axis(0), row), want.into_dyn().view());
        assert_eq!(pose[[row, 71]], ((seed + 71) as f64 * 0.7).cos());
        let hot = [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]][outfit];
        assert_eq!(label.index_axis(Axis(0), row).as_slice().unwrap(), hot);
        // A rotation matrix's trace is 1 + 2 cos(angle).
        for joint in 0..24 {
            let angle = (0..3).map(|i| pose[[row, 3 * joint + i]].powi(2)).sum::<f64>().sqrt();
            let trace: f64 = (0..3).map(|i| rot[[row, 9 * joint + 4 * i]]).sum();
            assert!((trace - 1.0 - 2.0 * angle.cos()).abs() < 1e-12);
        }
    }
    let stats = DisplacementStatistics::load(out.join(STATISTICS_FILE)).unwrap();
    for v in 0..VERTICES {
        for c in 0..3 {
            let values: Vec<f64> = (0..22).map(|row| disp[[row, v, c]]).collect();
            let mean = values.iter().sum::<f64>() / 22.0;
            let var = values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / 22.0;
            assert!((stats.mean()[[v, c]] - mean).abs() < 1e-14);
            assert!((stats.std()[[v, c]] - var.sqrt().max(MIN_STD)).abs() < 1e-14);
        }
    }
    let csv = fs::read_to_string(out.join("train/train_frames.csv")).unwrap();
    assert_eq!(csv.lines().nth(1), Some("b,longshort,walk,longshort_walk.000001"));
    assert_eq!(csv.lines().count(), 25);
    assert_eq!(fs::read_to_string(out.join(BODY_FILE)).unwrap(), "body");
    assert_eq!(fs::read_to_string(out.join("broken_frames.txt")).unwrap(), "");
    let notes = fs::read_to_string(out.join("stats.txt")).unwrap();
    assert!(notes.contains("train 24\n") && notes.contains("a/longshort_soccer 3"), "{notes}");
    assert_eq!(SplitSpec::from_file(out.join(SPLIT_FILE)).unwrap(), split());
    let test = read_f64(out.join("test/test_disp.npy")).unwrap();
    assert_eq!(test.shape(), &[12, VERTICES, 3]);
}

#[test]
fn unreadable_frames_are_skipped_and_listed() {
    let root = raw_tree();
    let walk = capture(root.path(), "a/shortlong_walk");
    fs::write(walk.join("shortlong_walk.000002.npz"), "not a zip").unwrap();
    let mut bad = frame(1);
    bad.v_cano[[3, 1]] = f64::NAN;
    write_frame(root.path(), "b", Outfit::LONG_SHORT, "soccer", 1, &bad).unwrap();
    let out = root.path().join("packed");
    let report = pack_to(root.path(), &out, &split()).unwrap();
    assert_eq!((report.train_frames, report.test_frames), (23, 11));
    let listed = fs::read_to_string(out.join("broken_frames.txt")).unwrap();
    let lines: Vec<&str> = listed.lines().collect();
    assert!(lines[0].starts_with("a/shortlong_walk/shortlong_walk.000002.npz\tnot a"), "{listed}");
    assert!(lines[1].ends_with("`v_cano`: vertex 3 has a y that is not finite"), "{listed}");
    let header = cape_core::npy::npy_header(out.join("train/train_disp.npy")).unwrap();
    assert_eq!(header.shape, [23, VERTICES, 3]);

    let strict = root.path().join("strict");
    let error = pack(
        root.path(),
        &strict,
        &split(),
        PackOptions { strict: true, ..PackOptions::default() },
        &mut silent,
    );
    assert!(error.unwrap_err().to_string().contains("shortlong_walk.000002.npz"));
    assert!(!strict.exists() && !root.path().join(".strict.cape-partial").exists());
}

#[test]
fn what_is_missing_is_listed_and_fails_only_if_nothing_is_left() {
    let root = raw_tree();
    let mut wanted = split();
    wanted.subjects.push("nobody".into());
    wanted.test.sequences.push("ski".into());
    fs::remove_dir_all(root.path().join("minimal_body_shape/b")).unwrap();
    let out = root.path().join("packed");
    let report = pack_to(root.path(), &out, &wanted).unwrap();
    assert_eq!((report.train_frames, report.test_frames), (12, 6));
    let missing: Vec<_> =
        report.missing.iter().map(|m| (m.subject.as_str(), m.sequence.as_deref())).collect();
    assert_eq!(missing, [("b", None), ("nobody", None), ("a", Some("ski"))]);
    let strict = pack(
        root.path(),
        root.path().join("s"),
        &wanted,
        PackOptions { strict: true, ..PackOptions::default() },
        &mut silent,
    );
    assert!(strict.unwrap_err().to_string().starts_with("b: no minimal shape"));

    wanted.subjects = vec!["nobody".into()];
    let none = root.path().join("none");
    let message = pack_to(root.path(), &none, &wanted).unwrap_err().to_string();
    assert!(message.contains("no frame can be packed: subject nobody"), "{message}");
    wanted = SplitSpec { cut: 3, subjects: vec!["a".into()], ..split() };
    let message = pack_to(root.path(), &none, &wanted).unwrap_err().to_string();
    assert!(message.contains("has 5 frames, none is left after cutting 3"), "{message}");
    assert!(!none.exists() && !root.path().join(".none.cape-partial").exists());
}

#[cfg(unix)]
#[test]
fn links_out_of_the_data_are_refused_unless_they_are_allowed() {
    let root = raw_tree();
    let elsewhere = tempfile::tempdir().unwrap();
    let walk = capture(root.path(), "a/shortlong_walk");
    let moved = elsewhere.path().join("walk");
    fs::rename(&walk, &moved).unwrap();
    std::os::unix::fs::symlink(&moved, &walk).unwrap();
    let out = root.path().join("packed");
    let report = pack_to(root.path(), &out, &split()).unwrap();
    assert_eq!(report.broken.len(), 3);
    assert!(report.broken[0].reason.contains("outside of"), "{:?}", report.broken);
    let out = root.path().join("followed");
    let options = PackOptions { follow_links: true, ..PackOptions::default() };
    let report = pack(root.path(), &out, &split(), options, &mut silent).unwrap();
    assert_eq!((report.broken.len(), report.train_frames), (0, 24));
}

#[test]
fn exclusions_sampling_and_a_single_frame() {
    let root = raw_tree();
    let mut wanted = SplitSpec { cut: 0, sample_rate: 2, ..split() };
    wanted.train.exclude = vec!["walk".into(), "a/longshort_hips".into()];
    let out = root.path().join("packed");
    let report = pack_to(root.path(), &out, &wanted).unwrap();
    assert_eq!((report.train_frames, report.missing.len()), (3 * 3, 0));
    let csv = fs::read_to_string(out.join("train/train_frames.csv")).unwrap();
    assert!(csv.contains("hips.000004") && !csv.contains("000003") && !csv.contains("walk"));

    wanted = SplitSpec { cut: 2, subjects: vec!["a".into()], ..wanted };
    wanted.test.sequences.clear();
    let one = root.path().join("one");
    let report = pack_to(root.path(), &one, &wanted).unwrap();
    assert_eq!((report.train_frames, report.validation_frames), (1, 0));
    assert!(!one.join("test").exists());
    let mut stats = Npz::open(one.join(STATISTICS_FILE)).unwrap();
    assert!(stats.f64("std").unwrap().iter().all(|&std| std == MIN_STD));
}

#[test]
fn disagreeing_vertex_counts_are_errors() {
    let root = raw_tree();
    let path = raw::minimal_path(root.path(), "a");
    write_npy(&path, &Array2::<f64>::zeros((4, 3))).unwrap();
    let out = root.path().join("packed");
    let message = pack_to(root.path(), &out, &split()).unwrap_err().to_string();
    assert!(message.contains("4 vertices, but other subjects have 5"), "{message}");
}

#[test]
fn an_existing_set_is_kept_and_a_killed_runs_rest_is_not() {
    let root = raw_tree();
    let out = root.path().join("packed");
    let rest = root.path().join(".packed.cape-partial");
    fs::create_dir_all(rest.join("train")).unwrap();
    fs::write(rest.join("train/old"), "x").unwrap();
    fs::create_dir(&out).unwrap();
    pack_to(root.path(), &out, &split()).unwrap();
    assert!(!rest.exists() && !out.join("train/old").exists());
    let message = pack_to(root.path(), &out, &split()).unwrap_err().to_string();
    assert!(message.contains("already exists"), "{message}");
    assert!(out.join("train/train_disp.npy").is_file());
    let file = root.path().join("file");
    fs::write(&file, "x").unwrap();
    assert!(pack_to(root.path(), &file.join("packed"), &split()).is_err());
}

/// Every file of a packed set, by its path.
fn files(root: &Path) -> std::collections::BTreeMap<PathBuf, Vec<u8>> {
    let mut found = std::collections::BTreeMap::new();
    let mut left = vec![root.to_owned()];
    while let Some(directory) = left.pop() {
        for entry in fs::read_dir(directory).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                left.push(path);
            } else {
                found.insert(path.strip_prefix(root).unwrap().to_owned(), fs::read(&path).unwrap());
            }
        }
    }
    found
}

#[test]
fn an_interrupted_packing_goes_on_to_the_same_bytes() {
    let root = tempfile::tempdir().unwrap();
    write_minimal(root.path(), "a", &vertices(0)).unwrap();
    for (sequence, count) in [("walk", 140), ("soccer", 30)] {
        for k in 0..count {
            write_frame(root.path(), "a", Outfit::SHORT_LONG, sequence, k, &frame(k)).unwrap();
        }
    }
    let broken = capture(root.path(), "a/shortlong_walk").join("shortlong_walk.000003.npz");
    fs::write(broken, "x").unwrap();
    let split = SplitSpec { subjects: vec!["a".into()], cut: 0, ..split() };
    let whole = root.path().join("whole");
    let expected = pack_to(root.path(), &whole, &split).unwrap();
    let out = root.path().join("packed");
    let rest = root.path().join(".packed.cape-partial");
    // In the training part, at its end, in the test part.
    for stop in [20, 140, 150] {
        let interrupted = std::panic::catch_unwind(|| {
            pack(root.path(), &out, &split, PackOptions::default(), &mut |done, _| {
                assert!(done < stop, "interrupted");
            })
        });
        assert!(interrupted.is_err() && rest.is_dir() && !out.exists());
        // Rows after the last entry of the log, and a truncated entry.
        let journal = rest.join("journal.txt");
        fs::write(&journal, fs::read_to_string(&journal).unwrap() + "pack").unwrap();
        let path = rest.join("train/train_pose.npy");
        fs::write(&path, [fs::read(&path).unwrap(), vec![7; 99]].concat()).unwrap();
        let report = pack_to(root.path(), &out, &split).unwrap();
        assert!((stop..170).contains(&report.resumed), "{}", report.resumed);
        assert_eq!(PackReport { resumed: 0, ..report }, expected);
        assert_eq!(files(&out), files(&whole));
        assert!(!rest.exists());
        fs::remove_dir_all(&out).unwrap();
    }
    // Rows that are lost are packed again.
    let interrupted = std::panic::catch_unwind(|| {
        pack(root.path(), &out, &split, PackOptions::default(), &mut |done, _| {
            assert!(done < 60, "interrupted");
        })
    });
    assert!(interrupted.is_err());
    let path = rest.join("train/train_rot.npy");
    fs::write(&path, &fs::read(&path).unwrap()[..500]).unwrap();
    let report = pack_to(root.path(), &out, &split).unwrap();
    assert_eq!((report.resumed, files(&out) == files(&whole)), (0, true));
    fs::remove_dir_all(&out).unwrap();
    // Two at once would spoil each other's files.
    let held = StagingDirectory::prepare(&out).unwrap();
    let message = pack_to(root.path(), &out, &split).unwrap_err().to_string();
    assert!(message.contains("another process"), "{message}");
    drop(held);
    // Other data are not gone on with.
    let interrupted = std::panic::catch_unwind(|| {
        pack(root.path(), &out, &split, PackOptions::default(), &mut |done, _| {
            assert!(done < 20, "interrupted");
        })
    });
    assert!(interrupted.is_err());
    let other = SplitSpec { sample_rate: 2, ..split };
    assert_eq!(pack_to(root.path(), &out, &other).unwrap().resumed, 0);
}

/// Captures for validation come last and are not in the statistics, also of a resumed packing.
#[test]
fn named_captures_are_for_validation() {
    let root = raw_tree();
    let list = |name: &str| SequenceList { sequences: vec![name.into()], exclude: Vec::new() };
    let split = SplitSpec {
        train: list("walk"),
        validation: SequenceList { exclude: vec!["a/shortlong_hips".into()], ..list("hips") },
        ..split()
    };
    let out = root.path().join("packed");
    let report = pack_to(root.path(), &out, &split).unwrap();
    // Subjects × outfits × frames, and one capture fewer.
    assert_eq!((report.train_frames, report.validation_frames), (2 * 2 * 3 + 3 * 3, 3 * 3));
    let statistics = DisplacementStatistics::load(out.join(STATISTICS_FILE)).unwrap();
    let rows = read_f64(out.join("train/train_disp.npy")).unwrap();
    let mean = rows.slice(ndarray::s![..12, 3, 1]).mean().unwrap();
    assert!((statistics.mean()[[3, 1]] - mean).abs() < 1e-12);
    assert_eq!(statistics.validation_rows(21), 12..21);
    let frames = fs::read_to_string(out.join("train/train_frames.csv")).unwrap();
    let sequences: Vec<&str> =
        frames.lines().skip(1).filter_map(|line| line.split(',').nth(2)).collect();
    assert!(sequences[..12].iter().all(|name| *name == "walk"), "{sequences:?}");
    assert!(sequences[12..].iter().all(|name| *name == "hips"), "{sequences:?}");

    let again = root.path().join("again");
    for stop in [6, 16] {
        let interrupted = std::panic::catch_unwind(|| {
            pack(root.path(), &again, &split, PackOptions::default(), &mut |done, _| {
                assert!(done < stop, "interrupted");
            })
        });
        assert!(interrupted.is_err());
        assert!(pack_to(root.path(), &again, &split).unwrap().resumed >= stop);
        assert_eq!(files(&again), files(&out));
        fs::remove_dir_all(&again).unwrap();
    }

    let only = SplitSpec { train: SequenceList::default(), ..split };
    let message = pack_to(root.path(), &again, &only).unwrap_err().to_string();
    assert!(message.contains("for validation: add training sequences"), "{message}");
}

/// More than 100 training frames behind the latest, and the same bytes for any thread count.
#[test]
fn long_sequences_and_any_number_of_threads() {
    let root = tempfile::tempdir().unwrap();
    write_minimal(root.path(), "a", &vertices(0)).unwrap();
    for k in 0..1010 {
        write_frame(root.path(), "a", Outfit::SHORT_LONG, "walk", k, &frame(k)).unwrap();
    }
    let split = SplitSpec { subjects: vec!["a".into()], cut: 0, ..split() };
    let files = |threads: usize| {
        let out = root.path().join(format!("packed{threads}"));
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| pack_to(root.path(), &out, &split)).unwrap();
        ["train/train_disp.npy", STATISTICS_FILE].map(|name| fs::read(out.join(name)).unwrap())
    };
    assert_eq!(files(1), files(3));
    let stats =
        DisplacementStatistics::load(root.path().join("packed1").join(STATISTICS_FILE)).unwrap();
    assert_eq!(stats.validation(), 100);
    let values: Vec<f64> = (0..910).map(|k| vertices(k)[[4, 2]] - vertices(0)[[4, 2]]).collect();
    let mean = values.iter().sum::<f64>() / 910.0;
    assert!((stats.mean()[[4, 2]] - mean).abs() < 1e-13);
}

/// A mirrored frame, posed and dressed, is the reflection of the posed and dressed frame.
#[test]
fn mirrored_training_frames_are_reflections() {
    let root = tempfile::tempdir().unwrap();
    let body = cape_synth::synthetic_body();
    body.save(root.path().join(BODY_FILE)).unwrap();
    let vertices = body.vertices();
    let minimal = body.v_template.clone();
    write_minimal(root.path(), "a", &minimal).unwrap();
    for (s, sequence) in ["walk", "hips", "soccer"].into_iter().enumerate() {
        for k in 0..2 {
            let seed = 10 * s + k;
            let worn = Array2::from_shape_fn((vertices, 3), |(v, c)| {
                0.03 * ((seed * 31 + v * 3 + c) as f64).sin()
            });
            let frame = RawFrame {
                v_cano: &minimal + &worn,
                v_posed: minimal.clone(),
                pose: std::array::from_fn(|i| 0.5 * ((seed + i) as f64 * 0.7).cos()),
                transl: [0.0; 3],
            };
            write_frame(root.path(), "a", Outfit::LONG_LONG, sequence, k, &frame).unwrap();
        }
    }
    let list = |name: &str| SequenceList { sequences: vec![name.into()], exclude: Vec::new() };
    let split = SplitSpec {
        subjects: vec!["a".into()],
        outfits: vec![Outfit::LONG_LONG],
        cut: 0,
        mirror: true,
        train: list("walk"),
        validation: list("hips"),
        test: list("soccer"),
        ..SplitSpec::default()
    };
    let out = root.path().join("packed");
    let report = pack_to(root.path(), &out, &split).unwrap();
    assert_eq!((report.train_frames, report.validation_frames, report.test_frames), (6, 2, 2));
    let set = crate::PackedSet::open(&out, Split::Train).unwrap();
    let captures: Vec<_> = (0..6).map(|row| set.capture(row).unwrap()).collect();
    let walk = "a/longlong_walk";
    let mirrored = "a/longlong_mirrored_walk";
    let hips = "a/longlong_hips";
    assert_eq!(captures, [walk, walk, mirrored, mirrored, hips, hips]);

    let displacement = read_f64(out.join("train/train_disp.npy")).unwrap();
    let pose = read_f64(out.join("train/train_pose.npy")).unwrap();
    let rotations = read_f64(out.join("train/train_rot.npy")).unwrap();
    let posed = |row: usize| {
        let pose = pose.index_axis(Axis(0), row);
        let worn = displacement.index_axis(Axis(0), row).into_dimensionality().unwrap().to_owned();
        let pose: Vec<f64> = pose.iter().copied().collect();
        let expected = pose_rotations(&pose).unwrap();
        let row = rotations.index_axis(Axis(0), row);
        assert!(row.iter().eq(expected.as_flattened().as_flattened()));
        body.pose_shape(&minimal, &pose, [0.0; 3], Some(&worn)).unwrap().vertices
    };
    let symmetry = MirrorSymmetry::of(&body.mesh()).unwrap();
    for row in 0..2 {
        let reflected = symmetry.mirror(&posed(row)).unwrap();
        let difference = (&posed(2 + row) - &reflected).mapv(f64::abs);
        let largest = difference.fold(0.0, |a: f64, &b| a.max(b));
        assert!(largest < 1e-4, "{largest} m");
    }

    // Without a body, without its symmetry, and without captures for validation.
    let again = root.path().join("again");
    let lopsided = SplitSpec { validation: SequenceList::default(), ..split.clone() };
    let mut skewed = body.clone();
    skewed.v_template.column_mut(0).mapv_inplace(|x| x + 0.3);
    let other = SplitSpec { body: Some("skewed.npz".into()), ..split.clone() };
    skewed.save(root.path().join("skewed.npz")).unwrap();
    let refuse = |split: &SplitSpec, said: &str| {
        let message = pack_to(root.path(), &again, split).unwrap_err().to_string();
        assert!(message.contains(said), "{message}");
    };
    refuse(&lopsided, "validation.sequences");
    refuse(&other, "skewed.npz: the mesh is not symmetric");
    fs::remove_file(root.path().join(BODY_FILE)).unwrap();
    refuse(&split, "body.npz: not found");
}
