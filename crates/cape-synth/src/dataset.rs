//! Synthetic capture sequences of subjects, outfits and motions, and their files in the layout of the
//! CAPE release.

use std::{
    collections::{BTreeMap, BTreeSet, HashSet},
    fs,
    path::{Path, PathBuf},
};

use ndarray::{Array1, Array2};
use rand::{SeedableRng, rngs::ChaCha8Rng};
use rayon::prelude::*;

use super::{
    Motion, MotionStyle, Wardrobe,
    wardrobe::{FittedOutfit, GarmentLengths, mix_seed},
};
use crate::{Error, Result};
use cape_core::{
    Outfit, SmplModel,
    npy::{NpzWriter, write_npy},
    smpl::{Gender, SubjectBodies, write_genders},
};

/// Specification of a synthetic data set.
///
/// ```
/// use cape_core::Outfit;
/// use cape_synth::{Motion, SynthSpec};
///
/// let spec = SynthSpec {
///     subjects: 2,
///     outfits: vec![Outfit::SHORT_LONG],
///     motions: vec![Motion::Squats, Motion::Soccer],
///     ..SynthSpec::default()
/// };
/// assert_eq!(spec.sequences().len(), 2 * 2);
/// assert_eq!(spec.train_motions(), [Motion::Squats]);
/// assert_eq!(spec.test_motions(), [Motion::Soccer]);
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct SynthSpec {
    /// Number of subjects.
    pub subjects: usize,
    /// Number of frames per sequence.
    pub frames_per_sequence: usize,
    /// Random seed.
    pub seed: u64,
    /// Frames per second.
    pub frame_rate: f64,
    /// Outfits of every subject.
    pub outfits: Vec<Outfit>,
    /// Motions of every subject in every outfit.
    pub motions: Vec<Motion>,
}

impl Default for SynthSpec {
    fn default() -> Self {
        Self {
            subjects: 4,
            frames_per_sequence: 60,
            seed: 1,
            frame_rate: 15.0,
            outfits: Outfit::PAPER.to_vec(),
            motions: Motion::CAPTURED.to_vec(),
        }
    }
}

impl SynthSpec {
    /// Names of the subjects, in order.
    pub fn subject_names(&self) -> Vec<String> {
        (0..self.subjects).map(subject_name).collect()
    }

    /// Motions of the training split, in order.
    pub fn train_motions(&self) -> Vec<Motion> {
        self.motions.iter().copied().filter(|motion| !motion.is_test()).collect()
    }

    /// Motions of the test split, in order.
    pub fn test_motions(&self) -> Vec<Motion> {
        self.motions.iter().copied().filter(|motion| motion.is_test()).collect()
    }

    /// All sequences, ordered by subject, outfit and motion.
    pub fn sequences(&self) -> Vec<SynthSequence> {
        (0..self.subjects)
            .flat_map(|subject| {
                self.outfits.iter().flat_map(move |&outfit| {
                    self.motions.iter().map(move |&motion| SynthSequence {
                        subject,
                        outfit,
                        motion,
                    })
                })
            })
            .collect()
    }

    fn check(&self) -> Result<()> {
        if self.subjects == 0 || self.subjects > 9999 {
            return Err(Error::Argument(format!("{} subjects: expected 1 to 9999", self.subjects)));
        }
        if self.frames_per_sequence == 0 || self.frames_per_sequence > 999_999 {
            return Err(Error::Argument(format!(
                "{} frames per sequence: expected 1 to 999999",
                self.frames_per_sequence
            )));
        }
        for &outfit in &self.outfits {
            GarmentLengths::from_outfit(outfit)?;
        }
        if !(self.frame_rate.is_finite() && self.frame_rate > 0.0) {
            return Err(Error::Argument(format!(
                "frame rate {}: expected a positive number",
                self.frame_rate
            )));
        }
        Ok(())
    }
}

/// Sequence of a data set: subject, outfit and motion.
///
/// ```
/// use cape_core::Outfit;
/// use cape_synth::{Motion, SynthSequence};
///
/// let sequence = SynthSequence { subject: 0, outfit: Outfit::LONG_LONG, motion: Motion::Hips };
/// assert_eq!(sequence.name(), "longlong_hips");
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct SynthSequence {
    /// Index of the subject, from 0.
    pub subject: usize,
    /// Outfit of the subject.
    pub outfit: Outfit,
    /// Motion of the subject.
    pub motion: Motion,
}

