use std::path::PathBuf;

use cape_core::{Outfit, StagingDirectory};
use cape_data::{SequenceList, SplitSpec};
use cape_synth::Motion;
use clap::Args;
use serde::Serialize;

use super::{simulated::SimulatedArgs, tree_files::TreeFiles};
use crate::{
    body_source::SubjectBodyArgs,
    console::{Console, seconds},
    error::{Context, Result},
    options::{GlobalArgs, OutputArgs, at_least_one, choices},
    table::Table,
};

/// Create synthetic captures in the raw layout of the CAPE data set.
///
/// Subjects in the four outfits perform motions, some of which are held out for testing; the first, third
/// and so on are male, the others female. Writes the frames, the bodies in SMPL's layout (body_male.npz,
/// body_female.npz), the clothing vertices (clothing_verts_idx.npy) and the splits into training and test
/// sequences (split_male.toml, split_female.toml), and with --body one body.npz and split.toml.
///
/// With --clothes simulated, garments of each subject's own are simulated over the body and laid onto
/// its topology; quality.json then has the quality of each take. Run the same command again to resume.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  cape data synth --out raw --subjects 4 --frames-per-sequence 60 --seed 1\n  \
                  cape data synth --clothes simulated --subjects 2 --motions walk_march,squats \
                  --frames-per-sequence 30 --out simulated"
)]
pub(crate) struct SynthArgs {
    #[command(flatten)]
    output: OutputArgs,
    /// Number of subjects.
    #[arg(long, default_value_t = 4, value_name = "N", value_parser = at_least_one)]
    subjects: usize,
    /// Frames per sequence.
    #[arg(long, default_value_t = 60, value_name = "K", value_parser = at_least_one)]
    frames_per_sequence: usize,
    /// Outfits [default: the paper's four].
    #[arg(long, value_delimiter = ',', value_name = "OUTFIT,…")]
    outfits: Vec<Outfit>,
    /// Synthetic motions; with --clothes simulated one that is listed twice has two takes [default: the
    /// 15 of the captures].
    #[arg(long, value_delimiter = ',', value_name = "MOTION,…")]
    motions: Vec<Motion>,
    /// Displacements by formula, or garments simulated over the moving body.
    #[arg(long, default_value = "procedural", value_name = "KIND", value_parser = choices(CLOTHES))]
    clothes: Clothes,
    #[command(flatten)]
    simulated: SimulatedArgs,
    #[command(flatten)]
    body: SubjectBodyArgs,
}

/// Kind of clothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Clothes {
    Procedural,
    Simulated,
}

const CLOTHES: [(&str, Clothes); 2] =
    [("procedural", Clothes::Procedural), ("simulated", Clothes::Simulated)];

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    subjects: usize,
    sequences: usize,
    frames: usize,
    vertices: usize,
    clothing_vertices: usize,
    seconds: f64,
}

impl SynthArgs {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        let start = std::time::Instant::now();
        let models = self.body.load()?;
        let defaults = cape_synth::SynthSpec::default();
        let spec = cape_synth::SynthSpec {
            subjects: self.subjects,
            frames_per_sequence: self.frames_per_sequence,
            seed: global.seed(),
            outfits: or_default(self.outfits, defaults.outfits),
            motions: or_default(self.motions, defaults.motions),
            ..defaults
        };
        if self.clothes == Clothes::Simulated {
            return self.simulated.run(models.bodies(), spec, self.output.out, console);
        }
        self.simulated.require_absent()?;
        let out = self.output.out;
        let staging = StagingDirectory::create(&out)?;
        let split = split_of(&spec);
        let sequences = spec.sequences().len();
        let synth = cape_synth::CaptureGenerator::new(models.bodies(), spec)
            .doing(|| "preparing clothing for the body".into())?;
        console
            .while_showing("synth", "frames", |progress| synth.write(&staging.path, progress))?;
        let layout = TreeFiles::write_splits(&staging.path, synth.groups(), &split)?;
        staging.commit(&out)?;
        let report = Report {
            subjects: self.subjects,
            sequences,
            frames: sequences * self.frames_per_sequence,
            vertices: synth.vertices(),
            clothing_vertices: synth.clothing_vertices().len(),
            seconds: start.elapsed().as_secs_f64(),
            out,
        };
        console.result(&report, || report.text(&layout))
    }
}

fn or_default<T>(given: Vec<T>, default: Vec<T>) -> Vec<T> {
    if given.is_empty() { default } else { given }
}

/// The split into training and test motions of `spec`.
pub(crate) fn split_of(spec: &cape_synth::SynthSpec) -> SplitSpec {
    let names = |motions: Vec<cape_synth::Motion>| SequenceList {
        sequences: motions.into_iter().map(|motion| motion.name().to_owned()).collect(),
        exclude: Vec::new(),
    };
    SplitSpec {
        subjects: spec.subject_names(),
        outfits: spec.outfits.clone(),
        train: names(spec.train_motions()),
        test: names(spec.test_motions()),
        ..SplitSpec::default()
    }
}

impl Report {
    fn text(&self, layout: &TreeFiles) -> String {
        let mut table = Table::default();
        table.row(["subjects".to_owned(), self.subjects.to_string()]);
        table.row(["sequences".to_owned(), self.sequences.to_string()]);
        table.row(["frames".to_owned(), self.frames.to_string()]);
        table.row(["vertices".to_owned(), self.vertices.to_string()]);
        table.row(["clothing vertices".to_owned(), self.clothing_vertices.to_string()]);
        table.row(["time".to_owned(), seconds(self.seconds)]);
        format!("{}\n\n{}", table.text(), layout.text(&self.out, ""))
    }
}
