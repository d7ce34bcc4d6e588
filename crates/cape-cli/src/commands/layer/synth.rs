use std::{
    path::{Path, PathBuf},
    time::Instant,
};

use cape_cloth::{ClothMaterial, Garment, GarmentKind, GarmentMesh, SimulationQuality};
use cape_core::SmplModel;
use cape_infer::write_json;
use cape_layer::{
    LayerSet,
    synth::{Design, DesignCell, Exercise, append_body},
};
use clap::{Args, ValueEnum};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::body;
use crate::{
    arguments::at_least_one,
    console::Console,
    error::{Error, Result},
    files,
    table::Table,
};

const PLAN: &str = "design.json";
const DONE: &str = "simulation.json";

/// Simulate a garment over moving bodies.
///
/// Every subject does every exercise in every size and material: lists of ratios span a full grid.
/// Each sequence is saved when it is done; the same command goes on where it was interrupted.
/// simulation.json tells how far cloth was inside the body and itself, and how much it stretched.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  cape layer synth --garment skirt --frames 100 --out skirt\n  \
                  cape layer synth --garment tshirt --subjects=-1,0,1 --widths 1,1.1 \
                  --stiffness 0.1,1 --out shirts"
)]
pub(super) struct SynthArgs {
    /// Directory to write, or to go on with.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    plan: SimulationPlan,
}

