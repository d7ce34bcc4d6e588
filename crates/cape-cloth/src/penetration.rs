use cape_core::geometry::{
    BoxTree, SurfaceMesh, bounds, closest_on_triangle, ray_triangle_distance,
};
use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Penetration of a cloth into a closed body, measured on the two surfaces alone: by intersections of
/// edges with faces, both ways, and by winding numbers, not at the points where the simulation
/// resolves contact.
///
/// Parts of a body may overlap, as an arm and the torso in the armpit. Surfaces inside another part
/// are hidden: cloth that meets only these is counted apart.
///
/// ```
/// use cape_cloth::Penetration;
/// use cape_core::geometry::{SurfaceMesh, primitives::sphere};
/// use glam::DVec3;
///
/// // A ball of radius 0.1 m reaches 2 cm through the middle of a large triangle.
/// let ball = sphere(0.1, 4);
/// let corners = [(-5.0, -5.0), (5.0, -5.0), (0.0, 5.0)].map(|(x, z)| DVec3::new(x, 0.08, z));
/// let cloth = SurfaceMesh::new("cloth", corners.to_vec(), vec![[0, 1, 2]])?;
/// let found = Penetration::measure(&cloth, &ball);
/// assert!(found.inside == 0 && found.intersections > 0);
/// assert!((found.depth - 0.02).abs() < 1e-3);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Penetration {
    /// Largest depth of a point of the cloth inside the body, metres.
    pub depth: f64,
    /// Mean depth of the vertices of the cloth inside the body, 0 for those outside, metres.
    pub mean_depth: f64,
    /// Number of vertices of the cloth inside the body.
    pub inside: usize,
    /// Number of intersections of edges of the cloth with faces of the body, and of edges of the body
    /// with faces of the cloth.
    pub intersections: usize,
    /// Number of vertices and intersections on or in hidden parts of the body.
    pub hidden: usize,
}

/// An intersection of an edge with a face.
#[derive(Debug, Clone, Copy)]
struct Piercing {
    edge: u32,
    face: u32,
    point: DVec3,
}

impl Penetration {
    /// Measures a cloth against a closed body.
    pub fn measure(cloth: &SurfaceMesh, body: &SurfaceMesh) -> Self {
        let body = Solid::new(body);
        let (edges, body_edges) = (cloth.edges(), body.surface.edges());
        let by_cloth = piercings(&edges, &cloth.vertices, body.surface, &body.tree);
        let cloth_tree = BoxTree::from_elements(&cloth.faces, &cloth.vertices);
        let by_body = piercings(&body_edges, &body.surface.vertices, cloth, &cloth_tree);
        let mut found = Self::default();
        // A body edge has the normal of one of its faces, which is enough to step off the surface.
        let mut normal_of = vec![DVec3::ZERO; body.surface.vertices.len()];
        if !by_body.is_empty() {
            normal_of = body.surface.vertex_normals();
        }
        let hidden = |piercing: &Piercing, normal: DVec3| body.is_hidden(piercing.point, normal);
        let mut pierced: Vec<u32> = Vec::new();
        for piercing in &by_cloth {
            if hidden(piercing, body.normals[piercing.face as usize]) {
                found.hidden += 1;
            } else {
                found.intersections += 1;
            }
        }
        for piercing in &by_body {
            let [a, b] = body_edges[piercing.edge as usize].map(|v| normal_of[v as usize]);
            if hidden(piercing, (a + b).normalize_or_zero()) {
                found.hidden += 1;
            } else {
                found.intersections += 1;
                pierced.push(piercing.face);
            }
        }
        let windings = body.windings(cloth, &edges, &by_cloth);
        let depths: Vec<f64> = (0..cloth.vertices.len())
            .into_par_iter()
            .map(|v| if windings[v] == 1 { body.distance(cloth.vertices[v]) } else { 0.0 })
            .collect();
        found.inside = windings.iter().filter(|&&winding| winding == 1).count();
        found.hidden += windings.iter().filter(|&&winding| winding > 1).count();
        found.mean_depth = depths.iter().sum::<f64>() / depths.len().max(1) as f64;
        found.depth = depths.into_iter().fold(0.0, f64::max);
        pierced.sort_unstable();
        pierced.dedup();
        let inner = pierced.par_iter().map(|&face| body.depth_within(cloth.corners(face as usize)));
        found.depth = inner.collect::<Vec<f64>>().into_iter().fold(found.depth, f64::max);
        found
    }
}

/// Intersections of edges with the faces of a surface.
fn piercings(
    edges: &[[u32; 2]],
    vertices: &[DVec3],
    surface: &SurfaceMesh,
    tree: &BoxTree,
) -> Vec<Piercing> {
    edges
        .par_iter()
        .enumerate()
        .flat_map_iter(|(edge, ends)| {
            let [from, to] = ends.map(|v| vertices[v as usize]);
            let faces = tree.overlapping(bounds([from, to]));
            let hit = move |face: u32| {
                let corners = surface.corners(face as usize);
                let t = ray_triangle_distance(from, to - from, corners).filter(|&t| t <= 1.0)?;
                Some(Piercing { edge: edge as u32, face, point: from.lerp(to, t) })
            };
            faces.into_iter().filter_map(hit)
        })
        .collect()
}

