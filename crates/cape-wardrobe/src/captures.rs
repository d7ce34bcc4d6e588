//! Simulated data sets in the raw layout of the CAPE release.

use std::{fs, path::Path, sync::mpsc, thread};

use cape_cloth::{SIMULATOR_VERSION, SimulationOptions};
use cape_core::{BodyMotion, DirectoryLock, Outfit, SmplModel, smpl::SubjectBodies};
use cape_synth::{
    CaptureGenerator, Motion, MotionStyle, SubjectGroup, SynthFrame, SynthSpec, mix_seed,
};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use rayon::prelude::*;
use serde::Serialize;

use crate::{
    Error, OutfitCut, Result, TakeQuality, TakeRecord,
    record::{QUALITY_FILE, to_json, write_json},
    take::{DressedSubject, RegistrationNoise},
    take_motion::{RUN_UP, RecordedMotion, take_motion},
};

/// Name of the file of settings in a data set's directory.
pub const PLAN_FILE: &str = "wardrobe.json";

/// Version of the garments' random cuts, and of how they are laid onto the body.
const GARMENTS_VERSION: u32 = 2;

/// Directory in which takes are written before they are complete.
const PARTIAL: &str = ".partial";

/// Least frame rate of the simulation, frames per second.
const SIMULATION_RATE: f64 = 30.0;

/// Random streams of a data set's seed.
const GARMENTS: u64 = 11;
const STYLES: u64 = 4;
const DRESSING: u64 = 12;
const NOISE: u64 = 13;

/// Options of a simulated data set besides its [`SynthSpec`].
///
/// ```
/// use cape_wardrobe::WardrobeOptions;
///
/// let coarse = WardrobeOptions { resolution: 0.03, ..WardrobeOptions::default() };
/// assert_eq!((coarse.takes, coarse.noise), (1, 0.0));
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct WardrobeOptions {
    /// Takes of each motion.
    pub takes: usize,
    /// Length of the garments' edges, metres.
    pub resolution: f64,
    /// Standard deviation of the registration error, metres.
    pub noise: f64,
    /// Share of the cloth's sliding along the skin that vertices follow, 0 to 1. Registrations of scans
    /// follow little of it, as nothing but their regularisation ties a vertex to a place of the cloth;
    /// with 1 each vertex keeps its point on the garment.
    pub sliding: f64,
    /// Named motions from files, recorded besides the synthetic ones.
    pub recordings: Vec<(String, BodyMotion)>,
    /// Options of the simulation.
    pub simulation: SimulationOptions,
}

impl Default for WardrobeOptions {
    fn default() -> Self {
        Self {
            takes: 1,
            resolution: 0.025,
            noise: 0.0,
            sliding: 0.1,
            recordings: Vec::new(),
            simulation: SimulationOptions {
                substeps: 8,
                settle: 0.4,
                ..SimulationOptions::default()
            },
        }
    }
}

/// One of `of` equal shares of the takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    /// Index of the share, from 0.
    pub index: usize,
    /// Number of shares.
    pub of: usize,
}

impl Default for Shard {
    fn default() -> Self {
        Self { index: 0, of: 1 }
    }
}

/// A take of a data set: subject, outfit, motion and the number of the take.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SimulatedTake {
    /// Index of the subject, from 0.
    pub subject: usize,
    /// Outfit of the subject.
    pub outfit: Outfit,
    /// Index of the motion: synthetic motions of the specification, then recordings.
    pub motion: usize,
    /// Name of the motion.
    pub motion_name: String,
    /// Number of the take of this entry of the list of motions, from 0.
    pub trial: usize,
}

/// Generator of a simulated data set.
///
/// ```
/// use cape_core::Outfit;
/// use cape_synth::{Motion, SynthSpec, synthetic_body};
/// use cape_wardrobe::{SimulatedCaptures, WardrobeOptions};
///
/// let body = synthetic_body();
/// let spec = SynthSpec {
///     subjects: 1,
///     outfits: vec![Outfit::SHORT_LONG],
///     motions: vec![Motion::Squats],
///     ..SynthSpec::default()
/// };
/// let options = WardrobeOptions { takes: 2, ..WardrobeOptions::default() };
/// let captures = SimulatedCaptures::new(&body, spec.clone(), options)?;
/// let names: Vec<String> = captures.takes().iter().map(|take| captures.name(take)).collect();
/// assert_eq!(names, ["shortlong_squats_trial1", "shortlong_squats_trial2"]);
///
/// // A motion that is listed several times has as many takes.
/// let spec = SynthSpec { motions: vec![Motion::Squats, Motion::Hips, Motion::Squats], ..spec };
/// let captures = SimulatedCaptures::new(&body, spec, WardrobeOptions::default())?;
/// let names: Vec<String> = captures.takes().iter().map(|take| captures.sequence(take)).collect();
/// assert_eq!(names, ["squats_trial1", "hips", "squats_trial2"]);
/// # Ok::<(), cape_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct SimulatedCaptures<'a> {
    procedural: CaptureGenerator<'a>,
    options: WardrobeOptions,
}