/// What is simulated, and what makes two invocations the same.
#[derive(Debug, PartialEq, Args, Serialize, Deserialize)]
struct SimulationPlan {
    /// What is worn.
    #[arg(long, value_enum, default_value_t = GarmentName::Skirt)]
    garment: GarmentName,
    /// The body, .pkl or .npz; by default the synthetic one.
    #[arg(long, value_name = "SMPL")]
    body: Option<PathBuf>,
    /// Frames of each sequence.
    #[arg(long, default_value_t = 100, value_name = "N", value_parser = at_least_one)]
    frames: usize,
    /// Frames a second.
    #[arg(long, default_value_t = 30.0, value_name = "FPS")]
    fps: f64,
    /// Steps of the simulation a frame.
    #[arg(long, default_value_t = 20, value_name = "N", value_parser = at_least_one)]
    steps: usize,
    /// Length of triangles' edges, millimetres.
    #[arg(long, default_value_t = 25.0, value_name = "MM")]
    resolution: f64,
    /// What subjects do: walk, squat, march, swing, jump; by default all.
    #[arg(long, value_delimiter = ',', value_name = "EXERCISE,…", value_parser = exercise)]
    exercises: Vec<Exercise>,
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
    /// Widths, as ratios to the usual one.
    #[arg(long, value_delimiter = ',', default_value = "1", value_name = "R,…")]
    widths: Vec<f64>,
    /// Lengths of sleeves, as ratios to the usual one.
    #[arg(long, value_delimiter = ',', default_value = "1", value_name = "R,…")]
    sleeves: Vec<f64>,
    /// Stiffness of the cloth in stretching and bending, as ratios to that of cotton jersey.
    #[arg(long, value_delimiter = ',', default_value = "1", value_name = "R,…")]
    stiffness: Vec<f64>,
    /// Further ratios of its stiffness in bending alone.
    #[arg(long, value_delimiter = ',', default_value = "1", value_name = "R,…")]
    bending: Vec<f64>,
    /// Masses of a square metre, as ratios to that of cotton jersey.
    #[arg(long, value_delimiter = ',', default_value = "1", value_name = "R,…")]
    masses: Vec<f64>,
    /// Dampings, as ratios to that of cotton jersey.
    #[arg(long, value_delimiter = ',', default_value = "1", value_name = "R,…")]
    damping: Vec<f64>,
    /// Frictions against the body, as ratios to that of cotton jersey.
    #[arg(long, value_delimiter = ',', default_value = "1", value_name = "R,…")]
    friction: Vec<f64>,
    /// Let the clothing mesh have the body's vertices after its own.
    #[arg(long)]
    with_body: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum GarmentName {
    Tshirt,
    Shorts,
    Skirt,
    Dress,
}

impl From<GarmentName> for GarmentKind {
    fn from(kind: GarmentName) -> Self {
        match kind {
            GarmentName::Tshirt => Self::TShirt,
            GarmentName::Shorts => Self::Shorts,
            GarmentName::Skirt => Self::Skirt,
            GarmentName::Dress => Self::Dress,
        }
    }
}

fn exercise(name: &str) -> Result<Exercise, String> {
    Exercise::ALL.into_iter().find(|exercise| exercise.name() == name).ok_or_else(|| {
        let names: Vec<&str> = Exercise::ALL.iter().map(|exercise| exercise.name()).collect();
        format!("expected one of {}", names.join(", "))
    })
}

/// Every value so far in every change.
fn vary<T: Copy>(values: &[T], ratios: &[f64], change: impl Fn(T, f64) -> T) -> Vec<T> {
    values
        .iter()
        .flat_map(|&value| ratios.iter().map(move |&r| (value, r)))
        .map(|(value, ratio)| change(value, ratio))
        .collect()
}

impl SimulationPlan {
    fn design(&self) -> Design {
        let kind = GarmentKind::from(self.garment);
        let garment = Garment { resolution: 1e-3 * self.resolution, ..Garment::new(kind) };
        let sizes = vary(&[garment], &self.lengths, |g, r| Garment { length: g.length * r, ..g });
        let sizes = vary(&sizes, &self.widths, |g, r| Garment { width: g.width * r, ..g });
        let sizes = vary(&sizes, &self.sleeves, |g, r| Garment { sleeve: g.sleeve * r, ..g });
        let materials = vary(&[ClothMaterial::default()], &self.stiffness, |m, r| ClothMaterial {
            stretch: m.stretch / r,
            bend: m.bend / r,
            ..m
        });
        let materials =
            vary(&materials, &self.bending, |m, r| ClothMaterial { bend: m.bend / r, ..m });
        let materials =
            vary(&materials, &self.masses, |m, r| ClothMaterial { density: m.density * r, ..m });
        let materials =
            vary(&materials, &self.damping, |m, r| ClothMaterial { damping: m.damping * r, ..m });
        let materials = vary(&materials, &self.friction, |m, r| ClothMaterial {
            friction: m.friction * r,
            ..m
        });
        let mut design = Design {
            subjects: self.subjects.iter().map(|&beta| vec![beta]).collect(),
            sizes,
            materials,
            frames: self.frames,
            frame_rate: self.fps,
            ..Design::new(garment)
        };
        design.simulation.substeps = self.steps;
        if !self.exercises.is_empty() {
            design.exercises.clone_from(&self.exercises);
        }
        design
    }
}

/// A line of simulation.json.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct SimulationRecord {
    name: String,
    penetration_mm: f64,
    mean_penetration_mm: f64,
    crossings: usize,
    mean_strain: f64,
    strain: f64,
    metres_per_second: f64,
}

impl SimulationRecord {
    fn new(name: String, quality: &SimulationQuality) -> Self {
        // Short enough to be read back as they are.
        let rounded = |x: f64| (x * 1e5).round() / 1e5;
        Self {
            name,
            penetration_mm: rounded(1e3 * quality.penetration),
            mean_penetration_mm: rounded(1e3 * quality.mean_depth),
            crossings: quality.crossings,
            mean_strain: rounded(quality.mean_strain),
            strain: rounded(quality.strain),
            metres_per_second: rounded(quality.speed),
        }
    }

    fn row(&self) -> [String; 6] {
        [
            self.name.clone(),
            format!("{:.2}", self.penetration_mm),
            format!("{:.4}", self.mean_penetration_mm),
            self.crossings.to_string(),
            format!("{:.1}", 1e2 * self.mean_strain),
            format!("{:.0}", 1e2 * self.strain),
        ]
    }
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    sequences: usize,
    frames: usize,
    vertices: usize,
    simulated_now: usize,
    seconds_per_frame: Option<f64>,
    simulations: Vec<SimulationRecord>,
}

