//! Neighbourhoods of the vertices and faces of a body, and interpolation over them.

use cape_core::geometry::{BoxTree, SurfaceMesh, bounds, ray_triangle_distance};
use glam::DVec3;

/// Edges, neighbours and faces around the vertices of a mesh.
#[derive(Debug, Clone)]
pub(crate) struct MeshGraph {
    pub(crate) edges: Vec<[u32; 2]>,
    pub(crate) faces: Vec<[u32; 3]>,
    neighbours: Vec<Vec<u32>>,
    around: Vec<Vec<u32>>,
    /// Areas of the faces, doubled, square metres.
    areas: Vec<f64>,
}

impl MeshGraph {
    pub(crate) fn new(surface: &SurfaceMesh) -> Self {
        let edges = surface.edges();
        let mut neighbours = vec![Vec::new(); surface.vertices.len()];
        for &[a, b] in &edges {
            neighbours[a as usize].push(b);
            neighbours[b as usize].push(a);
        }
        let area = |face| doubled_area(surface.corners(face)).length();
        Self {
            edges,
            neighbours,
            around: surface.vertex_faces(),
            areas: (0..surface.faces.len()).map(area).collect(),
            faces: surface.faces.clone(),
        }
    }

    /// Mean of a quantity over the neighbours of a vertex.
    pub(crate) fn mean(&self, vertex: u32, at: impl Fn(u32) -> DVec3) -> DVec3 {
        let near = &self.neighbours[vertex as usize];
        near.iter().map(|&n| at(n)).sum::<DVec3>() / near.len().max(1) as f64
    }

    /// Mean of the known values `[V]` of a vertex's neighbours.
    pub(crate) fn mean_known(&self, vertex: u32, values: &[Option<DVec3>]) -> Option<DVec3> {
        let near = self.neighbours[vertex as usize].iter();
        let (sum, count) = near
            .filter_map(|&n| values[n as usize])
            .fold((DVec3::ZERO, 0.0), |(sum, count), value| (sum + value, count + 1.0));
        (count > 0.0).then(|| sum / count)
    }

    /// Interpolates missing values harmonically from known ones over the vertices of `domain`, `[V]`.
    pub(crate) fn fill(&self, values: &mut [Option<DVec3>], domain: &[bool], iterations: usize) {
        let missing: Vec<usize> =
            (0..values.len()).filter(|&v| domain[v] && values[v].is_none()).collect();
        for _ in 0..iterations {
            for &v in &missing {
                let known: Vec<DVec3> = self.neighbours[v]
                    .iter()
                    .filter(|&&n| domain[n as usize])
                    .filter_map(|&n| values[n as usize])
                    .collect();
                if !known.is_empty() {
                    values[v] = Some(known.iter().sum::<DVec3>() / known.len() as f64);
                }
            }
        }
    }

    /// Faces of `vertices`, metres, turned against their normals `rest`, ascending.
    pub(crate) fn turned(&self, rest: impl AsRef<[DVec3]>, vertices: &[DVec3]) -> Vec<u32> {
        let turned = |&face: &u32| {
            let corners = self.faces[face as usize].map(|v| vertices[v as usize]);
            doubled_area(corners).dot(rest.as_ref()[face as usize]) < 0.0
        };
        (0..self.faces.len() as u32).filter(turned).collect()
    }

    /// Vertices of faces, ascending.
    pub(crate) fn corners(&self, faces: &[u32]) -> Vec<u32> {
        let mut corners: Vec<u32> =
            faces.iter().flat_map(|&face| self.faces[face as usize]).collect();
        corners.sort_unstable();
        corners.dedup();
        corners
    }

    /// `vertices` and their neighbours, ascending.
    pub(crate) fn grown(&self, vertices: &[u32]) -> Vec<u32> {
        let near = vertices.iter().flat_map(|&v| self.neighbours[v as usize].iter().copied());
        let mut grown: Vec<u32> = vertices.iter().copied().chain(near).collect();
        grown.sort_unstable();
        grown.dedup();
        grown
    }

    /// Least quality of the faces around a vertex: area in the direction of the normal `rest` relative
    /// to the area of the body's face; negative if one is turned.
    pub(crate) fn least_quality(&self, vertex: u32, rest: &[DVec3], at: &[DVec3]) -> f64 {
        let quality = |&face: &u32| {
            let face = face as usize;
            let corners = self.faces[face].map(|v| at[v as usize]);
            doubled_area(corners).dot(rest[face]) / self.areas[face].max(f64::MIN_POSITIVE)
        };
        self.around[vertex as usize].iter().map(quality).fold(f64::INFINITY, f64::min)
    }

    /// Faces that intersect others without a common vertex, for the positions `at`, metres, `[faces]`.
    pub(crate) fn intersecting(&self, at: &[DVec3]) -> Vec<bool> {
        let tree = BoxTree::from_elements(&self.faces, at);
        let place = |v: u32| at[v as usize];
        let mut hit = vec![false; self.faces.len()];
        for (index, face) in self.faces.iter().enumerate() {
            for side in 0..3 {
                let (a, b) = (face[side], face[(side + 1) % 3]);
                if a > b {
                    continue;
                }
                let (from, to) = (place(a), place(b));
                for other in tree.overlapping(bounds([from, to])) {
                    let corners = self.faces[other as usize];
                    if !corners.contains(&a)
                        && !corners.contains(&b)
                        && ray_triangle_distance(from, to - from, corners.map(place))
                            .is_some_and(|t| t <= 1.0)
                    {
                        hit[other as usize] = true;
                        hit[index] = true;
                    }
                }
            }
        }
        hit
    }
}

/// Normal of a triangle with twice its area as length.
fn doubled_area([a, b, c]: [DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a)
}
