//! From the raw layout to the packed one.
//!
//! ```text
//! train/train_disp.npy       [n, V, 3]  displacements (v_cano − minimal), metres, float64
//! train/train_pose.npy       [n, 72]    axis-angle
//! train/train_rot.npy        [n, 216]   24 rotation matrices, row-major
//! train/train_clo_label.npy  [n, 4]     outfit, one-hot
//! train/train_frames.csv     which frame each row is
//! test/test_…                the same
//! stats.txt                  how many frames of what
//! broken_frames.txt          frames left out because they cannot be read, and why
//! stats.npz, split.toml      normalisation; the split that was packed
//! body.npz, clothing_verts_idx.npy   copied, if the raw data bring them
//! ```
//!
//! Rows are ordered by subject, sequence, outfit and frame name. The `.csv`, `.npz` and `.toml`
//! files are additions to the release's layout.

use std::{
    collections::BTreeMap,
    fmt::Write as _,
    fs,
    path::{Path, PathBuf},
};

use cape_core::{Outfit, joints::pose_rotations};
use ndarray::Array2;
use rayon::prelude::*;
use serde::Serialize;

use super::{
    Split, SplitSpec,
    pack_log::{FrameStatus, PackLog, plan_hash},
    raw::{self, BODY_FILE, CLOTHING_FILE, SPLIT_FILE},
    split_writer::SplitWriter,
    statistics::STATISTICS_FILE,
};
use crate::{Error, Result};
use cape_core::ProgressFn;
use cape_core::StagingDirectory;

/// How to pack.
///
/// ```
/// use cape_core::Outfit;
/// use cape_core::silent;
/// use cape_data::{PackOptions, SequenceList, SplitSpec, pack, raw};
/// use ndarray::Array2;
///
/// let directory = tempfile::tempdir()?;
/// let [raw, packed] = ["raw", "packed"].map(|name| directory.path().join(name));
/// raw::write_minimal(&raw, "anna", &Array2::zeros((3, 3)))?;
/// for number in 0..4 {
///     let v_cano = Array2::from_elem((3, 3), 0.01);
///     let v_posed = v_cano.clone();
///     let frame = raw::RawFrame { v_cano, v_posed, pose: [0.0; 72], transl: [0.0; 3] };
///     raw::write_frame(&raw, "anna", Outfit::LongLong, "walk", number, &frame)?;
/// }
/// let capture = raw::capture_dir(&raw, "anna", Outfit::LongLong, "walk");
/// std::fs::write(capture.join("longlong_walk.000002.npz"), "damaged")?;
///
/// let list = |names: &[&str]| SequenceList {
///     sequences: names.iter().map(ToString::to_string).collect(),
///     exclude: Vec::new(),
/// };
/// let split = SplitSpec {
///     subjects: vec!["anna".into()],
///     outfits: vec![Outfit::LongLong],
///     cut: 0,
///     sample_rate: 1,
///     train: list(&["walk", "run"]),
///     test: list(&[]),
/// };
/// let strict = PackOptions { strict: true, ..PackOptions::default() };
/// assert!(pack(&raw, &packed, &split, strict, &mut silent).is_err());
///
/// let report = pack(&raw, &packed, &split, PackOptions::default(), &mut silent)?;
/// assert_eq!((report.vertices, report.train_frames, report.test_frames), (3, 3, 0));
/// assert!(report.broken[0].path.ends_with("longlong_walk.000002.npz"));
/// assert_eq!(report.missing[0].sequence.as_deref(), Some("run"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct PackOptions {
    /// Whether anything missing or unreadable is an error instead of being listed.
    pub strict: bool,
    /// Whether links may bring in files from outside of the raw tree.
    pub follow_links: bool,
}

/// What was packed, and what was not.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct PackReport {
    /// Vertices of a frame.
    pub vertices: usize,
    /// Training frames, validation included.
    pub train_frames: usize,
    /// Of these, the last ones that validate.
    pub validation_frames: usize,
    /// Test frames.
    pub test_frames: usize,
    /// Frames that could not be read, in packing order.
    pub broken: Vec<BrokenFrame>,
    /// Subjects and sequences of the split that the raw data do not have.
    pub missing: Vec<MissingCapture>,
    /// Frames that an interrupted packing of the same data had dealt with before.
    pub resumed: usize,
}

