//! Byte strings that Python 3 wrote as text.
//!
//! Arrays are such texts of millions of characters, of which any may take one byte or two: characters from
//! U+0080 are their low six bits after `0xC2` or `0xC3`, whose last bit is the next one. There are no branches
//! on single characters.

use rayon::prelude::*;

/// Bytes of a text that a thread decodes.
const PIECE: usize = 1 << 20;
/// The highest bits of eight bytes.
const HIGH: u64 = 0x8080_8080_8080_8080;

/// Bytes whose values are the characters of a UTF-8 text; `None` if one is above U+00FF, or the text is
/// not valid.
pub(super) fn latin1(text: &[u8]) -> Option<Vec<u8>> {
    let pieces = pieces(text);
    let lengths: Option<Vec<usize>> = pieces.par_iter().map(|piece| characters(piece)).collect();
    let lengths = lengths?;
    let mut bytes = vec![0; lengths.iter().sum()];
    let mut rest = &mut bytes[..];
    let mut places = Vec::with_capacity(pieces.len());
    for length in lengths {
        let (place, after) = rest.split_at_mut(length);
        places.push(place);
        rest = after;
    }
    pieces.into_par_iter().zip(places).for_each(|(piece, place)| decode(piece, place));
    Some(bytes)
}

/// Pieces of a text, none of which begins within a character.
fn pieces(mut text: &[u8]) -> Vec<&[u8]> {
    let mut pieces = Vec::with_capacity(text.len() / PIECE + 1);
    while !text.is_empty() {
        let mut end = text.len().min(PIECE);
        if text.get(end).is_some_and(|&byte| continues(byte)) {
            end += 1;
        }
        let (piece, rest) = text.split_at(end);
        pieces.push(piece);
        text = rest;
    }
    pieces
}

/// Number of characters; `None` if one is above U+00FF, or the text is not valid.
fn characters(text: &[u8]) -> Option<usize> {
    let (Some(&first), Some(&last)) = (text.first(), text.last()) else { return Some(0) };
    let valid =
        |before: u8, byte: u8| (continues(byte) == leads(before)) & ((byte < 0xc0) | leads(byte));
    let pairs = text.iter().zip(text.iter().skip(1));
    let all = pairs.fold(valid(0, first), |all, (&before, &byte)| all & valid(before, byte));
    // As many as one byte can count.
    let blocks = text.chunks(u8::MAX.into());
    let count = |block: &[u8]| block.iter().fold(0u8, |sum, &byte| sum + u8::from(!leads(byte)));
    (all && !leads(last)).then(|| blocks.map(|block| usize::from(count(block))).sum())
}

/// True for the first byte of a character of two.
fn leads(byte: u8) -> bool {
    byte & 0xfe == 0xc2
}

/// True for the second byte of a character of two.
fn continues(byte: u8) -> bool {
    byte & 0xc0 == 0x80
}

/// Decodes a valid text of as many characters as `bytes`.
fn decode(text: &[u8], bytes: &mut [u8]) {
    let (mut before, mut count) = (0, 0);
    let (words, _) = text.as_chunks::<8>();
    let mut done = 0;
    for word in words {
        let Some(place) = bytes.get_mut(count..).and_then(<[u8]>::first_chunk_mut::<8>) else {
            break;
        };
        done += 8;
        if u64::from_ne_bytes(*word) & HIGH == 0 {
            *place = *word;
            (before, count) = (0, count + 8);
            continue;
        }
        let mut of_word = 0;
        for &byte in word {
            // A first byte is overwritten by what follows.
            place[of_word & 7] = byte | u8::from(before == 0xc3) << 6;
            of_word += usize::from(!leads(byte));
            before = byte;
        }
        count += of_word;
    }
    for &byte in &text[done..] {
        if let Some(place) = bytes.get_mut(count) {
            *place = byte | u8::from(before == 0xc3) << 6;
        }
        count += usize::from(!leads(byte));
        before = byte;
    }
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
    fn long_texts_are_decoded_over_the_ends_of_pieces() {
        let bytes: Vec<u8> = (0..2 * PIECE).map(|at| (at * at / 7) as u8).collect();
        for shift in 0..3 {
            let mut text: String = "a".repeat(shift);
            text.extend(bytes.iter().map(|&byte| char::from(byte)));
            assert_eq!(latin1(text.as_bytes()), expected(text.as_bytes()));
            assert_eq!(latin1(&[text.as_bytes(), "\u{100}".as_bytes()].concat()), None);
        }
    }
}
