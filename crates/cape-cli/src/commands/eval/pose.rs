use std::path::PathBuf;

use cape_core::{BodyPose, joints::JOINT_NAMES, ply};
use cape_infer::{BodySpec, Run, write_json};
use cape_render::{
    Bounds, Camera, Object, Projection, Style, Tile, View, colormap, contact_sheet, portrait,
    render,
};
use cape_stats::errors::distance_mm;
use cape_synth::poses::poses;
use clap::Args;
use ndarray::{Array3, Axis, concatenate};
use serde::Serialize;

use crate::{
    console::Console,
    dressed_mesh::{DressedMesh, DressedRenderer, eight_bit},
    error::{Error, Result},
    files,
    options::{GlobalArgs, OutfitArgs, OutputArgs, RunArgs, positive},
    priors::PriorArgs,
    table::Table,
};

/// Body parts that are listed.
const PARTS: usize = 8;

/// Measure and draw the effect of the pose on clothing (figure 6 of the paper).
///
/// Decodes one latent code under two poses. The change of the canonical displacements is what fixed
/// offsets on a skinned body would miss. Writes pose_effect.json with the change by body part,
/// change.ply coloured by it, and pose_effect.png.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  cape eval pose runs/cape --pose-a a-pose --pose-b squats --out effect"
)]
pub(crate) struct PoseEffectArgs {
    #[command(flatten)]
    run: RunArgs,
    #[command(flatten)]
    output: OutputArgs,
    /// First pose: t-pose, a-pose, a motion, or the first pose of a file.
    #[arg(long, default_value = "a-pose", value_name = "POSE")]
    pose_a: String,
    /// Second pose.
    #[arg(long, default_value = "squats", value_name = "POSE")]
    pose_b: String,
    #[command(flatten)]
    outfit: OutfitArgs,
    #[command(flatten)]
    drawn: PriorArgs,
    /// Change of the brightest colour, mm.
    #[arg(long, default_value_t = 20.0, value_name = "MM", value_parser = positive)]
    scale: f64,
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    /// Mean change of the canonical displacement at clothing vertices, millimetres.
    mean_mm: f64,
    largest_mm: f64,
    /// Mean distance between the posed surfaces with and without the change, millimetres.
    posed_mean_mm: f64,
    /// Mean change at the vertices that each joint moves most, largest first.
    parts: Vec<(String, f64)>,
}

impl PoseEffectArgs {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        let [a, b] = [first(&self.pose_a)?, first(&self.pose_b)?];
        self.output.require_empty()?;
        let out = self.output.out;
        let run = self.run.open(global)?;
        let outfit = self.outfit.outfit;
        let seed = global.seed();
        let code = self.drawn.codes(&run, &[outfit], 1, seed, console)?;
        let both = concatenate(Axis(0), &[code.view(), code.view()])
            .map_err(|error| Error::message(error.to_string()))?;
        let wearers = [a, b].map(|pose| BodySpec { betas: Vec::new(), pose, outfit });
        let worn = run.decode_displacements(&both, &wearers)?;
        let fixed = worn.select(Axis(0), &[0, 0]);

        let painter = DressedRenderer::new(&run);
        let following = painter.pose_clothed(&worn, &wearers)?;
        let rigid = painter.pose_clothed(&fixed, &wearers)?;
        let [in_a, in_b] = &following[..] else {
            return Err(Error::message("internal error: no mesh was produced"));
        };

        let changes = changes(&worn);
        let clothing = run.clothing();
        let count = clothing.len().max(1) as f64;
        let over = |values: &[f64]| clothing.iter().map(|&v| values[v]).sum::<f64>() / count;
        let posed: Vec<f64> = in_b
            .mesh
            .vertices
            .iter()
            .zip(&rigid[1].mesh.vertices)
            .map(|(with, without)| distance_mm(*with, *without))
            .collect();

