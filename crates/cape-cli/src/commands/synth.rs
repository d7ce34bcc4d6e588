use std::path::PathBuf;

use cape_core::SmplModel;
use cape_data::{
    SequenceList, SplitSpec,
    raw::{BODY_FILE, CLOTHING_FILE, SPLIT_FILE},
};
use clap::Args;
use serde::Serialize;

use crate::{
    arguments::{GlobalArgs, at_least_one},
    console::{Console, seconds},
    error::{Context, Result},
    files,
    table::Table,
};

/// Write synthetic captures in the raw layout of the CAPE data set.
///
/// Subjects in four outfits perform movements; some movements are held out for testing. Beside the
/// frames come the body in SMPL's layout (body.npz), the vertices that clothes cover
/// (clothing_verts_idx.npy) and the split into training and test (split.toml).
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  cape synth --out raw --subjects 4 --frames-per-sequence 60 --seed 1"
)]
pub(crate) struct SynthArgs {
    /// Directory to write; it must be empty or missing.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Number of subjects.
    #[arg(long, default_value_t = 4, value_name = "N", value_parser = at_least_one)]
    subjects: usize,
    /// Frames of every sequence.
    #[arg(long, default_value_t = 60, value_name = "K", value_parser = at_least_one)]
    frames_per_sequence: usize,
    /// Body to dress, SMPL's .pkl or .npz; by default a synthetic one.
    #[arg(long, value_name = "SMPL")]
    body: Option<PathBuf>,
}

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
        let body = match &self.body {
            Some(path) => SmplModel::load(path)?,
            None => cape_synth::synthetic_body(),
        };
        let spec = cape_synth::SynthSpec {
            subjects: self.subjects,
            frames_per_sequence: self.frames_per_sequence,
            seed: global.seed.unwrap_or(1),
            ..cape_synth::SynthSpec::default()
        };
        files::require_empty(&self.out)?;
        let split = split_of(&spec);
        let (sequences, vertices) = (spec.sequences().len(), body.vertices());
        let synth =
            cape_synth::CaptureGenerator::new(&body, spec).doing(|| "dressing the body".into())?;
        console.while_showing("synth", "frames", |progress| synth.write(&self.out, progress))?;
        files::write_text(&self.out.join(SPLIT_FILE), &split.to_toml()?)?;
        let report = Report {
            subjects: self.subjects,
            sequences,
            frames: sequences * self.frames_per_sequence,
            vertices,
            clothing_vertices: synth.wardrobe().clothing_vertices().len(),
            seconds: start.elapsed().as_secs_f64(),
            out: self.out,
        };
        console.result(&report, || report.text())
    }
}

/// The split that the movements of `spec` are meant for.
pub(crate) fn split_of(spec: &cape_synth::SynthSpec) -> SplitSpec {
    let names = |motions: Vec<cape_synth::Motion>| SequenceList {
        sequences: motions.into_iter().map(|motion| motion.name().to_owned()).collect(),
        exclude: Vec::new(),
    };
    SplitSpec {
        subjects: spec.subject_names(),
        outfits: spec.outfits.clone(),
        cut: 2,
        sample_rate: 1,
        train: names(spec.train_motions()),
        test: names(spec.test_motions()),
    }
}

impl Report {
    fn text(&self) -> String {
        let mut table = Table::default();
        table.row(["subjects".to_owned(), self.subjects.to_string()]);
        table.row(["sequences".to_owned(), self.sequences.to_string()]);
        table.row(["frames".to_owned(), self.frames.to_string()]);
        table.row(["vertices".to_owned(), self.vertices.to_string()]);
        table.row(["clothed".to_owned(), self.clothing_vertices.to_string()]);
        table.row(["time".to_owned(), seconds(self.seconds)]);
        let out = self.out.display();
        format!(
            "{}\n\n{out}: {BODY_FILE}, {CLOTHING_FILE}, {SPLIT_FILE}, sequences/, \
             minimal_body_shape/\nnext: cape pack {out} --out {out}-packed",
            table.text()
        )
    }
}
