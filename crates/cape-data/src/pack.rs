//! Packing of raw frames into arrays.
//!
//! ```text
//! train/train_disp.npy       [n, V, 3]  displacements (v_cano − minimal), metres, float64
//! train/train_pose.npy       [n, 72]    axis-angle
//! train/train_rot.npy        [n, 216]   24 rotation matrices, row-major
//! train/train_clo_label.npy  [n, k]     outfit, one-hot; k is 4 for the paper's outfits
//! train/train_frames.csv     subject, outfit, sequence and frame of each row
//! test/test_…                the same for the test part
//! stats.txt                  numbers of frames
//! broken_frames.txt          unreadable frames that were left out, with the reason
//! stats.npz, split.toml      normalisation statistics; the split
//! body.npz, clothing_verts_idx.npy   copies from the raw data, if there; the body of the split
//! ```
//!
//! Rows are ordered by subject, sequence, outfit and frame name; mirrored training frames follow the
//! others, as sequences `mirrored_…`. The `.csv`, `.npz` and `.toml`
//! files are additions to the release's layout. Displacements are float64, as in the release.

use std::{
    collections::HashSet,
    fmt::Write as _,
    fs,
    path::{Path, PathBuf},
};

use cape_core::{
    MirrorSymmetry, Outfit,
    joints::{mirrored_pose, pose_rotations},
    smpl::SmplModel,
};
use ndarray::Array2;
use rayon::prelude::*;
use serde::Serialize;

use super::{
    RawTree, Split, SplitSpec,
    pack_log::{FrameStatus, PackLog, plan_hash},
    pack_plan::{MinimalShapes, PlannedFrame, plan, read_minimals},
    raw::{self, BODY_FILE, CLOTHING_FILE, SPLIT_FILE},
    split_writer::{FrameShape, SplitWriter},
    statistics::STATISTICS_FILE,
};
use crate::{Error, Result};
use cape_core::ProgressFn;
use cape_core::StagingDirectory;

/// Options of [`pack`](pack()).
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
///     raw::write_frame(&raw, "anna", Outfit::LONG_LONG, "walk", number, &frame)?;
/// }
/// let capture = raw::capture_dir(&raw, "anna", Outfit::LONG_LONG, "walk");
/// std::fs::write(capture.join("longlong_walk.000002.npz"), "damaged")?;
///
/// let list = |names: &[&str]| SequenceList {
///     sequences: names.iter().map(ToString::to_string).collect(),
///     exclude: Vec::new(),
/// };
/// let split = SplitSpec {
///     subjects: vec!["anna".into()],
///     outfits: vec![Outfit::LONG_LONG],
///     cut: 0,
///     train: list(&["walk", "run"]),
///     test: list(&[]),
///     ..SplitSpec::default()
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
    /// Treat missing captures and unreadable frames as errors instead of listing them.
    pub strict: bool,
    /// Follow symbolic links to files outside the raw tree.
    pub follow_links: bool,
}

/// Report of [`pack`](pack()).
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct PackReport {
    /// Number of vertices of a frame.
    pub vertices: usize,
    /// Number of training frames, including validation frames.
    pub train_frames: usize,
    /// Number of validation frames, the last ones of the training frames.
    pub validation_frames: usize,
    /// Number of test frames.
    pub test_frames: usize,
    /// Unreadable frames, in packing order.
    pub broken: Vec<BrokenFrame>,
    /// Subjects and sequences of the split that are not in the raw data.
    pub missing: Vec<MissingCapture>,
    /// Outfits of the split that no capture is of.
    pub missing_outfits: Vec<Outfit>,
    /// Number of frames processed before by an interrupted packing of the same data.
    pub resumed: usize,
}

/// A frame left out because it cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct BrokenFrame {
    /// Path below the subjects, `<subject>/<outfit>_<sequence>/<file>`.
    pub path: PathBuf,
    /// Reason for leaving it out.
    pub reason: String,
}

/// A subject or sequence of the split that is not in the raw data.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct MissingCapture {
    /// Name of the subject.
    pub subject: String,
    /// Name of the sequence; `None` if the whole subject is missing.
    pub sequence: Option<String>,
    /// Directory or file that is missing.
    pub reason: String,
}

