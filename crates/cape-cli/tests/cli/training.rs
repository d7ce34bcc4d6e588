//! Training: repeatable, and resumable wherever it was stopped.

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    thread::sleep,
    time::{Duration, Instant},
};

use cape::{core::npy::write_npy, infer::RunConfig, render::Image};
use serde_json::Value;

use crate::support::{Packed, Ran, cape, contents, truncate};

const LONG: &str = "--preset tiny --epochs 12 --batch 4 --checkpoint-steps 3 --keep 2";

/// Losses by step, without what depends on the clock.
fn losses(run: &Path) -> Vec<Value> {
    let text = fs::read_to_string(run.join("metrics.jsonl")).unwrap();
    let parse = |line: &str| {
        let mut line: Value = serde_json::from_str(line).unwrap();
        line.as_object_mut().unwrap().remove("seconds");
        line
    };
    text.lines().map(parse).collect()
}

/// Weights and momenta of all checkpoints.
fn states(run: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut files = contents(&run.join("checkpoints"));
    files.retain(|(path, _)| path.extension().is_some_and(|e| e == "safetensors"));
    assert!(!files.is_empty());
    files
}

#[test]
fn the_same_command_makes_the_same_weights() {
    let data = Packed::new();
    let train = |out: &str, threads: usize| {
        let line = format!(
            "train --data @/packed --out @/{out} --preset tiny --epochs 2 --batch 4 --seed 3 \
             --threads {threads}"
        );
        data.run(&line).succeeded();
    };
    train("one", 1);
    train("two", 3);
    assert_eq!(states(&data.at("one")), states(&data.at("two")));
    assert_eq!(losses(&data.at("one")), losses(&data.at("two")));
    let config = |out: &str| fs::read(data.at(out).join("config.toml")).unwrap();
    assert_eq!(config("one"), config("two"));
}

#[cfg(unix)]
#[test]
fn an_interrupted_training_resumes_as_if_nothing_had_been() {
    interrupted_and_resumed("");
}

#[cfg(unix)]
#[test]
fn so_does_one_with_every_option_away_from_the_paper() {
    interrupted_and_resumed(
        "--optimiser adam --peak-rate 0.001 --schedule cosine --ema 0.9 --kl-warmup-epochs 3 \
         --adversary hinge --spectral-norm --unit metres --bare-weight 0.5 --clothing-patches",
    );
}

#[cfg(unix)]
fn interrupted_and_resumed(options: &str) {
    let data = Packed::new();
    data.run(&format!("train --data @/packed --out @/whole {LONG} {options}")).succeeded();

    let line = format!("train --data @/packed --out @/cut {LONG} {options}");
    let words = line.split_whitespace().map(|w| w.replace('@', data.root().to_str().unwrap()));
    let child = cape(words).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let start = Instant::now();
    while !data.at("cut/checkpoints/step-00000003").exists() {
        assert!(start.elapsed() < Duration::from_mins(1), "no checkpoint after a minute");
        sleep(Duration::from_millis(2));
    }
    let pid = child.id().to_string();
    assert!(Command::new("kill").args(["-INT", &pid]).status().unwrap().success());
    let Ran { code, out, err } = child.wait_with_output().unwrap().into();
    assert_eq!(code, Some(130), "{err}");
    assert!(err.contains("finishing the step and saving"), "{err}");
    assert!(!out.contains("next:"), "{out}");

    // The last line is the command that goes on.
    let command = err.lines().last().unwrap().trim().strip_prefix("cape ").unwrap();
    assert!(command.contains("--resume"), "{err}");
    let ran: Ran = cape(command.split_whitespace()).output().unwrap().into();
    let out = ran.succeeded();
    assert!(out.contains("next: cape eval run"), "{out}");
    assert_eq!(states(&data.at("cut")), states(&data.at("whole")));
    assert_eq!(losses(&data.at("cut")), losses(&data.at("whole")));
}

