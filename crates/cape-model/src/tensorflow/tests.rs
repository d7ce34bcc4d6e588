use proptest::prelude::*;

use super::{proto::varint, *};

/// A checkpoint of one variable `a` of four floats and `step`, written by hand.
fn write(directory: &Path, compressed: bool) -> (Vec<u8>, Vec<u8>) {
    let data: Vec<u8> = [1.0f32, -2.5, 3.0, 4.25]
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .chain(7i64.to_le_bytes())
        .collect();
    let entry = |element: u8, axes: &[u8], offset: u8, size: u8, crc: u32| {
        let shape: Vec<u8> = axes.iter().flat_map(|&axis| [0x12, 2, 8, axis]).collect();
        let mut entry = vec![8, element, 0x12, shape.len() as u8];
        entry.extend(shape);
        entry.extend([0x20, offset, 0x28, size, 0x35]);
        entry.extend(crc.to_le_bytes());
        entry
    };
    let entries = [
        (&b""[..], vec![8, 1, 0x1a, 2, 8, 1]),
        (b"a", entry(1, &[2, 2], 0, 16, masked_crc32c(&data[..16]))),
        (b"a/step", entry(9, &[], 16, 8, masked_crc32c(&data[16..]))),
    ];
    let mut file = Vec::new();
    let mut append = |entries: &[(&[u8], Vec<u8>)], compressed: bool| {
        let mut block = Vec::new();
        let mut before: &[u8] = b"";
        for (key, value) in entries {
            let shared = key.iter().zip(before).take_while(|(a, b)| a == b).count();
            block.extend([shared as u8, (key.len() - shared) as u8, value.len() as u8]);
            block.extend(&key[shared..]);
            block.extend(value);
            before = key;
        }
        block.extend([0, 0, 0, 0, 1, 0, 0, 0]);
        if compressed {
            block = snap::raw::Encoder::new().compress_vec(&block).unwrap();
        }
        let place = vec![file.len() as u8, block.len() as u8];
        block.push(compressed.into());
        let crc = masked_crc32c(&block);
        file.extend(&block);
        file.extend(crc.to_le_bytes());
        place
    };
    let place = append(&entries, compressed);
    let meta = append(&[], false);
    let index = append(&[(b"b", place)], false);
    let mut footer = [meta, index].concat();
    footer.resize(40, 0);
    file.extend(footer);
    file.extend(0xdb47_7524_8b80_fb57u64.to_le_bytes());
    fs::write(directory.join("model-7.index"), &file).unwrap();
    fs::write(directory.join("model-7.data-00000-of-00001"), &data).unwrap();
    (file, data)
}

#[test]
fn variables_are_read_by_every_name_of_the_checkpoint() {
    let directory = tempfile::tempdir().unwrap();
    for compressed in [false, true] {
        write(directory.path(), compressed);
        for name in ["", "model-7", "model-7.index", "model-7.data-00000-of-00001"] {
            let checkpoint = TensorFlowCheckpoint::open(directory.path().join(name)).unwrap();
            let names: Vec<_> = checkpoint.variables().iter().map(|v| v.name.as_str()).collect();
            assert_eq!(names, ["a", "a/step"]);
            let a = checkpoint.variable("a").unwrap();
            let expected = HostArray { shape: vec![2, 2], values: vec![1.0, -2.5, 3.0, 4.25] };
            assert_eq!(checkpoint.floats(a).unwrap(), expected);
            let step = checkpoint.variable("a/step").unwrap();
            assert_eq!(checkpoint.integers(step).unwrap(), [7]);
            let message = checkpoint.floats(step).unwrap_err().to_string();
            assert!(message.contains("`a/step`: holds I64, expected floats"), "{message}");
        }
    }
}

