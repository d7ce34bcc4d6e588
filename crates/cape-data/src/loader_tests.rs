use std::{fmt::Write as _, path::Path};

use cape_core::{Outfit, npy::write_npy};
use ndarray::{Array2, Array3};

use super::*;
use crate::Split;

/// A training set in which every displacement and rotation of a frame is the index of the frame.
fn packed(root: &Path, frames: usize) -> (Arc<PackedSet>, Arc<DisplacementStatistics>) {
    std::fs::create_dir_all(root.join("train")).unwrap();
    let path = |what: &str| root.join(format!("train/train_{what}.npy"));
    write_npy(path("disp"), &Array3::from_shape_fn((frames, 2, 3), |(k, ..)| k as f64)).unwrap();
    write_npy(path("pose"), &Array2::<f64>::zeros((frames, 72))).unwrap();
    write_npy(path("rot"), &Array2::from_shape_fn((frames, 216), |(k, _)| k as f64)).unwrap();
    let label = Array2::from_shape_fn((frames, 4), |(_, i)| {
        f64::from(Outfit::PAPER[i] == Outfit::LONG_LONG)
    });
    write_npy(path("clo_label"), &label).unwrap();
    let statistics =
        DisplacementStatistics::new(Array2::zeros((2, 3)), Array2::ones((2, 3)), 1).unwrap();
    (Arc::new(PackedSet::open(root, Split::Train).unwrap()), Arc::new(statistics))
}

fn loader(
    (set, statistics): &(Arc<PackedSet>, Arc<DisplacementStatistics>),
    rows: Range<usize>,
    batch: usize,
    state: LoaderState,
) -> Loader {
    let options = LoaderOptions { batch, ..LoaderOptions::default() };
    Loader::new(set.clone(), statistics.clone(), rows, options, state).unwrap()
}

#[test]
fn steps_bring_the_frames_they_name_and_resume_anywhere() {
    let dir = tempfile::tempdir().unwrap();
    let data = packed(dir.path(), 12);
    let mut whole = loader(&data, 2..12, 4, LoaderState::new(5));
    let steps: Vec<StepBatches> = (0..9).map(|_| whole.step().unwrap()).collect();
    let mut counts = [0; 12];
    for step in &steps {
        let real = step.discriminator.as_ref().unwrap();
        for batch in [&step.generator, real] {
            assert_eq!(batch.displacement.dim(), (4, 2, 3));
            for (row, &frame) in batch.frames.iter().enumerate() {
                assert_eq!(batch.displacement[[row, 1, 2]], frame as f32);
            }
        }
        step.generator.frames.iter().for_each(|&frame| counts[frame] += 1);
    }
    // 36 draws of 10 frames: each three or four times.
    assert!(counts[..2] == [0, 0] && counts[2..].iter().all(|&n| n == 3 || n == 4));
    assert!(steps.iter().any(|s| s.generator.frames != s.discriminator.as_ref().unwrap().frames));
    assert_eq!(steps[4].state.generator, ShufflePosition { epoch: 1, drawn: 10 });
    for k in 0..8 {
        let mut resumed = loader(&data, 2..12, 4, steps[k].state);
        assert_eq!(resumed.step().unwrap(), steps[k + 1]);
    }
}

#[test]
fn a_set_smaller_than_the_batch_repeats() {
    let dir = tempfile::tempdir().unwrap();
    let data = packed(dir.path(), 1);
    let mut loader = loader(&data, 0..1, 3, LoaderState::new(0));
    assert_eq!(loader.step().unwrap().generator.frames, [0, 0, 0]);
    for (frames, batch, steps) in [(1, 16, 1), (16, 16, 1), (17, 16, 2), (30_936, 16, 1934)] {
        assert_eq!(steps_per_epoch(frames, batch), steps);
    }
}

#[test]
fn the_discriminators_batches_are_optional_and_change_nothing_else() {
    let dir = tempfile::tempdir().unwrap();
    let (set, statistics) = packed(dir.path(), 9);
    let step = |discriminator| {
        let options =
            LoaderOptions { batch: 2, discriminator, prefetch: 0, ..LoaderOptions::default() };
        let state = LoaderState::new(1);
        let mut loader =
            Loader::new(set.clone(), statistics.clone(), 0..9, options, state).unwrap();
        loader.step().unwrap()
    };
    assert!(step(false).discriminator.is_none());
    assert_eq!(step(false).generator, step(true).generator);
}

