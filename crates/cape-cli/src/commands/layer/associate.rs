use std::{
    path::{Path, PathBuf},
    time::Instant,
};

use cape_core::{geometry::SurfaceMesh, ply};
use cape_infer::write_json;
use cape_layer::{
    LayerSet,
    associate::{EdgeChange, EdgeChangeStudy, UnposedClothing},
};
use cape_render::{Image, Tile, View, contact_sheet};
use clap::Args;
use ndarray::Axis;
use serde::Serialize;

use super::{
    association::{AssociationArgs, AssociationOutput},
    pictures::{PictureCamera, by_place, mesh_of, shades},
};
use crate::{
    body_source::BodyModelArgs,
    console::Console,
    dressed_mesh::eight_bit,
    error::Result,
    files,
    options::{OutputArgs, at_least_one},
    table::Table,
};

/// Height of a picture, pixels.
const HEIGHT: u32 = 330;
/// Relative change of an edge's length that has the brightest colour.
const TORN: f64 = 1.0;

/// Associate clothing vertices with body vertices.
///
/// Writes body.ply and clothing.ply, in which associated vertices have the same colour, both in
/// association.png, and seams.png: unposed clothing for several numbers of body vertices per clothing
/// vertex (figure 1 of the paper). Few body vertices tear cloth whose neighbours follow different legs.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  cape layer associate skirt --compare 1,2,4,16 --out associated"
)]
pub(crate) struct AssociateArgs {
    /// Set of sequences written by `cape layer synth` or `cape layer import`.
    #[arg(value_name = "SET")]
    set: PathBuf,
    #[command(flatten)]
    output: OutputArgs,
    #[command(flatten)]
    body: BodyModelArgs,
    #[command(flatten)]
    association_args: AssociationArgs,
    /// Numbers of body vertices per clothing vertex to compare.
    #[arg(
        long,
        value_delimiter = ',',
        default_value = "1,2,4,16",
        value_name = "N,…",
        value_parser = at_least_one
    )]
    compare: Vec<usize>,
    /// Frame of the comparison [default: the one torn most by a single body vertex].
    #[arg(long, value_name = "K")]
    shown: Option<usize>,
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    body_vertices: usize,
    clothing_vertices: usize,
    rays: usize,
    hits: usize,
    pairs: usize,
    /// Number of clothing vertices with widened support, by the number of rings added.
    widened: Vec<usize>,
    isolated: usize,
    /// Number of hits ignored: on the other side of the clothing than most, or through the body.
    on_outer_side: usize,
    blocked: usize,
    inside_body: usize,
    clothing_is_flipped: bool,
    /// Time of the association.
    seconds: f64,
    shown: usize,
    seams: Vec<EdgeChange>,
}

impl AssociateArgs {
    pub(super) fn run(self, console: Console) -> Result {
        self.output.require_empty()?;
        let out = self.output.out;
        let model = self.body.load()?;
        let set = LayerSet::load_for(&self.set, &model)?;
        let start = Instant::now();
        let tied = self.association_args.associate(&model, &set, console)?;
        let seconds = start.elapsed().as_secs_f64();
        files::create_dir(&out)?;
        draw(&tied, &out)?;
        let study = EdgeChangeStudy {
            model: &model,
            set: &set,
            body: &tied.body,
            clothing: &tied.clothing,
            standard: self.association_args.standard(),
        };
        let shown = match self.shown {
            Some(shown) => shown,
            None => study.most_torn(&tied.association)?,
        };
        let unposed = study.compare(shown, &self.association_args.options(), &self.compare)?;
        seams_picture(&study, shown, &unposed)?.save(out.join("seams.png"))?;
        let seams = unposed.into_iter().map(|unposed| unposed.change).collect();
        let association = &tied.association;
        let statistics = &association.statistics;
        let report = Report {
            body_vertices: tied.body.vertices.len(),
            clothing_vertices: association.clothing_vertices(),
            rays: statistics.rays,
            hits: statistics.hits,
            pairs: association.pairs,
            widened: association.completion.widened.clone(),
            isolated: association.completion.isolated,
            on_outer_side: statistics.on_outer_side,
            blocked: statistics.blocked,
            inside_body: statistics.inside,
            clothing_is_flipped: statistics.clothing_is_flipped(),
            seconds,
            shown,
            seams,
            out,
        };
        write_json(&report.out.join("association.json"), &report)?;
        console.result(&report, || report.text())
    }
}

