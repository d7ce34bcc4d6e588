use std::{path::PathBuf, time::Instant};

use cape_graph::{EdgeCounts, MeshPyramid, Surface, Weighting};
use clap::{Args, ValueEnum};
use serde::Serialize;

use crate::{
    console::{Console, seconds},
    error::Result,
    mesh_file::read_surface,
    table::Table,
};

/// Simplify a mesh level by level and write matrices for other programs.
///
/// Level i becomes level_i.obj with its adjacency A_i.npz; D_i.npz selects the vertices of level
/// i + 1 from those of level i, U_i.npz interpolates back. Read them with scipy.sparse.load_npz.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  cape pyramid body.npz --factors 2,2,2,2 --out levels")]
pub(crate) struct PyramidArgs {
    /// Mesh (.obj or .ply), or SMPL's body (.pkl, .npz).
    #[arg(value_name = "MESH")]
    mesh: PathBuf,
    /// How many times fewer vertices each level has than the one before; 1 repeats it.
    #[arg(long, value_delimiter = ',', default_value = "2,2,2,2", value_name = "F,F,…")]
    factors: Vec<f64>,
    /// How up-sampling is weighted: barycentric for new models, release for the authors' weights.
    #[arg(long, value_enum, default_value_t = WeightingName::Barycentric)]
    weighting: WeightingName,
    /// Directory to write.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
pub(crate) enum WeightingName {
    Barycentric,
    Release,
}

impl From<WeightingName> for Weighting {
    fn from(name: WeightingName) -> Self {
        match name {
            WeightingName::Barycentric => Self::Barycentric,
            WeightingName::Release => Self::Release,
        }
    }
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    weighting: Weighting,
    levels: Vec<LevelReport>,
    build_seconds: f64,
}

#[derive(Debug, Serialize)]
pub(crate) struct LevelReport {
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
        let pyramid = MeshPyramid::build(surface, &self.factors, self.weighting.into())?;
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
                "{}\n\nbuilt in {}, {} weighting, written to {}",
                level_table(&report.levels).text(),
                seconds(report.build_seconds),
                report.weighting.name(),
                report.out.display()
            )
        })
    }
}

pub(crate) fn levels(pyramid: &MeshPyramid) -> Vec<LevelReport> {
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

pub(crate) fn level_table(levels: &[LevelReport]) -> Table {
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
