//! Byte strings that Python 3 wrote as text.

/// Bytes of a text that is checked before it is decoded, so that both find it in the cache.
const BLOCK: usize = 1 << 12;

/// Bytes whose values are the characters of a UTF-8 text; `None` if one is above U+00FF, or the text is
/// not valid.
///
/// Arrays are such texts of millions of characters, of which any may take one byte or two: there are no
/// branches on them. A character from U+0080 is its low six bits after `0xC2` or `0xC3`, whose last bit is
/// the next one.
pub(super) fn latin1(text: &[u8]) -> Option<Vec<u8>> {
    let mut bytes = vec![0; text.len()];
    let (mut before, mut count) = (0, 0);
    for block in text.chunks(BLOCK) {
        let starts = block.first().is_none_or(|&byte| follows(before, byte));
        let pairs = block.iter().zip(block.iter().skip(1));
        if !pairs.fold(starts, |all, (&before, &byte)| all & follows(before, byte)) {
            return None;
        }
        for &byte in block {
            bytes[count] = byte | u8::from(before == 0xc3) << 6;
            count += usize::from(byte < 0xc0);
            before = byte;
        }
    }
    bytes.truncate(count);
    (before < 0xc0).then_some(bytes)
}

/// True if one byte may come after another.
fn follows(before: u8, byte: u8) -> bool {
    let leads = |byte: u8| byte & 0xfe == 0xc2;
    let continues = byte & 0xc0 == 0x80;
    (continues == leads(before)) & ((byte < 0xc0) | leads(byte))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The same by the standard library.
    fn expected(text: &[u8]) -> Option<Vec<u8>> {
        std::str::from_utf8(text).ok()?.chars().map(|c| u8::try_from(c).ok()).collect()
    }

    #[test]
    fn all_short_texts_are_those_of_the_standard_library() {
        let edges =
            [0, b'a', 0x7f, 0x80, 0x9f, 0xbf, 0xc0, 0xc1, 0xc2, 0xc3, 0xc4, 0xdf, 0xe2, 0xf0, 0xff];
        assert_eq!(latin1(b""), Some(Vec::new()));
        for a in edges {
            assert_eq!(latin1(&[a]), expected(&[a]));
            for b in edges {
                assert_eq!(latin1(&[a, b]), expected(&[a, b]));
                for c in edges {
                    for d in edges {
                        let text = [a, b, c, d];
                        assert_eq!(latin1(&text), expected(&text), "{text:x?}");
                    }
                }
            }
        }
    }

    #[test]
    fn long_texts_are_decoded_over_the_ends_of_blocks() {
        let bytes: Vec<u8> = (0..3 * BLOCK).map(|at| (at * at / 7) as u8).collect();
        for shift in 0..2 {
            let mut text: String = "a".repeat(shift);
            text.extend(bytes.iter().map(|&byte| char::from(byte)));
            assert_eq!(latin1(text.as_bytes()), expected(text.as_bytes()));
            assert_eq!(latin1(&[text.as_bytes(), "\u{100}".as_bytes()].concat()), None);
        }
    }
}
