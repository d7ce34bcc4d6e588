//! Scalar curves for TensorBoard: event files written without TensorFlow.
//!
//! An event file is a sequence of records (length, masked CRC-32C of the length, payload, masked
//! CRC-32C of the payload), each payload a protobuf `Event`. Only what scalars need is encoded:
//! `wall_time = 1` (double), `step = 2` (varint), `file_version = 3` (string),
//! `summary = 5 { value = 1 { tag = 1 (string), simple_value = 2 (float) } }`.

use std::{
    fs::{self, File, OpenOptions},
    io::{self, BufWriter, Write},
    path::{Path, PathBuf},
    time::{SystemTime, UNIX_EPOCH},
};

use cape_model::tensorflow::masked_crc32c;

use crate::{Error, Result};

/// Writes one event file. A resumed run creates another in the same directory, as TensorBoard
/// expects; of two values at the same step, it shows the later.
#[derive(Debug)]
pub struct EventWriter {
    path: PathBuf,
    file: BufWriter<File>,
}

impl EventWriter {
    /// Creates a new event file in `directory`, which is created if need be.
    pub fn create(directory: impl AsRef<Path>) -> Result<Self> {
        let directory = directory.as_ref();
        fs::create_dir_all(directory).map_err(|e| Error::io(directory, e))?;
        let time = wall_time();
        // TensorBoard reads files in the order of their names: seconds first, then a counter for
        // runs resumed within a second.
        let mut counter = 0;
        let (path, file) = loop {
            let name = format!("events.out.tfevents.{:010}.{counter:04}.cape", time as u64);
            let path = directory.join(name);
            match OpenOptions::new().write(true).create_new(true).open(&path) {
                Ok(file) => break (path, file),
                Err(e) if e.kind() == io::ErrorKind::AlreadyExists => counter += 1,
                Err(e) => return Err(Error::io(path, e)),
            }
        };
        let mut writer = Self { path, file: BufWriter::new(file) };
        let mut event = event_at(time);
        put_bytes(&mut event, 3, b"brain.Event:2");
        writer.record(&event)?;
        writer.flush()?;
        Ok(writer)
    }

    /// The file being written.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Adds one point to the curve called `tag`.
    pub fn scalar(&mut self, tag: &str, step: u64, value: f32) -> Result<()> {
        let mut entry = Vec::new();
        put_bytes(&mut entry, 1, tag.as_bytes());
        put_key(&mut entry, 2, WIRE_FIXED32);
        entry.extend(value.to_le_bytes());
        let mut summary = Vec::new();
        put_bytes(&mut summary, 1, &entry);
        let mut event = event_at(wall_time());
        put_key(&mut event, 2, WIRE_VARINT);
        put_varint(&mut event, step);
        put_bytes(&mut event, 5, &summary);
        self.record(&event)
    }

    /// Makes everything written so far visible to readers.
    pub fn flush(&mut self) -> Result<()> {
        self.file.flush().map_err(|e| Error::io(&self.path, e))
    }

    fn record(&mut self, payload: &[u8]) -> Result<()> {
        let length = (payload.len() as u64).to_le_bytes();
        let mut record = Vec::with_capacity(payload.len() + 16);
        record.extend(length);
        record.extend(masked_crc32c(&length).to_le_bytes());
        record.extend(payload);
        record.extend(masked_crc32c(payload).to_le_bytes());
        self.file.write_all(&record).map_err(|e| Error::io(&self.path, e))
    }
}

const WIRE_VARINT: u64 = 0;
const WIRE_FIXED64: u64 = 1;
const WIRE_BYTES: u64 = 2;
const WIRE_FIXED32: u64 = 5;

fn wall_time() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |time| time.as_secs_f64())
}

fn event_at(time: f64) -> Vec<u8> {
    let mut event = Vec::new();
    put_key(&mut event, 1, WIRE_FIXED64);
    event.extend(time.to_le_bytes());
    event
}

fn put_varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

fn put_key(out: &mut Vec<u8>, field: u64, wire: u64) {
    put_varint(out, field << 3 | wire);
}

