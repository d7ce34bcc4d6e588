use std::{
    path::{Path, PathBuf},
    time::Instant,
};

use cape_core::{SmplModel, ply};
use cape_core::{geometry::SurfaceMesh, smpl::StandardPose};
use cape_infer::write_json;
use cape_layer::{AssociateOptions, LayerSet};
use cape_render::{Image, Tile, View, contact_sheet};
use clap::Args;
use ndarray::{Array2, ArrayView2, Axis};
use serde::Serialize;

use super::{
    association::{AssociationArgs, AssociationOutput},
    pictures::{PictureCamera, by_place, mesh_of, shades},
};
use crate::{
    console::Console,
    dressed_mesh::eight_bit,
    error::Result,
    files,
    options::{BodyModelArgs, OutputArgs, at_least_one},
    table::Table,
};

/// Height of a picture, pixels.
const HEIGHT: u32 = 330;
/// Relative change of an edge's length that has the brightest colour.
const TORN: f64 = 1.0;
/// Number of frames among which the one to draw is searched.
const SEARCHED: usize = 24;

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

/// Change of the lengths of the clothing's edges by unposing.
#[derive(Debug, Clone, Serialize)]
pub(super) struct EdgeChange {
    /// Body vertices per clothing vertex.
    neighbours: usize,
    /// Mean relative change of an edge's length.
    mean_change: f64,
    /// 99th percentile of the relative change.
    percentile_99: f64,
    /// Largest relative change.
    largest_change: f64,
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
        let set = LayerSet::load(&self.set)?;
        let start = Instant::now();
        let tied = self.association_args.associate(&model, &set, console)?;
        let seconds = start.elapsed().as_secs_f64();
        files::create_dir(&out)?;
        draw(&tied, &out)?;
        let standard = self.association_args.standard();
        let shown = match self.shown {
            Some(shown) => shown,
            None => most_torn(&model, &set, &tied, &standard)?,
        };
        let options = self.association_args.options();
        let seams =
            EdgeChangeStudy { model: &model, set: &set, tied: &tied, standard, options, shown };
        let (image, seams) = seams.compare(&self.compare)?;
        image.save(out.join("seams.png"))?;
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

/// Clothing of one frame, unposed by associations with different numbers of body vertices.
struct EdgeChangeStudy<'a> {
    model: &'a SmplModel,
    set: &'a LayerSet,
    tied: &'a AssociationOutput,
    standard: StandardPose,
    options: AssociateOptions,
    shown: usize,
}

impl EdgeChangeStudy<'_> {
    /// Picture of the frame, posed and unposed for each of `counts`, and the changes of its edges.
    fn compare(&self, counts: &[usize]) -> Result<(Image, Vec<EdgeChange>)> {
        let each = self.set.each_frame();
        let &(sequence, frame) = each.get(self.shown).ok_or_else(|| {
            let message = format!("--shown {}: the set has {} frames", self.shown, each.len());
            crate::error::Error::message(message)
        })?;
        let faces = &self.set.faces;
        let sequence = &self.set.sequences[sequence];
        let body = sequence.body(self.model, frame, &self.standard)?;
        let posed = sequence.clothing.index_axis(Axis(0), frame);
        let edges = self.tied.clothing.edges();
        let mut unposed = Vec::new();
        for &neighbours in counts {
            let options = AssociateOptions { neighbours, ..self.options };
            let association = options.associate(&self.tied.body, &self.tied.clothing)?;
            unposed.push(association.unpose(&body, posed)?);
        }
        let clothing = mesh_of(posed, faces);
        let under: Vec<[f32; 3]> = body.posed.iter().map(|v| v.as_vec3().to_array()).collect();
        let under = cape_core::Mesh { vertices: under, faces: self.model.faces.clone() };
        let stage = PictureCamera::around([&under, &clothing], View::Front, HEIGHT)?;
        let mut tiles =
            vec![Tile { image: stage.show(Some(&under), &clothing, None)?, label: "posed".into() }];
        let meshes: Vec<_> = unposed.iter().map(|v| mesh_of(v.view(), faces)).collect();
        let mut seams = Vec::new();
        for ((&neighbours, vertices), mesh) in counts.iter().zip(&unposed).zip(&meshes) {
            let changes = changes(&edges, posed, vertices.view());
            let mut worst = vec![0.0f64; posed.nrows()];
            for (&[a, b], &change) in edges.iter().zip(&changes) {
                for v in [a as usize, b as usize] {
                    worst[v] = worst[v].max(change);
                }
            }
            let stage = PictureCamera::around([mesh], View::Front, HEIGHT)?;
            let image = stage.show(None, mesh, Some(&shades(&worst, TORN)))?;
            tiles.push(Tile { image, label: format!("{neighbours} per vertex") });
            seams.push(EdgeChange::from_changes(neighbours, changes));
        }
        let title = "change of edge lengths by unposing, 0 to 100 %";
        Ok((contact_sheet(&tiles, tiles.len(), Some(title))?, seams))
    }
}

impl EdgeChange {
    fn from_changes(neighbours: usize, mut changes: Vec<f64>) -> Self {
        changes.sort_by(f64::total_cmp);
        let at = |share: f64| {
            let index = (share * changes.len() as f64) as usize;
            changes.get(index.min(changes.len().saturating_sub(1))).copied().unwrap_or(0.0)
        };
        Self {
            neighbours,
            mean_change: changes.iter().sum::<f64>() / changes.len().max(1) as f64,
            percentile_99: at(0.99),
            largest_change: at(1.0),
        }
    }
}

/// The frame whose edges change most if every clothing vertex follows only its first body vertex.
fn most_torn(
    model: &SmplModel,
    set: &LayerSet,
    tied: &AssociationOutput,
    standard: &StandardPose,
) -> Result<usize> {
    let first = tied.association.indices.slice(ndarray::s![.., ..1]).to_owned();
    let alone =
        cape_layer::Association::new(first.clone(), Array2::ones(first.dim()), model.vertices())?;
    let each = set.each_frame();
    let edges = tied.clothing.edges();
    let mut best = (0.0, 0);
    for index in (0..each.len()).step_by(each.len().div_ceil(SEARCHED)) {
        let (sequence, frame) = each[index];
        let sequence = &set.sequences[sequence];
        let posed = sequence.clothing.index_axis(Axis(0), frame);
        let unposed = alone.unpose(&sequence.body(model, frame, standard)?, posed)?;
        let total: f64 = changes(&edges, posed, unposed.view()).iter().sum();
        if total > best.0 {
            best = (total, index);
        }
    }
    Ok(best.1)
}

/// Relative changes of the edges' lengths.
fn changes(
    edges: &[[u32; 2]],
    before: ArrayView2<'_, f64>,
    after: ArrayView2<'_, f64>,
) -> Vec<f64> {
    let length = |vertices: ArrayView2<'_, f64>, [a, b]: [u32; 2]| {
        let along = &vertices.row(a as usize) - &vertices.row(b as usize);
        along.dot(&along).sqrt()
    };
    let change = |&edge: &[u32; 2]| {
        let from = length(before, edge).max(1e-9);
        (length(after, edge) - from).abs() / from
    };
    edges.iter().map(change).collect()
}