impl SynthArgs {
    pub(super) fn run(self, console: Console) -> Result {
        let model = body(self.plan.body.as_deref())?;
        let design = self.plan.design();
        let sewn = design.sew(&model)?;
        for size in &design.sizes {
            sewn.resize(&model, size)?;
        }
        for material in &design.materials {
            material.check()?;
        }
        let mut done = self.begin()?;
        let takes = design.cells();
        let left: Vec<DesignCell> = takes
            .iter()
            .filter(|take| !done.iter().any(|done| done.name == take.name()))
            .copied()
            .collect();
        let start = Instant::now();
        console.while_showing("simulate", "sequences", |progress| {
            // As many side by side as there are threads; each is the same alone.
            for some in left.chunks(rayon::current_num_threads()) {
                progress(done.len(), takes.len());
                self.simulate((&model, &sewn), &design, some, &mut done, console)?;
            }
            Ok::<_, Error>(())
        })?;
        let seconds = start.elapsed().as_secs_f64() / (left.len() * self.plan.frames) as f64;
        let extra = if self.plan.with_body { model.vertices() } else { 0 };
        let report = Report {
            sequences: takes.len(),
            frames: takes.len() * self.plan.frames,
            vertices: sewn.surface.vertices.len() + extra,
            simulated_now: left.len(),
            seconds_per_frame: seconds.is_finite().then_some(seconds),
            simulations: done,
            out: self.out,
        };
        console.result(&report, || report.text())
    }

    /// Makes the directory, or reads what is done of the same plan.
    fn begin(&self) -> Result<Vec<SimulationRecord>> {
        let path = self.out.join(PLAN);
        if path.exists() {
            if read::<SimulationPlan>(&path)? != self.plan {
                return Err(Error::message(format!(
                    "{}: holds sequences of other settings: choose another --out",
                    self.out.display()
                )));
            }
            let done = self.out.join(DONE);
            return if done.exists() { read(&done) } else { Ok(Vec::new()) };
        }
        files::require_empty(&self.out)?;
        files::create_dir(&self.out)?;
        write_json(&path, &self.plan)?;
        Ok(Vec::new())
    }

    fn simulate(
        &self,
        (model, sewn): (&SmplModel, &GarmentMesh),
        design: &Design,
        takes: &[DesignCell],
        done: &mut Vec<SimulationRecord>,
        console: Console,
    ) -> Result {
        let results: Vec<_> =
            takes.par_iter().map(|&take| design.simulate(model, sewn, take)).collect();
        for result in results {
            let (sequence, quality) = result?;
            let faces = &sewn.surface.faces;
            if self.plan.with_body {
                let (faces, whole) = append_body(model, faces, &sequence)?;
                LayerSet::add(&self.out, &faces, &whole)?;
            } else {
                LayerSet::add(&self.out, faces, &sequence)?;
            }
            let simulation = SimulationRecord::new(sequence.name, &quality);
            console.note(&format!(
                "{}: {:.2} mm inside the body at most, {:.4} mm on average, {} edges through cloth, \
                 lengthened by {:.0} % at most",
                simulation.name,
                simulation.penetration_mm,
                simulation.mean_penetration_mm,
                simulation.crossings,
                1e2 * simulation.strain
            ));
            done.push(simulation);
            write_json(&self.out.join(DONE), done)?;
        }
        Ok(())
    }
}

impl Report {
    fn text(&self) -> String {
        let mut table = Table::new([
            "sequence",
            "inside, mm",
            "mean, mm",
            "crossings",
            "strain, %",
            "at most, %",
        ]);
        for simulation in &self.simulations {
            table.row(simulation.row());
        }
        let seconds =
            self.seconds_per_frame.map_or(String::new(), |s| format!(", {s:.3} s a frame"));
        format!(
            "{}\n\n{} frames of {} vertices in {} sequences, {} of them now{seconds}\n{}",
            table.text(),
            self.frames,
            self.vertices,
            self.sequences,
            self.simulated_now,
            self.out.display()
        )
    }
}

fn read<T: for<'de> Deserialize<'de>>(path: &Path) -> Result<T> {
    let text = std::fs::read(path).map_err(|error| Error::io(path, error))?;
    Ok(serde_json::from_slice(&text)
        .map_err(|error| cape_core::Error::format(path, error.to_string()))?)
}
