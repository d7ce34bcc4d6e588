//! Completeness of a copy of the CAPE release.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::{KNOWN_BROKEN, ListedSequence, RawTree, Result, Split, SplitSpec, split::SequenceList};

/// Subjects that the release's list of genders has and the data have not.
const PHANTOMS: [&str; 2] = ["03212", "03213"];

/// Frames of a preset in a raw data set, counted without reading them.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct PresetCompleteness {
    /// Name of the preset.
    pub preset: String,
    /// Training frames that are there and those of the complete public release.
    pub train: [usize; 2],
    /// Test frames, likewise.
    pub test: [usize; 2],
    /// Subjects of the preset without any capture.
    pub missing_subjects: Vec<String>,
    /// Captures of the preset that the release's lists name and that are not there,
    /// `subject/outfit_sequence`; unknown without the lists.
    pub missing_captures: Option<Vec<String>>,
}

/// Compares a raw data set with a preset.
pub(super) fn completeness(tree: &RawTree, preset: &str) -> Result<PresetCompleteness> {
    let split = SplitSpec::preset(preset)?;
    let expected = match preset {
        "male" => [31_036, 5_128],
        _ => [21_090, 5_441],
    };
    let count = |list: &SequenceList| -> usize {
        captures(&split, list)
            .filter_map(|(subject, outfit, sequence)| tree.capture(subject, outfit, sequence))
            .map(|capture| capture.frames().len().saturating_sub(2 * split.cut))
            .sum()
    };
    let missing_subjects = split.subjects.iter().filter(|name| tree.captures(name).is_empty());
    let mut listed = false;
    let mut missing = Vec::new();
    for subject in &split.subjects {
        let Some(list) = tree.sequence_list(subject)? else { continue };
        listed = true;
        for ListedSequence { capture: name, .. } in list {
            let wanted = [&split.train, &split.test].into_iter().any(|list| {
                captures(&split, list).any(|(known, outfit, sequence)| {
                    known == subject && format!("{outfit}_{sequence}") == name
                })
            });
            if wanted && !tree.captures(subject).iter().any(|capture| capture.name() == name) {
                missing.push(format!("{subject}/{name}"));
            }
        }
    }
    Ok(PresetCompleteness {
        preset: preset.to_owned(),
        train: [count(&split.train), expected[0]],
        test: [count(&split.test), expected[1]],
        missing_subjects: missing_subjects.cloned().collect(),
        missing_captures: listed.then_some(missing),
    })
}

/// Subjects, outfits and sequences that a list of a split selects.
fn captures<'a>(
    split: &'a SplitSpec,
    list: &'a SequenceList,
) -> impl Iterator<Item = (&'a str, cape_core::Outfit, &'a str)> {
    split.subjects.iter().flat_map(move |subject| {
        list.sequences.iter().flat_map(move |sequence| {
            let kept =
                move |outfit: &&cape_core::Outfit| !list.excludes(subject, **outfit, sequence);
            let outfits = split.outfits.iter().filter(kept);
            outfits.map(move |&outfit| (subject.as_str(), outfit, sequence.as_str()))
        })
    })
}

/// Facts from the release's lists, compared with the files.
pub(super) fn examine(tree: &RawTree) -> Result<Vec<String>> {
    let mut facts = Vec::new();
    let archives: Vec<&str> = tree
        .subjects()
        .filter(|subject| tree.subject_path(subject).is_some_and(std::path::Path::is_file))
        .collect();
    if !archives.is_empty() {
        facts.push(format!("read from archives without unpacking: {}", archives.join(" ")));
    }
    let genders = tree.genders()?;
    let mut by_gender: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for subject in tree.subjects() {
        if let Some(gender) = genders.get(subject) {
            by_gender.entry(gender).or_default().push(subject);
        }
    }
    for (gender, subjects) in by_gender {
        facts.push(format!("{gender}: {}", subjects.join(" ")));
    }
    let phantoms: Vec<&str> =
        PHANTOMS.into_iter().filter(|&subject| genders.contains_key(subject)).collect();
    if !phantoms.is_empty() {
        facts.push(format!(
            "subj_genders.pkl lists {}, of whom the release has no captures",
            phantoms.join(" and ")
        ));
    }
    let with_betas: Vec<&str> = tree
        .subjects()
        .filter(|subject| tree.parameters(subject).is_ok_and(|found| found.is_some()))
        .collect();
    if !with_betas.is_empty() {
        facts.push(format!("shape coefficients of {}", with_betas.join(" ")));
    }
    for subject in tree.subjects() {
        if let Err(error) = tree.parameters(subject) {
            facts.push(format!("shape coefficients of {subject} cannot be read: {error}"));
        }
        for capture in tree.captures(subject) {
            for name in capture.misnamed() {
                let known = known_broken(subject, name);
                facts.push(format!(
                    "{subject}/{}/{name}: not read, its name does not end with .npz{}",
                    capture.name(),
                    if known { " (a known broken frame)" } else { "" }
                ));
            }
            let broken = capture.frames().iter().filter_map(|frame| {
                let name = frame.relative().file_name()?.to_str()?;
                known_broken(subject, name).then_some(name)
            });
            for name in broken {
                facts.push(format!(
                    "{subject}/{}/{name}: known to be broken in the release; left out if it does \
                     not open",
                    capture.name()
                ));
            }
        }
        facts.extend(list_differences(tree, subject)?);
    }
    Ok(facts)
}

/// True for the file of a known broken frame of a subject.
fn known_broken(subject: &str, file: &str) -> bool {
    KNOWN_BROKEN.iter().any(|known| {
        known.split_once('/').is_some_and(|(of, frame)| of == subject && file.starts_with(frame))
    })
}

/// Differences between the list of a subject and its captures.
fn list_differences(tree: &RawTree, subject: &str) -> Result<Vec<String>> {
    let Some(list) = tree.sequence_list(subject)? else { return Ok(Vec::new()) };
    let mut facts = Vec::new();
    let mut missing = Vec::new();
    for ListedSequence { capture: name, frames, removed } in &list {
        let Some(capture) = tree.captures(subject).iter().find(|found| found.name() == name) else {
            missing.push(name.as_str());
            continue;
        };
        let found = capture.frames().len() + capture.misnamed().len();
        if found != *frames {
            let without: usize = removed.iter().map(|(a, b)| b.saturating_sub(*a) + 1).sum();
            let ranges = match without {
                0 => String::new(),
                count => format!(" ({count} more were removed)"),
            };
            facts.push(format!("{subject}/{name}: {found} frames, the list has {frames}{ranges}"));
        }
    }
    if !missing.is_empty() {
        facts.push(format!("{subject}: listed but missing: {}", missing.join(" ")));
    }
    let unlisted: Vec<&str> = tree
        .captures(subject)
        .iter()
        .map(crate::RawCapture::name)
        .filter(|name| !list.iter().any(|listed| listed.capture == *name))
        .collect();
    if !unlisted.is_empty() {
        facts.push(format!("{subject}: not in the list: {}", unlisted.join(" ")));
    }
    Ok(facts)
}

impl PresetCompleteness {
    /// Numbers of frames of a part: there, and in the complete release.
    pub fn frames(&self, part: Split) -> [usize; 2] {
        match part {
            Split::Train => self.train,
            Split::Test => self.test,
        }
    }
}
