//! Products of sparse matrices of fixed structure with features `[batch, vertices, channels]`.
//!
//! ONNX has no sparse product. Rows with equally many entries are gathered together, weighted and
//! summed, then all rows are brought into their order: without padding and with few nodes.

use std::collections::BTreeMap;

use cape_graph::{MeshPyramid, Transition};
use sprs::CsMat;

use crate::graph::{GraphBuilder, Value};

/// Graph of a level of the pyramid: `L̃ = −s A s` with the adjacency `A` and `s = D^{−1/2}`.
pub(crate) struct LevelGraph {
    /// `A` at the rows of the result, `[rows, vertices]`.
    adjacency: CsMat<f64>,
    /// `s` of the vertices.
    scale: Vec<f32>,
    /// `−s` of the rows.
    row_scale: Vec<f32>,
}

impl LevelGraph {
    /// The graph of `level`.
    pub(crate) fn new(pyramid: &MeshPyramid, level: usize) -> Self {
        let adjacency = pyramid.levels()[level].adjacency();
        let degree = adjacency.outer_iterator().map(|row| row.nnz() as f64);
        let scale: Vec<f32> =
            degree.map(|d| if d > 0.0 { (1.0 / d.sqrt()) as f32 } else { 0.0 }).collect();
        Self { adjacency: adjacency.clone(), row_scale: scale.iter().map(|s| -s).collect(), scale }
    }

    /// The rows that `transition` keeps: `D L̃`.
    pub(crate) fn kept_rows(&self, transition: &Transition) -> Self {
        let rows = transition.down().iter().map(|&row| self.row_scale[row as usize]);
        Self {
            adjacency: (&transition.down_matrix() * &self.adjacency).to_csr(),
            scale: self.scale.clone(),
            row_scale: rows.collect(),
        }
    }

    /// `L̃ x`.
    pub(crate) fn apply(&self, graph: &mut GraphBuilder, x: &Value) -> Value {
        let scale = graph.constants(&[self.scale.len(), 1], &self.scale);
        let x = graph.mul(x, &scale);
        let sums = sparse_product(graph, &self.adjacency, &x);
        let scale = graph.constants(&[self.row_scale.len(), 1], &self.row_scale);
        graph.mul(&sums, &scale)
    }
}

/// `A x` with `A` in compressed rows.
pub(crate) fn sparse_product(graph: &mut GraphBuilder, a: &CsMat<f64>, x: &Value) -> Value {
    let mut by_entries: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (index, row) in a.outer_iterator().enumerate() {
        by_entries.entry(row.nnz()).or_default().push(index);
    }
    let mut sums = Vec::with_capacity(by_entries.len());
    for (&entries, rows) in &by_entries {
        sums.push(row_sums(graph, a, (entries, rows), x));
    }
    let sums = graph.concat(&sums, 1);
    let order: Vec<usize> = by_entries.into_values().flatten().collect();
    if order.is_sorted() {
        return sums;
    }
    let mut place = vec![0; order.len()];
    for (at, row) in order.into_iter().enumerate() {
        place[row] = at;
    }
    graph.select(&sums, &place, 1)
}

/// Rows of `A x` of which each has the same number of entries.
fn row_sums(
    graph: &mut GraphBuilder,
    a: &CsMat<f64>,
    (entries, rows): (usize, &[usize]),
    x: &Value,
) -> Value {
    // A row without entries is zero times any row.
    let (width, mut columns, mut weights) = (entries.max(1), Vec::new(), Vec::new());
    for row in rows.iter().filter_map(|&row| a.outer_view(row)) {
        columns.extend_from_slice(row.indices());
        weights.extend(row.data().iter().map(|&weight| weight as f32));
    }
    columns.resize(width * rows.len(), 0);
    weights.resize(width * rows.len(), 0.0);
    let one_each = width == 1;
    let shape = if one_each { vec![rows.len()] } else { vec![rows.len(), width] };
    let columns = graph.indices(&shape, &columns);
    let mut terms = graph.gather(x, &columns, 1);
    if weights.iter().any(|&weight| weight != 1.0) {
        let weights = graph.constants(&[&shape[..], &[1]].concat(), &weights);
        terms = graph.mul(&terms, &weights);
    }
    if one_each { terms } else { graph.reduce("ReduceSum", &terms, 2, false) }
}
