use std::{
    fmt, fs,
    ops::Range,
    path::{Path, PathBuf},
};

use cape_core::{
    Outfit, OutfitVocabulary,
    joints::{CLOTHING_JOINTS, POSE_FEATURE, pose_rotations},
};
use ndarray::{Array2, Array3};
use serde::{Deserialize, Serialize};

use super::{
    SplitSpec,
    npy_rows::RowReader,
    raw::SPLIT_FILE,
    statistics::{Accumulator, DisplacementStatistics, STATISTICS_FILE, validation_count},
};
use crate::{Error, Result};
use cape_core::ProgressFn;

pub(super) const FRAMES_HEADER: &str = "subject,outfit,sequence,frame";

/// Training or test part of a packed set.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Split {
    /// Training frames; the last ones are for validation.
    Train,
    /// Test frames.
    Test,
}

impl Split {
    /// Name of the directory and prefix of the files: `train` or `test`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Test => "test",
        }
    }

    /// True if the packed set in `root` has this part.
    pub fn exists(self, root: impl AsRef<Path>) -> bool {
        self.path(root, "disp").exists()
    }

    /// Path of an array of this part of the packed set in `root`; `array` is `disp`, `pose`, `rot`
    /// or `clo_label`.
    pub fn path(self, root: impl AsRef<Path>, array: &str) -> PathBuf {
        root.as_ref().join(self.name()).join(format!("{self}_{array}.npy"))
    }

    pub(super) fn frames_path(self, root: &Path) -> PathBuf {
        root.join(self.name()).join(format!("{self}_frames.csv"))
    }
}

impl fmt::Display for Split {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Capture and raw frame of a packed frame.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FrameOrigin {
    /// Name of the subject.
    pub subject: String,
    /// Outfit in the name of the capture; the label can be another.
    pub outfit: Outfit,
    /// Name of the motion sequence, without the outfit.
    pub sequence: String,
    /// File name of the raw frame without extension.
    pub frame: String,
}

/// Batch of frames on the host, in the layout of the network's inputs.
#[derive(Debug, Clone, PartialEq)]
pub struct HostBatch {
    /// Rows of the frames in the packed set.
    pub frames: Vec<usize>,
    /// Displacements, `[batch, V, 3]`, normalised or in metres.
    pub displacement: Array3<f32>,
    /// Pose feature: rotation matrices of the clothing-related joints, row-major, `[batch, 126]`.
    pub pose_feature: Array2<f32>,
    /// One-hot outfits, `[batch, outfits]`.
    pub outfit: Array2<f32>,
}

/// Reader of one part of a packed set, frame by frame, written by this crate or by the official tools.
/// The arrays can hold floating-point numbers or integers of any size, byte order and memory order; those
/// in Fortran order are copied to a temporary file. Rotations are computed from poses if the set has
/// none.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use cape_core::Outfit;
/// use cape_core::silent;
/// use cape_data::{PackedSet, Split, DisplacementStatistics};
///
/// // Five training frames of a walk of a triangle, and five test frames of a kick.
/// let directory = triangles()?;
/// let packed = directory.path().join("packed");
/// let set = PackedSet::open(&packed, Split::Train)?;
/// assert_eq!((set.frames(), set.vertices(), set.outfits()[0]), (5, 3, Outfit::LONG_LONG));
/// assert_eq!(set.origins().unwrap()[0].sequence, "walk");
/// let batch = set.batch(&[4, 0], None)?;
/// assert_eq!((batch.displacement.dim(), batch.pose_feature.dim()), ((2, 3, 3), (2, 126)));
/// assert!((batch.displacement[[0, 0, 0]] - 0.04).abs() < 1e-6);
///
/// // The last frame is for validation; the mean of 0, 1, 2 and 3 centimetres is 1.5.
/// let statistics = DisplacementStatistics::from_packed(&packed, &mut silent)?;
/// assert_eq!(statistics.training_rows(set.frames()), 0..4);
/// assert!((statistics.mean()[[0, 0]] - 0.015).abs() < 1e-6);
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct PackedSet {
    displacement: RowReader,
    pose: RowReader,
    /// `None` if rotations are computed from the poses.
    rotations: Option<RowReader>,
    vocabulary: OutfitVocabulary,
    /// True if the set names its outfits.
    names_outfits: bool,
    /// Place of each frame's outfit in the vocabulary.
    classes: Vec<usize>,
    outfits: Vec<Outfit>,
    origins: Option<Vec<FrameOrigin>>,
    /// Displacements and pose features of all frames, if read into memory.
    preloaded: Option<(Vec<f32>, Vec<f32>)>,
}

impl PackedSet {
    /// Opens a part of the packed set in `root`.
    ///
    /// Outfits have the names of the set's `split.toml`. Without that file, four are the paper's, and
    /// any other number of them are called `outfit1`, `outfit2` and so on.
    ///
    /// # Errors
    /// If a file is missing, has an unexpected shape or type, or another number of frames than the
    /// others.
    pub fn open(root: impl AsRef<Path>, part: Split) -> Result<Self> {
        let root = root.as_ref();
        let open = |what, row: &[Option<usize>]| RowReader::open(part.path(root, what), row);
        let displacement = open("disp", &[None, Some(3)])?;
        let frames = displacement.rows();
        if frames == 0 || displacement.shape()[1] == 0 {
            let message = format!("shape {:?}: no frames", displacement.shape());
            return Err(Error::format(displacement.path(), message));
        }
        let pose = open("pose", &[Some(72)])?;
        let rotations =
            if part.path(root, "rot").exists() { Some(open("rot", &[Some(216)])?) } else { None };
        let labels = open("clo_label", &[None])?;
        for other in [Some(&pose), rotations.as_ref(), Some(&labels)].into_iter().flatten() {
            if other.rows() != frames {
                let message = format!(
                    "{} frames, but {} has {frames}",
                    other.rows(),
                    displacement.path().display()
                );
                return Err(Error::format(other.path(), message));
            }
        }
        let (vocabulary, names_outfits) = read_vocabulary(root, &labels)?;
        let classes: Vec<usize> =
            (0..frames).map(|row| class(&labels, row)).collect::<Result<_>>()?;
        let origins = read_origins(&part.frames_path(root), frames)?;
        Ok(Self {
            displacement,
            pose,
            rotations,
            outfits: classes.iter().map(|&class| vocabulary[class]).collect(),
            classes,
            vocabulary,
            names_outfits,
            origins,
            preloaded: None,
        })
    }