/// Packs the frames of the raw tree `raw` selected by `split` into the directory `out`, which
/// appears only when it is complete. An interrupted packing of the same data is resumed.
///
/// Frames are read in parallel. Memory holds a few frames and the latest 100 training frames, which
/// can be validation frames, unless the split names captures for validation. Unreadable frames, missing
/// subjects and missing sequences are listed in the report.
///
/// # Errors
/// If `out` exists, the split is invalid, no frame is left, the raw tree vanishes, or anything is missing or
/// unreadable with [`PackOptions::strict`].
pub fn pack(
    raw: impl AsRef<Path>,
    out: impl AsRef<Path>,
    split: &SplitSpec,
    options: PackOptions,
    progress: &mut ProgressFn,
) -> Result<PackReport> {
    let (raw, out) = (raw.as_ref(), out.as_ref());
    split.validate()?;
    let mut report = PackReport::default();
    let tree = RawTree::open(raw)?;
    let body = raw.join(split.body.as_deref().unwrap_or(Path::new(BODY_FILE)));
    if split.body.is_some() && !body.is_file() {
        return Err(Error::Data(format!(
            "{}: not found: it is `body` of the split",
            body.display()
        )));
    }
    let reader = FrameReader {
        inside: !options.follow_links,
        minimal: read_minimals(&tree, split, options, &mut report)?,
        symmetry: split.mirror.then(|| symmetry(&body)).transpose()?,
    };
    let minimal = &reader.minimal;
    let vocabulary = split.label_vocabulary()?;
    let mut plans = Vec::new();
    for part in [Split::Train, Split::Test] {
        plans.push((part, plan(&tree, split, part, minimal, &mut report.missing)?));
    }
    if let (true, Some(missing)) = (options.strict, report.missing.first()) {
        return Err(Error::Data(format!("{}: {}", missing.subject, missing.reason)));
    }
    let frames = || plans.iter().flat_map(|(_, frames)| frames);
    let total = frames().count();
    let worn: HashSet<Outfit> = frames().map(|frame| frame.outfit).collect();
    report.missing_outfits =
        split.outfits.iter().copied().filter(|outfit| !worn.contains(outfit)).collect();
    let plan = plan_hash(raw, split, options, minimal.values(), frames())?;

    let mut staging = StagingDirectory::prepare(out)?;
    let mut done = PackLog::read(&staging.path, &plan);
    done.truncate(total);
    // Broken frames may have been repaired since.
    let repaired = frames()
        .zip(&done)
        .position(|(frame, status)| *status != FrameStatus::Packed && reader.read(frame).is_ok());
    done.truncate(repaired.unwrap_or(total));
    let shape = FrameShape { vertices: report.vertices, labels: vocabulary.len() };
    if !is_whole(&staging.path, &plans, &done, shape) {
        done.clear();
    }
    if done.is_empty() {
        staging.clear()?;
    }
    report.resumed = done.len();
    let mut log = PackLog::start(&staging.path, &plan, &done)?;
    // From here on, packed frames are kept on errors for the next attempt.
    staging.keep = true;
    let mut text = String::new();
    let mut before = 0;
    for (part, frames) in &plans {
        let statuses = &done[before.min(done.len())..(before + frames.len()).min(done.len())];
        let mut writer = resume(&staging.path, *part, shape, frames, statuses, &mut report)?;
        let left = &frames[statuses.len()..];
        let mut count = before + statuses.len();
        for chunk in left.chunks(4 * rayon::current_num_threads()) {
            progress(count, total);
            let read: Vec<_> = chunk.par_iter().map(|frame| reader.read(frame)).collect();
            for (frame, read) in chunk.iter().zip(read) {
                match read {
                    Ok(read) => {
                        if writer.is_none() {
                            writer = Some(SplitWriter::create(&staging.path, *part, shape)?);
                        }
                        if let Some(writer) = &mut writer {
                            writer.push(frame, &read)?;
                        }
                        log.push(&FrameStatus::Packed);
                    }
                    Err(error) if options.strict => {
                        staging.keep = false;
                        return Err(error);
                    }
                    Err(error) => {
                        require_there(raw)?;
                        let broken = broken(frame, &error);
                        log.push(&FrameStatus::Broken(broken.reason.clone()));
                        report.broken.push(broken);
                    }
                }
            }
            if let Some(writer) = &mut writer {
                writer.flush()?;
            }
            log.commit()?;
            count += chunk.len();
            progress(count, total);
        }
        before += frames.len();
        let Some(writer) = writer else { continue };
        describe(&mut text, *part, &writer.captures);
        match part {
            Split::Train => {
                report.train_frames = writer.rows();
                let statistics = writer.finish(!split.validation.is_empty())?;
                report.validation_frames = statistics.validation();
                statistics.save(staging.path.join(STATISTICS_FILE))?;
            }
            Split::Test => {
                report.test_frames = writer.rows();
                writer.finish(false)?;
            }
        }
    }
    if report.train_frames + report.test_frames == 0 {
        staging.keep = false;
        return Err(no_frames_error(raw, &report));
    }
    require_there(raw)?;
    write_notes(&tree, &staging.path, split, options, &report, &text)?;
    log.finish()?;
    staging.commit(out)?;
    Ok(report)
}

/// Returns an error if the raw tree is gone, such as a drive that was taken away: its frames are not
/// unreadable then. What is packed is kept for the next attempt.
fn require_there(raw: &Path) -> Result<()> {
    if raw.is_dir() {
        return Ok(());
    }
    Err(Error::Data(format!(
        "{}: is no longer there: make it available and run the same command again, which goes on",
        raw.display()
    )))
}

