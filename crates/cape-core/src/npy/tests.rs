use std::fs;

use ndarray::{Array1, Array2, Array3, array};
use proptest::prelude::*;

use super::*;

/// A `.npy` file with the given header text and data.
fn npy(header: &str, data: &[u8]) -> Vec<u8> {
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(data);
    bytes
}

fn parse<T: NpyElement>(bytes: &[u8]) -> Result<ArrayD<T>> {
    Source { path: Path::new("x.npy"), name: None }.read(bytes, bytes.len() as u64)
}

fn header(descr: &str, fortran: &str, shape: &str) -> String {
    format!("{{'descr': '{descr}', 'fortran_order': {fortran}, 'shape': {shape}, }}\n")
}

#[test]
fn every_number_type_is_converted() {
    let cases: [(&str, &[u8], f64); 16] = [
        ("<f2", &[0x00, 0xc5], -5.0),
        (">f2", &[0x35, 0x55], 0.333251953125),
        ("<f2", &[0x01, 0x00], 5.960464477539063e-8),
        ("<f4", &1.5f32.to_le_bytes(), 1.5),
        (">f4", &1.5f32.to_be_bytes(), 1.5),
        ("<f8", &(-0.1f64).to_le_bytes(), -0.1),
        (">f8", &(-0.1f64).to_be_bytes(), -0.1),
        ("|i1", &[0xff], -1.0),
        ("<i2", &(-300i16).to_le_bytes(), -300.0),
        (">i4", &(-70000i32).to_be_bytes(), -70000.0),
        ("<i8", &(1i64 << 40).to_le_bytes(), (1i64 << 40) as f64),
        ("|u1", &[200], 200.0),
        (">u2", &[1, 2], 258.0),
        ("<u4", &u32::MAX.to_le_bytes(), 4294967295.0),
        ("<u8", &7u64.to_le_bytes(), 7.0),
        ("|b1", &[1], 1.0),
    ];
    for (descr, data, value) in cases {
        let file = npy(&header(descr, "False", "(1,)"), data);
        assert_eq!(parse::<f64>(&file).unwrap(), array![value].into_dyn(), "{descr}");
        if value.fract() == 0.0 {
            assert_eq!(parse::<i64>(&file).unwrap(), array![value as i64].into_dyn(), "{descr}");
        }
    }
}

#[test]
fn integers_that_do_not_fit_are_refused() {
    for (descr, data) in [
        ("<u8", u64::MAX.to_le_bytes()),
        ("<f8", 0.5f64.to_le_bytes()),
        ("<f8", f64::NAN.to_le_bytes()),
    ] {
        let message = parse::<i64>(&npy(&header(descr, "False", "(1,)"), &data)).unwrap_err();
        assert!(message.to_string().contains("does not fit i64"), "{message}");
    }
}

#[test]
fn fortran_order_is_the_transpose() {
    let data: Vec<u8> = (0..6u8).collect();
    let c = parse::<i64>(&npy(&header("|u1", "False", "(2, 3)"), &data)).unwrap();
    let f = parse::<i64>(&npy(&header("|u1", "True", "(3, 2)"), &data)).unwrap();
    assert_eq!(c, array![[0, 1, 2], [3, 4, 5]].into_dyn());
    assert_eq!(f, c.t());
    assert!(f.is_standard_layout());
    // Python 2 long integers, lists of keys in another order, a scalar.
    let python2 = "{'shape': (2L, 3L), 'descr': '|u1', 'fortran_order': False}";
    assert_eq!(parse::<i64>(&npy(python2, &data)).unwrap(), c);
    assert_eq!(parse::<i64>(&npy(&header("|u1", "False", "()"), &[9])).unwrap().ndim(), 0);
}

#[test]
fn sizes_are_checked_before_memory_is_allocated() {
    for shape in ["(536870912,)", "(4294967296, 4294967296, 4294967296)", "(99999999999999999999,)"]
    {
        let message = parse::<f64>(&npy(&header("<f8", "False", shape), &[0; 16])).unwrap_err();
        let message = message.to_string();
        assert!(
            ["but the file has 16", "more than memory", "length of an axis"]
                .iter()
                .any(|part| message.contains(part)),
            "{message}"
        );
    }
    let mut long = b"\x93NUMPY\x02\x00".to_vec();
    long.extend(u32::MAX.to_le_bytes());
    assert!(parse::<f64>(&long).unwrap_err().to_string().contains("header of 4294967295 bytes"));
}

