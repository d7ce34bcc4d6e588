//! Writer of TensorBoard event files with scalars, histograms and images that does not need
//! TensorFlow.
//!
//! An event file is a sequence of records (length, masked CRC-32C of the length, payload, masked
//! CRC-32C of the payload), each payload a protobuf `Event`. Only the fields in use are encoded:
//! `wall_time = 1` (double), `step = 2` (varint), `file_version = 3` (string),
//! `summary = 5 { value = 1 { tag = 1 (string), … } }` with one of `simple_value = 2` (float),
//! `image = 4 { height = 1, width = 2, colorspace = 3 (varints), encoded_image_string = 4 }` and
//! `histo = 5 { min = 1, max = 2, num = 3, sum = 4, sum_squares = 5 (doubles), bucket_limit = 6,
//! bucket = 7 (packed doubles) }`.

use std::{
    fs::{self, File, OpenOptions},
    io::{self, BufWriter, Write},
    path::{Path, PathBuf},
    time::{SystemTime, UNIX_EPOCH},
};

use cape_model::tensorflow::masked_crc32c;

use crate::{Error, Result};

/// Writer of one event file. A resumed run creates another file in the same directory, as
/// TensorBoard expects; TensorBoard shows the later of two values at the same step.
///
/// ```
/// use cape_train::tensorboard::EventWriter;
///
/// let directory = tempfile::tempdir()?;
/// let mut events = EventWriter::create(directory.path())?;
/// for step in 0..10 {
///     events.scalar("loss", step, 1.0 / (1.0 + step as f32))?;
/// }
/// events.histogram("codes", 10, &[0.1, -0.3, 0.2])?;
/// events.flush()?;
/// assert!(std::fs::metadata(events.path())?.len() > 0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct EventWriter {
    path: PathBuf,
    file: BufWriter<File>,
}

impl EventWriter {
    /// Creates a new event file in `directory`, and the directory if it does not exist.
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

    /// Path of the event file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Adds a scalar under `tag`.
    pub fn scalar(&mut self, tag: &str, step: u64, value: f32) -> Result<()> {
        self.value(tag, step, |entry| {
            put_key(entry, 2, WIRE_FIXED32);
            entry.extend(value.to_le_bytes());
        })
    }

    /// Adds an image: the contents of a PNG file of `size` = `[width, height]` pixels.
    pub fn image(&mut self, tag: &str, step: u64, size: [u32; 2], png: &[u8]) -> Result<()> {
        const RGBA: u64 = 4;
        let [width, height] = size.map(u64::from);
        let mut image = Vec::new();
        for (field, number) in [(1, height), (2, width), (3, RGBA)] {
            put_key(&mut image, field, WIRE_VARINT);
            put_varint(&mut image, number);
        }
        put_bytes(&mut image, 4, png);
        self.value(tag, step, |entry| put_bytes(entry, 4, &image))
    }

    /// Adds a histogram of `values` with equal bins from the smallest to the largest value. Nothing
    /// is added if `values` is empty or a value is not finite.
    pub fn histogram(&mut self, tag: &str, step: u64, values: &[f32]) -> Result<()> {
        let Some((limits, counts)) = bins(values) else { return Ok(()) };
        let (mut sum, mut squares) = (0.0, 0.0);
        for value in values.iter().map(|&value| f64::from(value)) {
            sum += value;
            squares += value * value;
        }
        let least = values.iter().copied().fold(f32::INFINITY, f32::min);
        let most = values.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let mut histogram = Vec::new();
        for (field, number) in [
            (1, f64::from(least)),
            (2, f64::from(most)),
            (3, values.len() as f64),
            (4, sum),
            (5, squares),
        ] {
            put_key(&mut histogram, field, WIRE_FIXED64);
            histogram.extend(number.to_le_bytes());
        }
        for (field, list) in [(6, limits), (7, counts)] {
            let packed: Vec<u8> = list.iter().flat_map(|number| number.to_le_bytes()).collect();
            put_bytes(&mut histogram, field, &packed);
        }
        self.value(tag, step, |entry| put_bytes(entry, 5, &histogram))
    }