        let mut canonical = run.body().mesh();
        for (vertex, worn) in canonical.vertices.iter_mut().zip(worn.index_axis(Axis(0), 1).rows())
        {
            for (at, by) in vertex.iter_mut().zip(worn) {
                *at += by;
            }
        }
        let mut colours = vec![[0.75; 3]; changes.len()];
        for &vertex in clothing {
            colours[vertex] = colormap((changes[vertex] / self.scale) as f32);
        }
        files::create_dir(&out)?;
        let eight: Vec<[u8; 3]> = colours.iter().copied().map(eight_bit).collect();
        ply::write(out.join("change.ply"), &canonical, Some(&eight))?;
        let style = Style { width: 300, height: 460, ..Style::default() };
        let change = portrait(Object::new(&canonical).with_colours(&colours), View::Front, &style)?;
        // One camera, so that sizes can be compared.
        let shown = [in_a, &rigid[1], in_b];
        let bounds = Bounds::from_meshes(shown.map(|dressed| &dressed.mesh))
            .ok_or_else(|| Error::message("the body has no vertices"))?;
        let aspect = style.width as f32 / style.height as f32;
        let camera = Camera::framing(&bounds, View::Front, Projection::default(), aspect);
        let picture = |dressed: &DressedMesh| {
            render(&[Object::new(&dressed.mesh).with_colours(&dressed.colours)], &camera, &style)
        };
        let tiles = [
            (picture(in_a)?, self.pose_a.clone()),
            (picture(&rigid[1])?, format!("{}, offsets of {}", self.pose_b, self.pose_a)),
            (picture(in_b)?, self.pose_b.clone()),
            (change, format!("change, 0 to {} mm", self.scale)),
        ];
        let tiles: Vec<Tile> =
            tiles.into_iter().map(|(image, label)| Tile { image, label }).collect();
        contact_sheet(&tiles, 4, None)?.save(out.join("pose_effect.png"))?;

        let report = Report {
            mean_mm: over(&changes),
            largest_mm: clothing.iter().map(|&v| changes[v]).fold(0.0, f64::max),
            posed_mean_mm: over(&posed),
            parts: parts(&run, &changes),
            out,
        };
        write_json(&report.out.join("pose_effect.json"), &report)?;
        console.result(&report, || report.text())
    }
}

fn first(text: &str) -> Result<BodyPose> {
    let found = poses(text)?;
    found
        .first()
        .map(|(_, pose)| *pose)
        .ok_or_else(|| Error::message(format!("{text}: has no pose")))
}

/// Length of the difference of two displacements at every vertex, millimetres.
fn changes(worn: &Array3<f32>) -> Vec<f64> {
    let rows = worn.index_axis(Axis(0), 0);
    let others = worn.index_axis(Axis(0), 1);
    let pairs = rows.rows().into_iter().zip(others.rows());
    pairs.map(|(a, b)| distance_mm([a[0], a[1], a[2]], [b[0], b[1], b[2]])).collect()
}

/// Mean change of clothing vertices by the joint that moves them most.
fn parts(run: &Run, changes: &[f64]) -> Vec<(String, f64)> {
    let mut sums = vec![(0.0, 0usize); JOINT_NAMES.len()];
    for &vertex in run.clothing() {
        let weights = run.body().weights.row(vertex);
        let most = weights.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1));
        if let Some(sum) = most.and_then(|(joint, _)| sums.get_mut(joint)) {
            *sum = (sum.0 + changes[vertex], sum.1 + 1);
        }
    }
    let named = JOINT_NAMES.iter().zip(sums).filter(|(_, (_, count))| *count > 0);
    let mut parts: Vec<(String, f64)> =
        named.map(|(name, (sum, count))| ((*name).to_owned(), sum / count as f64)).collect();
    parts.sort_by(|a, b| b.1.total_cmp(&a.1));
    parts.truncate(PARTS);
    parts
}

impl Report {
    fn text(&self) -> String {
        let mut table = Table::new(["body part", "change, mm"]);
        for (part, change) in &self.parts {
            table.row([part.clone(), format!("{change:.1}")]);
        }
        format!(
            "{}\n\ncanonical displacements change by {:.1} mm on average, {:.1} mm at most; with fixed \
             offsets the posed surface is off by {:.1} mm on average\n{}",
            table.text(),
            self.mean_mm,
            self.largest_mm,
            self.posed_mean_mm,
            self.out.join("pose_effect.png").display()
        )
    }
}
