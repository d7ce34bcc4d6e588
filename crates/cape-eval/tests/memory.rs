//! Updates do not leak memory: the process needs no more after 200 updates than after 20.

#![cfg(target_os = "linux")]

use cape_eval::bench::{Workload, rss_mb};
use cape_model::CapeConfig;

const BATCH: usize = 4;
const SEED: u64 = 1;

#[test]
fn memory_is_constant_over_200_steps() {
    let device = cape_core::devices().remove(0);
    let mut workload = Workload::new(&CapeConfig::tiny(), BATCH, SEED, &device).unwrap();
    let mut after = |updates: usize| {
        for _ in 0..updates {
            workload.update().unwrap();
        }
        rss_mb().unwrap()
    };
    let early = after(20);
    let late = after(180);
    println!("{early:.1} MB after 20 updates, {late:.1} MB after 200");
    // A leak of one activation per step (6890 vertices, 3 coordinates, 4 examples) would be 60 MB.
    assert!(late < early + 16.0, "{early:.1} MB after 20 updates, {late:.1} MB after 200");
}