fn put_bytes(out: &mut Vec<u8>, field: u64, bytes: &[u8]) {
    put_key(out, field, WIRE_BYTES);
    put_varint(out, bytes.len() as u64);
    out.extend(bytes);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, Default, PartialEq)]
    struct Event {
        version: String,
        step: u64,
        tag: String,
        value: f32,
    }

    /// Bit by bit, independent of the crate used for writing.
    fn crc_by_definition(bytes: &[u8]) -> u32 {
        let mut crc = !0u32;
        for &byte in bytes {
            crc ^= u32::from(byte);
            for _ in 0..8 {
                crc = if crc & 1 == 1 { crc >> 1 ^ 0x82f6_3b78 } else { crc >> 1 };
            }
        }
        !crc
    }

    fn take<'a>(bytes: &mut &'a [u8], n: usize) -> &'a [u8] {
        let (head, tail) = bytes.split_at(n);
        *bytes = tail;
        head
    }

    fn varint(bytes: &mut &[u8]) -> u64 {
        let mut value = 0;
        for shift in 0.. {
            let byte = take(bytes, 1)[0];
            value |= u64::from(byte & 0x7f) << (7 * shift);
            if byte < 0x80 {
                break;
            }
        }
        value
    }

    fn parse(mut message: &[u8], event: &mut Event, inside: &str) {
        while !message.is_empty() {
            let key = varint(&mut message);
            let body = match key & 7 {
                0 => {
                    event.step = varint(&mut message);
                    continue;
                }
                1 => take(&mut message, 8),
                5 => take(&mut message, 4),
                2 => {
                    let n = varint(&mut message) as usize;
                    take(&mut message, n)
                }
                wire => panic!("wire type {wire}"),
            };
            match (inside, key >> 3) {
                ("event", 1) => assert!(f64::from_le_bytes(body.try_into().unwrap()) > 1.6e9),
                ("event", 3) => event.version = String::from_utf8(body.to_vec()).unwrap(),
                ("event", 5) => parse(body, event, "summary"),
                ("summary", 1) => parse(body, event, "value"),
                ("value", 1) => event.tag = String::from_utf8(body.to_vec()).unwrap(),
                ("value", 2) => event.value = f32::from_le_bytes(body.try_into().unwrap()),
                other => panic!("{other:?}"),
            }
        }
    }

    fn read(path: &Path) -> Vec<Event> {
        let bytes = fs::read(path).unwrap();
        let mut rest = bytes.as_slice();
        let mut events = Vec::new();
        let masked = |bytes: &[u8]| {
            let crc = crc_by_definition(bytes);
            crc.rotate_right(15).wrapping_add(0xa282_ead8).to_le_bytes()
        };
        while !rest.is_empty() {
            let length = take(&mut rest, 8);
            assert_eq!(take(&mut rest, 4), masked(length));
            let n = u64::from_le_bytes(length.try_into().unwrap()) as usize;
            let payload = take(&mut rest, n);
            assert_eq!(take(&mut rest, 4), masked(payload));
            let mut event = Event::default();
            parse(payload, &mut event, "event");
            events.push(event);
        }
        events
    }

    #[test]
    fn event_files_are_read_back() {
        assert_eq!(crc_by_definition(b"123456789"), 0xe306_9283);
        let dir = tempfile::tempdir().unwrap();
        let mut writer = EventWriter::create(dir.path().join("a/b")).unwrap();
        writer.scalar("loss/recon", 3, 0.25).unwrap();
        writer.scalar("lr", 70_000, 8e-3).unwrap();
        writer.flush().unwrap();
        let scalar =
            |tag: &str, step, value| Event { tag: tag.into(), step, value, ..Event::default() };
        let version = Event { version: "brain.Event:2".into(), ..Event::default() };
        let expected = [version, scalar("loss/recon", 3, 0.25), scalar("lr", 70_000, 8e-3)];
        assert_eq!(read(writer.path()), expected);
    }

    #[test]
    fn a_resumed_run_gets_a_later_file() {
        let dir = tempfile::tempdir().unwrap();
        let first = EventWriter::create(dir.path()).unwrap();
        let second = EventWriter::create(dir.path()).unwrap();
        assert!(first.path() < second.path());
        assert!(first.path().to_str().unwrap().contains("tfevents"));
    }

    #[test]
    fn an_unwritable_place_is_an_error() {
        let file = tempfile::NamedTempFile::new().unwrap();
        assert!(EventWriter::create(file.path().join("runs")).is_err());
    }
}