/// A closed surface with its hierarchy.
struct Solid<'a> {
    surface: &'a SurfaceMesh,
    normals: Vec<DVec3>,
    tree: BoxTree,
}

/// Directions of the rays that count windings: oblique, so that they rarely meet an edge.
const DIRECTIONS: [DVec3; 3] = [
    DVec3::new(0.267_261_241_912, 0.534_522_483_825, 0.801_783_725_737),
    DVec3::new(-0.811_107_105_654, 0.486_664_263_392, -0.324_442_842_262),
    DVec3::new(0.436_435_780_472, -0.872_871_560_944, 0.218_217_890_236),
];

/// Distance by which rays leave a surface, metres.
const OFF: f64 = 1e-9;

impl<'a> Solid<'a> {
    fn new(surface: &'a SurfaceMesh) -> Self {
        let tree = BoxTree::from_elements(&surface.faces, &surface.vertices);
        Self { surface, normals: surface.face_normals(), tree }
    }

    /// Number of parts of the body that a point is in: faces left minus faces entered by a ray, on
    /// which two rays of three agree.
    fn winding(&self, point: DVec3) -> i32 {
        let [one, other, third] =
            DIRECTIONS.map(|direction| move || self.winding_along(point, direction));
        let (one, other) = (one(), other());
        if one == other { one } else { one.max(other).min(third().max(one.min(other))) }
    }

    /// Number of faces that a ray leaves minus those that it enters.
    fn winding_along(&self, point: DVec3, direction: DVec3) -> i32 {
        let (mut from, mut count) = (point, 0);
        while let Some((face, way)) = self.tree.cast(from, direction, f64::MAX, |face| {
            ray_triangle_distance(from, direction, self.surface.corners(face as usize))
        }) {
            count += if self.normals[face as usize].dot(direction) > 0.0 { 1 } else { -1 };
            from += direction * (way + OFF);
        }
        count
    }

    /// True if a point of the surface with the unit normal `outward` is inside another part.
    fn is_hidden(&self, point: DVec3, outward: DVec3) -> bool {
        self.winding(point + outward * 1e-6) > 0
    }

    /// Winding number of each vertex of a cloth, of which an edge changes it only where it pierces
    /// the body: one point is measured for each connected part.
    fn windings(&self, cloth: &SurfaceMesh, edges: &[[u32; 2]], by_cloth: &[Piercing]) -> Vec<i32> {
        let mut cut = vec![false; edges.len()];
        for piercing in by_cloth {
            cut[piercing.edge as usize] = true;
        }
        let mut around = vec![Vec::new(); cloth.vertices.len()];
        for ([a, b], _) in edges.iter().zip(cut).filter(|(_, cut)| !cut) {
            around[*a as usize].push(*b);
            around[*b as usize].push(*a);
        }
        let mut windings = vec![None; cloth.vertices.len()];
        for seed in 0..windings.len() {
            if windings[seed].is_some() {
                continue;
            }
            let winding = self.winding(cloth.vertices[seed]);
            let mut front = vec![seed as u32];
            while let Some(v) = front.pop() {
                if windings[v as usize].replace(winding).is_none() {
                    front.extend(&around[v as usize]);
                }
            }
        }
        windings.into_iter().flatten().collect()
    }

    /// Distance of a point from the surface, metres.
    fn distance(&self, point: DVec3) -> f64 {
        let distance = |face: u32| {
            Some(closest_on_triangle(point, self.surface.corners(face as usize)).0.distance(point))
        };
        self.tree.nearest(point, f64::MAX, distance).map_or(0.0, |nearest| nearest.1)
    }

    /// Largest depth of a triangle of the cloth inside the body, sampled where the bound of its parts
    /// is largest, until it exceeds what was found by less than a tenth of a millimetre, metres.
    fn depth_within(&self, corners: [DVec3; 3]) -> f64 {
        const TOLERANCE: f64 = 1e-4;
        const MOST: usize = 256;
        let mut deepest = 0.0f64;
        let mut parts = vec![(f64::INFINITY, corners)];
        for _ in 0..MOST {
            let best = (0..parts.len()).max_by(|&a, &b| parts[a].0.total_cmp(&parts[b].0));
            let Some(best) = best.filter(|&best| parts[best].0 > deepest + TOLERANCE) else {
                break;
            };
            let [a, b, c] = parts.swap_remove(best).1;
            let [ab, bc, ca] = [a.midpoint(b), b.midpoint(c), c.midpoint(a)];
            for part in [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]] {
                let centre = part.iter().sum::<DVec3>() / 3.0;
                let radius = part.iter().map(|p| p.distance(centre)).fold(0.0, f64::max);
                let distance = self.distance(centre);
                let inside = self.winding(centre) == 1;
                if inside {
                    deepest = deepest.max(distance);
                }
                parts.push((if inside { distance + radius } else { radius - distance }, part));
            }
        }
        deepest
    }
}