#[test]
fn frames_of_the_same_capture_are_encoded_instead() {
    let dir = tempfile::tempdir().unwrap();
    packed(dir.path(), 12);
    // Captures of five, one and six frames.
    let mut csv = "subject,outfit,sequence,frame\n".to_owned();
    for frame in 0..12 {
        let name = ["walk", "jump", "squats"][usize::from(frame > 4) + usize::from(frame > 5)];
        writeln!(csv, "s0001,longlong,{name},{name}.{frame:06}").unwrap();
    }
    std::fs::write(dir.path().join("train/train_frames.csv"), csv).unwrap();
    let set = Arc::new(PackedSet::open(dir.path(), Split::Train).unwrap());
    let statistics =
        DisplacementStatistics::new(Array2::zeros((2, 3)), Array2::ones((2, 3)), 1).unwrap();
    let statistics = Arc::new(statistics);
    let load = |transfer, state| {
        let options = LoaderOptions { batch: 4, transfer, ..LoaderOptions::default() };
        Loader::new(set.clone(), statistics.clone(), 1..12, options, state).unwrap()
    };
    let capture = |frame: usize| {
        if frame < 5 {
            0
        } else if frame < 6 {
            1
        } else {
            2
        }
    };
    for (transfer, changed) in [(1.0, 400..800), (0.5, 150..450)] {
        let mut loader = load(transfer, LoaderState::new(3));
        let mut plain = load(0.0, LoaderState::new(3));
        let mut others = 0;
        let mut before: Option<StepBatches> = None;
        for _ in 0..200 {
            let step = loader.step().unwrap();
            assert_eq!(step.generator, plain.step().unwrap().generator);
            let encoded = step.encoded.as_ref().unwrap();
            for (row, (&frame, &other)) in
                step.generator.frames.iter().zip(&encoded.frames).enumerate()
            {
                assert_eq!(capture(frame), capture(other), "{frame} {other}");
                assert_eq!(encoded.displacement[[row, 0, 0]], other as f32);
                assert_ne!(other, 0, "no training row");
                others += usize::from(frame != other);
            }
            if let Some(before) = before {
                assert_eq!(load(transfer, before.state).step().unwrap(), step);
            }
            before = Some(step);
        }
        assert!(changed.contains(&others), "{transfer}: {others} of 800");
    }
    assert!(load(0.0, LoaderState::new(3)).step().unwrap().encoded.is_none());
    // Without captures, and out of range.
    std::fs::remove_file(dir.path().join("train/train_frames.csv")).unwrap();
    let bare = Arc::new(PackedSet::open(dir.path(), Split::Train).unwrap());
    for (transfer, said) in [(0.5, "train_frames.csv"), (1.5, "expected 0 to 1")] {
        let options = LoaderOptions { transfer, ..LoaderOptions::default() };
        let state = LoaderState::new(0);
        let error = Loader::new(bare.clone(), statistics.clone(), 0..12, options, state);
        assert!(error.unwrap_err().to_string().contains(said));
    }
}

#[test]
fn frames_are_reconstructed_under_the_poses_of_others() {
    let dir = tempfile::tempdir().unwrap();
    let (set, statistics) = packed(dir.path(), 12);
    let load = |pose_swap, state| {
        let options = LoaderOptions { batch: 4, pose_swap, ..LoaderOptions::default() };
        Loader::new(set.clone(), statistics.clone(), 1..12, options, state).unwrap()
    };
    let all: Vec<usize> = (0..12).collect();
    let poses = set.pose_features(&all).unwrap();
    assert_eq!(poses, set.batch(&all, None).unwrap().pose_feature);
    let mut seen = [false; 12];
    for (share, changed) in [(1.0, 650..800), (0.25, 130..230)] {
        let mut loader = load(share, LoaderState::new(3));
        let mut plain = load(0.0, LoaderState::new(3));
        let mut others = 0;
        let mut before: Option<StepBatches> = None;
        for _ in 0..200 {
            let step = loader.step().unwrap();
            let own = plain.step().unwrap().generator;
            assert_eq!(step.encoded.as_ref().unwrap(), &own);
            assert_eq!(step.generator.displacement, own.displacement);
            for (row, &frame) in own.frames.iter().enumerate() {
                let posed = step.generator.pose_feature[[row, 0]] as usize;
                assert_eq!(step.generator.pose_feature.row(row), poses.row(posed));
                assert_ne!(posed, 0, "no training row");
                seen[posed] = true;
                others += usize::from(posed != frame);
            }
            if let Some(before) = before {
                assert_eq!(load(share, before.state).step().unwrap(), step);
            }
            before = Some(step);
        }
        assert!(changed.contains(&others), "{share}: {others} of 800");
    }
    assert_eq!(seen.iter().filter(|seen| **seen).count(), 11);
    let options = LoaderOptions { pose_swap: -0.5, ..LoaderOptions::default() };
    let error = Loader::new(set.clone(), statistics.clone(), 0..12, options, LoaderState::new(0));
    assert!(error.unwrap_err().to_string().contains("pose_swap: expected 0 to 1"));
    assert!(set.pose_features(&[12]).unwrap_err().to_string().contains("frame 12 of a set of 12"));
}

