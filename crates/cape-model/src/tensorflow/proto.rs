//! Protocol buffer messages of the index of a checkpoint.

/// Largest number of axes of a tensor in TensorFlow.
const MAX_AXES: usize = 254;

/// `BundleHeaderProto`.
#[derive(Debug, PartialEq)]
pub(super) struct Header {
    pub(super) shards: usize,
    pub(super) big_endian: bool,
}

/// `BundleEntryProto`.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Entry {
    pub(super) element: u64,
    pub(super) shape: Vec<usize>,
    pub(super) shard: usize,
    pub(super) offset: u64,
    pub(super) size: u64,
    pub(super) crc: u32,
    pub(super) sliced: bool,
}

impl Header {
    pub(super) fn parse(message: &[u8]) -> Result<Self, String> {
        let mut header = Self { shards: 0, big_endian: false };
        for field in Fields(message) {
            match field? {
                (1, Field::Number(shards)) => header.shards = length(shards, "files")?,
                (2, Field::Number(order)) => header.big_endian = order != 0,
                _ => {}
            }
        }
        if header.shards == 0 || header.shards > 99_999 {
            return Err(format!("{} data files, expected 1 to 99999", header.shards));
        }
        Ok(header)
    }
}

impl Entry {
    pub(super) fn parse(message: &[u8]) -> Result<Self, String> {
        let mut entry = Self::default();
        for field in Fields(message) {
            match field? {
                (1, Field::Number(element)) => entry.element = element,
                (2, Field::Bytes(shape)) => entry.shape = parse_shape(shape)?,
                (3, Field::Number(shard)) => entry.shard = length(shard, "file")?,
                (4, Field::Number(offset)) => entry.offset = offset,
                (5, Field::Number(size)) => entry.size = size,
                (6, Field::Fixed(crc)) => entry.crc = crc,
                (7, _) => entry.sliced = true,
                _ => {}
            }
        }
        Ok(entry)
    }
}

/// `TensorShapeProto`.
fn parse_shape(message: &[u8]) -> Result<Vec<usize>, String> {
    let mut shape = Vec::new();
    for field in Fields(message) {
        match field? {
            (2, Field::Bytes(axis)) => {
                let mut extent = 0;
                for field in Fields(axis) {
                    if let (1, Field::Number(size)) = field? {
                        extent = length(size, "axis")?;
                    }
                }
                if shape.len() == MAX_AXES {
                    return Err(format!("more than {MAX_AXES} axes"));
                }
                shape.push(extent);
            }
            (3, Field::Number(unknown)) if unknown != 0 => {
                return Err("unknown number of axes".into());
            }
            _ => {}
        }
    }
    Ok(shape)
}

/// A length; an error if it is negative as a signed number.
fn length(value: u64, what: &str) -> Result<usize, String> {
    match i64::try_from(value) {
        Ok(value) => Ok(value as usize),
        Err(_) => Err(format!("{what}: {}, expected at least 0", value as i64)),
    }
}

enum Field<'a> {
    Number(u64),
    Fixed(u32),
    Bytes(&'a [u8]),
    /// A field of eight bytes; none is needed.
    Wide,
}

/// The fields of a message with their numbers.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn field(&mut self) -> Option<(u64, Field<'a>)> {
        let key = varint(&mut self.0)?;
        let field = match key & 7 {
            0 => Field::Number(varint(&mut self.0)?),
            1 => {
                self.0.split_off(..8)?;
                Field::Wide
            }
            2 => {
                let length = usize::try_from(varint(&mut self.0)?).ok()?;
                Field::Bytes(self.0.split_off(..length)?)
            }
            5 => Field::Fixed(u32::from_le_bytes(self.0.split_off(..4)?.try_into().ok()?)),
            _ => return None,
        };
        Some((key >> 3, field))
    }
}

impl<'a> Iterator for Fields<'a> {
    type Item = Result<(u64, Field<'a>), String>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.0.is_empty() {
            return None;
        }
        let field = self.field();
        if field.is_none() {
            self.0 = &[];
        }
        Some(field.ok_or_else(|| "malformed entry".into()))
    }
}

/// Reads a variable-length integer: seven bits per byte, lowest first. `bytes` is advanced past it.
pub(super) fn varint(bytes: &mut &[u8]) -> Option<u64> {
    let mut value = 0u64;
    for shift in (0..64).step_by(7) {
        let byte = *bytes.split_off_first()?;
        value |= u64::from(byte & 0x7f) << shift;
        if byte < 0x80 {
            return Some(value);
        }
    }
    None
}
