use std::path::PathBuf;

use cape_layer::{
    LayerSet,
    cloth::{Garment, GarmentKind, Material},
    synth::{Design, Exercise},
};
use clap::{Args, ValueEnum};
use serde::Serialize;

use super::body;
use crate::{arguments::at_least_one, console::Console, error::Result, files};

/// Simulate a garment over moving bodies.
///
/// Every subject does every exercise in every size and material.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  cape layer synth --garment skirt --frames 100 --out skirt")]
pub(super) struct Synth {
    /// Directory to write; it must be empty or missing.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// What is worn.
    #[arg(long, value_enum, default_value_t = Kind::Skirt)]
    garment: Kind,
    /// The body, .pkl or .npz; by default the synthetic one.
    #[arg(long, value_name = "SMPL")]
    body: Option<PathBuf>,
    /// Frames of each sequence.
    #[arg(long, default_value_t = 100, value_name = "N", value_parser = at_least_one)]
    frames: usize,
    /// Frames a second.
    #[arg(long, default_value_t = 30.0, value_name = "FPS")]
    fps: f64,
    /// Subjects, by their first shape coefficient.
    #[arg(
        long,
        value_delimiter = ',',
        allow_hyphen_values = true,
        default_value = "0",
        value_name = "B,…"
    )]
    subjects: Vec<f64>,
    /// Lengths of the garment, as ratios to its usual one.
    #[arg(long, value_delimiter = ',', default_value = "1", value_name = "R,…")]
    lengths: Vec<f64>,
    /// Stiffness of the cloth, as ratios to that of cotton jersey.
    #[arg(long, value_delimiter = ',', default_value = "1", value_name = "R,…")]
    stiffness: Vec<f64>,
    /// What subjects do: walk, squat, march, swing, jump; by default all.
    #[arg(long, value_delimiter = ',', value_name = "EXERCISE,…", value_parser = exercise)]
    exercises: Vec<Exercise>,
    /// Length of triangles' edges, millimetres.
    #[arg(long, default_value_t = 25.0, value_name = "MM")]
    resolution: f64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum Kind {
    Tshirt,
    Shorts,
    Skirt,
    Dress,
}

impl From<Kind> for GarmentKind {
    fn from(kind: Kind) -> Self {
        match kind {
            Kind::Tshirt => Self::TShirt,
            Kind::Shorts => Self::Shorts,
            Kind::Skirt => Self::Skirt,
            Kind::Dress => Self::Dress,
        }
    }
}

fn exercise(name: &str) -> Result<Exercise, String> {
    Exercise::ALL.into_iter().find(|exercise| exercise.name() == name).ok_or_else(|| {
        let names: Vec<&str> = Exercise::ALL.iter().map(|exercise| exercise.name()).collect();
        format!("expected one of {}", names.join(", "))
    })
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    sequences: usize,
    frames: usize,
    vertices: usize,
}

impl Synth {
    pub(super) fn run(self, console: Console) -> Result {
        files::require_empty(&self.out)?;
        let model = body(self.body.as_deref())?;
        let kind = GarmentKind::from(self.garment);
        let garment = Garment { resolution: 1e-3 * self.resolution, ..Garment::of(kind) };
        let usual = Material::default();
        let design = Design {
            subjects: self.subjects.iter().map(|&beta| vec![beta]).collect(),
            sizes: self
                .lengths
                .iter()
                .map(|ratio| Garment { length: garment.length * ratio, ..garment })
                .collect(),
            materials: self
                .stiffness
                .iter()
                .map(|ratio| Material {
                    stretch: usual.stretch / ratio,
                    bend: usual.bend / ratio,
                    ..usual
                })
                .collect(),
            frames: self.frames,
            frame_rate: self.fps,
            exercises: match &self.exercises[..] {
                [] => Exercise::ALL.to_vec(),
                chosen => chosen.to_vec(),
            },
            ..Design::of(garment)
        };
        let sewn = design.sew(&model)?;
        let takes = design.takes();
        let mut sequences = Vec::with_capacity(takes.len());
        console.while_showing("simulate", "sequences", |progress| {
            for (index, &take) in takes.iter().enumerate() {
                sequences.push(design.simulate(&model, &sewn, take)?.0);
                progress(index + 1, takes.len());
            }
            Ok::<_, crate::error::Error>(())
        })?;
        let set = LayerSet::new(sewn.surface.faces, sequences)?;
        set.save(&self.out)?;
        let report = Report {
            sequences: set.sequences.len(),
            frames: set.frames(),
            vertices: set.vertices(),
            out: self.out,
        };
        console.result(&report, || {
            format!(
                "{} frames of {} vertices in {} sequences\n{}",
                report.frames,
                report.vertices,
                report.sequences,
                report.out.display()
            )
        })
    }
}