    /// The set with labels of another vocabulary, such as that of a model. Outfits keep their names;
    /// if the set does not name them and their number is that of the vocabulary, they are told by
    /// their place.
    ///
    /// # Errors
    /// If a frame's outfit is not in the vocabulary.
    pub fn with_vocabulary(mut self, vocabulary: &OutfitVocabulary) -> Result<Self> {
        if !self.names_outfits && self.vocabulary.len() == vocabulary.len() {
            self.outfits = self.classes.iter().map(|&class| vocabulary[class]).collect();
        }
        for (class, &outfit) in self.classes.iter_mut().zip(&self.outfits) {
            *class = vocabulary.index(outfit).ok_or_else(|| {
                Error::Data(format!(
                    "{}: frames in `{outfit}`, expected outfits of the model: {vocabulary}",
                    self.displacement.path().display()
                ))
            })?;
        }
        self.vocabulary = vocabulary.clone();
        Ok(self)
    }

    /// Number of frames, at least 1.
    pub fn frames(&self) -> usize {
        self.displacement.rows()
    }

    /// Number of vertices of a frame, at least 1.
    pub fn vertices(&self) -> usize {
        self.displacement.shape()[1]
    }

    /// Outfits of the one-hot labels, in their order.
    pub fn vocabulary(&self) -> &OutfitVocabulary {
        &self.vocabulary
    }

    /// True if the set names its outfits in `split.toml`.
    pub fn names_outfits(&self) -> bool {
        self.names_outfits
    }

    /// Outfit of every frame.
    pub fn outfits(&self) -> &[Outfit] {
        &self.outfits
    }

    /// Origin of every frame; `None` for sets without `*_frames.csv`, such as the official one.
    pub fn origins(&self) -> Option<&[FrameOrigin]> {
        self.origins.as_deref()
    }

    /// Name of a frame's capture, `subject/outfit_sequence`; `None` if the origins are unknown.
    pub fn capture(&self, frame: usize) -> Option<String> {
        let FrameOrigin { subject, outfit, sequence, .. } = self.origins()?.get(frame)?;
        Some(format!("{subject}/{outfit}_{sequence}"))
    }

    /// Reads all frames into memory as f32.
    pub fn preload(&mut self, progress: &mut ProgressFn) -> Result<()> {
        let frames = self.frames();
        let mut all = (
            Vec::with_capacity(frames * 3 * self.vertices()),
            Vec::with_capacity(frames * POSE_FEATURE),
        );
        for frame in 0..frames {
            self.read_into(frame, &mut all.0, &mut all.1)?;
            progress(frame + 1, frames);
        }
        self.preloaded = Some(all);
        Ok(())
    }