/// True if the files have all frames that the log lists as packed; after a power failure they may
/// not.
fn is_whole(
    directory: &Path,
    plans: &[(Split, Vec<PlannedFrame>)],
    done: &[FrameStatus],
    shape: FrameShape,
) -> bool {
    let mut left = done;
    plans.iter().all(|(part, frames)| {
        let (own, rest) = left.split_at(frames.len().min(left.len()));
        left = rest;
        let rows = own.iter().filter(|status| **status == FrameStatus::Packed).count();
        rows == 0 || SplitWriter::holds(directory, *part, shape, rows)
    })
}

/// Writer of a part whose first frames are processed already; `None` if none of them was packed.
fn resume(
    directory: &Path,
    part: Split,
    shape: FrameShape,
    frames: &[PlannedFrame],
    statuses: &[FrameStatus],
    report: &mut PackReport,
) -> Result<Option<SplitWriter>> {
    let mut packed = Vec::new();
    for (frame, status) in frames.iter().zip(statuses) {
        match status {
            FrameStatus::Packed => packed.push(frame),
            FrameStatus::Broken(reason) => report.broken.push(BrokenFrame {
                path: frame.source.relative().to_owned(),
                reason: reason.clone(),
            }),
        }
    }
    if packed.is_empty() {
        return Ok(None);
    }
    SplitWriter::resume(directory, part, shape, &packed).map(Some)
}

/// One row of every packed array.
pub(super) struct PackedFrame {
    pub(super) displacement: Array2<f64>,
    pub(super) pose: [f64; 72],
    pub(super) rotations: Vec<f64>,
}

/// Reader of the planned frames.
struct FrameReader {
    /// Refuse files outside the raw tree.
    inside: bool,
    minimal: MinimalShapes,
    /// Symmetry of the body, if there are mirrored frames.
    symmetry: Option<MirrorSymmetry>,
}

impl FrameReader {
    fn read(&self, frame: &PlannedFrame) -> Result<PackedFrame> {
        if self.inside {
            frame.source.require_inside()?;
        }
        let name = frame.source.path().file_stem().and_then(|name| name.to_str());
        if name.is_none_or(|name| name.contains(char::is_control)) {
            return Err(Error::format(
                frame.source.path(),
                "file name: expected text without control characters",
            ));
        }
        let Some(minimal) = self.minimal.get(frame.subject) else {
            return Err(Error::Data(format!("subject {} has no minimal shape", frame.subject)));
        };
        let read = frame.source.canonical(minimal.nrows())?;
        let (mut displacement, mut pose) = (read.v_cano - minimal, read.pose);
        if let (true, Some(symmetry)) = (frame.mirrored, &self.symmetry) {
            displacement = symmetry.mirror(&displacement)?;
            pose = mirrored_pose(&pose);
        }
        let rotations = pose_rotations(&pose)?.as_flattened().as_flattened().to_vec();
        Ok(PackedFrame { displacement, pose, rotations })
    }
}

/// Symmetry of the body of the raw data.
fn symmetry(body: &Path) -> Result<MirrorSymmetry> {
    if !body.is_file() {
        return Err(Error::Data(format!(
            "{}: not found: `mirror` of the split needs the mesh of the body",
            body.display()
        )));
    }
    MirrorSymmetry::of(&SmplModel::load(body)?.mesh())
        .map_err(|e| Error::format(body, e.to_string()))
}

fn broken(frame: &PlannedFrame, error: &Error) -> BrokenFrame {
    let path = frame.source.relative();
    // The reason does not repeat the path.
    let reason = error.to_string();
    let reason = reason.strip_prefix(&*frame.source.path().to_string_lossy()).unwrap_or(&reason);
    let reason = reason.trim_start_matches(": ").replace(['\n', '\t'], " ");
    BrokenFrame { path: path.to_owned(), reason }
}

fn no_frames_error(raw: &Path, report: &PackReport) -> Error {
    let reason = match (report.broken.first(), report.missing.first()) {
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
        (None, None) => "the split excludes all frames".to_owned(),
    };
    Error::Data(format!("{}: no frame can be packed: {reason}", raw.display()))
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
    tree: &RawTree,
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
    // The packed set has one body.
    put(SPLIT_FILE, SplitSpec { body: None, ..split.clone() }.to_toml()?)?;
    let body = split.body.as_deref().unwrap_or(Path::new(BODY_FILE));
    for (from, name) in [(body, BODY_FILE), (Path::new(CLOTHING_FILE), CLOTHING_FILE)] {
        let from = tree.root().join(from);
        if from.is_file() {
            if !options.follow_links {
                raw::require_inside(tree.root(), &from)?;
            }
            fs::copy(&from, out.join(name)).map_err(|e| Error::io(from, e))?;
        }
    }
    Ok(())
}

#[cfg(test)]
#[path = "pack_tests.rs"]
mod tests;
