use std::{cmp::Ordering, collections::BinaryHeap, collections::HashMap};

use glam::DVec3;

use cape_core::geometry::SurfaceMesh;

/// Metric of geodesic distances on a triangle mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum GeodesicMetric {
    /// Along edges (Dijkstra): never too short, up to 15 % too long on regular triangles of any size.
    Graph,
    /// Across triangles, each unfolded into a plane with the virtual source that the distances of
    /// its two nearer corners define (Novotni and Klein 2002). Exact on a plane; on curved surfaces
    /// the error vanishes with the size of the triangles.
    #[default]
    Unfolded,
}

/// Geodesic distances from vertices of a surface.
///
/// The association needs thousands of distances within a few edge lengths, where Dijkstra's error
/// does not vanish and where the heat method, which smooths over one edge length, is at its worst;
/// a global solve for each source would also be wasted. A wave front that unfolds triangles is
/// local, takes microseconds, and is exact where the surface is flat.
///
/// ```
/// use cape_core::geometry::SurfaceMesh;
/// use cape_layer::geometry::{Geodesics, GeodesicMetric};
/// use glam::DVec3;
///
/// // From corner to corner of a square of two triangles, across the other diagonal.
/// let corners = vec![DVec3::ZERO, DVec3::X, DVec3::new(1.0, 1.0, 0.0), DVec3::Y];
/// let square = SurfaceMesh::new("square", corners, vec![[0, 1, 2], [0, 2, 3]])?;
/// let across = |metric| Geodesics::new(&square, metric).within(1, 3.0)[3].1;
/// assert_eq!(across(GeodesicMetric::Graph), 2.0);
/// assert!((across(GeodesicMetric::Unfolded) - 2f64.sqrt()).abs() < 1e-12);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct Geodesics {
    vertices: Vec<DVec3>,
    faces: Vec<[u32; 3]>,
    around: Vec<Vec<u32>>,
    metric: GeodesicMetric,
}

impl Geodesics {
    /// Distances on a surface.
    pub fn new(surface: &SurfaceMesh, metric: GeodesicMetric) -> Self {
        Self {
            vertices: surface.vertices.clone(),
            faces: surface.faces.clone(),
            around: surface.vertex_faces(),
            metric,
        }
    }

    /// Vertices within `reach` metres of the vertex `source` and their distances, metres, by
    /// ascending vertex.
    pub fn within(&self, source: u32, reach: f64) -> Vec<(u32, f64)> {
        let mut distances: HashMap<u32, f64> = HashMap::from([(source, 0.0)]);
        let mut front = BinaryHeap::from([HeapEntry { distance: 0.0, vertex: source }]);
        while let Some(HeapEntry { distance, vertex }) = front.pop() {
            if distance > distances[&vertex] {
                continue;
            }
            for &face in &self.around[vertex as usize] {
                let others = others(self.faces[face as usize], vertex);
                for [target, third] in [others, [others[1], others[0]]] {
                    let known = distances.get(&third).copied();
                    let found = self.step(distance, vertex, known.map(|d| (d, third)), target);
                    let before = distances.get(&target).copied().unwrap_or(f64::INFINITY);
                    if found <= reach && found < before - 1e-12 {
                        distances.insert(target, found);
                        front.push(HeapEntry { distance: found, vertex: target });
                    }
                }
            }
        }
        let mut found: Vec<(u32, f64)> = distances.into_iter().collect();
        found.sort_unstable_by_key(|&(vertex, _)| vertex);
        found
    }

    /// Distance of `target` through the triangle of `vertex`, `target` and, if known, a third corner.
    fn step(&self, distance: f64, vertex: u32, third: Option<(f64, u32)>, target: u32) -> f64 {
        let at = |v: u32| self.vertices[v as usize];
        let along = distance + at(vertex).distance(at(target));
        match (self.metric, third) {
            (GeodesicMetric::Unfolded, Some((other, third))) => {
                unfold([at(vertex), at(third), at(target)], [distance, other])
                    .map_or(along, |across| across.min(along))
            }
            _ => along,
        }
    }
}

/// Distance of corner `c` from the virtual source at distances `da` from corner `a` and `db` from
/// corner `b` in the plane of the triangle, if the straight line from it crosses the side `ab`.
fn unfold([a, b, c]: [DVec3; 3], [da, db]: [f64; 2]) -> Option<f64> {
    let base = a.distance(b);
    if base == 0.0 {
        return None;
    }
    let along = (b - a) / base;
    // The source lies below the side, at (x, −y); the corner above it, at (cx, cy).
    let x = (base * base + da * da - db * db) / (2.0 * base);
    let y2 = da * da - x * x;
    if y2 < -1e-9 * base * base {
        return None;
    }
    let y = y2.max(0.0).sqrt();
    let cx = (c - a).dot(along);
    let cy = ((c - a) - along * cx).length();
    if cy + y == 0.0 {
        return None;
    }
    let crossing = x + (cx - x) * y / (y + cy);
    let slack = 1e-9 * base;
    (-slack..=base + slack).contains(&crossing).then(|| (cx - x).hypot(cy + y))
}

/// Corners of a face other than `vertex`.
fn others([a, b, c]: [u32; 3], vertex: u32) -> [u32; 2] {
    if a == vertex {
        [b, c]
    } else if b == vertex {
        [c, a]
    } else {
        [a, b]
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct HeapEntry {
    distance: f64,
    vertex: u32,
}

impl Eq for HeapEntry {}

impl Ord for HeapEntry {
    /// Reversed by distance: `BinaryHeap` pops the greatest entry first.
    fn cmp(&self, other: &Self) -> Ordering {
        other.distance.total_cmp(&self.distance).then(other.vertex.cmp(&self.vertex))
    }
}

impl PartialOrd for HeapEntry {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}
