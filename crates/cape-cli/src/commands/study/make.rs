use std::{fs, path::PathBuf};

use cape_core::{BodyPose, Outfit, StagingDirectory};
use cape_data::{PackedSet, Split};
use cape_infer::Run;
use cape_render::{Bounds, Camera, Image, Object, Projection, Style, View, render};
use cape_study::{PairKind, Stimulus, StimulusPair, StudyCase, StudyDesign, stimulus_name};
use clap::Args;
use ndarray::Array3;
use rand::{SeedableRng, rngs::ChaCha8Rng, seq::SliceRandom};
use rand_distr::{Distribution, StandardNormal};
use serde::Serialize;

use super::source::{ClothingRequest, ClothingSource};
use crate::{
    console::Console,
    error::{Error, Result},
    files,
    options::{DataArgs, GlobalArgs, OutputArgs, RunArgs, at_least_one},
    priors::PriorArgs,
};

/// Size of a picture, pixels.
const SIZE: [u32; 2] = [440, 600];
/// Standard deviation of the noise on the clothing of an obvious picture, metres.
const OBVIOUS: f32 = 0.012;

const CONSENT: &str = "\
In this study you compare pictures of dressed people. It takes about ten minutes.

Your choices, their times and the size of your window are recorded, and nothing that names you. You can \
stop at any time by closing the page.
";

/// Make the pictures and the design of a perceptual study.
///
/// Renders pairs of bodies from the front with the same camera, light and material on both sides: one
/// outfit in various poses (the paper's case 1), all outfits in the A-pose (case 2), and a harder set of
/// the same outfit and pose on both sides. Poses and registrations are of held-out frames. Obvious
/// pairs test the attention of raters, practice pairs come first. Edit STUDY/consent.txt before raters
/// see it.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  cape study make runs/cape --out study\n  cape study make \
                        runs/cape --poses 20 --a-pose 5 --matched 10 --trials 20 --out small\n  cape \
                        study make runs/cape --real runs/other --out two-runs")]
pub(crate) struct MakeArgs {
    #[command(flatten)]
    run: RunArgs,
    #[command(flatten)]
    data: DataArgs,
    /// Source on the side that counts as real: registrations, or another run.
    #[arg(long, default_value = "registrations", value_name = "SOURCE")]
    real: String,
    /// Outfit of the pairs in various poses [default: shortlong, or the run's default].
    #[arg(long, value_name = "OUTFIT")]
    outfit: Option<Outfit>,
    /// Number of pairs in various poses.
    #[arg(long, default_value_t = 300, value_name = "N")]
    poses: usize,
    /// Number of pairs in the A-pose, for each outfit.
    #[arg(long, default_value_t = 100, value_name = "N")]
    a_pose: usize,
    /// Number of pairs of the same outfit and pose.
    #[arg(long, default_value_t = 100, value_name = "N")]
    matched: usize,
    /// Number of obvious pairs that test attention.
    #[arg(long, default_value_t = 6, value_name = "N")]
    catches: usize,
    /// Number of practice pairs.
    #[arg(long, default_value_t = 4, value_name = "N")]
    practice: usize,
    /// Number of scored pairs that a rater sees; all, if there are fewer.
    #[arg(long, default_value_t = 60, value_name = "N", value_parser = at_least_one)]
    trials: usize,
    #[command(flatten)]
    drawn: PriorArgs,
    #[command(flatten)]
    output: OutputArgs,
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    scored: usize,
    catches: usize,
    practice: usize,
    pictures: usize,
}

/// A pair before it is drawn.
struct PlannedPair {
    kind: PairKind,
    case: StudyCase,
    outfit: Outfit,
    /// Frames of the real and of the generated side.
    frames: [usize; 2],
    pose: Option<BodyPose>,
    /// Noise on the generated side in place of its source.
    obvious: bool,
}

impl MakeArgs {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        self.output.require_empty()?;
        let device = global.device()?;
        let run = self.run.open(global)?;
        let real = ClothingSource::open(&self.real, &device)?;
        let set = run.open_set(self.data.of(&run)?, Split::Test)?;
        let seed = global.seed();
        let planned = self.plan(&run, &set, seed)?;
        let sources = [real, ClothingSource::Model(Box::new(self.run.open(global)?))];
        let outfits = run.outfits().to_vec();
        let codes = |side: usize| {
            let seed = seed.wrapping_add(side as u64);
            sources[side].codes(&self.drawn, &outfits, planned.len(), seed, console)
        };
        let codes = [codes(0)?, codes(1)?];

