//! Faults of processes, disks and files: after each of them the same command, run again, ends with the bytes
//! of an undisturbed one, and nothing that was finished is lost.
//!
//! `CAPE_FAULTS=N` kills each command N times and tries N sizes of a full disk. Disks are file systems in
//! memory in a mount namespace of their own; where the system does not allow them, these tests report
//! themselves as skipped.

// What writes and reads files does not depend on the backend.
#![cfg(all(unix, feature = "flex"))]

mod clock;
mod damage;
mod disk;
mod job;
mod kills;
mod messages;
mod places;
#[path = "../browser/serve.rs"]
mod serve;
#[allow(dead_code, reason = "shared with tests/cli, which uses all of it")]
#[path = "../cli/support.rs"]
mod support;
mod together;

/// Number of trials of each kind for each command.
fn trials(usual: usize) -> usize {
    std::env::var("CAPE_FAULTS").ok().and_then(|n| n.parse().ok()).unwrap_or(usual)
}
