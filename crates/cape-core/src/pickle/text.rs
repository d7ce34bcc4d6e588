//! Escape sequences of the text protocol.

/// Decodes a Python 2 string literal with its quotes, e.g. `'a\x00b'`.
pub(super) fn string_literal(line: &[u8]) -> Result<Box<[u8]>, String> {
    let line = line.trim_ascii();
    let ([b'\'', quoted @ .., b'\''] | [b'"', quoted @ .., b'"']) = line else {
        return Err("string literal without quotes".into());
    };
    let mut out = Vec::with_capacity(quoted.len());
    let mut rest = quoted;
    while let [first, after @ ..] = rest {
        rest = after;
        if *first != b'\\' {
            out.push(*first);
            continue;
        }
        let [code, after @ ..] = rest else {
            return Err("string literal that ends in `\\`".into());
        };
        rest = after;
        match code {
            b'\n' => {}
            b'n' => out.push(b'\n'),
            b'r' => out.push(b'\r'),
            b't' => out.push(b'\t'),
            b'a' => out.push(7),
            b'b' => out.push(8),
            b'f' => out.push(12),
            b'v' => out.push(11),
            b'\\' | b'\'' | b'"' => out.push(*code),
            b'x' => {
                let (value, used) = number(rest, 2, 16);
                if used != 2 {
                    return Err("malformed `\\x` in a string literal".into());
                }
                out.push(value as u8);
                rest = &rest[used..];
            }
            b'0'..=b'7' => {
                let digits = [&[*code], &rest[..rest.len().min(2)]].concat();
                let (value, used) = number(&digits, 3, 8);
                out.push(value as u8);
                rest = &rest[used - 1..];
            }
            _ => out.extend([b'\\', *code]),
        }
    }
    Ok(out.into())
}

/// Decodes `raw-unicode-escape`: Latin-1 with `\u` and `\U`.
pub(super) fn raw_unicode(line: &[u8]) -> Result<Box<[u8]>, String> {
    let mut out = String::with_capacity(line.len());
    let mut rest = line;
    while let [first, after @ ..] = rest {
        rest = after;
        let digits = match (first, rest.first()) {
            (b'\\', Some(b'u')) => 4,
            (b'\\', Some(b'U')) => 8,
            _ => {
                out.push(char::from(*first));
                continue;
            }
        };
        let (value, used) = number(&rest[1..], digits, 16);
        let decoded = char::from_u32(value).filter(|_| used == digits);
        out.push(decoded.ok_or("malformed `\\u` in a Unicode string")?);
        rest = &rest[1 + used..];
    }
    Ok(out.into_bytes().into())
}

/// Value of the first at most `digits` digits, and their count.
fn number(bytes: &[u8], digits: usize, radix: u32) -> (u32, usize) {
    let values = bytes.iter().take(digits).map_while(|&byte| char::from(byte).to_digit(radix));
    values.fold((0, 0), |(value, used), digit| (value * radix + digit, used + 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn escapes_agree_with_python() {
        let literal = br"'a\n\\\'\x00\xff\101\7z\q'";
        assert_eq!(*string_literal(literal).unwrap(), *b"a\n\\'\x00\xffA\x07z\\q");
        assert_eq!(*string_literal(b"\"it's\"\r").unwrap(), *b"it's");
        assert_eq!(*raw_unicode(b"\xe9\\u20ac\\U0001F600\\n").unwrap(), *"é€😀\\n".as_bytes());
        for bad in [&b"'"[..], b"a", b"'\\'", b"'\\x1'", b"'a\""] {
            assert!(string_literal(bad).is_err());
        }
        for bad in [&b"\\u12"[..], b"\\ud800", b"\\U00110000"] {
            assert!(raw_unicode(bad).is_err());
        }
    }
}
