use cape_core::{SmplModel, geometry::SurfaceMesh, smpl::StandardPose};
use ndarray::{Array2, ArrayView2, Axis, s};
use serde::Serialize;

use super::{AssociateOptions, Association};
use crate::{BodyFrame, Error, LayerSet, Result};

/// Frames among which [`EdgeChangeStudy::most_torn`] chooses, evenly spaced.
const SEARCHED_FRAMES: usize = 24;

/// Relative change of the lengths of clothing edges by unposing: seams between vertices that follow
/// different limbs change most (figure 1 of the paper).
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EdgeChange {
    /// Number of body vertices for each clothing vertex, `n_f`.
    pub neighbours: usize,
    /// Mean over the edges.
    pub mean_change: f64,
    /// 99th percentile over the edges.
    pub percentile_99: f64,
    /// Largest over the edges.
    pub largest_change: f64,
}

/// Clothing of one frame in the standard pose, and how unposing changes its edges.
#[derive(Debug, Clone, PartialEq)]
pub struct UnposedClothing {
    /// Vertices in the standard pose, metres, `[n_v, 3]`.
    pub vertices: Array2<f64>,
    /// Largest relative change among the edges of each vertex, `[n_v]`.
    pub vertex_changes: Vec<f64>,
    /// Statistics over the edges.
    pub change: EdgeChange,
}

/// Comparison of associations by the seams that they tear when the pose is removed.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use cape_core::{geometry::SurfaceMesh, smpl::StandardPose};
/// use cape_layer::associate::{AssociateOptions, EdgeChangeStudy};
/// use cape_synth::synthetic_body;
///
/// // A patch on the skin follows one limb: unposing hardly changes its edges.
/// let model = synthetic_body();
/// let (set, association) = patch(&model)?;
/// let standard = StandardPose::default();
/// let frame = set.sequences[0].body(&model, 0, &standard)?;
/// let body = SurfaceMesh::new("body", frame.posed.clone(), model.faces.clone())?;
/// let clothing = set.clothing(0, 0)?;
/// let study =
///     EdgeChangeStudy { model: &model, set: &set, body: &body, clothing: &clothing, standard };
/// let torn = study.most_torn(&association)?;
/// let change = study.unpose_with(&association, torn)?.change;
/// assert!(change.largest_change < 0.5 && change.neighbours == 1);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct EdgeChangeStudy<'a> {
    /// Body model.
    pub model: &'a SmplModel,
    /// Sequences of the clothing.
    pub set: &'a LayerSet,
    /// Body in the frame of the association.
    pub body: &'a SurfaceMesh,
    /// Clothing in the frame of the association.
    pub clothing: &'a SurfaceMesh,
    /// Standard pose.
    pub standard: StandardPose,
}

impl EdgeChangeStudy<'_> {
    /// The frame of the set, among 24 evenly spaced ones, whose edges change most if each clothing
    /// vertex follows its most probable body vertex alone.
    ///
    /// # Errors
    /// If a frame cannot be unposed.
    pub fn most_torn(&self, association: &Association) -> Result<usize> {
        let first = association.indices.slice(s![.., ..1]).to_owned();
        let weights = Array2::ones(first.dim());
        let alone = Association::new(first, weights, self.model.vertices())?;
        let edges = self.clothing.edges();
        let frames = self.set.frames();
        let mut best = (0.0, 0);
        for index in (0..frames).step_by(frames.div_ceil(SEARCHED_FRAMES).max(1)) {
            let (body, posed) = self.frame(index)?;
            let unposed = alone.unpose(&body, posed)?;
            let total: f64 = edge_changes(&edges, posed, unposed.view()).iter().sum();
            if total > best.0 {
                best = (total, index);
            }
        }
        Ok(best.1)
    }

    /// Unposes frame `index` of the set by a new association with each of `counts` body vertices
    /// for each clothing vertex.
    ///
    /// # Errors
    /// If there is no such frame, or it cannot be associated or unposed.
    pub fn compare(
        &self,
        index: usize,
        options: &AssociateOptions,
        counts: &[usize],
    ) -> Result<Vec<UnposedClothing>> {
        let unpose = |&neighbours: &usize| {
            let options = AssociateOptions { neighbours, ..*options };
            self.unpose_with(&options.associate(self.body, self.clothing)?, index)
        };
        counts.iter().map(unpose).collect()
    }

    /// Unposes frame `index` of the set by an association.
    ///
    /// # Errors
    /// If there is no such frame, or it cannot be unposed.
    pub fn unpose_with(&self, association: &Association, index: usize) -> Result<UnposedClothing> {
        let (body, posed) = self.frame(index)?;
        let vertices = association.unpose(&body, posed)?;
        let edges = self.clothing.edges();
        let changes = edge_changes(&edges, posed, vertices.view());
        let mut vertex_changes = vec![0.0f64; posed.nrows()];
        for (edge, &change) in edges.iter().zip(&changes) {
            for &vertex in edge {
                let largest = &mut vertex_changes[vertex as usize];
                *largest = largest.max(change);
            }
        }
        let change = EdgeChange::from_changes(association.neighbours(), changes);
        Ok(UnposedClothing { vertices, vertex_changes, change })
    }

    /// Body and clothing of frame `index` of the set.
    fn frame(&self, index: usize) -> Result<(BodyFrame, ArrayView2<'_, f64>)> {
        let each = self.set.each_frame();
        let &(sequence, frame) = each.get(index).ok_or_else(|| {
            Error::argument(format!("layer set: no frame {index} of {}", each.len()))
        })?;
        let sequence = &self.set.sequences[sequence];
        let body = sequence.body(self.model, frame, &self.standard)?;
        Ok((body, sequence.clothing.index_axis(Axis(0), frame)))
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

/// Changes of the lengths of edges between positions `[n_v, 3]`, relative to those before, `[edges]`.
fn edge_changes(
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
