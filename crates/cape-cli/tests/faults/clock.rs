//! Clocks that jump.

use std::{
    fs::{self, File},
    path::Path,
    process::Command,
    time::{Duration, SystemTime},
};

use crate::{
    job::{Bench, quick_jobs},
    support::Ran,
};

const YEAR: Duration = Duration::from_hours(8766);

#[test]
fn times_of_files_and_the_clock_decide_nothing() {
    let faketime = Command::new("faketime").arg("--version").output().is_ok();
    if !faketime {
        println!("skipped in part: faketime, which sets a program's clock, is not installed");
    }
    for job in quick_jobs() {
        let bench = Bench::new(job);
        for (time, clock) in [
            (SystemTime::UNIX_EPOCH, "2038-01-20 00:00:00"),
            (SystemTime::now() + 70 * YEAR, "1999-12-31 23:59:59"),
        ] {
            bench.kill_after(bench.took.mul_f64(0.7));
            set_times(bench.place.root(), time);
            if faketime {
                // Files made under one clock are gone on with under another.
                let mut command = Command::new("faketime");
                command.arg(clock).arg(env!("CARGO_BIN_EXE_cape")).args(bench.words());
                let ran = Ran::from(command.output().unwrap());
                assert!(!ran.err.contains("panicked"), "{}: {}", job.name, ran.err);
            }
            bench.finish();
            bench.assert_as_expected(clock);
            bench.clear();
        }
    }
}

/// Sets the times of all files that a command has written.
fn set_times(root: &Path, time: SystemTime) {
    for entry in fs::read_dir(root).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if path.is_dir() {
            set_times(&path, time);
        } else if !["raw", "packed"].contains(&name.as_str()) {
            File::options().append(true).open(&path).unwrap().set_modified(time).unwrap();
        }
    }
}