    /// Reads `frames` in this order; repetitions are allowed. Displacements are normalised by the
    /// given statistics, or in metres. The values do not depend on [`preload`].
    ///
    /// [`preload`]: Self::preload
    pub fn batch(
        &self,
        frames: &[usize],
        normalise: Option<&DisplacementStatistics>,
    ) -> Result<HostBatch> {
        let (count, vertices) = (frames.len(), self.vertices());
        let mut displacement = Vec::with_capacity(count * 3 * vertices);
        let mut pose_feature = Vec::with_capacity(count * POSE_FEATURE);
        let width = self.vocabulary.len();
        let mut outfit = Array2::zeros((count, width));
        for (row, &frame) in frames.iter().enumerate() {
            let Some(&class) = self.classes.get(frame) else {
                let total = self.frames();
                return Err(Error::argument(format!("frame {frame} of a set of {total} frames")));
            };
            outfit[[row, class]] = 1.0;
            match &self.preloaded {
                Some((all, features)) => {
                    let row = 3 * vertices;
                    displacement.extend(&all[frame * row..][..row]);
                    pose_feature.extend(&features[frame * POSE_FEATURE..][..POSE_FEATURE]);
                }
                None => self.read_into(frame, &mut displacement, &mut pose_feature)?,
            }
        }
        if let Some(statistics) = normalise {
            statistics.expect_vertices(vertices)?;
            statistics.normalise(&mut displacement);
        }
        let shape = |e: ndarray::ShapeError| Error::argument(e.to_string());
        Ok(HostBatch {
            frames: frames.to_vec(),
            displacement: Array3::from_shape_vec((count, vertices, 3), displacement)
                .map_err(shape)?,
            pose_feature: Array2::from_shape_vec((count, POSE_FEATURE), pose_feature)
                .map_err(shape)?,
            outfit,
        })
    }

    /// Pose features of frames, `[frames, 126]` (see [`HostBatch::pose_feature`]).
    pub fn pose_features(&self, frames: &[usize]) -> Result<Array2<f32>> {
        let mut features = Vec::with_capacity(frames.len() * POSE_FEATURE);
        for &frame in frames {
            if frame >= self.frames() {
                let total = self.frames();
                return Err(Error::argument(format!("frame {frame} of a set of {total} frames")));
            }
            match &self.preloaded {
                Some((_, all)) => features.extend(&all[frame * POSE_FEATURE..][..POSE_FEATURE]),
                None => self.read_pose_feature(frame, &mut features)?,
            }
        }
        Array2::from_shape_vec((frames.len(), POSE_FEATURE), features)
            .map_err(|error| Error::argument(error.to_string()))
    }

    /// One frame in f64: displacements `[V, 3]`, metres; pose in axis-angle `[72]`, radians;
    /// rotation matrices of the 24 joints, row-major, `[216]`.
    pub fn frame(&self, frame: usize) -> Result<(Array2<f64>, Vec<f64>, Vec<f64>)> {
        let displacement =
            Array2::from_shape_vec((self.vertices(), 3), self.displacement.row(frame)?)
                .map_err(|error| Error::argument(error.to_string()))?;
        Ok((displacement, self.pose.row(frame)?, self.rotations(frame)?))
    }

    /// Displacements of one frame, metres, `[3 V]`.
    pub fn displacement_row(&self, frame: usize) -> Result<Vec<f64>> {
        self.displacement.row(frame)
    }

    /// Pose of one frame in axis-angle, `[72]`, radians.
    pub fn pose(&self, frame: usize) -> Result<Vec<f32>> {
        Ok(self.pose.row(frame)?.into_iter().map(|x| x as f32).collect())
    }

    /// Rotation matrices of the 24 joints of one frame, row-major, `[216]`.
    fn rotations(&self, frame: usize) -> Result<Vec<f64>> {
        match &self.rotations {
            Some(rotations) => rotations.row(frame),
            None => {
                Ok(pose_rotations(&self.pose.row(frame)?)?.as_flattened().as_flattened().to_vec())
            }
        }
    }

    fn read_into(
        &self,
        frame: usize,
        displacement: &mut Vec<f32>,
        feature: &mut Vec<f32>,
    ) -> Result<()> {
        displacement.extend(self.displacement.row(frame)?.into_iter().map(|x| x as f32));
        self.read_pose_feature(frame, feature)
    }

