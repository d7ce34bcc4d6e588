//! Frames that a packing reads, in their order.

use std::{borrow::Cow, collections::BTreeMap};

use cape_core::Outfit;
use ndarray::Array2;

use super::{
    FrameSource, RawTree, SequenceList, Split, SplitSpec,
    pack::{MissingCapture, PackOptions, PackReport},
};
use crate::{Error, Result};

/// First part of the sequence's name of a mirrored capture.
const MIRRORED: &str = "mirrored_";

/// A frame to be packed.
#[derive(Debug)]
pub(super) struct PlannedFrame<'a> {
    pub(super) source: &'a FrameSource,
    pub(super) subject: &'a str,
    /// Name of the sequence, with [`MIRRORED`] before that of a mirrored capture.
    pub(super) sequence: Cow<'a, str>,
    /// First part of the name of the capture's directory.
    pub(super) outfit: Outfit,
    /// Place of the 1 in the one-hot label.
    pub(super) class: usize,
    /// True for the captures that the split names for validation.
    pub(super) validation: bool,
    /// True for the mirror image of the frame.
    pub(super) mirrored: bool,
}

impl PlannedFrame<'_> {
    /// The mirror image of the frame.
    fn image(&self) -> Self {
        let sequence = format!("{MIRRORED}{}", self.sequence).into();
        Self { sequence, mirrored: true, ..*self }
    }
}

/// Minimal shape of each subject, metres, `[V, 3]`.
pub(super) type MinimalShapes = BTreeMap<String, Array2<f64>>;

/// Reads the minimal shapes of the split's subjects; missing ones are listed in the report.
pub(super) fn read_minimals(
    tree: &RawTree,
    split: &SplitSpec,
    options: PackOptions,
    report: &mut PackReport,
) -> Result<MinimalShapes> {
    let mut shapes = MinimalShapes::new();
    for subject in &split.subjects {
        let reason = if tree.subject_path(subject).is_some() {
            match tree.minimal(subject, options.follow_links) {
                Ok(shape) if report.vertices == 0 || report.vertices == shape.nrows() => {
                    report.vertices = shape.nrows();
                    shapes.insert(subject.clone(), shape);
                    continue;
                }
                Ok(shape) => {
                    let message = format!(
                        "{} vertices, but other subjects have {}",
                        shape.nrows(),
                        report.vertices
                    );
                    return Err(Error::format(tree.minimal_path(subject), message));
                }
                Err(error) => format!("no minimal shape: {error}"),
            }
        } else {
            format!("no directory sequences/{subject}, {subject} or archive {subject}.zip")
        };
        report.missing.push(MissingCapture { subject: subject.clone(), sequence: None, reason });
    }
    Ok(shapes)
}

/// Frames of a part; captures that are not there are added to `missing`.
pub(super) fn plan<'a>(
    tree: &'a RawTree,
    split: &'a SplitSpec,
    part: Split,
    minimal: &MinimalShapes,
    missing: &mut Vec<MissingCapture>,
) -> Result<Vec<PlannedFrame<'a>>> {
    let parts: &[(&SequenceList, bool)] = match part {
        Split::Train => &[(&split.train, false), (&split.validation, true)],
        Split::Test => &[(&split.test, false)],
    };
    let mut frames = Vec::new();
    for &(list, validation) in parts {
        let planned = plan_sequences(tree, split, (list, validation), minimal, missing)?;
        if split.mirror && part == Split::Train && !validation {
            let images: Vec<_> = planned.iter().map(PlannedFrame::image).collect();
            frames.extend(planned);
            frames.extend(images);
        } else {
            frames.extend(planned);
        }
    }
    Ok(frames)
}

/// Frames of a list of sequences, which may be for validation.
fn plan_sequences<'a>(
    tree: &'a RawTree,
    split: &'a SplitSpec,
    (list, validation): (&'a SequenceList, bool),
    minimal: &MinimalShapes,
    missing: &mut Vec<MissingCapture>,
) -> Result<Vec<PlannedFrame<'a>>> {
    let vocabulary = split.label_vocabulary()?;
    let mut frames = Vec::new();
    for subject in split.subjects.iter().filter(|&subject| minimal.contains_key(subject)) {
        for sequence in &list.sequences {
            let wanted: Vec<_> = split
                .outfits
                .iter()
                .filter(|&&outfit| !list.excludes(subject, outfit, sequence))
                .collect();
            let mut found = wanted.is_empty();
            let mut miss = |reason| {
                let (subject, sequence) = (subject.clone(), Some(sequence.clone()));
                missing.push(MissingCapture { subject, sequence, reason });
            };
            for &outfit in wanted {
                let Some(capture) = tree.capture(subject, outfit, sequence) else { continue };
                found = true;
                let count = capture.frames().len();
                let kept = count.saturating_sub(2 * split.cut);
                if kept == 0 {
                    miss(format!(
                        "{outfit}_{sequence} has {count} frames, none is left after cutting {} \
                         at either end",
                        split.cut
                    ));
                }
                let class = vocabulary.require(split.label(outfit))?;
                let sources = capture.frames().iter().skip(split.cut).take(kept);
                frames.extend(sources.step_by(split.sample_rate).map(|source| PlannedFrame {
                    source,
                    subject,
                    sequence: sequence.into(),
                    outfit,
                    class,
                    validation,
                    mirrored: false,
                }));
            }
            if !found {
                miss(format!("no sequence {sequence} in any outfit"));
            }
        }
    }
    Ok(frames)
}
