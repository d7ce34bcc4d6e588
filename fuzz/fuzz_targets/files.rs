//! The first byte says what kind of file the others are.

#![no_main]

#[path = "../../tests/fuzz/readers.rs"]
mod readers;

use libfuzzer_sys::fuzz_target;

fuzz_target!(|input: &[u8]| {
    let Some((first, bytes)) = input.split_first() else { return };
    let (kind, name) = readers::KINDS[usize::from(*first) % readers::KINDS.len()];
    let directory = std::env::temp_dir().join(format!("cape-fuzz-{}", std::process::id()));
    let path = directory.join(name);
    if std::fs::create_dir_all(&directory).is_ok() && std::fs::write(&path, bytes).is_ok() {
        readers::read(kind, &path);
    }
});