impl Report {
    fn text(&self) -> String {
        let mut table = Table::new(["body vertices", "mean", "99th percentile", "largest"]);
        for seam in &self.seams {
            let changes = [seam.mean_change, seam.percentile_99, seam.largest_change];
            let cells = changes.map(|change| format!("{:.1} %", 100.0 * change));
            table.row([seam.neighbours.to_string()].into_iter().chain(cells));
        }
        format!(
            "{} clothing vertices associated with {} body vertices: {} pairs from {} hits, {} \
             vertices completed, {:.1} s\n\nchange of edge lengths by unposing frame {}\n\n{}\n\n{}",
            self.clothing_vertices,
            self.body_vertices,
            self.pairs,
            self.hits,
            self.widened.iter().sum::<usize>() + self.isolated,
            self.seconds,
            self.shown,
            table.text(),
            self.out.join("association.png").display()
        )
    }
}

/// Writes association.png, body.ply and clothing.ply in colours by position on the body, the same for
/// associated vertices.
pub(super) fn draw(tied: &AssociationOutput, out: &Path) -> Result {
    let [body, clothing] = [&tied.body, &tied.clothing].map(SurfaceMesh::to_mesh);
    let of_body = by_place(&tied.body)?;
    let eight: Vec<[u8; 3]> = of_body.iter().copied().map(eight_bit).collect();
    let of_clothing = tied.association.colours(&eight)?;
    ply::write(out.join("body.ply"), &body, Some(&eight))?;
    ply::write(out.join("clothing.ply"), &clothing, Some(&of_clothing))?;
    let of_clothing: Vec<[f32; 3]> =
        of_clothing.iter().map(|c| c.map(|x| f32::from(x) / 255.0)).collect();
    let mut tiles = Vec::new();
    for (view, side) in [(View::Front, "front"), (View::Back, "back")] {
        let stage = PictureCamera::around([&body, &clothing], view, HEIGHT)?;
        for (mesh, colours, name) in
            [(&body, &of_body, "body"), (&clothing, &of_clothing, "clothing")]
        {
            let image = stage.show(None, mesh, Some(colours))?;
            tiles.push(Tile { image, label: format!("{name}, {side}") });
        }
    }
    Ok(contact_sheet(&tiles, tiles.len(), None)?.save(out.join("association.png"))?)
}

/// A contact sheet of a frame of the set as it is, and unposed by each association, with the edges that
/// change most in the brightest colours.
fn seams_picture(
    study: &EdgeChangeStudy<'_>,
    shown: usize,
    unposed: &[UnposedClothing],
) -> Result<Image> {
    let (sequence, frame) = study.set.each_frame()[shown];
    let sequence = &study.set.sequences[sequence];
    let body = sequence.body(study.model, frame, &study.standard)?;
    let faces = &study.set.faces;
    let clothing = mesh_of(sequence.clothing.index_axis(Axis(0), frame), faces);
    let under: Vec<[f32; 3]> = body.posed.iter().map(|v| v.as_vec3().to_array()).collect();
    let under = cape_core::Mesh { vertices: under, faces: study.model.faces.clone() };
    let stage = PictureCamera::around([&under, &clothing], View::Front, HEIGHT)?;
    let mut tiles =
        vec![Tile { image: stage.show(Some(&under), &clothing, None)?, label: "posed".into() }];
    for UnposedClothing { vertices, vertex_changes, change } in unposed {
        let mesh = mesh_of(vertices.view(), faces);
        let stage = PictureCamera::around([&mesh], View::Front, HEIGHT)?;
        let image = stage.show(None, &mesh, Some(&shades(vertex_changes, TORN)))?;
        tiles.push(Tile { image, label: format!("{} per vertex", change.neighbours) });
    }
    let title = "change of edge lengths by unposing, 0 to 100 %";
    Ok(contact_sheet(&tiles, tiles.len(), Some(title))?)
}
