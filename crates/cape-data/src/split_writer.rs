use std::{
    collections::VecDeque,
    fs::{self, File},
    io::{BufWriter, Write},
    path::{Path, PathBuf},
};

use super::{
    Split,
    npy_rows::RowWriter,
    pack::PackedFrame,
    pack_plan::PlannedFrame,
    packed::FRAMES_HEADER,
    statistics::{Accumulator, DisplacementStatistics, validation_count},
};
use crate::{Error, Result};

/// Largest number of validation frames.
const LATEST: usize = 100;

/// Extents of the rows of a packed set.
#[derive(Debug, Clone, Copy)]
pub(super) struct FrameShape {
    pub(super) vertices: usize,
    /// Length of a one-hot label.
    pub(super) labels: usize,
}

/// Writer of one part of a packed set that accumulates its statistics.
#[derive(Debug)]
pub(super) struct SplitWriter {
    displacement: RowWriter,
    pose: RowWriter,
    rotations: RowWriter,
    label: RowWriter,
    /// Length of a one-hot label.
    labels: usize,
    names: PathBuf,
    frames: BufWriter<File>,
    /// Captures with their numbers of frames, in packing order.
    pub(super) captures: Vec<(String, usize)>,
    statistics: Accumulator,
    /// Latest frames, not yet in the statistics.
    latest: VecDeque<Vec<f64>>,
    /// Number of frames that the split names for validation; they come last, and are not in the
    /// statistics.
    validation: usize,
}

impl SplitWriter {
    pub(super) fn create(root: &Path, part: Split, shape: FrameShape) -> Result<Self> {
        let directory = root.join(part.name());
        fs::create_dir_all(&directory).map_err(|e| Error::io(&directory, e))?;
        let names = part.frames_path(root);
        fs::write(&names, format!("{FRAMES_HEADER}\n")).map_err(|e| Error::io(&names, e))?;
        Self::assemble(root, part, shape, RowWriter::create)
    }

    /// Resumes files that have `frames` already; the statistics are computed from them.
    pub(super) fn resume(
        root: &Path,
        part: Split,
        shape: FrameShape,
        frames: &[&PlannedFrame],
    ) -> Result<Self> {
        let rows = frames.len();
        let mut writer =
            Self::assemble(root, part, shape, |path, shape| RowWriter::resume(path, shape, rows))?;
        let lines: String = frames.iter().map(|frame| csv_line(frame)).collect();
        let text = format!("{FRAMES_HEADER}\n{lines}");
        fs::write(&writer.names, text).map_err(|e| Error::io(&writer.names, e))?;
        for frame in frames {
            writer.count(frame);
        }
        let mut left = rows - writer.validation;
        let Self { displacement, statistics, latest, .. } = &mut writer;
        displacement.for_each_row(|row| {
            if left > 0 {
                settle(statistics, latest, row.to_vec());
                left -= 1;
            }
        })?;
        Ok(writer)
    }

    /// True if the files in `root` are long enough for `rows` rows.
    pub(super) fn holds(root: &Path, part: Split, shape: FrameShape, rows: usize) -> bool {
        let FrameShape { vertices, labels } = shape;
        let arrays = [("disp", 3 * vertices), ("pose", 72), ("rot", 216), ("clo_label", labels)];
        arrays.into_iter().all(|(what, numbers)| {
            let found = fs::metadata(part.path(root, what));
            // The header adds to the size.
            found.is_ok_and(|found| found.len() > (8 * rows * numbers) as u64)
        })
    }

    fn assemble(
        root: &Path,
        part: Split,
        shape: FrameShape,
        open: impl Fn(PathBuf, &[usize]) -> Result<RowWriter>,
    ) -> Result<Self> {
        let FrameShape { vertices, labels } = shape;
        let names = part.frames_path(root);
        let frames = File::options()
            .create(true)
            .append(true)
            .open(&names)
            .map_err(|e| Error::io(&names, e))?;
        let open = |what, shape: &[usize]| open(part.path(root, what), shape);
        Ok(Self {
            displacement: open("disp", &[vertices, 3])?,
            pose: open("pose", &[72])?,
            rotations: open("rot", &[216])?,
            label: open("clo_label", &[labels])?,
            labels,
            names,
            frames: BufWriter::new(frames),
            captures: Vec::new(),
            statistics: Accumulator::new(3 * vertices),
            latest: VecDeque::new(),
            validation: 0,
        })
    }

    pub(super) fn rows(&self) -> usize {
        self.displacement.rows()
    }

    pub(super) fn push(&mut self, frame: &PlannedFrame, packed: &PackedFrame) -> Result<()> {
        self.displacement.push(packed.displacement.iter().copied())?;
        self.pose.push(packed.pose)?;
        self.rotations.push(packed.rotations.iter().copied())?;
        self.label.push((0..self.labels).map(|class| f64::from(u8::from(class == frame.class))))?;
        self.frames.write_all(csv_line(frame).as_bytes()).map_err(|e| Error::io(&self.names, e))?;
        self.count(frame);
        if !frame.validation {
            let row = packed.displacement.iter().copied().collect();
            settle(&mut self.statistics, &mut self.latest, row);
        }
        Ok(())
    }

    fn count(&mut self, frame: &PlannedFrame) {
        let PlannedFrame { subject, sequence, outfit, .. } = frame;
        self.validation += usize::from(frame.validation);
        let capture = format!("{subject}/{outfit}_{sequence}");
        match self.captures.last_mut() {
            Some((last, frames)) if *last == capture => *frames += 1,
            _ => self.captures.push((capture, 1)),
        }
    }

    /// Flushes all files, so that the packing can be resumed from here.
    pub(super) fn flush(&mut self) -> Result<()> {
        let Self { displacement, pose, rotations, label, .. } = self;
        for rows in [displacement, pose, rotations, label] {
            rows.flush()?;
        }
        self.frames.flush().map_err(|e| Error::io(&self.names, e))
    }

    /// Completes the files and returns the statistics of the frames without validation frames, which the
    /// split names (`named`), or else are the last ones.
    ///
    /// # Errors
    /// If all frames are for validation, or a file cannot be written.
    pub(super) fn finish(mut self, named: bool) -> Result<DisplacementStatistics> {
        let validation = if named { self.validation } else { validation_count(self.rows()) };
        if named && validation == self.rows() {
            return Err(Error::Data(
                "all frames of the training part are for validation: add training sequences".into(),
            ));
        }
        let settled = self.latest.len().saturating_sub(if named { 0 } else { validation });
        for row in self.latest.drain(..settled) {
            self.statistics.push(row);
        }
        self.displacement.finish()?;
        self.pose.finish()?;
        self.rotations.finish()?;
        self.label.finish()?;
        self.frames.flush().map_err(|e| Error::io(&self.names, e))?;
        self.statistics.finish(validation)
    }
}

fn csv_line(frame: &PlannedFrame) -> String {
    let PlannedFrame { source, subject, sequence, outfit, .. } = frame;
    let name = source.path().file_stem().unwrap_or_default().to_string_lossy();
    format!("{subject},{outfit},{sequence},{name}\n")
}

/// Adds a frame to `latest`, and the oldest one to the statistics if there are too many.
fn settle(statistics: &mut Accumulator, latest: &mut VecDeque<Vec<f64>>, row: Vec<f64>) {
    latest.push_back(row);
    if latest.len() > LATEST
        && let Some(settled) = latest.pop_front()
    {
        statistics.push(settled);
    }
}