/// A frame left out because it cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct BrokenFrame {
    /// Relative to `sequences/`.
    pub path: PathBuf,
    /// What is wrong with it.
    pub reason: String,
}

/// Something the split names and the raw data do not have.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct MissingCapture {
    /// The subject.
    pub subject: String,
    /// The sequence; `None` if the whole subject is missing.
    pub sequence: Option<String>,
    /// What is missing.
    pub reason: String,
}

/// Packs the frames that `split` selects of the raw tree `raw` into the directory `out`, which
/// appears only when it is complete.
///
/// A packing that was interrupted goes on where it was, if it is of the same data.
///
/// Frames are read in parallel, a few at a time; nothing larger than a few frames (and the at most
/// 100 latest training frames, which may turn out to be validation) is held in memory. Unreadable
/// frames, missing subjects and missing sequences are listed in the report; they are an error if
/// nothing is left, or with [`PackOptions::strict`].
pub fn pack(
    raw: &Path,
    out: &Path,
    split: &SplitSpec,
    options: PackOptions,
    progress: &mut ProgressFn,
) -> Result<PackReport> {
    split.validate()?;
    let mut report = PackReport::default();
    let minimal = read_minimals(raw, split, options, &mut report)?;
    let mut plans = Vec::new();
    for part in [Split::Train, Split::Test] {
        plans.push((part, plan(raw, split, part, &minimal, &mut report.missing)?));
    }
    if let (true, Some(missing)) = (options.strict, report.missing.first()) {
        return Err(Error::Data(format!("{}: {}", missing.subject, missing.reason)));
    }
    let frames = || plans.iter().flat_map(|(_, frames)| frames);
    let total = frames().count();
    let plan = plan_hash(raw, split, options, minimal.values(), frames())?;

    let mut staging = StagingDirectory::prepare(out)?;
    let mut done = PackLog::read(&staging.path, &plan);
    done.truncate(total);
    let inside = (!options.follow_links).then_some(raw);
    // What could not be read then may be readable now.
    let healed = frames().zip(&done).position(|(frame, fate)| {
        *fate != FrameStatus::Packed && read(frame, inside, &minimal).is_ok()
    });
    done.truncate(healed.unwrap_or(total));
    if !is_whole(&staging.path, &plans, &done, report.vertices) {
        done.clear();
    }
    if done.is_empty() {
        staging.clear()?;
    }
    report.resumed = done.len();
    let mut journal = PackLog::start(&staging.path, &plan, &done)?;
    // From here on an error leaves what was packed for the next attempt.
    staging.keep = true;
    let mut text = String::new();
    let mut before = 0;
    for (part, frames) in &plans {
        let fates = &done[before.min(done.len())..(before + frames.len()).min(done.len())];
        let mut writer = resume(&staging.path, *part, raw, frames, fates, &mut report)?;
        let left = &frames[fates.len()..];
        let mut count = before + fates.len();
        for chunk in left.chunks(4 * rayon::current_num_threads()) {
            progress(count, total);
            let read: Vec<_> =
                chunk.par_iter().map(|frame| read(frame, inside, &minimal)).collect();
            for (frame, read) in chunk.iter().zip(read) {
                match read {
                    Ok(read) => {
                        if writer.is_none() {
                            writer =
                                Some(SplitWriter::create(&staging.path, *part, report.vertices)?);
                        }
                        if let Some(writer) = &mut writer {
                            writer.push(frame, &read)?;
                        }
                        journal.note(&FrameStatus::Packed);
                    }
                    Err(error) if options.strict => {
                        staging.keep = false;
                        return Err(error);
                    }
                    Err(error) => {
                        let broken = broken(raw, frame, &error);
                        journal.note(&FrameStatus::Broken(broken.reason.clone()));
                        report.broken.push(broken);
                    }
                }
            }
            if let Some(writer) = &mut writer {
                writer.flush()?;
            }
            journal.commit()?;
            count += chunk.len();
            progress(count, total);
        }
        before += frames.len();
        let Some(writer) = writer else { continue };
        describe(&mut text, *part, &writer.captures);
        match part {
            Split::Train => {
                report.train_frames = writer.rows();
                let statistics = writer.finish()?;
                report.validation_frames = statistics.validation();
                statistics.save(staging.path.join(STATISTICS_FILE))?;
            }
            Split::Test => {
                report.test_frames = writer.rows();
                writer.finish()?;
            }
        }
    }
    if report.train_frames + report.test_frames == 0 {
        staging.keep = false;
        return Err(no_frames_error(raw, &report));
    }
    write_notes(raw, &staging.path, split, options, &report, &text)?;
    journal.finish()?;
    staging.commit(out)?;
    Ok(report)
}