#[test]
fn parts_of_batches_are_their_rows() {
    let dir = tempfile::tempdir().unwrap();
    let (set, statistics) = packed(dir.path(), 12);
    for (batch, count) in [(5, 1), (6, 2), (5, 3), (3, 4)] {
        let load = |part| {
            let options = LoaderOptions { batch, pose_swap: 0.5, part, ..LoaderOptions::default() };
            let state = LoaderState::new(2);
            Loader::new(set.clone(), statistics.clone(), 1..12, options, state).unwrap()
        };
        let mut whole = load(BatchPart::WHOLE);
        let mut parts: Vec<_> = (0..count).map(|index| load(BatchPart { index, count })).collect();
        for _ in 0..4 {
            let whole = whole.step().unwrap();
            let parts: Vec<StepBatches> =
                parts.iter_mut().map(|loader| loader.step().unwrap()).collect();
            let mut rows = 0;
            for (index, part) in parts.iter().enumerate() {
                assert_eq!((&part.drawn, part.state), (&whole.drawn, whole.state));
                let range = BatchPart { index, count }.range(batch);
                rows += range.len();
                let expected = if range.is_empty() { 0..1 } else { range };
                let features = |step: &StepBatches| step.generator.pose_feature.clone();
                let slice = ndarray::s![expected.clone(), ..];
                assert_eq!(features(part), features(&whole).slice(slice));
                for of in [
                    |step: &StepBatches| step.generator.frames.clone(),
                    |step: &StepBatches| step.encoded.clone().unwrap().frames,
                    |step: &StepBatches| step.discriminator.clone().unwrap().frames,
                ] {
                    assert_eq!(of(part), of(&whole)[expected.clone()]);
                }
            }
            assert_eq!(rows, batch);
        }
    }
}

#[test]
fn sequential_reading_sees_each_frame_once() {
    let dir = tempfile::tempdir().unwrap();
    let (set, _) = packed(dir.path(), 8);
    let batches = |rows, batch| -> Vec<Vec<usize>> {
        sequential(set.clone(), None, rows, batch).unwrap().map(|b| b.unwrap().frames).collect()
    };
    assert_eq!(batches(1..8, 3), [vec![1, 2, 3], vec![4, 5, 6], vec![7]]);
    assert_eq!(batches(6..99, 5), [[6, 7]]);
    assert!(batches(3..3, 5).is_empty());
    // Stopping early does not wait for the rest.
    drop(sequential(set.clone(), None, 0..8, 1).unwrap());
}

#[test]
fn mistakes_and_bad_frames_are_errors() {
    let dir = tempfile::tempdir().unwrap();
    let (set, statistics) = packed(dir.path(), 4);
    let new = |rows, batch| {
        let options = LoaderOptions { batch, ..LoaderOptions::default() };
        Loader::new(set.clone(), statistics.clone(), rows, options, LoaderState::new(0))
    };
    assert!(new(2..2, 1).unwrap_err().to_string().contains("2..2 of a set of 4"));
    assert!(new(0..5, 1).is_err());
    assert!(new(0..4, 0).unwrap_err().to_string().contains("batch: expected at least 1"));
    let mut disp = Array3::<f64>::zeros((4, 2, 3));
    disp[[2, 0, 0]] = f64::NAN;
    write_npy(dir.path().join("train/train_disp.npy"), &disp).unwrap();
    let set = Arc::new(PackedSet::open(dir.path(), Split::Train).unwrap());
    let state = LoaderState::new(0);
    let options = LoaderOptions { batch: 4, ..LoaderOptions::default() };
    let mut loader = Loader::new(set, statistics.clone(), 0..4, options, state).unwrap();
    assert!(loader.step().unwrap_err().to_string().contains("`frame 2`"));
    assert!(loader.step().unwrap_err().to_string().contains("stopped"));
}
