//! Lines and numbers of mesh files in text form.

use std::str::FromStr;

/// `bytes` without a byte-order mark.
pub(crate) fn without_mark(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes)
}

/// Byte that ends the lines of a text: the line feed, or, in files without one, the carriage return
/// of old Macintosh programs.
pub(crate) fn line_end(text: &[u8]) -> u8 {
    if text.contains(&b'\n') || !text.contains(&b'\r') { b'\n' } else { b'\r' }
}

/// Words of a line up to a comment, which begins with `#`.
pub(crate) fn words(line: &str) -> impl Iterator<Item = &str> {
    line.split_whitespace().take_while(|word| !word.starts_with('#'))
}

/// A number; NaN and infinity also as Microsoft's C library prints them: `-nan(ind)`, `1.#QNAN`,
/// `-1.#IND`, `1.#INF`.
pub(crate) fn number<T: FromStr + From<f32>>(word: &str) -> Result<T, String> {
    if let Ok(number) = word.parse() {
        return Ok(number);
    }
    let unsigned = word.trim_start_matches(['+', '-']).to_ascii_lowercase();
    let begins = |names: &[&str]| names.iter().any(|name| unsigned.starts_with(name));
    if begins(&["nan(", "1.#qnan", "1.#snan", "1.#ind"]) {
        return Ok(f32::NAN.into());
    }
    if begins(&["1.#inf"]) {
        return Ok(if word.starts_with('-') { f32::NEG_INFINITY } else { f32::INFINITY }.into());
    }
    let point = word.replacen(',', ".", 1);
    if word.contains(',') && point.parse::<f64>().is_ok() {
        return Err(format!(
            "`{word}` is not a number: it has a decimal comma, expected a decimal point (`{point}`)"
        ));
    }
    Err(format!("`{word}` is not a number"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_every_runtime_are_read() {
        for nan in
            ["nan", "NaN", "-nan", "-nan(ind)", "nan(snan)", "1.#QNAN", "-1.#IND", "-1.#IND00"]
        {
            assert!(number::<f32>(nan).unwrap().is_nan(), "{nan}");
        }
        assert_eq!(number::<f64>("-1.#INF").unwrap(), f64::NEG_INFINITY);
        assert_eq!(number::<f64>("+1.5e-2").unwrap(), 0.015);
        assert!(number::<f32>("0,1").unwrap_err().contains("decimal comma"));
        assert_eq!(number::<f32>("a,b").unwrap_err(), "`a,b` is not a number");
    }
}