/// Whether the files hold every frame that the journal says is packed: after a loss of power they
/// may not.
fn is_whole(
    directory: &Path,
    plans: &[(Split, Vec<PlannedFrame>)],
    done: &[FrameStatus],
    vertices: usize,
) -> bool {
    let mut left = done;
    plans.iter().all(|(part, frames)| {
        let (own, rest) = left.split_at(frames.len().min(left.len()));
        left = rest;
        let rows = own.iter().filter(|fate| **fate == FrameStatus::Packed).count();
        rows == 0 || SplitWriter::holds(directory, *part, vertices, rows)
    })
}

/// The writer of a part whose first frames are packed already, if any of them was.
fn resume(
    directory: &Path,
    part: Split,
    raw: &Path,
    frames: &[PlannedFrame],
    fates: &[FrameStatus],
    report: &mut PackReport,
) -> Result<Option<SplitWriter>> {
    let mut packed = Vec::new();
    for (frame, fate) in frames.iter().zip(fates) {
        match fate {
            FrameStatus::Packed => packed.push(frame),
            FrameStatus::Broken(reason) => report.broken.push(BrokenFrame {
                path: relative(raw, frame).to_owned(),
                reason: reason.clone(),
            }),
        }
    }
    if packed.is_empty() {
        return Ok(None);
    }
    SplitWriter::resume(directory, part, report.vertices, &packed).map(Some)
}

fn relative<'a>(raw: &Path, frame: &'a PlannedFrame) -> &'a Path {
    frame.path.strip_prefix(raw.join("sequences")).unwrap_or(&frame.path)
}

/// One frame to be packed.
#[derive(Debug)]
pub(super) struct PlannedFrame<'a> {
    pub(super) path: PathBuf,
    pub(super) subject: &'a str,
    pub(super) sequence: &'a str,
    pub(super) outfit: Outfit,
}

/// One row of every packed array.
pub(super) struct PackedFrame {
    pub(super) displacement: Array2<f64>,
    pub(super) pose: [f64; 72],
    pub(super) rotations: Vec<f64>,
}

type MinimalShapes = BTreeMap<String, Array2<f64>>;

fn read_minimals(
    raw: &Path,
    split: &SplitSpec,
    options: PackOptions,
    report: &mut PackReport,
) -> Result<MinimalShapes> {
    let mut shapes = MinimalShapes::new();
    for subject in &split.subjects {
        let reason = if raw.join("sequences").join(subject).is_dir() {
            let read = || {
                let path = raw::minimal_path(raw, subject);
                if !options.follow_links && path.exists() {
                    raw::require_inside(raw, &path)?;
                }
                raw::read_minimal(raw, subject)
            };
            match read() {
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
                    return Err(Error::format(raw::minimal_path(raw, subject), message));
                }
                Err(error) => format!("no minimal shape: {error}"),
            }
        } else {
            format!("no directory sequences/{subject}")
        };
        report.missing.push(MissingCapture { subject: subject.clone(), sequence: None, reason });
    }
    Ok(shapes)
}

fn plan<'a>(
    raw: &Path,
    split: &'a SplitSpec,
    part: Split,
    minimal: &MinimalShapes,
    missing: &mut Vec<MissingCapture>,
) -> Result<Vec<PlannedFrame<'a>>> {
    let list = match part {
        Split::Train => &split.train,
        Split::Test => &split.test,
    };
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
                let directory = raw::capture_dir(raw, subject, outfit, sequence);
                let Some(paths) = raw::frame_paths(&directory)? else { continue };
                found = true;
                let count = paths.len();
                let kept = count.saturating_sub(2 * split.cut);
                if kept == 0 {
                    miss(format!(
                        "{outfit}_{sequence} has {count} frames, nothing is left after cutting {} \
                         at either end",
                        split.cut
                    ));
                }
                let paths = paths.into_iter().skip(split.cut).take(kept).step_by(split.sample_rate);
                frames.extend(paths.map(|path| PlannedFrame { path, subject, sequence, outfit }));
            }
            if !found {
                miss(format!("no sequence {sequence} in any outfit"));
            }
        }
    }
    Ok(frames)
}

