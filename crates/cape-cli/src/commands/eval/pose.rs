use std::path::PathBuf;

use cape_core::{BodyPose, ply};
use cape_eval::clothing::{PoseEffect, mean_vertex_distance_mm};
use cape_infer::{BodySpec, write_json};
use cape_render::{
    Bounds, Camera, Object, Projection, Style, Tile, View, colormap, contact_sheet, portrait,
    render,
};
use clap::Args;
use ndarray::{Axis, concatenate};
use serde::Serialize;

use crate::{
    console::Console,
    dressed_mesh::{DressedMesh, DressedRenderer, eight_bit},
    error::{Error, Result},
    files,
    motion_source::MotionFileArgs,
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
    poses: MotionFileArgs,
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
        let first = |text: &str| -> Result<BodyPose> {
            Ok(self.poses.poses(text, console)?.upright_poses()?[0])
        };
        let [a, b] = [first(&self.pose_a)?, first(&self.pose_b)?];
        self.output.require_empty()?;
        let out = self.output.out;
        let run = self.run.open(global)?;
        let outfit = self.outfit.of(&run)?;
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

        let [before, after] = [0, 1].map(|index| worn.index_axis(Axis(0), index));
        let effect = PoseEffect::new(&run, before, after)?;
        let changes = &effect.changes_mm;
        let clothing = run.clothing();
        let posed_mean_mm = mean_vertex_distance_mm(&in_b.mesh, &rigid[1].mesh, clothing);

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
            mean_mm: effect.mean_mm,
            largest_mm: effect.largest_mm,
            posed_mean_mm,
            parts: effect.by_joint.into_iter().take(PARTS).collect(),
            out,
        };
        write_json(&report.out.join("pose_effect.json"), &report)?;
        console.result(&report, || report.text())
    }
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
