//! Training by several processes, started by Open MPI's `mpirun` on this machine.
//!
//! Without `mpirun` the tests report themselves as skipped. `CAPE_FAULTS=N` kills a process N times.

#![cfg(all(target_os = "linux", feature = "mpi", feature = "flex"))]

mod group;
#[allow(dead_code, reason = "shared with tests/cli, which uses all of it")]
#[path = "../cli/support.rs"]
mod support;

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    sync::Mutex,
    time::{Duration, Instant},
};

use cape::{infer::checkpoint, model::weights::Weights};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

use crate::{
    group::{Group, wait_for},
    support::{Packed, Ran, contents},
};

/// Batches of five frames, which neither two nor four processes can share evenly; 14 steps, 7 an epoch.
const LINE: &str = "train --data @/packed --preset tiny --epochs 2 --batch 5 --seed 3 \
                    --checkpoint-steps 3 --keep 9 --log-steps 1 --threads 1 --ema 0.9 --pose-swap 0.3";

/// One group at a time: the processes of several on few cores wait for each other.
static TURN: Mutex<()> = Mutex::new(());

/// A packed set, or `None` after a note if there is no `mpirun`.
fn packed() -> Option<Packed> {
    Group::possible().then(Packed::new)
}

fn train(data: &Packed, out: &str, processes: usize) {
    Group::start(data, processes, &format!("{LINE} --out @/{out}")).ran().succeeded();
}

/// Weights and momenta by their files.
fn states(run: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut files = contents(&run.join("checkpoints"));
    files.retain(|(path, _)| path.extension().is_some_and(|e| e == "safetensors"));
    assert!(!files.is_empty());
    files
}

/// Weights of all checkpoints by step.
fn weights(run: &Path) -> BTreeMap<u64, Weights> {
    let found = checkpoint::list(&run.join("checkpoints")).unwrap();
    found
        .into_iter()
        .map(|(step, path)| (step, checkpoint::Checkpoint::load(&path).unwrap().model))
        .collect()
}

/// Largest difference of the weights of two runs at any step, relative to the largest of each array.
fn difference(found: &Path, expected: &Path) -> f64 {
    let (found, expected) = (weights(found), weights(expected));
    assert!(found.keys().eq(expected.keys()));
    let mut most = 0.0f64;
    for (step, arrays) in &expected {
        for (name, array) in arrays {
            let largest = array.values.iter().fold(1e-6f32, |most, x| most.max(x.abs()));
            let pairs = found[step][name].values.iter().zip(&array.values);
            most = pairs.map(|(a, b)| f64::from((a - b).abs() / largest)).fold(most, f64::max);
        }
    }
    most
}

fn turn() -> std::sync::MutexGuard<'static, ()> {
    TURN.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}

#[test]
fn several_processes_train_as_one_with_their_whole_batch() {
    let _turn = turn();
    let Some(data) = packed() else { return };
    data.run(&format!("{LINE} --out @/alone")).succeeded();
    let alone = data.at("alone");
    train(&data, "one", 1);
    assert_eq!(states(&data.at("one")), states(&alone));
    let metrics = |run: &Path| fs::read_to_string(run.join("metrics.jsonl")).unwrap();
    for processes in [2, 4] {
        let [first, second] = ["a", "b"].map(|name| {
            let out = format!("{name}{processes}");
            train(&data, &out, processes);
            data.at(&out)
        });
        assert_eq!(states(&first), states(&second), "results depend on timing");
        let off = difference(&first, &alone);
        println!("{processes} processes: {off:.1e} of the largest weight");
        assert!(off < 2e-5, "{processes} processes: {off:e}");
        assert_eq!(metrics(&first).lines().count(), metrics(&alone).lines().count());
        assert!(first.join("prior.json").exists() == alone.join("prior.json").exists());
    }
}

#[test]
fn any_number_of_processes_resumes() {
    let _turn = turn();
    let Some(data) = packed() else { return };
    data.run(&format!("{LINE} --out @/alone")).succeeded();
    // A signal to one process stops all.
    let long = format!("{} --out @/cut", LINE.replace("--epochs 2", "--epochs 2000"));
    let group = Group::start(&data, 2, &long);
    wait_for(&data.at("cut/checkpoints/step-00000003"));
    group.signal(1, "TERM");
    let Ran { code, err, .. } = group.ran();
    assert_eq!(code, Some(130), "{err}");
    assert!(err.contains("interrupted and saved; resume by"), "{err}");
    let step = newest(&data.at("cut"));
    assert!(step >= 3);
    for (processes, more) in [(3, 2), (1, 2), (4, 2)] {
        let before = newest(&data.at("cut"));
        let line = "train --out @/cut --resume --threads 1";
        let group = Group::start(&data, processes, line);
        let next = before + 3 * more;
        wait_for(&data.at(&format!("cut/checkpoints/step-{:08}", next - next % 3)));
        group.signal(0, "TERM");
        let Ran { code, err, .. } = group.ran();
        assert_eq!(code, Some(130), "{processes} processes: {err}");
        assert!(newest(&data.at("cut")) > before);
    }
    // The whole, in two parts by different numbers.
    let group = Group::start(&data, 4, &format!("{LINE} --out @/parts"));
    wait_for(&data.at("parts/checkpoints/step-00000006"));
    group.kill(2);
    group.ran();
    Group::start(&data, 2, "train --out @/parts --resume --threads 1").ran().succeeded();
    let off = difference(&data.at("parts"), &data.at("alone"));
    assert!(off < 2e-5, "{off:e}");
}

