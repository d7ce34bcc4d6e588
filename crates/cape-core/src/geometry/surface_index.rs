use glam::{DMat3, DVec3};

use super::{
    box_tree::{BoxTree, bounds},
    surface::{SurfaceMesh, corner_angle, face_normals},
};

/// Intersection of a ray with a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RayHit {
    /// Index of the face.
    pub face: u32,
    /// Distance from the ray's origin, metres.
    pub distance: f64,
    /// Position of the intersection, metres.
    pub point: DVec3,
}

/// Point of a surface closest to a query point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClosestPoint {
    /// Index of the face that the point lies on.
    pub face: u32,
    /// Barycentric coordinates of the point on the face.
    pub barycentric: [f64; 3],
    /// Position of the point, metres.
    pub point: DVec3,
    /// Signed distance of the query point, metres; negative inside.
    pub signed_distance: f64,
    /// Gradient of the signed distance, a unit vector.
    pub outward: DVec3,
}

/// Bounding-volume hierarchy over the triangles of a surface, static or moving, for closest-point
/// and ray queries.
///
/// For a surface that moves linearly between two frames the bounding boxes enclose the whole sweep,
/// so that one hierarchy is valid at every time ([`set_time`](Self::set_time)). Distances are signed
/// by angle-weighted pseudo-normals.
///
/// ```
/// use cape_core::geometry::{SurfaceIndex, primitives::sphere};
/// use glam::DVec3;
///
/// // The faces of an octahedron of radius 1 are 1/√3 from its centre.
/// let index = SurfaceIndex::new(&sphere(1.0, 0));
/// let (outside, inward) = (DVec3::ONE, -DVec3::ONE.normalize());
/// let hit = index.cast(outside, inward, 3.0).ok_or("no hit")?;
/// assert!((hit.distance - (3f64.sqrt() - 1.0 / 3f64.sqrt())).abs() < 1e-9);
/// // Distances are negative inside.
/// let closest = index.closest(0.1 * DVec3::ONE, 1.0).ok_or("too far")?;
/// assert!((closest.signed_distance + 0.7 / 3f64.sqrt()).abs() < 1e-9);
/// assert!((closest.outward + inward).length() < 1e-9);
/// # Ok::<(), &str>(())
/// ```
#[derive(Debug, Clone)]
pub struct SurfaceIndex {
    from: Vec<DVec3>,
    to: Vec<DVec3>,
    faces: Vec<[u32; 3]>,
    across: Vec<[Option<u32>; 3]>,
    tree: BoxTree,
    now: SurfaceMesh,
    face_normals: Vec<DVec3>,
}

impl SurfaceIndex {
    /// Indexes a static surface.
    pub fn new(surface: &SurfaceMesh) -> Self {
        let across = surface.neighbours();
        Self::moving(surface, surface.vertices.clone(), across)
    }

    /// Indexes a surface whose vertices move linearly to `to` as the time goes from 0 to 1; `across`
    /// is its face adjacency, [`SurfaceMesh::neighbours`].
    pub fn moving(surface: &SurfaceMesh, to: Vec<DVec3>, across: Vec<[Option<u32>; 3]>) -> Self {
        let swept = |face: &[u32; 3]| {
            bounds(face.iter().flat_map(|&v| [surface.vertices[v as usize], to[v as usize]]))
        };
        let tree = BoxTree::new(surface.faces.iter().map(swept));
        let face_normals = surface.face_normals();
        Self {
            from: surface.vertices.clone(),
            to,
            faces: surface.faces.clone(),
            across,
            tree,
            now: surface.clone(),
            face_normals,
        }
    }

    /// Moves the surface to time `t`, 0 to 1.
    pub fn set_time(&mut self, t: f64) {
        for ((now, &from), &to) in self.now.vertices.iter_mut().zip(&self.from).zip(&self.to) {
            *now = from.lerp(to, t);
        }
        self.face_normals = face_normals(&self.now.vertices, &self.faces);
    }

    /// The surface at the current time.
    pub fn surface(&self) -> &SurfaceMesh {
        &self.now
    }

    /// Position at time `t` of the surface point at `barycentric` on `face`, metres.
    pub fn position_at(&self, face: u32, barycentric: [f64; 3], t: f64) -> DVec3 {
        let corners = self.faces[face as usize].map(|v| v as usize);
        corners.iter().zip(barycentric).map(|(&v, w)| self.from[v].lerp(self.to[v], t) * w).sum()
    }

    /// First intersection of a ray (unit `direction`) within `reach` metres.
    pub fn cast(&self, origin: DVec3, direction: DVec3, reach: f64) -> Option<RayHit> {
        let (face, distance) = self.tree.cast(origin, direction, reach, |face| {
            let distance =
                ray_triangle_distance(origin, direction, self.now.corners(face as usize))?;
            (distance <= reach).then_some(distance)
        })?;
        Some(RayHit { face, distance, point: origin + direction * distance })
    }

    /// Closest point of the surface within `reach` metres.
    pub fn closest(&self, point: DVec3, reach: f64) -> Option<ClosestPoint> {
        self.closest_from(point, reach, None)
    }

