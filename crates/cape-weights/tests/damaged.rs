//! Damaged model files are errors.

use burn::tensor::Device;
use cape_infer::ModelFile;

/// Bytes of the header: its length, then JSON.
fn header() -> usize {
    let (length, _) = cape_weights::MODEL.split_first_chunk::<8>().unwrap();
    8 + u64::from_le_bytes(*length) as usize
}

#[test]
fn damaged_model_files_are_errors_not_panics() {
    let device = Device::default();
    let end = header();
    let mut state = 7u64;
    let mut refused = 0;
    for _ in 0..60 {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        let at = (state >> 33) as usize % end;
        let mut bytes = cape_weights::MODEL.to_vec();
        bytes[at] = bytes[at].wrapping_add(1 + (state >> 20) as u8 % 250);
        let opened = ModelFile::decode("damaged", &bytes).and_then(|file| file.open("m", &device));
        refused += usize::from(opened.is_err());
    }
    assert!(refused > 30, "{refused} of 60");
    for kept in [0, 7, 100, end - 1, end, cape_weights::MODEL.len() - 1] {
        let error = ModelFile::decode("cut", &cape_weights::MODEL[..kept]).unwrap_err();
        assert!(error.to_string().starts_with("cut: no complete model file"), "{error}");
    }
}

#[test]
fn bytes_without_factors_are_refused() {
    let (name, other) = (b"\"factors.decoder.linear_path\"", b"\"fectors.decoder.linear_path\"");
    let mut bytes = cape_weights::MODEL.to_vec();
    let at = bytes[..header()].windows(name.len()).position(|found| found == name).unwrap();
    bytes[at..at + name.len()].copy_from_slice(other);
    let error = ModelFile::decode("renamed", &bytes).unwrap_err().to_string();
    assert!(error.contains("renamed") && error.contains("factors.decoder.linear_path"), "{error}");
}