        let staging = StagingDirectory::create(&self.output.out)?;
        let stimuli = staging.path.join("stimuli");
        files::create_dir(&stimuli)?;
        let mut pairs = Vec::with_capacity(planned.len());
        console.while_showing("study", "pairs", |progress| -> Result {
            for (sample, pair) in planned.iter().enumerate() {
                let code = sample + run.outfits().require(pair.outfit)? * planned.len();
                let mut worn = Vec::with_capacity(2);
                for side in 0..2 {
                    let obvious = pair.obvious && side == 1;
                    let request =
                        ClothingRequest { frame: pair.frames[side], pose: pair.pose, code };
                    let source =
                        if obvious { &ClothingSource::Registrations } else { &sources[side] };
                    let (mut clothing, wearer) = source.clothing(&set, &request, &codes[side])?;
                    if obvious {
                        spoil(&mut clothing, seed ^ sample as u64);
                    }
                    worn.extend(run.pose_clothed(&clothing, &[wearer])?);
                }
                let mut names = Vec::with_capacity(2);
                for image in front_views(&worn)? {
                    let mut bytes = Vec::new();
                    image.encode(&mut bytes).map_err(|error| Error::io(&stimuli, error))?;
                    let name = stimulus_name(&bytes);
                    files::write_bytes(&stimuli.join(&name), &bytes)?;
                    names.push(name);
                }
                let [real, generated] = &names[..] else {
                    return Err(Error::message(
                        "internal error: a pair of other than two pictures",
                    ));
                };
                let stimulus = |file: &String, frame| Stimulus { file: file.clone(), frame };
                pairs.push(StimulusPair {
                    kind: pair.kind,
                    case: pair.case,
                    outfit: pair.outfit,
                    real: stimulus(real, pair.frames[0]),
                    generated: stimulus(generated, pair.frames[1]),
                });
                progress(sample + 1, planned.len());
            }
            Ok(())
        })?;
        let scored = pairs.iter().filter(|pair| pair.kind == PairKind::Scored).count();
        let generated = self.run.name();
        let trials = self.trials.min(scored);
        let design = StudyDesign::new(seed, trials, [&self.real, &generated], pairs)?;
        design.save(&staging.path)?;
        files::write_text(&staging.path.join("consent.txt"), CONSENT)?;
        let pictures = fs::read_dir(&stimuli).map_err(|error| Error::io(&stimuli, error))?.count();
        staging.commit(&self.output.out)?;
        let report = Report {
            scored,
            catches: self.catches,
            practice: self.practice,
            pictures,
            out: self.output.out,
        };
        console.result(&report, || {
            format!(
                "{scored} scored pairs, {} catch and {} practice pairs, {pictures} pictures; a rater \
                 sees {trials}\n{}",
                report.catches,
                report.practice,
                report.out.display()
            )
        })
    }

    fn plan(&self, run: &Run, set: &PackedSet, seed: u64) -> Result<Vec<PlannedPair>> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut frames_of = |outfit: Outfit| {
            let mut frames: Vec<usize> =
                (0..set.frames()).filter(|&frame| set.outfits()[frame] == outfit).collect();
            frames.shuffle(&mut rng);
            frames
        };
        let outfits: Vec<(Outfit, Vec<usize>)> = run
            .outfits()
            .iter()
            .map(|&outfit| (outfit, frames_of(outfit)))
            .filter(|(_, frames)| !frames.is_empty())
            .collect();
        let wanted = self.outfit.unwrap_or(Outfit::SHORT_LONG);
        let posed = outfits
            .iter()
            .find(|(outfit, _)| *outfit == wanted)
            .or_else(|| outfits.first().filter(|_| self.outfit.is_none()));
        let Some((posed, frames)) = posed else {
            let known: Vec<&str> = outfits.iter().map(|(outfit, _)| outfit.name()).collect();
            return Err(Error::message(format!(
                "no held-out frames of `{}`: expected one of {}",
                wanted.name(),
                known.join(", ")
            )));
        };
        let a_pose = cape_synth::poses::preset("a-pose");
        let mut planned = Vec::new();
        let scored = |case, outfit, frames, pose| PlannedPair {
            kind: PairKind::Scored,
            case,
            outfit,
            frames,
            pose,
            obvious: false,
        };
        // Frames half a list apart, which differ if there are two.
        let two = |frames: &[usize], index: usize| {
            let count = frames.len();
            [frames[index % count], frames[(index + count.div_ceil(2)) % count]]
        };
        planned.extend(
            (0..self.poses).map(|i| scored(StudyCase::Poses, *posed, two(frames, i), None)),
        );
        for (outfit, frames) in &outfits {
            let pair = |i| scored(StudyCase::APose, *outfit, two(frames, i), a_pose);
            planned.extend((0..self.a_pose).map(pair));
        }
        planned.extend((0..self.matched).map(|i| {
            let (outfit, frames) = &outfits[i % outfits.len()];
            let frame = frames[i / outfits.len() % frames.len()];
            scored(StudyCase::Matched, *outfit, [frame; 2], None)
        }));
        for (kind, count) in [(PairKind::Catch, self.catches), (PairKind::Practice, self.practice)]
        {
            planned.extend((0..count).map(|i| {
                let (outfit, frames) = &outfits[i % outfits.len()];
                let frames = two(frames, i / outfits.len());
                // Every other practice pair is as the scored ones.
                let obvious = kind == PairKind::Catch || i % 2 == 0;
                PlannedPair { kind, obvious, ..scored(StudyCase::Poses, *outfit, frames, None) }
            }));
        }
        Ok(planned)
    }
}

/// Adds independent noise to displacements.
fn spoil(displacement: &mut Array3<f32>, seed: u64) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    for value in displacement {
        let noise: f32 = StandardNormal.sample(&mut rng);
        *value += OBVIOUS * noise;
    }
}

/// Pictures of both bodies by one camera, which frames either.
fn front_views(bodies: &[cape_core::Mesh]) -> Result<Vec<Image>> {
    let bounds = Bounds::from_meshes(bodies)
        .ok_or_else(|| Error::message("nothing to draw: the body has no vertices"))?;
    let [width, height] = SIZE;
    let aspect = width as f32 / height as f32;
    let camera = Camera::framing(&bounds, View::Front, Projection::default(), aspect);
    let style = Style { width, height, ..Style::default() };
    let draw = |body| Ok(render(&[Object::new(body)], &camera, &style)?);
    bodies.iter().map(draw).collect()
}