#[test]
fn objects_and_records_are_refused_by_name() {
    let objects = npy(&header("|O", "False", "(1,)"), b"\x80\x03cos\nsystem\n");
    assert!(parse::<f64>(&objects).unwrap_err().to_string().contains("pickled Python objects"));
    let record = "{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (1,)}";
    assert!(parse::<f64>(&npy(record, &[0; 8])).unwrap_err().to_string().contains("record"));
}

#[test]
fn files_round_trip() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("a.npy");
    let a = Array3::from_shape_fn((3, 5, 2), |(i, j, k)| (i * 100 + j * 10 + k) as f64 - 0.25);
    write_npy(&path, &a).unwrap();
    assert_eq!(read_f64(&path).unwrap(), a.clone().into_dyn());
    assert_eq!(read_npy::<f32>(&path).unwrap(), a.mapv(|x| x as f32).into_dyn());
    let header = npy_header(&path).unwrap();
    assert_eq!(header.dtype, NpyType::F64);
    assert_eq!((header.fortran, header.shape), (false, vec![3, 5, 2]));
    assert_eq!(header.data_offset % 64, 0);
    // A transposed view is written in logical order.
    write_npy(&path, &a.t()).unwrap();
    assert_eq!(read_f64(&path).unwrap(), a.t().into_dyn());
    write_npy(&path, &Array1::<i64>::zeros(0)).unwrap();
    assert_eq!(read_i64(&path).unwrap().shape(), &[0]);
    // Truncated.
    write_npy(&path, &a).unwrap();
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..bytes.len() - 1]).unwrap();
    let message = read_f64(&path).unwrap_err().to_string();
    assert!(message.contains("a.npy") && message.contains("[3, 5, 2]"), "{message}");
    assert!(npy_header(&path).is_err());
}

#[test]
fn archives_round_trip() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("a.npz");
    let a = Array2::from_shape_fn((300, 70), |(i, j)| (i as f32).sin() * j as f32);
    for deflate in [false, true] {
        let mut writer = NpzWriter::create(&path).unwrap();
        if deflate {
            writer = writer.deflate();
        }
        writer.add("a", &a).unwrap();
        writer.add("group/b:0", &array![1i64, -2]).unwrap();
        assert_eq!(path.exists(), deflate, "nothing may appear early");
        writer.finish().unwrap();
        let mut npz = Npz::open(&path).unwrap();
        assert_eq!(npz.names(), ["a", "group/b:0"]);
        assert!(npz.contains("a") && !npz.contains("c"));
        assert_eq!(npz.f32("a").unwrap(), a.clone().into_dyn());
        assert_eq!(npz.i64("group/b:0").unwrap(), array![1, -2].into_dyn());
        let message = npz.f64("c").unwrap_err().to_string();
        assert!(message.contains("`c`: missing array"), "{message}");
        let message = npz.expect_shape("a", &[300, 70], &[None, Some(3)]).unwrap_err().to_string();
        assert!(message.contains("shape [300, 70], expected [_, 3]"), "{message}");
    }
}

/// Writes archives where no file can have more than 128 KiB, in a process of its own.
#[test]
#[cfg(target_os = "linux")]
fn a_full_disk_is_an_error_and_prints_nothing() {
    use std::process::Command;
    const DIRECTORY: &str = "CAPE_TEST_FULL_DISK";
    if let Some(directory) = std::env::var_os(DIRECTORY) {
        let path = Path::new(&directory).join("full.npz");
        let large = Array1::from_shape_fn(200_000, |i| (i as f64).sin());
        let small = Array1::<f64>::zeros(8000);
        for deflate in [false, true] {
            let create = || {
                let writer = NpzWriter::create(&path).unwrap();
                if deflate { writer.deflate() } else { writer }
            };
            let mut writer = create();
            let error = writer.add("large", &large).unwrap_err();
            assert!(matches!(&error, Error::Io { path: at, .. } if *at == path), "{error}");
            drop(writer);
            // A failed write does not become a file later.
            let mut writer = create();
            assert!(writer.add("large", &large).is_err());
            let _ = writer.add("small", &small);
            assert!(writer.finish().is_err());
        }
        // Room ends somewhere about the directory of the archive.
        let mut ends = Vec::new();
        for count in (200..400).step_by(10) {
            for finish in [true, false] {
                let mut writer = NpzWriter::create(&path).unwrap();
                writer.add("a", &small).unwrap();
                writer.add("b", &small).unwrap();
                let added = writer.add("c", &Array1::from_elem(count, 1.0)).is_ok();
                if finish {
                    ends.push((added, writer.finish().is_ok()));
                }
            }
        }
        for end in [(true, true), (true, false)] {
            assert!(ends.contains(&end), "{ends:?}");
        }
        fs::remove_file(&path).unwrap();
        return;
    }
    let directory = tempfile::tempdir().unwrap();
    let limited = "trap '' XFSZ && ulimit -f 256 && exec \"$@\"";
    let output = Command::new("sh")
        .args(["-c", limited, "sh"])
        .arg(std::env::current_exe().unwrap())
        .args(["a_full_disk_is_an_error_and_prints_nothing", "--nocapture", "--test-threads", "1"])
        .env(DIRECTORY, directory.path())
        .output()
        .unwrap();
    assert_eq!(String::from_utf8_lossy(&output.stderr), "");
    let shown = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success() && shown.contains("1 passed"), "{shown}");
    assert_eq!(fs::read_dir(directory.path()).unwrap().count(), 0, "files are left");
}