fn read(
    frame: &PlannedFrame,
    inside: Option<&Path>,
    minimal: &MinimalShapes,
) -> Result<PackedFrame> {
    if let Some(root) = inside {
        raw::require_inside(root, &frame.path)?;
    }
    let name = frame.path.file_stem().and_then(|name| name.to_str());
    if name.is_none_or(|name| name.contains(char::is_control)) {
        return Err(Error::format(&frame.path, "its name is not plain text"));
    }
    let Some(minimal) = minimal.get(frame.subject) else {
        return Err(Error::Data(format!("subject {} has no minimal shape", frame.subject)));
    };
    let read = raw::read_canonical(&frame.path, minimal.nrows())?;
    let rotations = pose_rotations(&read.pose)?;
    let rotations = rotations.as_flattened().as_flattened().to_vec();
    Ok(PackedFrame { displacement: read.v_cano - minimal, pose: read.pose, rotations })
}

fn broken(raw: &Path, frame: &PlannedFrame, error: &Error) -> BrokenFrame {
    let path = relative(raw, frame);
    // The path is listed beside the reason.
    let reason = error.to_string();
    let reason = reason.strip_prefix(&*frame.path.to_string_lossy()).unwrap_or(&reason);
    let reason = reason.trim_start_matches(": ").replace(['\n', '\t'], " ");
    BrokenFrame { path: path.to_owned(), reason }
}

fn no_frames_error(raw: &Path, report: &PackReport) -> Error {
    let why = match (report.broken.first(), report.missing.first()) {
        (Some(frame), _) => format!(
            "all {} frames are unreadable; the first, {}: {}",
            report.broken.len(),
            frame.path.display(),
            frame.reason
        ),
        (None, Some(missing)) => format!(
            "subject {}: {}{}",
            missing.subject,
            missing.reason,
            match report.missing.len() {
                1 => String::new(),
                n => format!("; and {} more are missing", n - 1),
            }
        ),
        (None, None) => "the split excludes everything".to_owned(),
    };
    Error::Data(format!("{}: no frame can be packed: {why}", raw.display()))
}

fn describe(text: &mut String, part: Split, captures: &[(String, usize)]) {
    let frames: usize = captures.iter().map(|(_, frames)| frames).sum();
    // Writing to a string cannot fail.
    let _ = writeln!(text, "\n{part}: {frames} frames of {} captures", captures.len());
    for (name, frames) in captures {
        let _ = writeln!(text, "{name} {frames}");
    }
}

fn write_notes(
    raw: &Path,
    out: &Path,
    split: &SplitSpec,
    options: PackOptions,
    report: &PackReport,
    captures: &str,
) -> Result<()> {
    let put = |name: &str, text: String| {
        let path = out.join(name);
        fs::write(&path, text).map_err(|e| Error::io(path, e))
    };
    let PackReport { vertices, train_frames, validation_frames, test_frames, .. } = report;
    put(
        "stats.txt",
        format!(
            "train {train_frames}\nvalidation {validation_frames} (the last of train)\n\
             test {test_frames}\nbroken {}\nvertices {vertices}\n{captures}",
            report.broken.len()
        ),
    )?;
    let line = |frame: &BrokenFrame| format!("{}\t{}\n", frame.path.display(), frame.reason);
    put("broken_frames.txt", report.broken.iter().map(line).collect())?;
    put(SPLIT_FILE, split.to_toml()?)?;
    for name in [BODY_FILE, CLOTHING_FILE] {
        let from = raw.join(name);
        if from.is_file() {
            if !options.follow_links {
                raw::require_inside(raw, &from)?;
            }
            fs::copy(&from, out.join(name)).map_err(|e| Error::io(from, e))?;
        }
    }
    Ok(())
}

#[cfg(test)]
#[path = "pack_tests.rs"]
mod tests;
