use std::path::PathBuf;

use cape_core::{Outfit, ply};
use cape_infer::{BodySpec, directions_by_effect, interpolate_codes, walk_codes};
use cape_render::{
    Bounds, Camera, Object, Projection, Style, Tile, View, contact_sheet, render, save_animation,
};
use clap::{Args, ValueEnum};
use ndarray::Array2;
use serde::Serialize;

use crate::{
    console::Console,
    dressed_mesh::{DressedMesh, dress},
    error::{Error, Result},
    files,
    latent_sampler::LatentSampler,
    motion_source::MotionFileArgs,
    options::{GlobalArgs, OutfitArgs, OutputArgs, RunArgs, ShapeArgs, at_least_one},
    priors::{OutfitChangeArgs, PriorArgs, PriorName},
};

/// Vary code, pose, outfit or shape while the rest is fixed (figures 1, 5 and 6 of the paper).
///
/// --by selects the factor: code; pose, along a motion; outfit; shape, the first coefficient from -2 to
/// 2; direction, the latent dimensions of largest effect from -2 to 2; between, from one code to another;
/// walk, a closed path through codes as an animation; sum, sums of codes. Under another outfit a code is
/// moved to its place among that outfit's codes, unless --same-code is given. Writes a picture, coloured
/// meshes and variations.jsonl.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  cape vary runs/cape --by outfit --rows 3 --out outfits\n  \
                        cape vary runs/cape --by between --codes seed:1,frame:20 --out between\n  \
                        cape vary runs/cape --by sum --sum \"frame:3 - frame:10 + seed:1\" --out sum")]
pub(crate) struct VaryArgs {
    #[command(flatten)]
    run: RunArgs,
    #[command(flatten)]
    output: OutputArgs,
    /// Factor that varies from left to right.
    #[arg(long, value_enum, default_value_t = VariationKind::Code, value_name = "FACTOR")]
    by: VariationKind,
    /// Bodies per row, or frames of a walk.
    #[arg(long, default_value_t = 6, value_name = "N", value_parser = at_least_one)]
    columns: usize,
    /// Number of rows, each of another code, or with --by direction of another direction.
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = at_least_one)]
    rows: usize,
    /// Latent codes: mean, seed:N, frame:K, FILE.npy:ROW or samples.jsonl:ROW [default: sampled].
    #[arg(long, value_delimiter = ',', value_name = "CODE,…")]
    codes: Vec<String>,
    /// Sum of codes for --by sum, such as "frame:3 - frame:10 + seed:1".
    #[arg(long, value_name = "SUM", required_if_eq("by", "sum"))]
    sum: Option<String>,
    /// Pose: t-pose, a-pose, a motion, or the first pose of a file.
    #[arg(long, default_value = "a-pose", value_name = "POSE")]
    pose: String,
    /// Motion for --by pose, by name or from a file.
    #[arg(long, default_value = "walk", value_name = "MOTION")]
    motion: String,
    #[command(flatten)]
    poses: MotionFileArgs,
    #[command(flatten)]
    outfit: OutfitArgs,
    #[command(flatten)]
    shape: ShapeArgs,
    #[command(flatten)]
    drawn: PriorArgs,
    #[command(flatten)]
    change: OutfitChangeArgs,
    /// Write no meshes.
    #[arg(long)]
    no_meshes: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum VariationKind {
    Code,
    Pose,
    Outfit,
    Shape,
    Direction,
    Between,
    Walk,
    Sum,
}

/// A body, and its line of variations.jsonl.
#[derive(Debug, Clone, Serialize)]
struct VariationCell {
    label: String,
    file: Option<String>,
    outfit: Outfit,
    betas: Vec<f32>,
    pose: Vec<f32>,
    code: Vec<f32>,
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    bodies: usize,
    picture: PathBuf,
}