#[cfg(unix)]
#[test]
fn a_training_without_a_checkpoint_starts_over_by_itself() {
    let data = Packed::new();
    data.run(&format!("train --data @/packed --out @/whole {LONG}")).succeeded();
    // Killed as soon as the directory is complete, before or after the first steps.
    let line = format!("train --data @/packed --out @/cut {LONG}");
    let words = line.split_whitespace().map(|w| w.replace('@', data.root().to_str().unwrap()));
    let mut child = cape(words).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let start = Instant::now();
    while !data.at("cut/config.toml").exists() {
        assert!(start.elapsed() < Duration::from_mins(1), "no directory after a minute");
        sleep(Duration::from_millis(1));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    if data.at("cut/checkpoints").exists() {
        fs::remove_dir_all(data.at("cut/checkpoints")).unwrap();
    }
    // Metrics of steps that no checkpoint has.
    let logged = fs::read(data.at("whole/metrics.jsonl")).unwrap();
    fs::write(data.at("cut/metrics.jsonl"), logged).unwrap();
    let ran = data.run("train --out @/cut --resume");
    assert!(ran.err.contains("before its first checkpoint: starts over"), "{}", ran.err);
    ran.succeeded();
    assert_eq!(states(&data.at("cut")), states(&data.at("whole")));
    assert_eq!(losses(&data.at("cut")), losses(&data.at("whole")));
    data.run("train --out @/nothing --resume").failed_saying(&["nothing"]);
}

/// With the feature, crates/cape-cli/tests/mpi starts them.
#[cfg(not(feature = "mpi"))]
#[test]
fn several_processes_of_a_launcher_are_refused() {
    for (variables, launcher) in [
        (["OMPI_COMM_WORLD_RANK=1", "OMPI_COMM_WORLD_SIZE=2"], "Open MPI"),
        (["SLURM_PROCID=1", "SLURM_STEP_NUM_TASKS=2"], "Slurm"),
    ] {
        let mut command = cape(["train", "--data", "x", "--out", "y"]);
        command.envs(variables.iter().filter_map(|pair| pair.split_once('=')));
        let ran = Ran::from(command.output().unwrap());
        let expected = format!("process 1 of 2 that {launcher} started");
        ran.failed_saying(&[&expected, "build it with `--features mpi`"]);
    }
}

#[test]
fn a_finished_training_has_nothing_left_to_do() {
    let data = Packed::new();
    data.train().succeeded();
    let before = states(&data.at("run"));
    let report = data.run("train --out @/run --resume --json").json();
    assert_eq!(report["finished"], true);
    assert_eq!(states(&data.at("run")), before);
}

#[test]
fn settings_come_from_a_file_and_options_override_it() {
    let data = Packed::new();
    fs::write(data.at("my.toml"), "[train]\nepochs = 1\nbatch = 32\npeak_rate = 0.001\n").unwrap();
    let line = "train --data @/packed --out @/run --config @/my.toml --batch 16 --json";
    assert_eq!(data.run(line).json()["steps"], 2);
    let config = RunConfig::load(&data.at("run/config.toml")).unwrap();
    assert_eq!((config.train.epochs, config.train.batch), (1, 16));
    assert_eq!((config.train.peak_rate, config.train.momentum), (0.001, 0.9));
    fs::write(data.at("my.toml"), "[train]\nepoch = 1\n").unwrap();
    data.run("train --data @/packed --out @/other --config @/my.toml")
        .failed_saying(&["my.toml", "epoch"]);
    data.run("train --data @/packed --out @/other --preset tiny --peak-rate=-1")
        .failed_saying(&["train.peak_rate"]);
}

#[test]
fn a_training_that_blows_up_stops_before_the_damage_is_saved() {
    let data = Packed::new();
    let line = "train --data @/packed --out @/run --preset tiny --epochs 9 --batch 4 \
                --warmup-epochs 0 --checkpoint-steps 1 --peak-rate 1e12";
    let ran = data.run(line);
    ran.failed_saying(&["is not a finite number at step", "training frames [", "last checkpoint"]);
    for (path, content) in states(&data.at("run")) {
        let tensors = safetensors::SafeTensors::deserialize(&content).unwrap();
        for (name, view) in tensors.tensors() {
            let finite = |bytes: &[u8]| f32::from_le_bytes(bytes.try_into().unwrap()).is_finite();
            assert!(view.data().chunks(4).all(finite), "{}: {name}", path.display());
        }
    }
}

#[test]
fn every_row_of_the_table_is_trained_measured_and_kept() {
    let data = Packed::new();
    let line = "table2 --data @/packed --out @/table --preset tiny --epochs 1 --seeds 2 --rows \
                mean,pca,coma-4,cape,no-edge --json";
    let report = data.run(line).json();
    let lines = report["lines"].as_array().unwrap();
    let rows: Vec<&str> = lines.iter().map(|line| line["row"].as_str().unwrap()).collect();
    assert_eq!(rows, ["mean", "pca", "coma-4", "cape", "no-edge"]);
    let of = |row: usize, what: &str| lines[row][what].as_f64().unwrap();
    assert_eq!((lines[1]["seeds"].as_u64(), lines[3]["seeds"].as_u64()), (Some(1), Some(2)));
    assert!(of(1, "mean") < of(0, "mean"), "{report}");
    assert!(lines[3]["against"].is_null() && lines[4]["against"].is_array());
    assert_eq!(report["reference"], "cape");
    let counted = |row: usize| {
        let counts = lines[row]["histogram"]["counts"].as_array().unwrap().iter();
        let counts = counts.map(|count| count.as_u64().unwrap()).sum::<u64>();
        counts + lines[row]["histogram"]["beyond"].as_u64().unwrap()
    };
    let errors = 16 * 7 * 8;
    assert_eq!((counted(0), counted(3)), (errors, 2 * errors));
    assert_eq!((report["frames"].as_u64(), report["captures"].as_u64()), (Some(16), Some(4)));
    // The mean shape is the evaluation's baseline.
    data.run("train --data @/packed --out @/run --preset tiny --epochs 1 --batch 4").succeeded();
    let evaluation = data.run("eval run @/run --data @/packed --json").json();
    let expected = evaluation["mean_shape"]["overall"]["mean"].as_f64().unwrap();
    assert!((of(0, "mean") - expected).abs() < 1e-4, "{expected}");

    for name in ["table2.md", "table2.csv", "table2.tex", "table2.json"] {
        assert!(data.at("table").join(name).is_file(), "{name}");
    }
    for name in ["reconstructions.png", "error_maps.png", "histograms.png"] {
        Image::load(data.at("table").join(name)).unwrap();
    }
    let html = fs::read_to_string(data.at("table/report.html")).unwrap();
    assert!(html.contains("w/o edge loss"));
    assert_eq!(html.matches("data:image/png;base64,").count(), 3);
    let markdown = fs::read_to_string(data.at("table/table2.md")).unwrap();
    assert!(markdown.contains("error by outfit") && markdown.contains("error by sequence"));

    // What is done is kept; other settings are not mistaken for it.
    let again = data.run(line);
    assert_eq!(again.err.matches("already done").count(), 8, "{}", again.err);
    let again = again.json();
    assert_eq!(again["lines"], report["lines"]);
    // Without the frames that are shown, a row is measured again, not trained.
    let frames = data.at("table/cape/seed-1/frames.npz");
    fs::remove_file(&frames).unwrap();
    let again = data.run(line);
    assert_eq!(again.err.matches("already done").count(), 7, "{}", again.err);
    assert_eq!(again.json()["lines"], report["lines"]);
    assert!(frames.is_file());
    data.run("table2 --data @/raw --out @/nothing").failed_saying(&["train_disp.npy"]);
}

#[test]
fn the_time_of_a_table_is_estimated_before_it_is_made() {
    let data = Packed::new();
    let line = "table2 --data @/packed --out @/table --preset tiny --epochs 3 --seeds 2 --rows \
                mean,cape,no-edge";
    let estimate = data.run(&format!("{line} --dry-run --json")).json();
    assert!(!data.at("table").exists());
    let jobs = estimate["jobs"].as_array().unwrap();
    let of = |name: &str| -> Vec<_> { jobs.iter().map(|job| job[name].clone()).collect() };
    // All rows with the first seed come first.
    assert_eq!(of("row"), ["mean", "cape", "no-edge", "cape", "no-edge"]);
    assert_eq!(of("seed"), [1, 1, 1, 2, 2]);
    let updates: Vec<u64> = of("updates").iter().map(|count| count.as_u64().unwrap()).collect();
    let seconds: Vec<f64> =
        of("seconds_per_update").iter().map(|seconds| seconds.as_f64().unwrap()).collect();
    assert_eq!((updates[0], seconds[0]), (0, 0.0));
    let expected: f64 = updates.iter().zip(&seconds).map(|(&n, s)| n as f64 * s).sum();
    let left = estimate["seconds_left"].as_f64().unwrap();
    assert!(left > 0.0 && (left - expected).abs() < 1e-9 * left, "{estimate}");

    // What is trained is not counted again, and has as many updates as were announced.
    data.run(&line.replace("mean,cape,no-edge", "cape")).succeeded();
    let table = fs::read_to_string(data.at("table/table2.csv")).unwrap();
    assert_eq!(table.lines().count(), 2, "{table}");
    let config = fs::read_to_string(data.at("table/cape/seed-1/run/config.toml")).unwrap();
    assert!(config.contains("warmup_epochs = 0.2"), "{config}");
    let done = data.run(&format!("{line} --dry-run --json")).json();
    let cape = &done["jobs"][1];
    assert_eq!(
        (&cape["updates_done"], &cape["seconds_per_update"]),
        (&cape["updates"], &0.0.into())
    );
    let steps = data.run("info @/table/cape/seed-1/run --json").json();
    assert!(steps.to_string().contains(&updates[1].to_string()), "{steps}");
    assert!(done["seconds_left"].as_f64().unwrap() > 0.0);
    data.run(&format!("{line} --dry-run")).succeeded();
}

#[test]
fn several_processes_share_a_table() {
    let data = Packed::new();
    let line = "table2 --data @/packed --preset tiny --epochs 1 --seeds 2 --rows mean,cape,no-edge";
    let alone = data.run(&format!("{line} --out @/alone --json")).json();
    let shards: Vec<_> = ["1/2", "2/2"]
        .iter()
        .map(|shard| {
            let line = format!("{line} --out @/shared --shard {shard}");
            let root = data.root().to_str().unwrap().to_owned();
            let words = line.split_whitespace().map(move |word| word.replace('@', &root));
            cape(words).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
        })
        .collect();
    for shard in shards {
        let output = shard.wait_with_output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
    let shared = data.run(&format!("{line} --out @/shared --tabulate --json")).json();
    let without_time = |report: &serde_json::Value| {
        let mut lines = report["lines"].clone();
        for line in lines.as_array_mut().unwrap() {
            line["seconds"].take();
        }
        lines
    };
    assert_eq!(without_time(&shared), without_time(&alone));
    data.run(&format!("{line} --out @/nothing --tabulate")).failed_saying(&["no row is finished"]);
    assert_eq!(data.run(&format!("{line} --out @/nothing --shard 3/2")).code, Some(2));
}

#[test]
fn rows_of_other_settings_or_data_are_not_replaced_unasked() {
    let data = Packed::new();
    let line = "table2 --data @/packed --out @/table --preset tiny --epochs 1 --rows";
    data.run(&format!("{line} mean,cape")).succeeded();
    let before = contents(&data.at("table"));
    data.run(&line.replace("--epochs 1", "--epochs 2").replace("--rows", "--rows mean,cape"))
        .failed_saying(&["table/cape/seed-1/settings.json", "`settings.train.epochs`", "2"]);
    fs::copy(data.at("packed/test/test_disp.npy"), data.at("kept.npy")).unwrap();
    let mut displacement = fs::read(data.at("packed/test/test_disp.npy")).unwrap();
    *displacement.last_mut().unwrap() ^= 1;
    fs::write(data.at("packed/test/test_disp.npy"), displacement).unwrap();
    data.run(&format!("{line} mean,cape")).failed_saying(&[
        "table/mean/seed-1/settings.json",
        "`inputs.data`",
        "SHA-256",
        "--overwrite",
        "--out",
    ]);
    fs::copy(data.at("kept.npy"), data.at("packed/test/test_disp.npy")).unwrap();
    assert!(contents(&data.at("table")) == before);

    // Rows and seeds may be added; the mean does not depend on the training.
    let more = data.run(&format!("{line} mean,pca,cape --seeds 2"));
    assert_eq!(more.err.matches("already done").count(), 2, "{}", more.err);
    more.succeeded();
    let notes = data.at("table/cape/seed-1/notes.txt");
    fs::write(&notes, "mine").unwrap();
    let longer = line.replace("--epochs 1", "--epochs 2");
    let other = data.run(&format!("{longer} mean,cape --overwrite"));
    assert_eq!(other.err.matches("already done").count(), 1, "{}", other.err);
    other.succeeded();
    assert!(notes.is_file() && data.at("table/cape/seed-2/result.json").is_file());

    let result = data.at("table/mean/seed-1/result.json");
    truncate(&result);
    data.run(&format!("{line} mean")).failed_saying(&["mean/seed-1/result.json", "remove this"]);

    // Directories of others, and of versions without settings.json.
    data.run("table2 --data @/packed --out @/packed --rows mean")
        .failed_saying(&["is not empty", "another --out"]);
    let earlier = data.at("earlier/mean/seed-1");
    fs::create_dir_all(&earlier).unwrap();
    fs::write(earlier.join("result.json"), "{}").unwrap();
    let line = "table2 --data @/packed --out @/earlier --rows mean";
    data.run(line).failed_saying(&["mean/seed-1", "settings.json", "--overwrite"]);
    data.run(&format!("{line} --overwrite")).succeeded();
}

#[test]
fn runs_are_compared_with_the_first() {
    let data = Packed::new();
    let train = "train --data @/packed --preset tiny --epochs 1 --batch 4";
    data.run(&format!("{train} --out @/one")).succeeded();
    data.run(&format!("{train} --out @/other/one --seed 5")).succeeded();
    let line = "eval compare @/one @/other/one";
    let report = data.run(&format!("{line} --out @/table --json")).json();
    let lines = report["lines"].as_array().unwrap();
    assert_eq!((&lines[1]["row"], &report["frames"]), (&"other/one".into(), &16.into()));
    assert!(lines[0]["against"].is_null(), "{report}");
    let of = |row: usize| lines[row]["mean"].as_f64().unwrap();
    let difference = lines[1]["against"][0].as_f64().unwrap();
    assert!(difference != 0.0 && (difference - (of(1) - of(0))).abs() < 1e-6, "{report}");
    // What `cape eval` says of the same samples.
    let evaluation = data.run("eval run @/one --data @/packed --json").json();
    assert_eq!(lines[0]["mean"], evaluation["model"]["overall"]["mean"]);

    for name in ["compare.md", "compare.csv", "compare.tex", "compare.json"] {
        let text = fs::read_to_string(data.at("table").join(name)).unwrap();
        assert!(text.contains("other/one"), "{name}: {text}");
    }
    Image::load(data.at("table/histograms.png")).unwrap();
    let said = data.run(&format!("{line} @/one --data @/packed")).succeeded();
    assert!(said.contains("against") && said.contains("one (2)"), "{said}");

    // On the same frames only, and at the same vertices.
    fs::rename(data.at("packed"), data.at("moved")).unwrap();
    data.run(line).failed_saying(&["which does not exist: give the directory of the packed set"]);
    data.run(&format!("{line} --data @/moved --quiet")).succeeded();
    data.run("train --data @/moved --out @/third --preset tiny --epochs 1 --batch 4").succeeded();
    fs::create_dir(data.at("packed")).unwrap();
    data.run("eval compare @/one @/third").failed_saying(&["third", "moved", "packed"]);
    let clothing = data.at("third/clothing_verts_idx.npy");
    write_npy(&clothing, &ndarray::arr1(&[1i64, 2])).unwrap();
    data.run("eval compare @/one @/third --data @/moved")
        .failed_saying(&["third", "2 clothing vertices"]);
    data.run("eval compare @/one @/nowhere --data @/moved").failed_saying(&["nowhere"]);
}