/// Settings that a data set's directory belongs to.
#[derive(Debug, Serialize)]
struct Plan<'a> {
    simulator: u32,
    garments: u32,
    seed: u64,
    subjects: usize,
    frames: usize,
    frame_rate: f64,
    outfits: &'a [Outfit],
    motions: Vec<String>,
    takes: usize,
    resolution: f64,
    noise: f64,
    sliding: f64,
}

impl<'a> SimulatedCaptures<'a> {
    /// Creates a generator for subjects with `bodies`, as [`CaptureGenerator::new`] does.
    ///
    /// # Errors
    /// If specification or options are out of range, or the bodies cannot be dressed.
    pub fn new(
        bodies: impl Into<SubjectBodies<'a>>,
        spec: SynthSpec,
        options: WardrobeOptions,
    ) -> Result<Self> {
        if options.takes == 0 || options.takes > 999 {
            return Err(Error::argument(format!(
                "{} takes of each motion: expected 1 to 999",
                options.takes
            )));
        }
        if !(options.noise >= 0.0 && options.noise < 0.1) {
            return Err(Error::argument(format!(
                "registration error of {} m: expected 0 to 0.1",
                options.noise
            )));
        }
        if !(0.0..=1.0).contains(&options.sliding) {
            return Err(Error::argument(format!(
                "share {} of sliding: expected 0 to 1",
                options.sliding
            )));
        }
        Ok(Self { procedural: CaptureGenerator::new(bodies, spec)?, options })
    }

    /// Specification of the data set.
    pub fn spec(&self) -> &SynthSpec {
        self.procedural.spec()
    }

    /// The subjects by body.
    pub fn groups(&self) -> &[SubjectGroup<'a>] {
        self.procedural.groups()
    }

    /// Number of vertices of the bodies.
    pub fn vertices(&self) -> usize {
        self.procedural.vertices()
    }

    /// Indices of the vertices that garments may cover on any of the bodies, ascending.
    pub fn clothing_vertices(&self) -> Vec<usize> {
        self.procedural.clothing_vertices()
    }

    /// Number of synthetic motions; recordings come after them.
    pub fn synthetic_motions(&self) -> usize {
        self.spec().motions.len()
    }

    /// Names of the motions, in order.
    fn motions(&self) -> Vec<String> {
        let synthetic = self.spec().motions.iter().map(|motion| motion.name().to_owned());
        synthetic.chain(self.options.recordings.iter().map(|(name, _)| name.clone())).collect()
    }

    /// All takes, ordered by subject, outfit, motion and number.
    pub fn takes(&self) -> Vec<SimulatedTake> {
        let motions = self.motions();
        let mut takes = Vec::new();
        for subject in 0..self.spec().subjects {
            for &outfit in &self.spec().outfits {
                for (motion, name) in motions.iter().enumerate() {
                    for trial in 0..self.options.takes {
                        let motion_name = name.clone();
                        takes.push(SimulatedTake { subject, outfit, motion, motion_name, trial });
                    }
                }
            }
        }
        takes
    }

    /// Name of a take's motion in splits: with the number of the take, if the motion has several.
    pub fn sequence(&self, take: &SimulatedTake) -> String {
        let (motions, name, each) = (self.motions(), &take.motion_name, self.options.takes);
        let listed = |motions: &[String]| motions.iter().filter(|&other| other == name).count();
        match listed(&motions) * each {
            1 => name.clone(),
            _ => format!("{name}_trial{}", listed(&motions[..take.motion]) * each + take.trial + 1),
        }
    }

    /// Name of a take in files, `outfit_motion` as in the CAPE release.
    pub fn name(&self, take: &SimulatedTake) -> String {
        format!("{}_{}", take.outfit, self.sequence(take))
    }

