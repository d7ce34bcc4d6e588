//! Marching tetrahedra over the half space x ≥ 0, restricted to the surface connected to a seed.

use std::collections::{HashMap, VecDeque};

use glam::DVec3;

/// The six tetrahedra of a cell (corners numbered by their x, y, z bits) and their orientation.
const TETRAHEDRA: [([usize; 4], bool); 6] = [
    ([0, 1, 3, 7], true),
    ([0, 1, 5, 7], false),
    ([0, 2, 3, 7], false),
    ([0, 2, 6, 7], true),
    ([0, 4, 5, 7], true),
    ([0, 4, 6, 7], false),
];

/// Rectilinear sampling grid.
pub(super) struct Grid {
    /// Ascending sample positions along x, y and z, metres.
    pub(super) lines: [Vec<f64>; 3],
}

impl Grid {
    /// Grid over the box from `low` to `high` of spacing `coarse`, refined to `fine` within `ranges` of
    /// the axes.
    pub(super) fn new(
        low: DVec3,
        high: DVec3,
        coarse: f64,
        fine: f64,
        ranges: [[f64; 2]; 3],
    ) -> Self {
        let lines = std::array::from_fn(|axis| {
            let mut line = vec![low[axis]];
            let mut at = low[axis];
            while at < high[axis] {
                let [from, to] = ranges[axis];
                at += if at >= from && at < to { fine } else { coarse };
                line.push(at);
            }
            line
        });
        Self { lines }
    }

    fn corner(&self, index: [usize; 3]) -> usize {
        (index[2] * self.lines[1].len() + index[1]) * self.lines[0].len() + index[0]
    }

    fn position(&self, corner: usize) -> DVec3 {
        let (nx, ny) = (self.lines[0].len(), self.lines[1].len());
        DVec3::new(
            self.lines[0][corner % nx],
            self.lines[1][corner / nx % ny],
            self.lines[2][corner / nx / ny],
        )
    }
}

/// Lazily evaluated samples of the field.
struct Samples<'a, F> {
    grid: &'a Grid,
    field: F,
    values: Vec<f32>,
}

impl<F: Fn(DVec3) -> f64> Samples<'_, F> {
    fn at(&mut self, corner: usize) -> f32 {
        if self.values[corner].is_nan() {
            // Not exactly 0, so that no triangle collapses to a grid point.
            let value = (self.field)(self.grid.position(corner)) as f32;
            self.values[corner] = if value.abs() < 1e-6 { 1e-6 } else { value };
        }
        self.values[corner]
    }
}

/// Vertices and outward-oriented triangles of the connected zero surface of `field` through the first
/// surface cell above (+y) `inside`. The surface has a boundary in the plane of the lowest x of the
/// grid.
pub(super) fn polygonise(
    grid: &Grid,
    field: impl Fn(DVec3) -> f64,
    inside: DVec3,
) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let cells: [usize; 3] = std::array::from_fn(|axis| grid.lines[axis].len() - 1);
    let corners = grid.lines.iter().map(Vec::len).product();
    let mut samples = Samples { grid, field, values: vec![f32::NAN; corners] };
    let mut mesh = TriangleCollector::default();
    let mut seen = vec![false; corners];

    let mut start: [usize; 3] = std::array::from_fn(|axis| {
        let after = grid.lines[axis].partition_point(|&at| at <= inside[axis]);
        after.saturating_sub(1).min(cells[axis] - 1)
    });
    while start[1] + 1 < cells[1]
        && samples.at(grid.corner([start[0], start[1] + 1, start[2]])) < 0.0
    {
        start[1] += 1;
    }
    let mut queue = VecDeque::from([start]);
    seen[grid.corner(start)] = true;
    while let Some(cell) = queue.pop_front() {
        let corner: [usize; 8] = std::array::from_fn(|c| {
            grid.corner([cell[0] + (c & 1), cell[1] + (c >> 1 & 1), cell[2] + (c >> 2)])
        });
        let value = corner.map(|c| samples.at(c));
        for (tet, positive) in TETRAHEDRA {
            mesh.march(grid, tet.map(|c| corner[c]), tet.map(|c| value[c]), positive);
        }
        for axis in 0..3 {
            for side in 0..2 {
                let face = (0..8).filter(|c| (c >> axis & 1) == side);
                let negative = face.filter(|&c| value[c] < 0.0).count();
                let outside =
                    if side == 0 { cell[axis] == 0 } else { cell[axis] + 1 == cells[axis] };
                if outside || negative == 0 || negative == 4 {
                    continue;
                }
                let mut next = cell;
                next[axis] = if side == 0 { cell[axis] - 1 } else { cell[axis] + 1 };
                let index = grid.corner(next);
                if !seen[index] {
                    seen[index] = true;
                    queue.push_back(next);
                }
            }
        }
    }
    (mesh.vertices, mesh.faces)
}

/// Collects the triangles of the marched cells.
#[derive(Default)]
struct TriangleCollector {
    vertices: Vec<DVec3>,
    faces: Vec<[u32; 3]>,
    on_edge: HashMap<(usize, usize), u32>,
}

impl TriangleCollector {
    fn march(&mut self, grid: &Grid, corner: [usize; 4], value: [f32; 4], positive: bool) {
        let mut order: [usize; 4] = [0, 1, 2, 3];
        order.sort_by_key(|&i| value[i] >= 0.0);
        let inside = value.iter().filter(|&&v| v < 0.0).count();
        let inversions = (0..4)
            .flat_map(|i| (i + 1..4).map(move |j| (i, j)))
            .filter(|&(i, j)| order[i] > order[j])
            .count();
        let mut cut = |i: usize, j: usize| {
            let (i, j) = (order[i], order[j]);
            let (i, j) = if corner[i] < corner[j] { (i, j) } else { (j, i) };
            *self.on_edge.entry((corner[i], corner[j])).or_insert_with(|| {
                let (a, b) = (f64::from(value[i]), f64::from(value[j]));
                let (p, q) = (grid.position(corner[i]), grid.position(corner[j]));
                self.vertices.push(p + (q - p) * (a / (a - b)));
                self.vertices.len() as u32 - 1
            })
        };
        let polygon = match inside {
            1 => vec![cut(0, 1), cut(0, 2), cut(0, 3)],
            2 => vec![cut(0, 2), cut(0, 3), cut(1, 3), cut(1, 2)],
            3 => vec![cut(3, 0), cut(3, 1), cut(3, 2)],
            _ => return,
        };
        let outward = (inversions % 2 == 0) == positive;
        for i in 1..polygon.len() - 1 {
            let (b, c) = if outward { (i, i + 1) } else { (i + 1, i) };
            self.faces.push([polygon[0], polygon[b], polygon[c]]);
        }
    }
}
