//! Recognition of files that a failed download or a missing conversion left in place of data.

use std::{fs::File, io::Read, path::Path};

/// Number of bytes that tell what a file is.
const START: u64 = 4096;

/// Description of the content of a file that is not data, with the remedy, from its first bytes
/// (4096 suffice) and its length: an empty file, zeros, a web page, a Git LFS pointer, or an
/// archive, picture or document, or text in UTF-16. `None` for anything else.
///
/// ```
/// use cape_core::unexpected_content;
///
/// let page = b"<!DOCTYPE html><html><body>Please log in</body></html>";
/// assert!(unexpected_content(page, 55).unwrap().contains("web page"));
/// assert_eq!(unexpected_content(b"\x93NUMPY", 6), None);
/// ```
pub fn unexpected_content(start: &[u8], length: u64) -> Option<&'static str> {
    if length == 0 {
        return Some("the file is empty: copy or download it again");
    }
    if length >= 16 && start.iter().all(|&byte| byte == 0) {
        return Some(
            "the file begins with zeros only: an interrupted copy or download, get it again",
        );
    }
    let text = start.strip_prefix(b"\xef\xbb\xbf").unwrap_or(start).trim_ascii_start();
    let begins = |with: &str| {
        text.get(..with.len()).is_some_and(|found| found.eq_ignore_ascii_case(with.as_bytes()))
    };
    if ["<!doctype", "<html", "<head", "<!--", "<?xml"].into_iter().any(begins) {
        return Some(
            "the file is a web page, as a server sends when the download needs a login or a \
             confirmation: download it in a browser after logging in",
        );
    }
    if begins("version https://git-lfs") {
        return Some(
            "the file is a Git LFS pointer, not the data: run `git lfs pull` in its repository",
        );
    }
    Some(match start {
        [0x1f, 0x8b, ..] => "the file is compressed with gzip: unpack it with gunzip",
        [b'B', b'Z', b'h', b'1'..=b'9', ..] => {
            "the file is compressed with bzip2: unpack it with bunzip2"
        }
        [0xfd, b'7', b'z', b'X', b'Z', ..] => "the file is compressed with xz: unpack it with unxz",
        [b'7', b'z', 0xbc, 0xaf, ..] => "the file is a 7z archive: unpack it",
        [b'R', b'a', b'r', b'!', ..] => "the file is a RAR archive: unpack it",
        [0x89, b'P', b'N', b'G', ..] | [0xff, 0xd8, 0xff, ..] => "the file is a picture",
        // A letter and a zero.
        [0xff, 0xfe, _, 0, ..] | [0xfe, 0xff, 0, _, ..] => {
            "the file is text in UTF-16, as PowerShell writes it: save it as UTF-8"
        }
        [b'%', b'P', b'D', b'F', ..] => "the file is a PDF document",
        _ => return None,
    })
}

/// [`unexpected_content`] of the file at `path`; `None` also if it cannot be read.
pub fn unexpected_file(path: impl AsRef<Path>) -> Option<&'static str> {
    let file = File::open(path).ok()?;
    let length = file.metadata().ok().filter(std::fs::Metadata::is_file)?.len();
    let mut start = Vec::new();
    file.take(START).read_to_end(&mut start).ok()?;
    unexpected_content(&start, length)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_data_is_named() {
        let said = |bytes: &[u8]| unexpected_content(bytes, bytes.len() as u64).unwrap_or_default();
        assert!(said(b"").contains("empty"));
        assert!(said(&[0; 64]).contains("zeros"));
        assert!(said(b"\xef\xbb\xbf\r\n<HTML lang=en>").contains("web page"));
        assert!(said(b"<!DOCTYPE HTML PUBLIC").contains("login"));
        assert!(said(b"version https://git-lfs.github.com/spec/v1\noid").contains("git lfs pull"));
        assert!(said(b"\xff\xfev\0 \x000\0").contains("UTF-16"));
        assert!(said(b"\xfe\xff\0v\0 \x000").contains("UTF-16"));
        assert!(said(b"\x1f\x8b\x08").contains("gunzip"));
        assert!(said(b"Rar!\x1a").contains("RAR"));
        for data in [&b"\x80\x02}q"[..], b"PK\x03\x04", b"(dp0\n", b"ply\n", b"v 0 0 0\n", &[0; 8]]
        {
            assert_eq!(said(data), "");
        }
    }
}