    fn seed(&self, stream: u64, take: &SimulatedTake) -> u64 {
        let SimulatedTake { subject, outfit, motion, trial, .. } = *take;
        let path = [stream, subject as u64, outfit.stream(), motion as u64, trial as u64];
        mix_seed(self.spec().seed, &path)
    }

    /// Garments of a subject in an outfit.
    ///
    /// # Errors
    /// If the outfit is none of the paper's four.
    pub fn cut(&self, subject: usize, outfit: Outfit) -> Result<OutfitCut> {
        let seed = mix_seed(self.spec().seed, &[GARMENTS, subject as u64, outfit.stream()]);
        let betas = self.procedural.group(subject).betas(subject);
        Ok(OutfitCut::random(outfit, &betas, seed)?.with_resolution(self.options.resolution))
    }

    /// Frames of the simulation for each recorded frame, and its frame rate.
    fn rate(&self) -> (usize, f64) {
        let rate = self.spec().frame_rate;
        let stride = (SIMULATION_RATE / rate - 1e-9).ceil().max(1.0);
        (stride as usize, rate * stride)
    }

    /// Number of simulated frames of a take, the transition from the sewing pose included.
    pub fn simulated_frames(&self) -> usize {
        let (stride, rate) = self.rate();
        let seconds = RUN_UP + 1.5 * self.options.simulation.settle;
        (seconds * rate).round() as usize + (self.spec().frames_per_sequence - 1) * stride + 1
    }

    /// Simulates a take.
    ///
    /// # Errors
    /// If the garments cannot be sewn, or the simulation diverges.
    pub fn simulate(&self, take: &SimulatedTake) -> Result<(Vec<SynthFrame>, TakeQuality)> {
        let cut = self.cut(take.subject, take.outfit)?;
        let group = self.procedural.group(take.subject);
        let (model, minimal) = (group.body(), group.minimal(take.subject)?);
        let dressed = DressedSubject::new(model, minimal.clone(), cut)?;
        let rng = |stream| ChaCha8Rng::seed_from_u64(self.seed(stream, take));
        let (stride, rate) = self.rate();
        let frames = (self.spec().frames_per_sequence - 1) * stride + 1;
        let mut styles = rng(STYLES);
        let motion = if let Some(&motion) = self.spec().motions.get(take.motion) {
            RecordedMotion::Synthetic(motion, MotionStyle::random(&mut styles))
        } else {
            let (_, file) = &self.options.recordings[take.motion - self.spec().motions.len()];
            // Any part of the file with its run-up, as far as it is long enough.
            let spare = (file.seconds() - frames as f64 / rate).max(0.0);
            let least = spare.min(RUN_UP);
            RecordedMotion::File(file, least + styles.random::<f64>() * (spare - least))
        };
        let subject = (model, &minimal);
        let (motion, run_up) = take_motion(subject, &motion, (frames, rate), &mut rng(DRESSING))?;
        let mut noise = RegistrationNoise { deviation: self.options.noise, rng: rng(NOISE) };
        dressed.simulate(&self.options, &motion, (run_up, stride), &mut noise)
    }

