//! TensorFlow checkpoints as TensorFlow writes them, for tests.

use std::{fs, path::Path};

use cape::model::{tensorflow::masked_crc32c, weights::HostArray};

fn varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

fn field(out: &mut Vec<u8>, number: u8, bytes: &[u8]) {
    out.push(number << 3 | 2);
    varint(out, bytes.len() as u64);
    out.extend(bytes);
}

fn number(out: &mut Vec<u8>, number: u8, value: u64) {
    out.push(number << 3);
    varint(out, value);
}

/// Appends a block of sorted entries to the table; its place.
fn block(file: &mut Vec<u8>, entries: &[(Vec<u8>, Vec<u8>)]) -> Vec<u8> {
    let mut body = Vec::new();
    let mut restarts = Vec::new();
    let mut before: &[u8] = &[];
    for (index, (key, value)) in entries.iter().enumerate() {
        let mut shared = key.iter().zip(before).take_while(|(a, b)| a == b).count();
        if index.is_multiple_of(16) {
            restarts.push(body.len() as u32);
            shared = 0;
        }
        for length in [shared, key.len() - shared, value.len()] {
            varint(&mut body, length as u64);
        }
        body.extend(&key[shared..]);
        body.extend(value);
        before = key;
    }
    if restarts.is_empty() {
        restarts.push(0);
    }
    body.extend(restarts.iter().flat_map(|at| at.to_le_bytes()));
    body.extend((restarts.len() as u32).to_le_bytes());
    let mut place = Vec::new();
    varint(&mut place, file.len() as u64);
    varint(&mut place, body.len() as u64);
    body.push(0);
    file.extend(&body);
    file.extend(masked_crc32c(&body).to_le_bytes());
    place
}

/// Writes `model-<step>.index` and its data, and the `checkpoint` file.
pub(crate) fn write(directory: &Path, step: i64, variables: &[(String, HostArray)]) {
    let mut data: Vec<u8> = Vec::new();
    let mut entries = vec![(Vec::new(), {
        let mut header = Vec::new();
        number(&mut header, 1, 1);
        header
    })];
    let mut add = |name: &str, element: u64, shape: &[usize], bytes: &[u8]| {
        let mut axes = Vec::new();
        for &axis in shape {
            let mut extent = Vec::new();
            number(&mut extent, 1, axis as u64);
            field(&mut axes, 2, &extent);
        }
        let mut entry = Vec::new();
        number(&mut entry, 1, element);
        field(&mut entry, 2, &axes);
        number(&mut entry, 4, data.len() as u64);
        number(&mut entry, 5, bytes.len() as u64);
        entry.push(6 << 3 | 5);
        entry.extend(masked_crc32c(bytes).to_le_bytes());
        data.extend(bytes);
        entries.push((name.as_bytes().to_vec(), entry));
    };
    for (name, HostArray { shape, values }) in variables {
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        add(name, 1, shape, &bytes);
    }
    add("training/global_step", 9, &[], &step.to_le_bytes());
    entries.sort();
    let mut file = Vec::new();
    let mut index = Vec::new();
    for chunk in entries.chunks(20) {
        let place = block(&mut file, chunk);
        index.push((chunk[chunk.len() - 1].0.clone(), place));
    }
    let meta = block(&mut file, &[]);
    let index = block(&mut file, &index);
    let mut footer = [meta, index].concat();
    footer.resize(40, 0);
    file.extend(footer);
    file.extend(0xdb47_7524_8b80_fb57u64.to_le_bytes());
    fs::create_dir_all(directory).unwrap();
    let prefix = format!("model-{step}");
    fs::write(directory.join(format!("{prefix}.index")), file).unwrap();
    fs::write(directory.join(format!("{prefix}.data-00000-of-00001")), data).unwrap();
    let text = format!("model_checkpoint_path: \"/somewhere/else/{prefix}\"\n");
    fs::write(directory.join("checkpoint"), text).unwrap();
}
