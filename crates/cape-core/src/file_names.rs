//! Order of the files of a sequence.

use std::{
    cmp::Ordering,
    fs,
    path::{Path, PathBuf},
};

use crate::{Error, Result};

/// Natural order of file names: runs of digits compare as numbers, so that `frame2` comes before
/// `frame10`; everything else compares as text. Names that differ only in leading zeros are ordered
/// as text.
///
/// ```
/// use cape_core::natural_order;
///
/// let mut names = ["frame10.obj", "frame2.obj", "frame1.obj"];
/// names.sort_by(|a, b| natural_order(a, b));
/// assert_eq!(names, ["frame1.obj", "frame2.obj", "frame10.obj"]);
/// ```
pub fn natural_order(a: &str, b: &str) -> Ordering {
    let (mut left, mut right) = (a, b);
    loop {
        let (Some(x), Some(y)) = (left.chars().next(), right.chars().next()) else {
            return left.len().cmp(&right.len()).then_with(|| a.cmp(b));
        };
        let order = if x.is_ascii_digit() && y.is_ascii_digit() {
            let (p, q) = (digits(&mut left), digits(&mut right));
            p.len().cmp(&q.len()).then_with(|| p.cmp(q))
        } else {
            (left, right) = (&left[x.len_utf8()..], &right[y.len_utf8()..]);
            x.cmp(&y)
        };
        if order != Ordering::Equal {
            return order;
        }
    }
}

/// Takes the digits at the start of `text`, and returns them without leading zeros.
fn digits<'a>(text: &mut &'a str) -> &'a str {
    let end = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
    let (number, rest) = text.split_at(end);
    *text = rest;
    number.trim_start_matches('0')
}

/// Files in `directory` that `keep` accepts, in [`natural_order`] of their names. Hidden files, whose
/// names begin with a dot, are left out: file managers and archivers create them.
///
/// # Errors
/// If the directory cannot be read.
pub fn list_files(
    directory: impl AsRef<Path>,
    keep: impl Fn(&Path) -> bool,
) -> Result<Vec<PathBuf>> {
    let directory = directory.as_ref();
    let fail = |source| Error::io(directory, source);
    let mut named = Vec::new();
    for entry in fs::read_dir(directory).map_err(fail)? {
        let path = entry.map_err(fail)?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if !name.starts_with('.') && keep(&path) {
            named.push((name, path));
        }
    }
    named.sort_by(|(a, p), (b, q)| natural_order(a, b).then_with(|| p.cmp(q)));
    Ok(named.into_iter().map(|(_, path)| path).collect())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn digits_compare_as_numbers() {
        let mut names =
            ["f10.ply", "f9.ply", "f1.ply", "f01.ply", "g.ply", "f1b2.ply", "f1b10.ply", "f.ply"];
        names.sort_by(|a, b| natural_order(a, b));
        let expected =
            ["f.ply", "f01.ply", "f1.ply", "f1b2.ply", "f1b10.ply", "f9.ply", "f10.ply", "g.ply"];
        assert_eq!(names, expected);
        // Longer than any integer type.
        let long = ["1".repeat(60), "9".repeat(59)];
        assert_eq!(natural_order(&long[0], &long[1]), Ordering::Greater);
    }

    #[test]
    fn hidden_files_are_left_out() {
        let directory = tempfile::tempdir().unwrap();
        for name in ["b10.obj", "b9.obj", "._b9.obj", ".hidden.obj", "notes.txt"] {
            fs::write(directory.path().join(name), "").unwrap();
        }
        let found =
            list_files(directory.path(), |path| path.extension().is_some_and(|e| e == "obj"));
        let names: Vec<_> =
            found.unwrap().into_iter().map(|p| p.file_name().unwrap().to_owned()).collect();
        assert_eq!(names, ["b9.obj", "b10.obj"]);
        assert!(list_files(directory.path().join("none"), |_| true).is_err());
    }

    proptest! {
        #[test]
        fn the_order_is_total(names in prop::array::uniform3("[a0-2]{0,5}")) {
            let [a, b, c] = &names;
            prop_assert_eq!(natural_order(a, b), natural_order(b, a).reverse());
            prop_assert_eq!(natural_order(a, b) == Ordering::Equal, a == b);
            if natural_order(a, b).is_le() && natural_order(b, c).is_le() {
                prop_assert!(natural_order(a, c).is_le());
            }
        }
    }
}