#[test]
fn an_archive_with_an_impossible_claim_is_refused() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("a.npz");
    let mut writer = NpzWriter::create(&path).unwrap();
    writer.add("a", &array![1.0]).unwrap();
    writer.finish().unwrap();
    let mut bytes = fs::read(&path).unwrap();
    // The uncompressed size in the central directory.
    let at = bytes.windows(4).position(|w| w == b"PK\x01\x02").unwrap() + 24;
    bytes[at..at + 4].copy_from_slice(&0xf000_0000u32.to_le_bytes());
    fs::write(&path, bytes).unwrap();
    let message = Npz::open(&path).unwrap().f64("a").unwrap_err().to_string();
    assert!(message.contains("impossible"), "{message}");
}

#[test]
fn an_archive_that_would_fill_the_memory_is_refused() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("bomb.npz");
    let mut file = NpzWriter::create(&path).unwrap().deflate();
    file.add("zeros", &ndarray::Array1::<u8>::zeros(80 << 20)).unwrap();
    file.add("few", &ndarray::Array1::<u8>::zeros(1 << 20)).unwrap();
    file.finish().unwrap();
    assert!(std::fs::metadata(&path).unwrap().len() < 1 << 20);
    let mut archive = Npz::open(&path).unwrap();
    let message = archive.get::<u8>("zeros").unwrap_err().to_string();
    assert!(
        message.contains("`zeros`: rejected as a decompression bomb")
            && message.contains("bomb.npz"),
        "{message}"
    );
    assert_eq!(archive.get::<u8>("few").unwrap().len(), 1 << 20);
}

#[test]
fn a_changed_byte_is_noticed_by_the_checksum() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("a.npz");
    let mut writer = NpzWriter::create(&path).unwrap();
    writer.add("a", &array![1.0, 2.0]).unwrap();
    writer.finish().unwrap();
    let mut bytes = fs::read(&path).unwrap();
    let at = bytes.windows(8).position(|w| w == 2f64.to_le_bytes()).unwrap();
    bytes[at] ^= 1;
    fs::write(&path, bytes).unwrap();
    let message = Npz::open(&path).unwrap().f64("a").unwrap_err().to_string();
    assert!(message.contains("checksum"), "{message}");
}

proptest! {
    #[test]
    fn no_bytes_make_the_reader_panic(bytes: Vec<u8>, text in "[{}'(),:0-9a-zA-Z<|. ]{0,80}") {
        let _ = parse::<f64>(&bytes);
        let _ = parse::<i64>(&npy(&text, &bytes));
        let _ = parse::<i64>(&npy(&header("<f4", "True", &text), &bytes));
    }

    #[test]
    fn no_changed_archive_makes_the_reader_panic(at: prop::sample::Index, value: u8) {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.npz");
        let mut writer = NpzWriter::create(&path).unwrap().deflate();
        writer.add("a", &Array1::<f64>::zeros(9)).unwrap();
        writer.finish().unwrap();
        let mut bytes = fs::read(&path).unwrap();
        let at = at.index(bytes.len());
        bytes[at] = value;
        fs::write(&path, bytes).unwrap();
        if let Ok(mut npz) = Npz::open(&path) {
            for name in npz.names() {
                let _ = npz.f64(&name);
            }
        }
    }
}