impl SynthSequence {
    /// Name of the subject in files.
    pub fn subject_name(&self) -> String {
        subject_name(self.subject)
    }

    /// Name of the sequence in files, `outfit_motion` as in the CAPE release.
    pub fn name(&self) -> String {
        format!("{}_{}", self.outfit, self.motion)
    }
}

fn subject_name(subject: usize) -> String {
    format!("s{:04}", subject + 1)
}

/// One frame of a sequence.
#[derive(Debug, Clone, PartialEq)]
pub struct SynthFrame {
    /// Clothed vertices in canonical space: minimal shape plus displacement, metres, `[V, 3]`.
    pub v_cano: Array2<f32>,
    /// Posed clothed vertices, metres, `[V, 3]`.
    pub v_posed: Array2<f32>,
    /// Pose in axis-angle, radians, `[72]`.
    pub pose: Array1<f64>,
    /// Translation that puts the lowest vertex on the floor `y = 0`, metres, `[3]`.
    pub transl: Array1<f64>,
}

impl SynthFrame {
    /// Writes the frame as an `.npz` file of the CAPE release.
    pub fn write(&self, path: impl Into<PathBuf>) -> Result<()> {
        let mut archive = NpzWriter::create(path.into())?;
        archive.add("v_cano", &self.v_cano)?;
        archive.add("v_posed", &self.v_posed)?;
        archive.add("pose", &self.pose)?;
        archive.add("transl", &self.transl)?;
        archive.finish()
    }
}

/// Generator of the frames of a synthetic data set.
///
/// ```
/// use cape_synth::{CaptureGenerator, SynthSpec, synthetic_body};
///
/// let body = synthetic_body();
/// let captures = CaptureGenerator::new(&body, SynthSpec::default())?;
/// let generator = captures.prepare(captures.spec().sequences()[0])?;
/// let frame = captures.frame(&generator, 3)?;
/// assert_eq!((frame.v_posed.dim(), frame.pose.len()), ((6890, 3), 72));
/// // The lowest vertex is on the floor.
/// let floor = frame.v_posed.column(1).iter().copied().fold(f32::INFINITY, f32::min);
/// assert!(floor.abs() < 1e-6);
/// // In canonical space a frame is minimal shape plus displacement.
/// let displacement = captures.displacement(&generator, 3)?;
/// let expected = generator.minimal() + &displacement;
/// assert!((frame.v_cano.mapv(f64::from) - expected).iter().all(|x| x.abs() < 1e-6));
/// # Ok::<(), cape_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct CaptureGenerator<'a> {
    groups: Vec<SubjectGroup<'a>>,
    spec: SynthSpec,
}

/// Subjects who share a body and its wardrobe.
#[derive(Debug, Clone)]
pub struct SubjectGroup<'a> {
    gender: Option<Gender>,
    file: &'static str,
    model: &'a SmplModel,
    wardrobe: Wardrobe<'a>,
    subjects: Vec<usize>,
}

impl<'a> SubjectGroup<'a> {
    /// Gender of the subjects, if there are bodies by gender.
    pub fn gender(&self) -> Option<Gender> {
        self.gender
    }

    /// Name of the body's file in the data set.
    pub fn body_file(&self) -> &'static str {
        self.file
    }

    /// The body.
    pub fn body(&self) -> &'a SmplModel {
        self.model
    }

    /// The garments for the body.
    pub fn wardrobe(&self) -> &Wardrobe<'a> {
        &self.wardrobe
    }

    /// Names of the subjects, in order.
    pub fn subject_names(&self) -> Vec<String> {
        self.subjects.iter().copied().map(subject_name).collect()
    }

    /// Shape coefficients of a subject, at most 10.
    pub fn betas(&self, subject: usize) -> Vec<f64> {
        self.wardrobe.betas(subject)
    }

    /// Minimal shape of a subject (unclothed rest vertices), metres, `[V, 3]`.
    pub fn minimal(&self, subject: usize) -> Result<Array2<f64>> {
        self.model.rest_shape(&self.betas(subject))
    }
}

/// Data that all frames of a sequence share: motion style, fitted outfit and minimal shape.
#[derive(Debug, Clone)]
pub struct SequenceGenerator {
    sequence: SynthSequence,
    style: MotionStyle,
    fitted: FittedOutfit,
    minimal: Array2<f64>,
}

