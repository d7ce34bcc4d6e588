//! Synthetic capture sessions: subjects, outfits and movements, frame by frame, and their files in
//! the layout of the CAPE release.

use std::{
    fs,
    path::{Path, PathBuf},
};

use ndarray::{Array1, Array2};
use rand::{SeedableRng, rngs::ChaCha8Rng};
use rayon::prelude::*;

use super::{
    Motion, MotionStyle, Wardrobe,
    wardrobe::{FittedOutfit, mix_seed},
};
use crate::{Error, Result};
use cape_core::{
    Outfit, SmplModel,
    npy::{NpzWriter, write_npy},
};

/// What to synthesise.
///
/// ```
/// use cape_core::Outfit;
/// use cape_synth::{Motion, SynthSpec};
///
/// let spec = SynthSpec {
///     subjects: 2,
///     outfits: vec![Outfit::ShortLong],
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
    /// Frames of every sequence.
    pub frames_per_sequence: usize,
    /// All randomness follows from it.
    pub seed: u64,
    /// Frames a second.
    pub frame_rate: f64,
    /// Outfits that every subject wears.
    pub outfits: Vec<Outfit>,
    /// Movements that every subject performs in every outfit.
    pub motions: Vec<Motion>,
}

impl Default for SynthSpec {
    fn default() -> Self {
        Self {
            subjects: 4,
            frames_per_sequence: 60,
            seed: 1,
            frame_rate: 15.0,
            outfits: Outfit::ALL.to_vec(),
            motions: Motion::ALL.to_vec(),
        }
    }
}

impl SynthSpec {
    /// Names of the subjects, in order.
    pub fn subject_names(&self) -> Vec<String> {
        (0..self.subjects).map(subject_name).collect()
    }

    /// Movements that train, in order.
    pub fn train_motions(&self) -> Vec<Motion> {
        self.motions.iter().copied().filter(|motion| !motion.is_test()).collect()
    }

    /// Movements held out for testing, in order.
    pub fn test_motions(&self) -> Vec<Motion> {
        self.motions.iter().copied().filter(|motion| motion.is_test()).collect()
    }

    /// All takes: for each subject, each outfit, each movement.
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
        if !(self.frame_rate.is_finite() && self.frame_rate > 0.0) {
            return Err(Error::Argument(format!(
                "frame rate {}: expected a positive number",
                self.frame_rate
            )));
        }
        Ok(())
    }
}

/// One sequence: a subject in an outfit performing a movement.
///
/// ```
/// use cape_core::Outfit;
/// use cape_synth::{Motion, SynthSequence};
///
/// let take = SynthSequence { subject: 0, outfit: Outfit::LongLong, motion: Motion::Hips };
/// assert_eq!(take.name(), "longlong_hips");
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct SynthSequence {
    /// Number of the subject, from 0.
    pub subject: usize,
    /// What is worn.
    pub outfit: Outfit,
    /// What is done.
    pub motion: Motion,
}

impl SynthSequence {
    /// The subject's name in files.
    pub fn subject_name(&self) -> String {
        subject_name(self.subject)
    }

    /// The sequence's name in files, outfit first, as in the release.
    pub fn name(&self) -> String {
        format!("{}_{}", self.outfit, self.motion)
    }
}

fn subject_name(subject: usize) -> String {
    format!("s{:04}", subject + 1)
}

/// One frame of a take.
///
/// See [`CaptureGenerator`] for an example.
#[derive(Debug, Clone, PartialEq)]
pub struct SynthFrame {
    /// Clothed vertices in canonical space: minimal body plus displacement, metres, `[V, 3]`.
    pub v_cano: Array2<f32>,
    /// Clothed vertices, posed, metres, `[V, 3]`.
    pub v_posed: Array2<f32>,
    /// 24 axis-angles, `[72]`.
    pub pose: Array1<f64>,
    /// Translation that puts the lowest vertex on the floor `y = 0`, metres, `[3]`.
    pub transl: Array1<f64>,
}

/// A generator of synthetic frames for a body.
///
/// ```
/// use cape_synth::{CaptureGenerator, SynthSpec, synthetic_body};
///
/// let body = synthetic_body();
/// let synth = CaptureGenerator::new(&body, SynthSpec::default())?;
/// let session = synth.prepare(synth.spec().sequences()[0])?;
/// let frame = synth.frame(&session, 3)?;
/// assert_eq!((frame.v_posed.dim(), frame.pose.len()), ((6890, 3), 72));
/// // The lowest vertex is on the floor.
/// let floor = frame.v_posed.column(1).iter().copied().fold(f32::INFINITY, f32::min);
/// assert!(floor.abs() < 1e-6);
/// // In canonical space a frame is the subject's body and its clothes.
/// let clothes = synth.displacement(&session, 3)?;
/// let expected = session.minimal() + &clothes;
/// assert!((frame.v_cano.mapv(f64::from) - expected).iter().all(|x| x.abs() < 1e-6));
/// # Ok::<(), cape_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct CaptureGenerator<'a> {
    model: &'a SmplModel,
    wardrobe: Wardrobe<'a>,
    spec: SynthSpec,
}

/// A take with all that its frames share.
///
/// See [`CaptureGenerator`] for an example.
#[derive(Debug, Clone)]
pub struct SequenceGenerator {
    take: SynthSequence,
    style: MotionStyle,
    fitting: FittedOutfit,
    minimal: Array2<f64>,
}

impl SequenceGenerator {
    /// Who, in what, doing what.
    pub fn sequence(&self) -> SynthSequence {
        self.take
    }

    /// What is worn, laid out on the body.
    pub fn fitted_outfit(&self) -> &FittedOutfit {
        &self.fitting
    }

