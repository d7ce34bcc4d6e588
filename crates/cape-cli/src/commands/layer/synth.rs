use std::{
    path::{Path, PathBuf},
    time::Instant,
};

use cape_cloth::{
    ClothMaterial, Garment, GarmentKind, GarmentMesh, SIMULATOR_VERSION, SimulationQuality,
};
use cape_core::{DirectoryLock, SmplModel};
use cape_infer::write_json;
use cape_layer::{
    LayerSet,
    synth::{Design, DesignCell, Exercise, append_body},
};
use clap::Args;
use rayon::prelude::*;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::{
    body_source::BodyModelArgs,
    console::Console,
    error::{Error, Result},
    files,
    options::{ResumableOutputArgs, at_least_one, choices, non_negative, positive},
    table::Table,
};

const PLAN: &str = "design.json";
const DONE: &str = "simulation.json";

/// Simulate a garment over moving bodies.
///
/// Simulates every combination of subject, exercise, size and material; lists of ratios span a grid.
/// Writes a set of sequences, and simulation.json with penetration, crossings and strain of each. Run the
/// same command again to resume.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  cape layer synth --garment skirt --frames 100 --out skirt\n  \
                  cape layer synth --garment tshirt --subjects=-1,0,1 --widths 1,1.1 \
                  --stiffness 0.1,1 --out shirts"
)]
pub(crate) struct SynthArgs {
    #[command(flatten)]
    output: ResumableOutputArgs,
    #[command(flatten)]
    plan: SimulationPlan,
}

/// Settings of a simulation, which its directory belongs to.
#[derive(Debug, PartialEq, Args, Serialize, Deserialize)]
struct SimulationPlan {
    /// Garment.
    #[arg(long, default_value = "skirt", value_name = "GARMENT", value_parser = choices(GARMENTS))]
    #[serde(serialize_with = "write_garment", deserialize_with = "read_garment")]
    garment: GarmentKind,
    #[command(flatten)]
    #[serde(flatten)]
    body: BodyModelArgs,
    /// Frames per sequence.
    #[arg(long, default_value_t = 100, value_name = "N", value_parser = at_least_one)]
    frames: usize,
    /// Frames per second.
    #[arg(long, default_value_t = 30.0, value_name = "FPS", value_parser = positive)]
    fps: f64,
    /// Simulation steps per frame.
    #[arg(long, default_value_t = 20, value_name = "N", value_parser = at_least_one)]
    steps: usize,
    /// Edge length of the garment's triangles, mm.
    #[arg(long, default_value_t = 25.0, value_name = "MM", value_parser = positive)]
    resolution: f64,
    /// Width of the hems, in which the cloth is double, mm; 0 for none.
    #[arg(long, default_value_t = 20.0, value_name = "MM", value_parser = non_negative)]
    #[serde(default)]
    hem: f64,
    /// Elastic cuffs at the ends of sleeves, or of the legs of shorts.
    #[arg(long)]
    #[serde(default)]
    cuffs: bool,
    /// Exercises [default: all].
    #[arg(
        long,
        value_delimiter = ',',
        value_name = "EXERCISE,…",
        value_parser = choices(Exercise::ALL.map(|exercise| (exercise.motion_name(), exercise)))
    )]
    exercises: Vec<Exercise>,
    /// All 15 synthetic motions of `cape data synth` instead, each in this number of random styles.
    #[arg(long, value_name = "N", value_parser = at_least_one, conflicts_with = "exercises")]
    styles: Option<usize>,
    /// First shape coefficients of the subjects.
    #[arg(
        long,
        value_delimiter = ',',
        allow_hyphen_values = true,
        default_value = "0",
        value_name = "B,…"
    )]
    subjects: Vec<f64>,
    /// Lengths of the garment relative to its default.
    #[arg(long, value_delimiter = ',', default_value = "1", value_name = "R,…")]
    lengths: Vec<f64>,
    /// Widths of the garment relative to its default.
    #[arg(long, value_delimiter = ',', default_value = "1", value_name = "R,…")]
    widths: Vec<f64>,
    /// Lengths of sleeves relative to the default.
    #[arg(long, value_delimiter = ',', default_value = "1", value_name = "R,…")]
    sleeves: Vec<f64>,
    /// Stretching and bending stiffness relative to cotton shirting.
    #[arg(long, value_delimiter = ',', default_value = "1", value_name = "R,…")]
    stiffness: Vec<f64>,
    /// Additional factors on bending stiffness.
    #[arg(long, value_delimiter = ',', default_value = "1", value_name = "R,…")]
    bending: Vec<f64>,
    /// Area densities relative to cotton shirting.
    #[arg(long, value_delimiter = ',', default_value = "1", value_name = "R,…")]
    masses: Vec<f64>,
    /// Damping relative to cotton shirting.
    #[arg(long, value_delimiter = ',', default_value = "1", value_name = "R,…")]
    damping: Vec<f64>,
    /// Friction against the body relative to cotton shirting.
    #[arg(long, value_delimiter = ',', default_value = "1", value_name = "R,…")]
    friction: Vec<f64>,
    /// Version of the simulator; 0 in plans of the first one.
    #[arg(skip = SIMULATOR_VERSION)]
    #[serde(default)]
    simulator: u32,
    /// Append the body's vertices to the clothing mesh.
    #[arg(long)]
    with_body: bool,
}

