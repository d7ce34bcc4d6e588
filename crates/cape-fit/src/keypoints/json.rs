//! JSON as detectors write it: with byte-order marks and with numbers that JSON does not have.

use std::path::Path;

use serde_json::Value;

use crate::{Error, Result};

/// Words of other notations that stand for no number; JSON does not have them.
const NO_NUMBERS: [&[u8]; 7] =
    [b"-Infinity", b"Infinity", b"-inf", b"inf", b"NaN", b"nan", b"None"];

/// Reads a JSON file; a byte-order mark is skipped, UTF-16 is converted, and NaN and infinities are
/// `null`.
pub(crate) fn read_json(path: &Path) -> Result<Value> {
    let bytes = std::fs::read(path).map_err(|source| Error::io(path, source))?;
    let text = decode(&bytes).ok_or_else(|| Error::format(path, "not JSON: not UTF-8 text"))?;
    let strict = serde_json::from_str(&text);
    let value = strict.or_else(|_| serde_json::from_slice(&without_nan(text.as_bytes())));
    value.map_err(|error| {
        let found = match text.trim_start().chars().next() {
            None => "the file is empty".to_owned(),
            Some('<') => "the file is a web page or XML".to_owned(),
            Some(_) => error.to_string(),
        };
        Error::format(path, format!("not JSON: {found}"))
    })
}

/// Text of UTF-8, or of UTF-16 with a byte-order mark.
fn decode(bytes: &[u8]) -> Option<String> {
    let wide = |rest: &[u8], unit: fn([u8; 2]) -> u16| {
        let units: Vec<u16> = rest.as_chunks::<2>().0.iter().map(|&pair| unit(pair)).collect();
        String::from_utf16(&units).ok()
    };
    match bytes {
        [0xff, 0xfe, rest @ ..] => wide(rest, u16::from_le_bytes),
        [0xfe, 0xff, rest @ ..] => wide(rest, u16::from_be_bytes),
        [0xef, 0xbb, 0xbf, rest @ ..] => String::from_utf8(rest.to_vec()).ok(),
        _ => String::from_utf8(bytes.to_vec()).ok(),
    }
}

/// The text with `null` in place of NaN and infinities outside of strings.
fn without_nan(text: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(text.len());
    let (mut at, mut inside) = (0, false);
    while at < text.len() {
        let rest = &text[at..];
        match rest[0] {
            b'\\' if inside && rest.len() > 1 => {
                out.extend_from_slice(&rest[..2]);
                at += 2;
                continue;
            }
            b'"' => inside = !inside,
            _ if !inside => {
                if let Some(word) = NO_NUMBERS.iter().find(|word| rest.starts_with(word)) {
                    out.extend_from_slice(b"null");
                    at += word.len();
                    continue;
                }
            }
            _ => {}
        }
        out.push(rest[0]);
        at += 1;
    }
    out
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn read(bytes: &[u8]) -> Result<Value> {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.json");
        std::fs::write(&path, bytes).unwrap();
        read_json(&path)
    }

    #[test]
    fn marks_and_numbers_that_are_none_are_read() {
        let text = r#"{"NaN \" inf": [NaN, -Infinity, 1, nan, Infinity]}"#;
        let expected = json!({"NaN \" inf": [null, null, 1, null, null]});
        assert_eq!(read(text.as_bytes()).unwrap(), expected);
        let marked = [b"\xef\xbb\xbf", text.as_bytes()].concat();
        assert_eq!(read(&marked).unwrap(), expected);
        let wide = |swap: bool| -> Vec<u8> {
            let units = std::iter::once(0xfeff).chain(text.encode_utf16());
            units.flat_map(|u| if swap { u.to_be_bytes() } else { u.to_le_bytes() }).collect()
        };
        assert_eq!(read(&wide(false)).unwrap(), expected);
        assert_eq!(read(&wide(true)).unwrap(), expected);
        for (text, reason) in [("", "empty"), ("<html>", "web page"), ("[1, x]", "line 1")] {
            let message = read(text.as_bytes()).unwrap_err().to_string();
            assert!(message.contains("not JSON") && message.contains(reason), "{message}");
        }
    }
}
