//! Checks against reference data: `CAPE_REFERENCE=DIR cargo test --release --test reference`.
//!
//! Files are discovered by pattern, each is one test, and each prints its largest deviation. A
//! pattern without files, or no directory at all, is reported as skipped.

#![allow(unreachable_pub)]

mod fixture;
mod network;
mod objects;
mod pickles;
mod pyramid;
mod smplx;
mod tensorflow;
mod training;

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    path::{Path, PathBuf},
    process::ExitCode,
};

use burn::tensor::Device;

/// One kind of reference file: how its name starts and ends, and the check of one file.
struct Kind {
    prefix: &'static str,
    suffix: &'static str,
    check: fn(&Path, &Device, &mut dyn FnMut(String)),
    per_device: bool,
}

const KINDS: &[Kind] = &[
    Kind { prefix: "pyramid_", suffix: ".npz", check: pyramid::check, per_device: false },
    Kind { prefix: "smplx_", suffix: "_model.npz", check: smplx::check, per_device: true },
    Kind { prefix: "network_", suffix: ".npz", check: network::check, per_device: true },
    Kind { prefix: "smpl_pickles", suffix: "", check: pickles::check, per_device: false },
    Kind { prefix: "smpl", suffix: "smpl", check: objects::check, per_device: false },
    Kind { prefix: "tf_checkpoint_", suffix: "", check: tensorflow::check, per_device: true },
    Kind { prefix: "training_", suffix: ".json", check: training::check, per_device: true },
    Kind {
        prefix: "training_",
        suffix: ".json",
        check: training::check_in_bfloat16,
        per_device: true,
    },
];

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if arguments.iter().any(|argument| argument == "--list") {
        return ExitCode::SUCCESS;
    }
    let filter = arguments.iter().find(|argument| !argument.starts_with('-'));
    let Some(directory) = std::env::var_os("CAPE_REFERENCE").map(PathBuf::from) else {
        println!("\nSKIPPED: every reference test, because CAPE_REFERENCE is not set.\n");
        println!("0 passed, 0 failed, {} skipped", KINDS.len());
        return ExitCode::SUCCESS;
    };
    let mut files: Vec<PathBuf> = match std::fs::read_dir(&directory) {
        Ok(entries) => entries.filter_map(|entry| Some(entry.ok()?.path())).collect(),
        Err(error) => {
            println!("CAPE_REFERENCE={}: {error}", directory.display());
            return ExitCode::FAILURE;
        }
    };
    files.sort();

    let (mut passed, mut failed, mut skipped) = (0, 0, 0);
    for kind in KINDS {
        let matches = |path: &&PathBuf| {
            let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
            name.starts_with(kind.prefix)
                && name.ends_with(kind.suffix)
                && filter.is_none_or(|filter| name.contains(filter.as_str()))
        };
        let found: Vec<&PathBuf> = files.iter().filter(matches).collect();
        if found.is_empty() {
            println!("SKIPPED: {}*{}: no such file", kind.prefix, kind.suffix);
            skipped += 1;
        }
        for path in found {
            let devices = devices();
            let devices = if kind.per_device { &devices[..] } else { &devices[..1] };
            for (name, device) in devices {
                let file = path.file_name().unwrap_or_default().to_string_lossy();
                let label = if kind.per_device { format!("{file} on {name}") } else { file.into() };
                let mut report = |line: String| println!("  {label}: {line}");
                let check = AssertUnwindSafe(|| (kind.check)(path, device, &mut report));
                if catch_unwind(check).is_ok() {
                    println!("ok      {label}");
                    passed += 1;
                } else {
                    println!("FAILED  {label}");
                    failed += 1;
                }
            }
        }
    }
    println!("\n{passed} passed, {failed} failed, {skipped} skipped");
    if failed > 0 { ExitCode::FAILURE } else { ExitCode::SUCCESS }
}

/// `CAPE_TEST_DEVICES=flex,wgpu:cpu`, or every CPU device compiled in.
fn devices() -> Vec<(String, Device)> {
    let names = std::env::var("CAPE_TEST_DEVICES").unwrap_or_else(|_| {
        let cpu = |name: &&&str| ["flex", "ndarray"].contains(*name);
        cape::core::DEVICES.iter().filter(cpu).copied().collect::<Vec<_>>().join(",")
    });
    names
        .split(',')
        .map(|name| {
            let device = cape::core::parse_device(name).unwrap_or_else(|error| panic!("{error}"));
            (name.to_owned(), device)
        })
        .collect()
}