impl VaryArgs {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        self.output.require_empty()?;
        let run = self.run.open(global)?;
        let outfit = self.outfit.of(&run)?;
        let draw = LatentSampler { run: &run, drawn: self.drawn, outfit, console };
        let (mut cells, columns) = self.cells(&draw, global.seed())?;
        if !self.no_meshes {
            for (index, cell) in cells.iter_mut().enumerate() {
                cell.file = Some(format!("{index:03}.ply"));
            }
        }
        let codes: Vec<f32> = cells.iter().flat_map(|cell| cell.code.clone()).collect();
        let codes = Array2::from_shape_vec((cells.len(), run.config().model.latent), codes)
            .map_err(|error| Error::message(error.to_string()))?;
        let wearers: Vec<BodySpec> = cells.iter().map(VariationCell::body_spec).collect();
        files::create_dir(&self.output.out)?;
        let mut bodies = Vec::with_capacity(cells.len());
        console.while_showing("dress", "bodies", |progress| {
            dress(&run, &codes, &wearers, |index, body| {
                if let Some(file) = &cells[index].file {
                    ply::write(
                        self.output.out.join(file),
                        &body.mesh,
                        Some(&body.colours_8_bit()),
                    )?;
                }
                bodies.push(body);
                progress(index + 1, cells.len());
                Ok(())
            })
        })?;
        let picture = self.picture(&bodies, &cells, columns, console)?;
        files::write_json_lines(&self.output.out.join("variations.jsonl"), &cells)?;
        let report = Report { bodies: cells.len(), picture, out: self.output.out };
        console
            .result(&report, || format!("{} bodies\n{}", report.bodies, report.picture.display()))
    }

    /// All bodies, row by row, and the number of columns.
    fn cells(&self, draw: &LatentSampler, seed: u64) -> Result<(Vec<VariationCell>, usize)> {
        let pose = self.poses.poses(&self.pose, draw.console)?.upright_poses()?[0];
        let fixed = VariationCell {
            label: String::new(),
            file: None,
            outfit: draw.outfit,
            betas: self.shape.betas(draw.run.body())?,
            pose: pose.to_vec(),
            code: Vec::new(),
        };
        let columns = self.columns;
        let mut cells = Vec::new();
        match self.by {
            VariationKind::Code => {
                for (label, code) in self.rows_of_codes(draw, self.rows * columns, seed)? {
                    cells.push(VariationCell { label, code, ..fixed.clone() });
                }
            }
            VariationKind::Pose => {
                let rate = Some(columns as f64);
                let file = self.poses.motion(&self.motion, 1.0, [None, rate], draw.console)?;
                let moments = file.upright_poses()?;
                let step = moments.len().div_ceil(columns).max(1);
                let moments: Vec<_> = moments.into_iter().step_by(step).take(columns).collect();
                for (label, code) in self.rows_of_codes(draw, self.rows, seed)? {
                    cells.extend(moments.iter().map(|pose| {
                        let (label, code) = (label.clone(), code.clone());
                        VariationCell { label, code, pose: pose.to_vec(), ..fixed.clone() }
                    }));
                }
                return Ok((cells, moments.len()));
            }
            VariationKind::Outfit => {
                let outfits = draw.run.outfits();
                // Codes of the standard normal prior are of no outfit.
                let normal = self.drawn.prior == Some(PriorName::Normal);
                let change = OutfitChangeArgs { same_code: self.change.same_code || normal };
                for (name, code) in self.rows_of_codes(draw, self.rows, seed)? {
                    let codes = change.codes(draw.run, &code, draw.outfit_of(&name)?, outfits)?;
                    let worn = outfits.iter().zip(codes.rows());
                    cells.extend(worn.map(|(&outfit, code)| {
                        let label = outfit.name().to_owned();
                        VariationCell { label, code: code.to_vec(), outfit, ..fixed.clone() }
                    }));
                }
                return Ok((cells, outfits.len()));
            }
            VariationKind::Shape => {
                for (_, code) in self.rows_of_codes(draw, self.rows, seed)? {
                    cells.extend(spread(columns).map(|beta| {
                        let mut betas = fixed.betas.clone();
                        betas.resize(betas.len().max(1), 0.0);
                        betas[0] = beta;
                        let label = format!("beta {beta:+.1}");
                        VariationCell { label, betas, code: code.clone(), ..fixed.clone() }
                    }));
                }
            }
            VariationKind::Direction => {
                let base = self.rows_of_codes(draw, 1, seed)?.remove(0).1;
                let (order, effects) = directions_by_effect(draw.run, &fixed.body_spec())?;
                for &direction in order.iter().take(self.rows) {
                    cells.extend(spread(columns).map(|step| {
                        let mut code = base.clone();
                        code[direction] += step;
                        let effect = effects[direction];
                        let label = format!("z{direction} {step:+.1} ({effect:.1} mm)");
                        VariationCell { label, code, ..fixed.clone() }
                    }));
                }
            }
            VariationKind::Between => {
                let ends = self.rows_of_codes(draw, 2, seed)?;
                let [(from, a), (to, b)] = &ends[..] else {
                    return Err(Error::message("--by between: expected two codes"));
                };
                let steps = interpolate_codes(a, b, columns);
                for (index, code) in steps.rows().into_iter().enumerate() {
                    let label = match index {
                        0 => from.clone(),
                        index if index + 1 == columns => to.clone(),
                        _ => String::new(),
                    };
                    cells.push(VariationCell { label, code: code.to_vec(), ..fixed.clone() });
                }
            }
            VariationKind::Walk => {
                let stops = self.rows_of_codes(draw, self.codes.len().max(4), seed)?;
                let latent = draw.run.config().model.latent;
                let flat: Vec<f32> = stops.iter().flat_map(|(_, code)| code.clone()).collect();
                let stops = Array2::from_shape_vec((stops.len(), latent), flat)
                    .map_err(|error| Error::message(error.to_string()))?;
                for code in walk_codes(&stops, columns).rows() {
                    cells.push(VariationCell { code: code.to_vec(), ..fixed.clone() });
                }
            }
            VariationKind::Sum => {
                let (sum, terms) = draw.sum(self.sum.as_deref().unwrap_or_default())?;
                let result = ("sum".to_owned(), sum);
                for (label, code) in terms.into_iter().chain([result]) {
                    cells.push(VariationCell { label, code, ..fixed.clone() });
                }
                let columns = cells.len();
                return Ok((cells, columns));
            }
        }
        Ok((cells, columns))
    }

    /// `n` codes with labels: those of `--codes`, or sampled ones.
    fn rows_of_codes(
        &self,
        draw: &LatentSampler,
        n: usize,
        seed: u64,
    ) -> Result<Vec<(String, Vec<f32>)>> {
        if self.codes.is_empty() {
            let &LatentSampler { run, drawn, outfit, console } = draw;
            let drawn = drawn.codes(run, &[outfit], n, seed, console)?;
            let rows = drawn.rows().into_iter().enumerate();
            return Ok(rows.map(|(i, row)| (format!("sample {}", i + 1), row.to_vec())).collect());
        }
        if self.codes.len() != n {
            return Err(Error::message(format!(
                "--codes: expected {n}, found {}",
                self.codes.len()
            )));
        }
        self.codes.iter().map(|text| Ok((text.clone(), draw.code(text)?))).collect()
    }

    fn picture(
        &self,
        bodies: &[DressedMesh],
        cells: &[VariationCell],
        columns: usize,
        console: Console,
    ) -> Result<PathBuf> {
        let style = Style { width: 240, height: 352, ..Style::default() };
        let aspect = style.width as f32 / style.height as f32;
        // One camera, so that sizes can be compared.
        let bounds = Bounds::from_meshes(bodies.iter().map(|body| &body.mesh))
            .ok_or_else(|| Error::message("the body has no vertices"))?;
        let camera = Camera::framing(&bounds, View::ThreeQuarter, Projection::default(), aspect);
        let mut pictures = Vec::with_capacity(bodies.len());
        console.while_showing("draw", "bodies", |progress| {
            for (index, body) in bodies.iter().enumerate() {
                let object = Object::new(&body.mesh).with_colours(&body.colours);
                pictures.push(render(&[object], &camera, &style)?);
                progress(index + 1, bodies.len());
            }
            Ok::<_, Error>(())
        })?;
        if self.by == VariationKind::Walk {
            let path = self.output.out.join("walk.png");
            save_animation(&path, &pictures, 15)?;
            return Ok(path);
        }
        let labels = cells.iter().map(|cell| cell.label.clone());
        let tiles: Vec<Tile> =
            pictures.into_iter().zip(labels).map(|(image, label)| Tile { image, label }).collect();
        let path = self.output.out.join("variations.png");
        contact_sheet(&tiles, columns, None)?.save(&path)?;
        Ok(path)
    }
}

/// `n` evenly spaced numbers from -2 to 2.
fn spread(n: usize) -> impl Iterator<Item = f32> {
    (0..n).map(move |i| if n == 1 { 0.0 } else { -2.0 + 4.0 * i as f32 / (n - 1) as f32 })
}

impl VariationCell {
    fn body_spec(&self) -> BodySpec {
        let mut pose = [0.0; 72];
        pose.copy_from_slice(&self.pose);
        BodySpec { betas: self.betas.clone(), pose, outfit: self.outfit }
    }
}