    /// [`closest`](Self::closest) with a face near the point as initial `guess`, which speeds up the
    /// search.
    pub fn closest_from(
        &self,
        point: DVec3,
        reach: f64,
        guess: Option<u32>,
    ) -> Option<ClosestPoint> {
        let distance = |face: u32| {
            point.distance(closest_on_triangle(point, self.now.corners(face as usize)).0)
        };
        let known = guess.map(|face| (face, distance(face))).filter(|known| known.1 < reach);
        let reach = known.map_or(reach, |known| known.1);
        let better = self.tree.nearest(point, reach, |face| Some(distance(face)));
        let (face, _) = better.or(known)?;
        let (nearest, barycentric) = closest_on_triangle(point, self.now.corners(face as usize));
        let normal = self.pseudo_normal(face as usize, barycentric);
        let away = point - nearest;
        let distance = away.length();
        let inside = away.dot(normal) < 0.0;
        let outward = match away.try_normalize() {
            Some(direction) if distance > 1e-12 => {
                if inside {
                    -direction
                } else {
                    direction
                }
            }
            _ => normal,
        };
        let signed_distance = if inside { -distance } else { distance };
        Some(ClosestPoint { face, barycentric, point: nearest, signed_distance, outward })
    }

    /// Largest displacement of a vertex from time 0 to 1, metres.
    pub fn largest_displacement(&self) -> f64 {
        self.from.iter().zip(&self.to).map(|(from, to)| from.distance(*to)).fold(0.0, f64::max)
    }

    /// Orthonormal frame of a face at the current time, as columns: first edge, normal, and their
    /// cross product.
    pub fn axes(&self, face: u32) -> DMat3 {
        let [a, b, _] = self.now.corners(face as usize);
        let (side, normal) = ((b - a).normalize_or_zero(), self.face_normals[face as usize]);
        DMat3::from_cols(side, normal, side.cross(normal))
    }

    /// Pseudo-normal of the face, edge or vertex that a point of a face lies on.
    fn pseudo_normal(&self, face: usize, barycentric: [f64; 3]) -> DVec3 {
        const ON: f64 = 1e-9;
        let off: Vec<usize> = (0..3).filter(|&i| barycentric[i] > ON).collect();
        match off[..] {
            [corner] => self.vertex_normal(face, corner),
            [a, b] => {
                // Side `i` runs from corner `i` to corner `i + 1`.
                let side = if (a + 1) % 3 == b { a } else { b };
                let other =
                    self.across[face][side].map_or(DVec3::ZERO, |f| self.face_normals[f as usize]);
                (self.face_normals[face] + other).normalize_or_zero()
            }
            _ => self.face_normals[face],
        }
    }

    /// Angle-weighted normal of the vertex at a corner of a face.
    fn vertex_normal(&self, face: usize, corner: usize) -> DVec3 {
        let vertex = self.faces[face][corner];
        let corner_of = |face: usize| self.faces[face].iter().position(|&v| v == vertex);
        let mut sum = DVec3::ZERO;
        let mut add = |face: usize, corner: usize| {
            sum += self.face_normals[face] * corner_angle(self.now.corners(face), corner);
        };
        add(face, corner);
        // Walk around the vertex over the edge that ends there, then the other way from a boundary.
        for turn in [2, 0] {
            let mut here = (face, corner);
            // Bounded: adjacent faces of opposite orientation would make the walk endless.
            for _ in 0..MAX_VALENCE {
                let Some(next) = self.across[here.0][(here.1 + turn) % 3] else { break };
                let next = next as usize;
                let Some(corner) = corner_of(next) else { break };
                if next == face {
                    return sum.normalize_or_zero();
                }
                add(next, corner);
                here = (next, corner);
            }
        }
        sum.normalize_or_zero()
    }
}

/// Largest number of faces visited around a vertex in one direction.
const MAX_VALENCE: usize = 100;

/// Distance along a ray to a triangle (Möller and Trumbore 1997), metres. Triangles are enlarged by
/// a relative 1e-9, so that no ray passes between two adjacent ones.
pub fn ray_triangle_distance(
    origin: DVec3,
    direction: DVec3,
    [a, b, c]: [DVec3; 3],
) -> Option<f64> {
    const SLACK: f64 = 1e-9;
    let (ab, ac) = (b - a, c - a);
    let across = direction.cross(ac);
    let determinant = ab.dot(across);
    let from = origin - a;
    let (u, lift) = (from.dot(across) / determinant, from.cross(ab));
    let (v, t) = (direction.dot(lift) / determinant, ac.dot(lift) / determinant);
    (u >= -SLACK && v >= -SLACK && u + v <= 1.0 + SLACK && t >= 0.0).then_some(t)
}

/// Closest point of a triangle to `p` and its barycentric coordinates (Ericson 2005, §5.1.5).
pub fn closest_on_triangle(p: DVec3, [a, b, c]: [DVec3; 3]) -> (DVec3, [f64; 3]) {
    let (ab, ac) = (b - a, c - a);
    let ap = p - a;
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return (a, [1.0, 0.0, 0.0]);
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return (b, [0.0, 1.0, 0.0]);
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 && d1 > d3 {
        let v = d1 / (d1 - d3);
        return (a + ab * v, [1.0 - v, v, 0.0]);
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return (c, [0.0, 0.0, 1.0]);
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 && d2 > d6 {
        let w = d2 / (d2 - d6);
        return (a + ac * w, [1.0 - w, 0.0, w]);
    }
    let va = d3 * d6 - d5 * d4;
    let (near_b, near_c) = (d4 - d3, d5 - d6);
    if va <= 0.0 && near_b >= 0.0 && near_c >= 0.0 && near_b + near_c > 0.0 {
        let w = near_b / (near_b + near_c);
        return (b + (c - b) * w, [0.0, 1.0 - w, w]);
    }
    let sum = va + vb + vc;
    if sum <= 0.0 {
        return (a, [1.0, 0.0, 0.0]);
    }
    let (v, w) = (vb / sum, vc / sum);
    (a + ab * v + ac * w, [1.0 - v - w, v, w])
}
