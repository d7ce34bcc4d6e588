use std::{path::PathBuf, time::Instant};

use cape_graph::{EdgeCounts, MeshPyramid, Surface, Weighting};
use clap::Args;
use serde::Serialize;

use crate::{
    console::{Console, seconds},
    error::Result,
    mesh_file::read_surface,
    options::choices,
    table::Table,
};

/// Simplify a mesh level by level and write the sampling matrices.
///
/// Writes level_i.obj, its adjacency A_i.npz, down-sampling D_i.npz from level i to i + 1 and
/// up-sampling U_i.npz back, as SciPy sparse matrices (scipy.sparse.load_npz).
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  cape model pyramid body.npz --factors 2,2,2,2 --out levels")]
pub(crate) struct PyramidArgs {
    /// Mesh, .obj or .ply, or SMPL body, .pkl or .npz.
    #[arg(value_name = "MESH")]
    mesh: PathBuf,
    /// Ratio of vertex counts from level to level; 1 keeps all vertices.
    #[arg(long, value_delimiter = ',', default_value = "2,2,2,2", value_name = "F,F,…")]
    factors: Vec<f64>,
    /// Up-sampling weights: barycentric, or those of the authors' release.
    #[arg(long, default_value = "barycentric", value_name = "NAME", value_parser = choices(WEIGHTINGS))]
    weighting: Weighting,
    /// Directory to write; it is created if missing.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// Up-sampling weights by name.
pub(crate) const WEIGHTINGS: [(&str, Weighting); 2] =
    [("barycentric", Weighting::Barycentric), ("release", Weighting::Release)];

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    weighting: Weighting,
    levels: Vec<LevelReport>,
    build_seconds: f64,
}

#[derive(Debug, Serialize)]
struct LevelReport {
    vertices: usize,
    faces: usize,
    edges: usize,
    boundary_edges: usize,
    non_manifold_edges: usize,
}

impl PyramidArgs {
    pub(crate) fn run(self, console: Console) -> Result {
        let surface: Surface = read_surface(&self.mesh)?;
        let start = Instant::now();
        let pyramid = MeshPyramid::build(surface, &self.factors, self.weighting)?;
        let build_seconds = start.elapsed().as_secs_f64();
        pyramid.export_scipy(&self.out)?;
        let report = Report {
            out: self.out,
            weighting: pyramid.weighting(),
            levels: levels(&pyramid),
            build_seconds,
        };
        console.result(&report, || {
            format!(
                "{}\n\nbuilt in {} with {} weights\n{}",
                level_table(&report.levels).text(),
                seconds(report.build_seconds),
                report.weighting.name(),
                report.out.display()
            )
        })
    }
}

fn levels(pyramid: &MeshPyramid) -> Vec<LevelReport> {
    let report = |level: &cape_graph::Level| {
        let EdgeCounts { edges, boundary, non_manifold } = level.edge_counts();
        LevelReport {
            vertices: level.vertex_count(),
            faces: level.surface().faces.len(),
            edges,
            boundary_edges: boundary,
            non_manifold_edges: non_manifold,
        }
    };
    pyramid.levels().iter().map(report).collect()
}

fn level_table(levels: &[LevelReport]) -> Table {
    let mut table = Table::new(["level", "vertices", "faces", "edges", "boundary", "non-manifold"]);
    for (index, level) in levels.iter().enumerate() {
        let LevelReport { vertices, faces, edges, boundary_edges, non_manifold_edges } = level;
        table.row(
            [&index, vertices, faces, edges, boundary_edges, non_manifold_edges]
                .map(ToString::to_string),
        );
    }
    table
}