/// Garments by name.
pub(super) const GARMENTS: [(&str, GarmentKind); 4] = [
    ("tshirt", GarmentKind::TShirt),
    ("shorts", GarmentKind::Shorts),
    ("skirt", GarmentKind::Skirt),
    ("dress", GarmentKind::Dress),
];

fn write_garment<S: Serializer>(kind: &GarmentKind, to: S) -> Result<S::Ok, S::Error> {
    let name = GARMENTS.iter().find(|(_, garment)| garment == kind).map(|(name, _)| *name);
    name.serialize(to)
}

fn read_garment<'de, D: Deserializer<'de>>(from: D) -> Result<GarmentKind, D::Error> {
    let name = String::deserialize(from)?;
    let garment = GARMENTS.iter().find(|(garment, _)| *garment == name).map(|(_, kind)| *kind);
    garment.ok_or_else(|| serde::de::Error::custom(format!("unknown garment `{name}`")))
}

/// All combinations of `values` with `ratios`.
fn vary<T: Copy>(values: &[T], ratios: &[f64], change: impl Fn(T, f64) -> T) -> Vec<T> {
    values
        .iter()
        .flat_map(|&value| ratios.iter().map(move |&r| (value, r)))
        .map(|(value, ratio)| change(value, ratio))
        .collect()
}

impl SimulationPlan {
    fn design(&self) -> Design {
        let garment = Garment {
            resolution: 1e-3 * self.resolution,
            hem: 1e-3 * self.hem,
            cuffs: self.cuffs,
            ..Garment::new(self.garment)
        };
        let sizes = vary(&[garment], &self.lengths, |g, r| Garment { length: g.length * r, ..g });
        let sizes = vary(&sizes, &self.widths, |g, r| Garment { width: g.width * r, ..g });
        let sizes = vary(&sizes, &self.sleeves, |g, r| Garment { sleeve: g.sleeve * r, ..g });
        let materials = vary(&[ClothMaterial::default()], &self.stiffness, |m, r| ClothMaterial {
            stretch: m.stretch.scaled(r),
            bend: m.bend * r,
            ..m
        });
        let materials =
            vary(&materials, &self.bending, |m, r| ClothMaterial { bend: m.bend * r, ..m });
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
        if let Some(styles) = self.styles {
            design.exercises = Exercise::styled(styles as u64);
        } else if !self.exercises.is_empty() {
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
        // Rounded so that JSON reads them back exactly.
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
        let model = self.plan.body.load()?;
        let design = self.plan.design();
        let sewn = design.sew(&model)?;
        for size in &design.sizes {
            sewn.resize(&model, size)?;
        }
        for material in &design.materials {
            material.check()?;
        }
        files::create_dir(&self.output.out)?;
        let _lock = DirectoryLock::acquire(&self.output.out)?;
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
            out: self.output.out,
        };
        console.result(&report, || report.text())
    }

    /// Creates the directory, or reads the finished simulations of the same settings.
    fn begin(&self) -> Result<Vec<SimulationRecord>> {
        let out = &self.output.out;
        let path = out.join(PLAN);
        if path.exists() {
            let plan: SimulationPlan = read(&path)?;
            if plan.simulator != SIMULATOR_VERSION {
                return Err(Error::message(format!(
                    "{}: holds sequences of version {} of the simulator, expected {SIMULATOR_VERSION}; their \
                     material parameters mean something else: choose another --out",
                    out.display(),
                    plan.simulator
                )));
            }
            if plan != self.plan {
                return Err(Error::message(format!(
                    "{}: holds sequences of other settings: choose another --out",
                    out.display()
                )));
            }
            let done = out.join(DONE);
            return if done.exists() { read(&done) } else { Ok(Vec::new()) };
        }
        files::require_empty(out)?;
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
        let identity = self.plan.body.source()?.identity(model);
        for result in results {
            let (sequence, quality) = result?;
            let faces = &sewn.surface.faces;
            if self.plan.with_body {
                let (faces, whole) = append_body(model, faces, &sequence)?;
                LayerSet::add(&self.output.out, &identity, &faces, &whole)?;
            } else {
                LayerSet::add(&self.output.out, &identity, faces, &sequence)?;
            }
            let simulation = SimulationRecord::new(sequence.name, &quality);
            console.note(&format!(
                "{}: penetration {:.2} mm at most, {:.4} mm on average; {} edges through cloth; largest \
                 strain {:.0} %",
                simulation.name,
                simulation.penetration_mm,
                simulation.mean_penetration_mm,
                simulation.crossings,
                1e2 * simulation.strain
            ));
            done.push(simulation);
            write_json(&self.output.out.join(DONE), done)?;
        }
        Ok(())
    }
}

impl Report {
    fn text(&self) -> String {
        let mut table = Table::new([
            "sequence",
            "penetration, mm",
            "mean, mm",
            "crossings",
            "mean strain, %",
            "largest, %",
        ]);
        for simulation in &self.simulations {
            table.row(simulation.row());
        }
        let seconds =
            self.seconds_per_frame.map_or(String::new(), |s| format!(", {s:.3} s per frame"));
        format!(
            "{}\n\n{} frames of {} vertices in {} sequences, {} of them new{seconds}\n{}",
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