    fn value(&mut self, tag: &str, step: u64, put: impl FnOnce(&mut Vec<u8>)) -> Result<()> {
        let mut entry = Vec::new();
        put_bytes(&mut entry, 1, tag.as_bytes());
        put(&mut entry);
        let mut summary = Vec::new();
        put_bytes(&mut summary, 1, &entry);
        let mut event = event_at(wall_time());
        put_key(&mut event, 2, WIRE_VARINT);
        put_varint(&mut event, step);
        put_bytes(&mut event, 5, &summary);
        self.record(&event)
    }

    /// Flushes all events to the file.
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

const BINS: usize = 64;

/// Upper limits and counts of equal bins; `None` if `values` is empty or a value is not finite.
fn bins(values: &[f32]) -> Option<(Vec<f64>, Vec<f64>)> {
    if values.is_empty() || !values.iter().all(|value| value.is_finite()) {
        return None;
    }
    let least = f64::from(values.iter().copied().fold(f32::INFINITY, f32::min));
    let most = f64::from(values.iter().copied().fold(f32::NEG_INFINITY, f32::max));
    let width = ((most - least) / BINS as f64).max(f64::from(f32::MIN_POSITIVE));
    let mut counts = vec![0.0; BINS];
    for &value in values {
        let bin = (f64::from(value) - least) / width;
        counts[(bin as usize).min(BINS - 1)] += 1.0;
    }
    Some(((1..=BINS).map(|bin| least + width * bin as f64).collect(), counts))
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
        /// Numbers of an image or histogram.
        numbers: Vec<f64>,
        bytes: Vec<u8>,
    }

    /// CRC-32C bit by bit, independent of the crate used for writing.
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
                    let number = varint(&mut message);
                    if inside == "event" {
                        event.step = number;
                    } else {
                        event.numbers.push(number as f64);
                    }
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
                ("value", 4) => parse(body, event, "image"),
                ("image", 4) => event.bytes = body.to_vec(),
                ("value", 5) => parse(body, event, "histogram"),
                ("histogram", 6 | 7) => event.bytes.extend(body),
                ("histogram", 1..=5) => {
                    event.numbers.push(f64::from_le_bytes(body.try_into().unwrap()));
                }
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
    fn pictures_and_histograms_are_read_back() {
        let dir = tempfile::tempdir().unwrap();
        let mut writer = EventWriter::create(dir.path()).unwrap();
        writer.image("view", 7, [3, 2], b"png").unwrap();
        writer.histogram("weights", 7, &[1.0, -1.0, 3.0, 3.0]).unwrap();
        writer.histogram("same", 8, &[2.0; 5]).unwrap();
        writer.histogram("none", 8, &[]).unwrap();
        writer.histogram("broken", 8, &[f32::NAN]).unwrap();
        writer.flush().unwrap();
        let events = read(writer.path());
        let [_, image, weights, same] = events.as_slice() else { panic!("{events:?}") };
        assert_eq!((image.tag.as_str(), image.step), ("view", 7));
        assert_eq!(
            (image.numbers.as_slice(), &image.bytes[..]),
            (&[2.0, 3.0, 4.0][..], &b"png"[..])
        );
        assert_eq!(weights.numbers, [-1.0, 3.0, 4.0, 6.0, 20.0]);
        let doubles = |bytes: &[u8]| -> Vec<f64> {
            bytes.chunks(8).map(|x| f64::from_le_bytes(x.try_into().unwrap())).collect()
        };
        let numbers = doubles(&weights.bytes);
        let (limits, counts) = numbers.split_at(BINS);
        assert_eq!(counts.iter().sum::<f64>(), 4.0);
        assert_eq!((counts[0], counts[BINS / 2], counts[BINS - 1]), (1.0, 1.0, 2.0));
        assert!((limits[BINS - 1] - 3.0).abs() < 1e-12 && limits[0] > -1.0);
        assert_eq!(doubles(&same.bytes)[BINS..].iter().sum::<f64>(), 5.0);
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
