//! Disks that are full, and disks that become read-only.

use std::{
    fs,
    process::{Command, Output},
};

use crate::{
    job::{Bench, lasting, quick_jobs},
    support::{Ran, contents},
    trials,
};

/// Runs a shell script in a mount namespace of its own.
fn in_namespace(script: &str) -> Output {
    let mut command = Command::new("unshare");
    command.args(["--mount", "--map-root-user", "sh", "-c", script]).output().unwrap()
}

/// True if file systems can be mounted in a namespace.
fn can_mount() -> bool {
    let place = tempfile::tempdir().unwrap();
    let script = format!("mount -t tmpfs -o size=64k none {}", place.path().display());
    let can = Command::new("unshare")
        .args(["--mount", "--map-root-user", "sh", "-c", &script])
        .output()
        .is_ok_and(|output| output.status.success());
    if !can {
        println!("skipped: no file system can be mounted here");
    }
    can
}

/// Shell words of the bench's command, with `out` on the disk `@/disk`.
fn on_disk(bench: &Bench<'_>) -> (String, String) {
    let root = bench.place.root().display().to_string();
    let words =
        bench.words().join(" ").replace(&format!("{root}/out"), &format!("{root}/disk/out"));
    (root, format!("{} {words}", env!("CARGO_BIN_EXE_cape")))
}

#[test]
fn a_full_disk_is_said_and_the_command_goes_on_when_there_is_space() {
    if !can_mount() {
        return;
    }
    for job in quick_jobs() {
        let bench = Bench::new(job);
        bench.run().succeeded();
        let whole: usize = contents(&bench.place.at("out")).iter().map(|file| file.1.len()).sum();
        bench.clear();
        fs::create_dir(bench.place.at("disk")).unwrap();
        let (root, line) = on_disk(&bench);
        let again = match job.name {
            "train" => format!(
                "if [ -e {root}/disk/out/config.toml ]; then {} train --out {root}/disk/out --resume; else \
                 {line}; fi",
                env!("CARGO_BIN_EXE_cape")
            ),
            _ => line.clone(),
        };
        let sizes = trials(3);
        let mut full = 0;
        for number in 0..sizes {
            let bytes = whole * (2 * number + 1) / (2 * sizes) + 4096;
            let script = format!(
                "mount -t tmpfs -o size={bytes} none {root}/disk\n{line} > {root}/said 2>&1\n\
                 echo $? > {root}/code\nmount -o remount,size=1g {root}/disk\n{again} || exit 3\n\
                 rm -rf {root}/out; cp -r {root}/disk/out {root}/out\nls -A {root}/disk > {root}/beside"
            );
            let ran = Ran::from(in_namespace(&script));
            let said = fs::read_to_string(bench.place.at("said")).unwrap();
            let code = fs::read_to_string(bench.place.at("code")).unwrap();
            assert!(!said.contains("panicked"), "{}, {bytes} bytes: {said}", job.name);
            assert_eq!(ran.code, Some(0), "{}, {bytes} bytes: {said}\n{}", job.name, ran.err);
            if code.trim() != "0" {
                full += 1;
                assert_eq!(code.trim(), "1", "{}, {bytes} bytes: {said}", job.name);
                assert!(said.contains("No space left"), "{}, {bytes} bytes: {said}", job.name);
            }
            bench.assert_as_expected(&format!("{bytes} of {whole} bytes"));
            assert_eq!(fs::read_to_string(bench.place.at("beside")).unwrap().trim(), "out");
            bench.clear();
        }
        println!("{}: {full} of {sizes} disks full, {whole} bytes", job.name);
        assert!(full > 0, "{}", job.name);
    }
}

#[test]
fn a_read_only_disk_is_said_and_the_command_goes_on_when_it_is_not() {
    if !can_mount() {
        return;
    }
    for job in quick_jobs() {
        let bench = Bench::new(job);
        fs::create_dir(bench.place.at("disk")).unwrap();
        let (root, line) = on_disk(&bench);
        let script = format!(
            "mount -t tmpfs -o size=1g none {root}/disk\nmount -o remount,ro {root}/disk\n\
             {line} > {root}/said 2>&1\necho $? > {root}/code\nmount -o remount,rw {root}/disk\n\
             {line} || exit 3\ncp -r {root}/disk/out {root}/out"
        );
        let ran = Ran::from(in_namespace(&script));
        let said = fs::read_to_string(bench.place.at("said")).unwrap();
        let code = fs::read_to_string(bench.place.at("code")).unwrap();
        assert_eq!((ran.code, code.trim()), (Some(0), "1"), "{}: {said}{}", job.name, ran.err);
        assert!(said.contains("Read-only file system"), "{}: {said}", job.name);
        assert_eq!(lasting(&bench.place.at("out")).len(), bench.expected.len());
        bench.assert_as_expected("read-only");
    }
}
