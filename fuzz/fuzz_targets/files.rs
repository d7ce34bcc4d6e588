//! The first byte says what kind of file the others are. Index and data of a TensorFlow checkpoint come
//! together, after the length of the index in two bytes. `CAPE_FUZZ_CORPUS=DIR cargo test --release --test
//! fuzz` writes valid files of this form.

#![no_main]

#[path = "../../tests/fuzz/readers.rs"]
mod readers;

use std::{env, fs, path::PathBuf, process, sync::OnceLock};

use libfuzzer_sys::fuzz_target;

/// A directory of this process, in memory where the system has one.
fn directory() -> &'static PathBuf {
    static DIRECTORY: OnceLock<PathBuf> = OnceLock::new();
    DIRECTORY.get_or_init(|| {
        let place = env::temp_dir().join(format!("cape-fuzz-{}", process::id()));
        fs::create_dir_all(&place).expect("a directory for the files");
        place
    })
}

fuzz_target!(|input: &[u8]| {
    let Some((first, bytes)) = input.split_first() else { return };
    let (kind, name) = readers::KINDS[usize::from(*first) % readers::KINDS.len()];
    let write = |name: &str, bytes: &[u8]| fs::write(directory().join(name), bytes).is_ok();
    let written = if kind.starts_with("tensorflow") {
        let Some((length, both)) = bytes.split_first_chunk() else { return };
        let (index, data) = both.split_at(both.len().min(u16::from_le_bytes(*length).into()));
        write("a.index", index) && write("a.data-00000-of-00001", data)
    } else {
        write(name, bytes)
    };
    if written {
        readers::read(kind, &directory().join(name));
    }
});