    /// The subject's unclothed rest vertices, metres, `[V, 3]`.
    pub fn minimal(&self) -> &Array2<f64> {
        &self.minimal
    }
}

impl<'a> CaptureGenerator<'a> {
    /// A generator for `model`, which must have SMPL's 24 joints.
    pub fn new(model: &'a SmplModel, spec: SynthSpec) -> Result<Self> {
        spec.check()?;
        Ok(Self { model, wardrobe: Wardrobe::new(model, spec.seed)?, spec })
    }

    /// What is synthesised.
    pub fn spec(&self) -> &SynthSpec {
        &self.spec
    }

    /// The garments.
    pub fn wardrobe(&self) -> &Wardrobe<'a> {
        &self.wardrobe
    }

    /// A subject's unclothed rest vertices, metres, `[V, 3]`.
    pub fn minimal(&self, subject: usize) -> Result<Array2<f64>> {
        self.model.rest_shape(&self.wardrobe.betas(subject))
    }

    /// Prepares a take.
    pub fn prepare(&self, take: SynthSequence) -> Result<SequenceGenerator> {
        let SynthSequence { subject, outfit, motion } = take;
        let path = [4, subject as u64, outfit.index() as u64, motion as u64];
        let style =
            MotionStyle::random(&mut ChaCha8Rng::seed_from_u64(mix_seed(self.spec.seed, &path)));
        let garment = self.wardrobe.outfit_style(subject, outfit, motion as usize);
        Ok(SequenceGenerator {
            take,
            style,
            fitting: self.wardrobe.fit(garment),
            minimal: self.minimal(subject)?,
        })
    }

    /// The pose of a frame, `[72]`.
    pub fn pose(&self, session: &SequenceGenerator, frame: usize) -> [f64; 72] {
        session.take.motion.pose(&session.style, self.time(frame))
    }

    /// The clothing displacement of a frame with scan noise, metres, `[V, 3]`.
    pub fn displacement(&self, session: &SequenceGenerator, frame: usize) -> Result<Array2<f64>> {
        let pose = self.pose(session, frame);
        let noise = Some(frame as u64);
        self.wardrobe.displacement(&session.fitting, &pose, self.time(frame), noise)
    }

    /// One frame of a take.
    pub fn frame(&self, session: &SequenceGenerator, frame: usize) -> Result<SynthFrame> {
        let pose = self.pose(session, frame);
        let displacement = self.displacement(session, frame)?;
        let minimal = &session.minimal;
        let posed = self.model.pose_shape(minimal, &pose, [0.0; 3], Some(&displacement))?.vertices;
        let floor = posed.column(1).iter().copied().fold(f64::INFINITY, f64::min);
        let transl = Array1::from_vec(vec![0.0, -floor, 0.0]);
        Ok(SynthFrame {
            v_cano: (minimal + &displacement).mapv(|x| x as f32),
            v_posed: (posed + &transl).mapv(|x| x as f32),
            pose: Array1::from_vec(pose.to_vec()),
            transl,
        })
    }

    /// All frames of a take, computed in parallel.
    pub fn frames(&self, take: SynthSequence) -> Result<Vec<SynthFrame>> {
        let session = self.prepare(take)?;
        let frames = 0..self.spec.frames_per_sequence;
        frames.into_par_iter().map(|frame| self.frame(&session, frame)).collect()
    }

    /// Writes everything under `root` in the layout of the CAPE release.
    ///
    /// `sequences/<subject>/<outfit>_<motion>/<outfit>_<motion>.000001.npz` and so on with `v_cano`,
    /// `v_posed` (float32), `pose` and `transl` (float64);
    /// `minimal_body_shape/<subject>/<subject>_minimal.npy`; `body.npz`, the body in SMPL's layout;
    /// `clothing_verts_idx.npy`. Every file appears whole or not at all. `progress` is told the
    /// frames written and their total, after every sequence.
    pub fn write(
        &self,
        root: impl AsRef<Path>,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<()> {
        let root = root.as_ref();
        create(root)?;
        self.model.save(root.join("body.npz"))?;
        let clothing = self.wardrobe.clothing_vertices().into_iter().map(|vertex| vertex as i64);
        write_npy(root.join("clothing_verts_idx.npy"), &clothing.collect::<Array1<_>>())?;
        for subject in 0..self.spec.subjects {
            let name = subject_name(subject);
            let directory = root.join("minimal_body_shape").join(&name);
            create(&directory)?;
            write_npy(directory.join(format!("{name}_minimal.npy")), &self.minimal(subject)?)?;
        }
        let takes = self.spec.sequences();
        let total = takes.len() * self.spec.frames_per_sequence;
        progress(0, total);
        for (done, &take) in takes.iter().enumerate() {
            let name = take.name();
            let directory = root.join("sequences").join(take.subject_name()).join(&name);
            create(&directory)?;
            let session = self.prepare(take)?;
            (0..self.spec.frames_per_sequence).into_par_iter().try_for_each(|frame| {
                let path = directory.join(format!("{name}.{:06}.npz", frame + 1));
                write_frame(path, &self.frame(&session, frame)?)
            })?;
            progress((done + 1) * self.spec.frames_per_sequence, total);
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

fn write_frame(path: PathBuf, frame: &SynthFrame) -> Result<()> {
    let mut archive = NpzWriter::create(path)?;
    archive.add("v_cano", &frame.v_cano)?;
    archive.add("v_posed", &frame.v_posed)?;
    archive.add("pose", &frame.pose)?;
    archive.add("transl", &frame.transl)?;
    archive.finish()
}
