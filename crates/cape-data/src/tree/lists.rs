//! Lists of the release: sequences with their valid frames, genders, broken frames.

use std::{collections::BTreeMap, fs, path::Path};

use cape_core::pickle::Pickle;

use crate::{Error, Result};

/// Lines of a sequence list before the first sequence.
const HEADER_LINES: usize = 3;

/// Frames of the public release that are known to be broken, `<subject>/<outfit>_<sequence>.<number>`.
pub const KNOWN_BROKEN: [&str; 7] = [
    "00032/shortlong_pose_model.000047",
    "03394/longlong_ROM_lower.000100",
    "00215/poloshort_basketball.000061",
    "00096/shirtshort_chicken_wings.000108",
    "00122/shortshort_punching.000147",
    "02474/longlong_ROM_lower.000354",
    "02474/longlong_rotate_hips.000245",
];

/// Sequence in a list of the release.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ListedSequence {
    /// Name of the capture, `<outfit>_<sequence>`.
    pub capture: String,
    /// Number of valid frames.
    pub frames: usize,
    /// First and last frames of the ranges that were removed.
    pub removed: Vec<(usize, usize)>,
}

/// Reads a `seq_list_<subject>.txt`: three lines of header, then name, number of valid frames and
/// removed ranges (`12-15,40-44`), separated by tabs.
pub(super) fn sequences(path: &Path) -> Result<Vec<ListedSequence>> {
    let text = fs::read_to_string(path).map_err(|source| Error::io(path, source))?;
    let mut found = Vec::new();
    for (index, line) in text.lines().enumerate().skip(HEADER_LINES) {
        let fields: Vec<&str> = line.split('\t').map(str::trim).filter(|f| !f.is_empty()).collect();
        let fields = match fields[..] {
            // Edited by hand, with spaces.
            [one] => one.split_whitespace().collect(),
            _ => fields,
        };
        let Some((name, rest)) = fields.split_first() else { continue };
        let error = |message: String| Error::field(path, format!("line {}", index + 1), message);
        let frames = rest.first().and_then(|count| count.parse().ok()).ok_or_else(|| {
            error(format!("`{line}`: expected name, number of valid frames and removed ranges"))
        })?;
        let mut removed = Vec::new();
        for range in rest.iter().skip(1).flat_map(|ranges| ranges.split(',')) {
            let range = range.trim();
            if range.is_empty() || matches!(range, "-" | "None" | "none") {
                continue;
            }
            let ends = range.split_once('-').unwrap_or((range, range));
            match (ends.0.trim().parse(), ends.1.trim().parse()) {
                (Ok(first), Ok(last)) => removed.push((first, last)),
                _ => return Err(error(format!("`{range}`: expected a range such as 12-15"))),
            }
        }
        found.push(ListedSequence { capture: (*name).to_owned(), frames, removed });
    }
    Ok(found)
}

/// Reads `subj_genders.pkl`: a dictionary of genders by subject, or of subjects by gender.
pub(super) fn genders(path: &Path) -> Result<BTreeMap<String, String>> {
    let pickle = Pickle::open(path)?;
    let root = pickle.root();
    let mut found = BTreeMap::new();
    for key in root.keys() {
        let value = root.require(&key)?;
        match value.elements() {
            Some(subjects) => {
                for subject in subjects {
                    found.insert(subject.text()?.into_owned(), key.to_lowercase());
                }
            }
            None => {
                found.insert(key, value.text()?.to_lowercase());
            }
        }
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_have_counts_and_removed_ranges() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("seq_list_1.txt");
        let read = |text: &str| {
            fs::write(&path, text).unwrap();
            sequences(&path)
        };
        let head = "subject 1\n\nname\tframes\tremoved\n";
        let list = read(&format!(
            "{head}longlong_hips\t120\t\nshortlong_walk\t88\t3-5,7-9\n\nshortshort_x\t9\t4\n"
        ));
        let listed = |capture: &str, frames, removed: &[(usize, usize)]| ListedSequence {
            capture: capture.into(),
            frames,
            removed: removed.to_vec(),
        };
        assert_eq!(
            list.unwrap(),
            [
                listed("longlong_hips", 120, &[]),
                listed("shortlong_walk", 88, &[(3, 5), (7, 9)]),
                listed("shortshort_x", 9, &[(4, 4)]),
            ]
        );
        for bad in ["longlong_hips\tmany\n", "longlong_hips\n", "longlong_hips\t9\tx-y\n"] {
            let error = read(&format!("{head}{bad}")).unwrap_err().to_string();
            assert!(error.contains("seq_list_1.txt") && error.contains("line 4"), "{error}");
        }
    }
}