    /// Writes a shard of the data set under `root` in the layout of the CAPE release, as
    /// [`CaptureGenerator::write`] does, and a record of each take. Finished takes are kept; once all
    /// takes are there, `quality.json` has their records. `progress` gets the numbers of finished takes
    /// and of all takes of the shard.
    ///
    /// # Errors
    /// If `root` belongs to other settings, another process simulates the shard, or a take fails.
    pub fn write(
        &self,
        root: &Path,
        shard: Shard,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<Vec<TakeRecord>> {
        if shard.index >= shard.of {
            return Err(Error::argument(format!(
                "shard {} of {}: expected a number from 1 to the number of shards",
                shard.index + 1,
                shard.of
            )));
        }
        fs::create_dir_all(root).map_err(|error| Error::io(root, error))?;
        self.begin(root)?;
        let Shard { index, of } = shard;
        let share = root.join(PARTIAL).join(format!("shard-{}-of-{of}", index + 1));
        fs::create_dir_all(&share).map_err(|error| Error::io(&share, error))?;
        let Some(_lock) = DirectoryLock::try_acquire(&share)? else {
            return Err(Error::Data(format!(
                "{}: another process is simulating shard {} of {of}: wait until it ends, or give each \
                 process a shard of its own",
                root.display(),
                index + 1
            )));
        };
        let all = self.takes();
        let mine: Vec<&SimulatedTake> = all.iter().skip(shard.index).step_by(shard.of).collect();
        progress(0, mine.len());
        let (finished, messages) = mpsc::channel();
        let records = thread::scope(|scope| {
            let worker = scope.spawn(|| {
                let finished = finished;
                mine.par_iter()
                    .with_max_len(1)
                    .map_with(finished, |finished, take| {
                        let record = self.write_take(root, take)?;
                        // The receiver outlives the worker.
                        let _ = finished.send(());
                        Ok(record)
                    })
                    .collect::<Result<Vec<_>>>()
            });
            for (done, ()) in messages.iter().enumerate() {
                progress(done + 1, mine.len());
            }
            worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        })?;
        let record = |take| TakeRecord::read(root, &subject_name(take), &self.name(take));
        let found: Option<Vec<TakeRecord>> = all.iter().map(record).collect::<Result<_>>()?;
        if let Some(found) = found {
            write_json(&root.join(QUALITY_FILE), &found)?;
            let partial = root.join(PARTIAL);
            if partial.exists() {
                fs::remove_dir_all(&partial).map_err(|error| Error::io(partial, error))?;
            }
        }
        Ok(records)
    }

    /// Writes what all takes share, or checks that the directory belongs to the same settings.
    fn begin(&self, root: &Path) -> Result<()> {
        let _lock = DirectoryLock::wait(root)?;
        let spec = self.spec();
        let plan = Plan {
            simulator: SIMULATOR_VERSION,
            garments: GARMENTS_VERSION,
            seed: spec.seed,
            subjects: spec.subjects,
            frames: spec.frames_per_sequence,
            frame_rate: spec.frame_rate,
            outfits: &spec.outfits,
            motions: self.motions(),
            takes: self.options.takes,
            resolution: self.options.resolution,
            noise: self.options.noise,
            sliding: self.options.sliding,
        };
        let path = root.join(PLAN_FILE);
        if path.exists() {
            let there = fs::read_to_string(&path).map_err(|error| Error::io(&path, error))?;
            let of_these = |group: &SubjectGroup<'_>| {
                let path = root.join(group.body_file());
                SmplModel::load(path).is_ok_and(|body| body == *group.body())
            };
            return if there == to_json(&plan)? && self.groups().iter().all(of_these) {
                Ok(())
            } else {
                Err(Error::Data(format!(
                    "{}: holds captures of other settings or bodies, or of another version of the \
                     simulator: choose another directory",
                    root.display()
                )))
            };
        }
        self.procedural.write_subjects(root)?;
        write_json(&path, &plan)
    }

    fn write_take(&self, root: &Path, take: &SimulatedTake) -> Result<TakeRecord> {
        let (subject, name) = (subject_name(take), self.name(take));
        if let Some(record) = TakeRecord::read(root, &subject, &name)? {
            return Ok(record);
        }
        let (frames, quality) = self.simulate(take)?;
        if let Some(record) = TakeRecord::read(root, &subject, &name)? {
            // Another process has finished it meanwhile.
            return Ok(record);
        }
        let process = std::process::id();
        let partial = root.join(PARTIAL).join(format!("{subject}_{name}-{process}"));
        let directory = root.join("sequences").join(&subject).join(&name);
        let parent = root.join("sequences").join(&subject);
        for old in [&partial, &directory] {
            if old.exists() {
                fs::remove_dir_all(old).map_err(|error| Error::io(old, error))?;
            }
        }
        for new in [&partial, &parent] {
            fs::create_dir_all(new).map_err(|error| Error::io(new, error))?;
        }
        for (number, frame) in frames.iter().enumerate() {
            frame.write(partial.join(format!("{name}.{:06}.npz", number + 1)))?;
        }
        fs::rename(&partial, &directory).map_err(|error| Error::io(&directory, error))?;
        let garments = serde_json::to_value(self.cut(take.subject, take.outfit)?)
            .map_err(|error| Error::argument(error.to_string()))?;
        let record = TakeRecord {
            subject: subject.clone(),
            take: name.clone(),
            seed: self.seed(DRESSING, take),
            frames: frames.len(),
            garments,
            quality,
        };
        write_json(&TakeRecord::path(root, &subject, &name), &record)?;
        Ok(record)
    }
}

fn subject_name(take: &SimulatedTake) -> String {
    let SimulatedTake { subject, outfit, .. } = *take;
    // The name does not depend on the motion.
    cape_synth::SynthSequence { subject, outfit, motion: Motion::Simple }.subject_name()
}
