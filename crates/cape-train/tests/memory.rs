//! Updates keep nothing: the memory of a process stays what the first ones needed.

#![cfg(target_os = "linux")]

use cape_model::CapeConfig;
use cape_train::bench::Workload;

const BATCH: usize = 4;
const SEED: u64 = 1;

/// Resident memory, 10⁶ bytes.
fn resident() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
    let kibibytes: f64 = line.trim().strip_suffix("kB").unwrap().trim().parse().unwrap();
    kibibytes * 1024.0 / 1e6
}

#[test]
fn memory_is_constant_over_200_steps() {
    let device = cape_core::devices().remove(0);
    let mut workload = Workload::new(&CapeConfig::tiny(), BATCH, SEED, &device).unwrap();
    let mut after = |updates: usize| {
        for _ in 0..updates {
            workload.update().unwrap();
        }
        resident()
    };
    let early = after(20);
    let late = after(180);
    println!("{early:.1} MB after 20 updates, {late:.1} MB after 200");
    // One activation kept every step (6890 vertices, 3 coordinates, 4 examples) would be 60 MB.
    assert!(late < early + 16.0, "{early:.1} MB after 20 updates, {late:.1} MB after 200");
}