impl SequenceGenerator {
    /// Subject, outfit and motion.
    pub fn sequence(&self) -> SynthSequence {
        self.sequence
    }

    /// Minimal shape of the subject (unclothed rest vertices), metres, `[V, 3]`.
    pub fn minimal(&self) -> &Array2<f64> {
        &self.minimal
    }
}

impl<'a> CaptureGenerator<'a> {
    /// Creates a generator for subjects with `bodies`. Of bodies by gender, subjects of even index have
    /// the male one and subjects of odd index the female one.
    ///
    /// # Errors
    /// If the specification is invalid, or a body does not have SMPL's 24 joints, or two bodies differ
    /// in the number of vertices.
    pub fn new(bodies: impl Into<SubjectBodies<'a>>, spec: SynthSpec) -> Result<Self> {
        spec.check()?;
        let bodies = bodies.into();
        let genders: &[Option<Gender>] = match bodies {
            SubjectBodies::One(_) => &[None],
            SubjectBodies::Genders { .. } => &[Some(Gender::Male), Some(Gender::Female)],
        };
        let mut groups: Vec<SubjectGroup<'_>> = Vec::new();
        for (index, &gender) in genders.iter().enumerate() {
            let subjects: Vec<usize> = (index..spec.subjects).step_by(genders.len()).collect();
            if subjects.is_empty() {
                continue;
            }
            let model = bodies.of(gender)?;
            if let Some(first) = groups.first()
                && first.model.vertices() != model.vertices()
            {
                return Err(Error::Argument(format!(
                    "bodies of {} and {} vertices: expected the same number",
                    first.model.vertices(),
                    model.vertices()
                )));
            }
            groups.push(SubjectGroup {
                gender,
                file: bodies.file_name(gender),
                model,
                wardrobe: Wardrobe::new(model, spec.seed)?,
                subjects,
            });
        }
        Ok(Self { groups, spec })
    }

    /// Specification of the data set.
    pub fn spec(&self) -> &SynthSpec {
        &self.spec
    }

    /// The subjects by body.
    pub fn groups(&self) -> &[SubjectGroup<'a>] {
        &self.groups
    }