    fn read_pose_feature(&self, frame: usize, feature: &mut Vec<f32>) -> Result<()> {
        let rotations = self.rotations(frame)?;
        for joint in CLOTHING_JOINTS {
            feature.extend(rotations[9 * joint..][..9].iter().map(|&x| x as f32));
        }
        Ok(())
    }
}

/// Outfits of the labels of the packed set in `root`, and true if the set names them.
fn read_vocabulary(root: &Path, labels: &RowReader) -> Result<(OutfitVocabulary, bool)> {
    let found = labels.shape()[1];
    let path = root.join(SPLIT_FILE);
    if !path.exists() {
        let vocabulary = OutfitVocabulary::numbered(found).map_err(|_| {
            Error::format(labels.path(), "no columns, expected one for each outfit")
        })?;
        return Ok((vocabulary, false));
    }
    let vocabulary = SplitSpec::from_file(&path)?.label_vocabulary()?;
    if vocabulary.len() == found {
        return Ok((vocabulary, true));
    }
    Err(Error::format(
        labels.path(),
        format!(
            "{found} columns, but {} has {} outfits: {vocabulary}",
            path.display(),
            vocabulary.len()
        ),
    ))
}

/// Place of the 1 of a one-hot label.
fn class(labels: &RowReader, row: usize) -> Result<usize> {
    let label = labels.row(row)?;
    let is = |value: f64, expected: f64| (value - expected).abs() < 1e-6;
    let ones: Vec<usize> = (0..label.len()).filter(|&place| is(label[place], 1.0)).collect();
    match ones[..] {
        [class] if label.iter().filter(|&&value| is(value, 0.0)).count() + 1 == label.len() => {
            Ok(class)
        }
        _ => {
            let message = format!("label {label:?}, expected one 1 among 0 (one-hot)");
            Err(Error::field(labels.path(), format!("row {row}"), message))
        }
    }
}

fn read_origins(path: &Path, frames: usize) -> Result<Option<Vec<FrameOrigin>>> {
    if !path.exists() {
        return Ok(None);
    }
    let text = fs::read_to_string(path).map_err(|e| Error::io(path, e))?;
    let mut lines = text.lines();
    if lines.next() != Some(FRAMES_HEADER) {
        return Err(Error::format(path, format!("first line: expected `{FRAMES_HEADER}`")));
    }
    let origin = |(number, line): (usize, &str)| {
        let fields: Vec<&str> = line.splitn(4, ',').collect();
        let fault = |message: String| Error::field(path, format!("line {}", number + 2), message);
        let &[subject, outfit, sequence, frame] = fields.as_slice() else {
            return Err(fault(format!("expected `{FRAMES_HEADER}`")));
        };
        let outfit = outfit.parse().map_err(|error: Error| fault(error.to_string()))?;
        let [subject, sequence, frame] = [subject, sequence, frame].map(str::to_owned);
        Ok(FrameOrigin { subject, outfit, sequence, frame })
    };
    let origins = lines.enumerate().map(origin).collect::<Result<Vec<_>>>()?;
    if origins.len() != frames {
        let message = format!("lists {} frames, but the arrays have {frames}", origins.len());
        return Err(Error::format(path, message));
    }
    Ok(Some(origins))
}

impl DisplacementStatistics {
    /// Statistics of the packed set in `root`, read from its `stats.npz`, or computed from the
    /// training frames and saved there if the directory is writable.
    pub fn from_packed(root: impl AsRef<Path>, progress: &mut ProgressFn) -> Result<Self> {
        let root = root.as_ref();
        let path = root.join(STATISTICS_FILE);
        if path.exists() {
            return Self::load(path);
        }
        let set = PackedSet::open(root, Split::Train)?;
        let validation = validation_count(set.frames());
        let count = set.frames() - validation;
        let mut accumulator = Accumulator::new(3 * set.vertices());
        for frame in 0..count {
            accumulator.push(set.displacement.row(frame)?);
            progress(frame + 1, count);
        }
        let statistics = accumulator.finish(validation)?;
        // On a read-only medium the statistics are computed again next time.
        let _ = statistics.save(path);
        Ok(statistics)
    }

    /// Rows of the training frames, without validation frames, in a training part of `frames`
    /// frames.
    pub fn training_rows(&self, frames: usize) -> Range<usize> {
        0..frames.saturating_sub(self.validation())
    }

    /// Rows of the validation frames in a training part of `frames` frames.
    pub fn validation_rows(&self, frames: usize) -> Range<usize> {
        frames.saturating_sub(self.validation())..frames
    }

    /// Checks that the statistics are of frames of `vertices` vertices.
    ///
    /// # Errors
    /// If they are not; the message has both numbers.
    pub fn expect_vertices(&self, vertices: usize) -> Result<()> {
        if self.vertices() == vertices {
            return Ok(());
        }
        Err(Error::Data(format!(
            "normalisation statistics of {} vertices do not fit frames of {vertices}",
            self.vertices()
        )))
    }
}

#[cfg(test)]
#[path = "packed_tests.rs"]
mod tests;
