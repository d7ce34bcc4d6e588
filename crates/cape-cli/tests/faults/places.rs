//! Directories that vanish while a command runs.

use std::{fs, thread::sleep};

use crate::{
    job::{Bench, quick_jobs},
    support::Ran,
};

#[test]
fn a_vanished_directory_is_an_error_and_not_the_end() {
    for job in quick_jobs() {
        let bench = Bench::new(job);
        for (share, lost) in [(0.4, "out"), (0.7, "out"), (0.3, "packed"), (0.3, "raw")] {
            let child = bench.start();
            sleep(bench.took.mul_f64(share));
            let (there, away) = (bench.place.at(lost), bench.place.at("away"));
            // A command that has not begun to write, or has ended, loses nothing.
            let moved = fs::rename(&there, &away).is_ok();
            let ran = Ran::from(child.wait_with_output().unwrap());
            assert!(matches!(ran.code, Some(0 | 1)), "{}: {lost}: {}", job.name, ran.err);
            assert!(!ran.err.contains("panicked"), "{}: {lost}: {}", job.name, ran.err);
            if lost == "out" {
                // A directory that was made anew in the meantime is not whole.
                bench.clear();
            }
            if moved {
                fs::rename(&away, &there).unwrap();
            }
            bench.finish();
            bench.assert_as_expected(lost);
            bench.clear();
        }
    }
}
