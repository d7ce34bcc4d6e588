//! Commands that are killed at random moments.

use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

use crate::{
    job::{Bench, JOBS},
    trials,
};

#[test]
fn a_killed_command_ends_as_if_it_had_not_been_killed() {
    let mut kills = 0;
    for (number, job) in JOBS.iter().enumerate() {
        let bench = Bench::new(job);
        let mut rng = ChaCha8Rng::seed_from_u64(number as u64);
        let mut left = trials(2);
        while left > 0 {
            // A command may be killed more than once before it ends.
            for _ in 0..left.min(rng.random_range(1..=3)) {
                let before = bench.finished();
                bench.kill_after(bench.took.mul_f64(rng.random_range(0.0..1.0)));
                let after = bench.finished();
                assert!(before.iter().all(|file| after.contains(file)), "{}: lost", job.name);
                left -= 1;
                kills += 1;
            }
            let before = bench.finished();
            bench.finish();
            let after = bench.finished();
            assert!(before.iter().all(|file| after.contains(file)), "{}: done again", job.name);
            bench.assert_as_expected("killed");
            bench.clear();
        }
        println!("{}: {:.2?} undisturbed, killed {} times", job.name, bench.took, trials(2));
    }
    println!("{kills} kills");
}