    /// Subjects with the body of a subject.
    pub fn group(&self, subject: usize) -> &SubjectGroup<'a> {
        &self.groups[subject % self.groups.len()]
    }

    /// Number of vertices of the bodies.
    pub fn vertices(&self) -> usize {
        self.groups[0].model.vertices()
    }

    /// Indices of the vertices that garments may cover on any of the bodies, ascending.
    pub fn clothing_vertices(&self) -> Vec<usize> {
        let vertices = self.groups.iter().flat_map(|group| group.wardrobe.clothing_vertices());
        vertices.collect::<BTreeSet<_>>().into_iter().collect()
    }

    /// Prepares the generation of a sequence.
    pub fn prepare(&self, sequence: SynthSequence) -> Result<SequenceGenerator> {
        let SynthSequence { subject, outfit, motion } = sequence;
        let path = [4, subject as u64, outfit.stream(), motion as u64];
        let style =
            MotionStyle::random(&mut ChaCha8Rng::seed_from_u64(mix_seed(self.spec.seed, &path)));
        let group = self.group(subject);
        let garment = group.wardrobe.outfit_style(subject, outfit, motion as usize)?;
        Ok(SequenceGenerator {
            sequence,
            style,
            fitted: group.wardrobe.fit(garment),
            minimal: group.minimal(subject)?,
        })
    }

    /// Pose of a frame in axis-angle, radians, `[72]`.
    pub fn pose(&self, generator: &SequenceGenerator, frame: usize) -> [f64; 72] {
        generator.sequence.motion.pose(&generator.style, self.time(frame))
    }

    /// Clothing displacement of a frame with scan noise, metres, `[V, 3]`.
    pub fn displacement(&self, generator: &SequenceGenerator, frame: usize) -> Result<Array2<f64>> {
        let pose = self.pose(generator, frame);
        let noise = Some(frame as u64);
        let wardrobe = &self.group(generator.sequence.subject).wardrobe;
        wardrobe.displacement(&generator.fitted, &pose, self.time(frame), noise)
    }

    /// Generates one frame of a sequence.
    pub fn frame(&self, generator: &SequenceGenerator, frame: usize) -> Result<SynthFrame> {
        let pose = self.pose(generator, frame);
        let displacement = self.displacement(generator, frame)?;
        let minimal = &generator.minimal;
        let model = self.group(generator.sequence.subject).model;
        let posed = model.pose_shape(minimal, &pose, [0.0; 3], Some(&displacement))?.vertices;
        let floor = posed.column(1).iter().copied().fold(f64::INFINITY, f64::min);
        let transl = Array1::from_vec(vec![0.0, -floor, 0.0]);
        Ok(SynthFrame {
            v_cano: (minimal + &displacement).mapv(|x| x as f32),
            v_posed: (posed + &transl).mapv(|x| x as f32),
            pose: Array1::from_vec(pose.to_vec()),
            transl,
        })
    }

    /// Generates all frames of a sequence, in parallel.
    pub fn frames(&self, sequence: SynthSequence) -> Result<Vec<SynthFrame>> {
        let generator = self.prepare(sequence)?;
        let frames = 0..self.spec.frames_per_sequence;
        frames.into_par_iter().map(|frame| self.frame(&generator, frame)).collect()
    }

    /// Writes the data set under `root` in the layout of the CAPE release.
    ///
    /// `sequences/<subject>/<outfit>_<motion>/<outfit>_<motion>.000001.npz` and so on with `v_cano`,
    /// `v_posed` (float32), `pose` and `transl` (float64), and what [`Self::write_subjects`] writes.
    /// Files are written atomically. `progress` gets the numbers of written
    /// and of all frames after every sequence.
    pub fn write(
        &self,
        root: impl AsRef<Path>,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<()> {
        let root = root.as_ref();
        self.write_subjects(root)?;
        let sequences = self.spec.sequences();
        let mut names = HashSet::new();
        if let Some(twice) = sequences.iter().find(|sequence| !names.insert(**sequence)) {
            return Err(Error::Argument(format!(
                "{} of {} is listed twice: name each outfit and each motion once",
                twice.name(),
                twice.subject_name()
            )));
        }
        let total = sequences.len() * self.spec.frames_per_sequence;
        progress(0, total);
        for (done, &sequence) in sequences.iter().enumerate() {
            let name = sequence.name();
            let directory = root.join("sequences").join(sequence.subject_name()).join(&name);
            create(&directory)?;
            let generator = self.prepare(sequence)?;
            (0..self.spec.frames_per_sequence).into_par_iter().try_for_each(|frame| {
                let path = directory.join(format!("{name}.{:06}.npz", frame + 1));
                self.frame(&generator, frame)?.write(path)
            })?;
            progress((done + 1) * self.spec.frames_per_sequence, total);
        }
        Ok(())
    }

    /// Writes what all sequences of a data set share: `minimal_body_shape/<subject>/<subject>_minimal.npy`;
    /// `body.npz`, the body in SMPL's layout, or `body_male.npz` and `body_female.npz` with the subjects'
    /// genders in `misc/subj_genders.pkl`; `clothing_verts_idx.npy`.
    pub fn write_subjects(&self, root: &Path) -> Result<()> {
        create(root)?;
        let mut genders = BTreeMap::new();
        for group in &self.groups {
            group.model.save(root.join(group.file))?;
            if let Some(gender) = group.gender {
                genders.extend(group.subject_names().into_iter().map(|name| (name, gender)));
            }
        }
        if !genders.is_empty() {
            write_genders(root, &genders)?;
        }
        let clothing = self.clothing_vertices().into_iter().map(|vertex| vertex as i64);
        write_npy(root.join("clothing_verts_idx.npy"), &clothing.collect::<Array1<_>>())?;
        for subject in 0..self.spec.subjects {
            let name = subject_name(subject);
            let directory = root.join("minimal_body_shape").join(&name);
            create(&directory)?;
            write_npy(
                directory.join(format!("{name}_minimal.npy")),
                &self.group(subject).minimal(subject)?,
            )?;
        }
        Ok(())
    }

    fn time(&self, frame: usize) -> f64 {
        frame as f64 / self.spec.frame_rate
    }
}

fn create(directory: &Path) -> Result<()> {
    fs::create_dir_all(directory).map_err(|source| Error::io(directory, source))
}