#[test]
fn of_several_checkpoints_the_latest_is_opened() {
    let directory = tempfile::tempdir().unwrap();
    let (index, data) = write(directory.path(), false);
    fs::write(directory.path().join("model-9.index"), index).unwrap();
    fs::write(directory.path().join("model-9.data-00000-of-00001"), data).unwrap();
    let message = TensorFlowCheckpoint::open(directory.path()).unwrap_err().to_string();
    assert!(message.contains("model-7, model-9"), "{message}");
    let text = "model_checkpoint_path: \"/home/somebody/else/model-9\"\n";
    fs::write(directory.path().join("checkpoint"), text).unwrap();
    let checkpoint = TensorFlowCheckpoint::open(directory.path()).unwrap();
    assert_eq!(checkpoint.prefix().file_name().unwrap(), "model-9");
    let empty = tempfile::tempdir().unwrap();
    assert!(
        TensorFlowCheckpoint::open(empty.path()).unwrap_err().to_string().contains("no `.index`")
    );
    assert!(TensorFlowCheckpoint::open(empty.path().join("model")).is_err());
}

#[test]
fn every_changed_byte_is_noticed() {
    let directory = tempfile::tempdir().unwrap();
    let (index, data) = write(directory.path(), true);
    let read_all = || -> Result<()> {
        let checkpoint = TensorFlowCheckpoint::open(directory.path())?;
        for variable in checkpoint.variables() {
            if variable.element.is_float() {
                drop(checkpoint.floats(variable)?);
            } else {
                drop(checkpoint.integers(variable)?);
            }
        }
        Ok(())
    };
    read_all().unwrap();
    let path = directory.path().join("model-7.index");
    for at in 0..index.len() {
        let mut changed = index.clone();
        changed[at] ^= 0x10;
        fs::write(&path, changed).unwrap();
        // Changes of the footer's padding have no effect.
        let padding = (index.len() - 44..index.len() - 8).contains(&at);
        assert!(read_all().is_err() || padding, "byte {at}");
    }
    fs::write(&path, index).unwrap();
    let path = directory.path().join("model-7.data-00000-of-00001");
    for at in 0..data.len() {
        let mut changed = data.clone();
        changed[at] ^= 0x10;
        fs::write(&path, changed).unwrap();
        assert!(read_all().unwrap_err().to_string().contains("damaged"), "byte {at}");
    }
    fs::write(&path, &data[..20]).unwrap();
    let message = read_all().unwrap_err().to_string();
    assert!(message.contains("bytes 16 to 24"), "{message}");
    fs::remove_file(&path).unwrap();
    assert!(read_all().unwrap_err().to_string().contains("data-00000-of-00001"));
}

#[test]
fn numbers_of_seven_bits_a_byte() {
    let read = |mut bytes: &[u8]| varint(&mut bytes);
    assert_eq!(read(&[0]), Some(0));
    assert_eq!(read(&[0xac, 0x02]), Some(300));
    assert_eq!(read(&[0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 1]), Some(u64::MAX));
    assert_eq!(read(&[0x80]), None);
    assert_eq!(read(&[0x80; 11]), None);
}

proptest! {
    #[test]
    fn no_bytes_make_the_reader_panic(bytes: Vec<u8>) {
        let _ = (table::read(&bytes), Header::parse(&bytes), Entry::parse(&bytes));
        let mut file = bytes;
        file.resize(file.len().max(40), 0);
        file.extend(0xdb47_7524_8b80_fb57u64.to_le_bytes());
        let _ = table::read(&file);
    }

    /// Blocks with matching checksums, so that the parser behind the check is reached.
    #[test]
    fn no_block_makes_the_reader_panic(body: Vec<u8>, kind in 0u8..2) {
        let mut file = body;
        let length = file.len() as u8;
        file.truncate(length.into());
        file.push(kind);
        let crc = masked_crc32c(&file);
        file.extend(crc.to_le_bytes());
        let mut footer = vec![0, length, 0, length];
        footer.resize(40, 0);
        file.extend(footer);
        file.extend(0xdb47_7524_8b80_fb57u64.to_le_bytes());
        let _ = table::read(&file);
    }
}
