//! Sorted table of the index of a checkpoint, in LevelDB's format.

use super::{mask, proto::varint};

/// The last eight bytes of a table.
const MAGIC: u64 = 0xdb47_7524_8b80_fb57;
/// Bytes of the footer: two block handles of at most 20 bytes each, and the magic number.
const FOOTER: usize = 48;
/// Bytes after each block: compression type and checksum.
const TRAILER: usize = 5;
/// Largest compression ratio of Snappy, whose copies expand three bytes to at most 64.
const MAX_SNAPPY_RATIO: usize = 24;

type Result<T, E = String> = std::result::Result<T, E>;

/// Keys and values, sorted by key.
pub(super) type Entries = Vec<(Vec<u8>, Vec<u8>)>;

/// Reads all entries of a table.
pub(super) fn read(file: &[u8]) -> Result<Entries> {
    let footer_at = file.len().checked_sub(FOOTER).ok_or("too short for a checkpoint's index")?;
    let (mut places, magic) = file[footer_at..].split_at(FOOTER - 8);
    if magic != MAGIC.to_le_bytes() {
        return Err("not the index of a TensorFlow checkpoint: wrong magic number".into());
    }
    let malformed = || "malformed footer".to_owned();
    let meta = Handle::read(&mut places).ok_or_else(malformed)?;
    let index = Handle::read(&mut places).ok_or_else(malformed)?;

    // The meta block is not needed, but a damaged one is an error as well.
    block(file, meta)?;

    let mut entries = Entries::new();
    // Limit on the memory of all entries: shared prefixes of keys are few and short.
    let mut allowance = file.len().saturating_mul(64).saturating_add(1 << 16);
    for (_, place) in block(file, index)?.entries(&mut allowance)? {
        let handle = Handle::read(&mut &place[..]).ok_or("malformed block handle")?;
        allowance = usize::try_from(handle.size)
            .ok()
            .and_then(|size| allowance.checked_sub(size))
            .ok_or("blocks larger than the file allows")?;
        entries.extend(block(file, handle)?.entries(&mut allowance)?);
    }
    if !entries.is_sorted_by(|(a, _), (b, _)| a < b) {
        return Err("names are not sorted".into());
    }
    Ok(entries)
}

/// Location of a block in the file, bytes.
#[derive(Clone, Copy)]
struct Handle {
    offset: u64,
    size: u64,
}

impl Handle {
    fn read(bytes: &mut &[u8]) -> Option<Self> {
        Some(Self { offset: varint(bytes)?, size: varint(bytes)? })
    }
}

struct Block(Vec<u8>);

/// The block at `handle`, its checksum verified, decompressed.
fn block(file: &[u8], Handle { offset, size }: Handle) -> Result<Block> {
    let found = (|| {
        let (start, size) = (usize::try_from(offset).ok()?, usize::try_from(size).ok()?);
        let end = start.checked_add(size)?.checked_add(TRAILER)?;
        Some((file.get(start..end)?, size))
    })();
    let (bytes, size) = found
        .ok_or_else(|| format!("block of {size} bytes at byte {offset} is outside the file"))?;
    let stored = u32::from_le_bytes([0, 1, 2, 3].map(|i| bytes[size + 1 + i]));
    if mask(crc32c::crc32c(&bytes[..=size])) != stored {
        return Err(format!("block at byte {offset} is damaged (checksum)"));
    }
    let contents = &bytes[..size];
    match bytes[size] {
        0 => Ok(Block(contents.to_vec())),
        1 => {
            let unreadable = |error| format!("block at byte {offset}: {error}");
            let length = snap::raw::decompress_len(contents).map_err(unreadable)?;
            if length > contents.len().saturating_mul(MAX_SNAPPY_RATIO) {
                return Err(format!(
                    "block at byte {offset} decompresses to {length} bytes, which is too large"
                ));
            }
            let block = snap::raw::Decoder::new().decompress_vec(contents).map_err(unreadable)?;
            Ok(Block(block))
        }
        other => Err(format!("block at byte {offset} has unknown compression type {other}")),
    }
}

impl Block {
    fn entries(&self, allowance: &mut usize) -> Result<Entries> {
        let malformed = || "malformed block".to_owned();
        let (body, count) = self.0.split_last_chunk::<4>().ok_or_else(malformed)?;
        let restarts = u32::from_le_bytes(*count) as usize;
        let end = restarts.checked_mul(4).and_then(|bytes| body.len().checked_sub(bytes));
        let mut rest = body.get(..end.ok_or_else(malformed)?).ok_or_else(malformed)?;
        let mut entries = Entries::new();
        while !rest.is_empty() {
            let key: &[u8] = entries.last().map_or(&[], |(key, _)| key);
            let (key, value) = entry(key, &mut rest).ok_or_else(malformed)?;
            *allowance = allowance
                .checked_sub(key.len() + value.len() + 64)
                .ok_or("entries larger than the file allows")?;
            entries.push((key, value));
        }
        Ok(entries)
    }
}

/// Reads an entry: length of the prefix shared with the previous key, rest of the key, value.
fn entry(before: &[u8], rest: &mut &[u8]) -> Option<(Vec<u8>, Vec<u8>)> {
    let mut length = || usize::try_from(varint(rest)?).ok();
    let (shared, own, value) = (length()?, length()?, length()?);
    let mut key = before.get(..shared)?.to_vec();
    key.extend(rest.split_off(..own)?);
    Some((key, rest.split_off(..value)?.to_vec()))
}
