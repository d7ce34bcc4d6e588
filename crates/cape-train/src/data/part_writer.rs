use std::{
    collections::VecDeque,
    fs::{self, File},
    io::{BufWriter, Write},
    path::{Path, PathBuf},
};

use super::{
    Part,
    npy_rows::RowWriter,
    pack::{PackedFrame, PlannedFrame},
    packed::FRAMES_HEADER,
    statistics::{Accumulator, Statistics, validation_count},
};
use crate::{Error, Result};

/// Most frames that can turn out to be validation.
const LATEST: usize = 100;

/// Writes one part of a packed set and gathers its statistics.
#[derive(Debug)]
pub(super) struct PartWriter {
    displacement: RowWriter,
    pose: RowWriter,
    rotations: RowWriter,
    label: RowWriter,
    names: PathBuf,
    frames: BufWriter<File>,
    /// Captures and their numbers of frames, in packing order.
    pub(super) captures: Vec<(String, usize)>,
    statistics: Accumulator,
    /// Frames not yet in the statistics.
    latest: VecDeque<Vec<f64>>,
}

impl PartWriter {
    pub(super) fn create(root: &Path, part: Part, vertices: usize) -> Result<Self> {
        let directory = root.join(part.name());
        fs::create_dir_all(&directory).map_err(|e| Error::io(&directory, e))?;
        let create = |what, shape: &[usize]| RowWriter::create(part.path(root, what), shape);
        let names = part.frames_path(root);
        let open = || {
            let mut file = BufWriter::new(File::create(&names)?);
            writeln!(file, "{FRAMES_HEADER}")?;
            Ok(file)
        };
        let frames = open().map_err(|e| Error::io(&names, e))?;
        Ok(Self {
            displacement: create("disp", &[vertices, 3])?,
            pose: create("pose", &[72])?,
            rotations: create("rot", &[216])?,
            label: create("clo_label", &[4])?,
            names,
            frames,
            captures: Vec::new(),
            statistics: Accumulator::new(3 * vertices),
            latest: VecDeque::new(),
        })
    }

    pub(super) fn rows(&self) -> usize {
        self.displacement.rows()
    }

    pub(super) fn push(&mut self, frame: &PlannedFrame, packed: &PackedFrame) -> Result<()> {
        let PlannedFrame { path, subject, sequence, outfit } = frame;
        self.displacement.push(packed.displacement.iter().copied())?;
        self.pose.push(packed.pose)?;
        self.rotations.push(packed.rotations.iter().copied())?;
        self.label.push(outfit.one_hot().map(f64::from))?;
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        writeln!(self.frames, "{subject},{outfit},{sequence},{name}")
            .map_err(|e| Error::io(&self.names, e))?;
        let capture = format!("{subject}/{outfit}_{sequence}");
        match self.captures.last_mut() {
            Some((last, frames)) if *last == capture => *frames += 1,
            _ => self.captures.push((capture, 1)),
        }
        self.latest.push_back(packed.displacement.iter().copied().collect());
        if self.latest.len() > LATEST
            && let Some(settled) = self.latest.pop_front()
        {
            self.statistics.push(settled);
        }
        Ok(())
    }

    /// Completes the files and returns the statistics of the frames that do not validate.
    pub(super) fn finish(mut self) -> Result<Statistics> {
        let validation = validation_count(self.rows());
        let settled = self.latest.len().saturating_sub(validation);
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