fn newest(run: &Path) -> u64 {
    checkpoint::list(&run.join("checkpoints")).unwrap().last().map_or(0, |(step, _)| *step)
}

#[test]
fn a_killed_process_ends_all_and_nothing_is_lost_but_the_step() {
    let _turn = turn();
    let Some(data) = packed() else { return };
    let started = Instant::now();
    train(&data, "whole", 2);
    let took = started.elapsed();
    let kills = std::env::var("CAPE_FAULTS").ok().and_then(|n| n.parse().ok()).unwrap_or(3);
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let (mut left, mut runs, mut slowest) = (kills, 0, Duration::ZERO);
    while left > 0 {
        let out = format!("killed{runs}");
        runs += 1;
        loop {
            let resume = if data.at(&out).join("config.toml").exists() { "--resume" } else { "" };
            let before = newest(&data.at(&out));
            let line = if resume.is_empty() { LINE.to_owned() } else { "train --threads 1".into() };
            let group = Group::start(&data, 2, &format!("{line} --out @/{out} {resume}"));
            if left == 0 {
                group.ran().succeeded();
                break;
            }
            std::thread::sleep(took.mul_f64(rng.random_range(0.0..1.0)));
            let killed = Instant::now();
            let victim = rng.random_range(0..2);
            let hit = group.kill(victim);
            let Ran { code, err, .. } = group.ran();
            slowest = slowest.max(killed.elapsed());
            // Nothing that was saved is lost.
            assert!(newest(&data.at(&out)) >= before);
            if code == Some(0) {
                break;
            }
            assert!(hit, "process {victim} was not there: {err}");
            assert!(err.contains("signal 9"), "{err}");
            left -= 1;
        }
        assert_eq!(states(&data.at(&out)), states(&data.at("whole")));
    }
    println!(
        "{took:.2?} undisturbed; {kills} kills in {runs} runs; all ended within {slowest:.2?}"
    );
    assert!(slowest < Duration::from_secs(30));
}

#[test]
fn errors_end_all_processes_and_are_said_once() {
    let _turn = turn();
    let Some(data) = packed() else { return };
    let fails = |line: &str, parts: &[&str]| {
        let started = Instant::now();
        let Ran { code, out, err } = Group::start(&data, 3, line).ran();
        assert_ne!(code, Some(0), "{err}");
        assert_eq!(out, "");
        assert_eq!(err.matches("error: ").count(), 1, "{err}");
        for part in parts {
            assert!(err.contains(part), "`{part}` is not in:\n{err}");
        }
        assert!(!err.contains("panicked"), "{err}");
        assert!(started.elapsed() < Duration::from_secs(8), "{:?}", started.elapsed());
    };
    let diverges = format!("{LINE} --out @/diverges --peak-rate 1e30");
    fails(&diverges, &["not a finite number", "at step", "(process 0 of 3)"]);
    fails("train --data @/nowhere --out @/x --preset tiny", &["nowhere", "(process 0 of 3)"]);
    fails("train --data @/packed --preset tiny --check", &["--check", "one process, but 3"]);
    train(&data, "there", 2);
    fails(&format!("{LINE} --out @/there"), &["not empty"]);
    fails("train --out @/there --resume --batch 7", &["`train.batch` is 5"]);
    fs::remove_file(data.at("packed/train/train_pose.npy")).unwrap();
    fails("train --out @/there --resume", &["train_pose.npy"]);
}

#[test]
fn a_launcher_of_another_mpi_is_noticed() {
    let _turn = turn();
    if !Group::possible() {
        return;
    }
    let command = |variables: &[(&str, &str)]| {
        let mut command = support::cape(["train", "--data", "x", "--out", "y"]);
        Ran::from(command.envs(variables.iter().copied()).output().unwrap())
    };
    let torchrun = [("RANK", "1"), ("WORLD_SIZE", "2"), ("LOCAL_RANK", "1"), ("MASTER_ADDR", "a")];
    command(&torchrun).failed_saying(&["torchrun started 2 processes", "MPI knows of 1"]);
}
