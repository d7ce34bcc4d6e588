//! Points of garments that the vertices of a body follow.

use cape_core::geometry::{ClosestPoint, SurfaceIndex, SurfaceMesh, closest_on_triangle};
use glam::DVec3;
use rayon::prelude::*;

use crate::mesh_graph::MeshGraph;

/// Greatest distance of a garment from a body vertex that it covers, metres.
const REACH: f64 = 0.15;

/// Greatest distance along the normal, relative to the distance of the closest point, and in addition,
/// metres.
const ALONG_NORMAL: [f64; 2] = [2.0, 0.01];

/// Iterations of the interpolation where no point lies along the normal, and of the relaxation of
/// turned triangles.
const FILL: usize = 200;
const RELAX: usize = 20;

/// Rounds of the smoothing of sliding, each of which takes half of the mean of a vertex's neighbours.
const SMOOTHING: usize = 30;

/// Point on a garment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GarmentPoint {
    /// Index of the garment.
    pub garment: usize,
    /// Vertices of its face.
    pub corners: [u32; 3],
    /// Barycentric coordinates.
    pub barycentric: [f64; 3],
}

impl GarmentPoint {
    /// Position for the positions of the garment's vertices, metres.
    pub fn position(&self, vertices: &[DVec3]) -> DVec3 {
        let weighted = self.corners.iter().zip(self.barycentric);
        weighted.map(|(&v, w)| vertices[v as usize] * w).sum()
    }
}

/// Correspondence of body vertices and points of garments, found in the pose in which the garments
/// were sewn and kept in all others, so that cloth that slides over the skin moves the vertices along.
///
/// ```
/// use cape_core::geometry::{SurfaceMesh, primitives::sphere};
/// use cape_wardrobe::SurfaceTransfer;
///
/// // A closed garment 1 cm above a sphere covers all of its vertices.
/// let (body, garment) = (sphere(0.2, 3), sphere(0.21, 3));
/// let transfer = SurfaceTransfer::fit(&body, std::slice::from_ref(&garment));
/// assert!(transfer.points().iter().all(Option::is_some));
/// let laid = transfer.lay(&body.vertices, &garment.vertices);
/// assert!(laid.iter().all(|p| (p.length() - 0.21).abs() < 1e-3));
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct SurfaceTransfer {
    points: Vec<Option<GarmentPoint>>,
}

impl SurfaceTransfer {
    /// Finds the points for a body in garments, from the inner to the outer one; their faces may index
    /// shared vertices.
    ///
    /// A vertex is covered if the closest point of the garment is inside it and not on its boundary.
    /// Its point lies along the normal; where none does, at armpits and between the legs, the offset
    /// from the body is interpolated harmonically. Vertices next to a hem are moved onto it. Of two
    /// garments over a vertex the outer one is taken.
    pub fn fit(body: &SurfaceMesh, garments: &[SurfaceMesh]) -> Self {
        let graph = MeshGraph::new(body);
        let normals = body.vertex_normals();
        let mut points = vec![None; body.vertices.len()];
        for (index, garment) in garments.iter().enumerate() {
            let fitting = GarmentFit { body, normals: &normals, graph: &graph, garment, index };
            for (point, found) in points.iter_mut().zip(fitting.points()) {
                *point = found.or(*point);
            }
        }
        Self { points }
    }

    /// Points of the body's vertices, `[V]`; `None` for those that no garment covers.
    pub fn points(&self) -> &[Option<GarmentPoint>] {
        &self.points
    }

    /// The body's vertices `[V]` with the covered ones on garments of the vertices `garment`, metres.
    pub fn lay(&self, body: &[DVec3], garment: &[DVec3]) -> Vec<DVec3> {
        let covered = self.points.iter().zip(body);
        covered.map(|(point, &skin)| point.map_or(skin, |point| point.position(garment))).collect()
    }
}

/// Body on which a garment's sliding is measured, in one frame.
pub(crate) struct PosedBody<'a> {
    pub(crate) surface: &'a SurfaceMesh,
    pub(crate) graph: &'a MeshGraph,
}

impl SurfaceTransfer {
    /// [`lay`](Self::lay) on the posed `garments` with the share `kept` of sliding, 0 to 1. Sliding is
    /// the smooth part of the displacement from the skin along it. What is not kept is taken back, and
    /// the vertices go to the closest points of their garments: folds and hems stay where they are in
    /// space, but other vertices of the body lie on them. With all of it, vertices follow the cloth's
    /// material; with none, the skin under it.
    pub(crate) fn lay_sliding(
        &self,
        body: &PosedBody,
        garments: &[SurfaceMesh],
        kept: f64,
    ) -> Vec<DVec3> {
        let skin = &body.surface.vertices;
        let on = |(point, &skin): (&Option<GarmentPoint>, &DVec3)| {
            point.map_or(skin, |point| point.position(&garments[point.garment].vertices))
        };
        let laid: Vec<DVec3> = self.points.iter().zip(skin).map(on).collect();
        if kept >= 1.0 {
            return laid;
        }
        let normals = body.surface.vertex_normals();
        let along = |v: usize| (laid[v] - skin[v]).reject_from_normalized(normals[v]);
        let mut sliding: Vec<Option<DVec3>> =
            (0..laid.len()).map(|v| self.points[v].map(|_| along(v))).collect();
        for _ in 0..SMOOTHING {
            let smooth = |v: usize| {
                let own = sliding[v]?;
                let mean = body.graph.mean_known(v as u32, &sliding);
                Some(mean.map_or(own, |mean| own.midpoint(mean)))
            };
            sliding = (0..laid.len()).map(smooth).collect();
        }
        let indices: Vec<SurfaceIndex> = garments.iter().map(SurfaceIndex::new).collect();
        let back = |v: usize| {
            let (point, slid) = (self.points[v]?, sliding[v]?);
            indices[point.garment].closest(laid[v] - (1.0 - kept) * slid, REACH)
        };
        let vertices = (0..laid.len()).into_par_iter();
        vertices.map(|v| back(v).map_or(laid[v], |near| near.point)).collect()
    }
}

/// One garment on a body in the fitting pose.
struct GarmentFit<'a> {
    body: &'a SurfaceMesh,
    normals: &'a [DVec3],
    graph: &'a MeshGraph,
    garment: &'a SurfaceMesh,
    index: usize,
}

impl GarmentFit<'_> {
    fn points(&self) -> Vec<Option<GarmentPoint>> {
        let index = SurfaceIndex::new(self.garment);
        let across = self.garment.neighbours();
        let faces = self.garment.face_normals();
        let closest: Vec<Option<ClosestPoint>> = self
            .body
            .vertices
            .par_iter()
            .map(|&p| {
                let near = index.closest(p, REACH)?;
                let open = |side: usize| across[near.face as usize][side].is_none();
                let on_boundary =
                    (0..3).any(|side| open(side) && near.barycentric[(side + 2) % 3] < 1e-9);
                (near.signed_distance <= 0.0 && !on_boundary).then_some(near)
            })
            .collect();
        let mut offsets: Vec<Option<DVec3>> = closest
            .par_iter()
            .zip(&self.body.vertices)
            .zip(self.normals)
            .map(|((near, &p), &normal)| {
                let [ratio, more] = ALONG_NORMAL;
                let reach = near.as_ref()?.signed_distance.abs() * ratio + more;
                let hit = index.cast(p, normal, reach)?;
                (faces[hit.face as usize].dot(normal) > 0.3).then_some(hit.point - p)
            })
            .collect();
        let covered: Vec<bool> = closest.iter().map(Option::is_some).collect();
        self.graph.fill(&mut offsets, &covered, FILL);
        let nearest = |p: DVec3| {
            let near = index.closest(p, REACH)?;
            let corners = self.garment.faces[near.face as usize];
            Some(GarmentPoint { garment: self.index, corners, barycentric: near.barycentric })
        };
        let place = |v: usize, offset: DVec3| nearest(self.body.vertices[v] + offset);
        let mut points: Vec<Option<GarmentPoint>> = (0..covered.len())
            .into_par_iter()
            .map(|v| offsets[v].filter(|_| covered[v]).and_then(|offset| place(v, offset)))
            .collect();
        for _ in 0..RELAX {
            let laid = self.laid(&points);
            let turned = self.graph.turned(self.normals_of_faces(), &laid);
            if turned.is_empty() {
                break;
            }
            let offset = |v: u32| laid[v as usize] - self.body.vertices[v as usize];
            for v in self.graph.corners(&turned) {
                if points[v as usize].is_some() {
                    let mean = 0.5 * (offset(v) + self.graph.mean(v, offset));
                    points[v as usize] = place(v as usize, mean);
                }
            }
        }
        self.snap_to_hems(&mut points);
        points
    }

    fn normals_of_faces(&self) -> Vec<DVec3> {
        self.body.face_normals()
    }

    fn laid(&self, points: &[Option<GarmentPoint>]) -> Vec<DVec3> {
        let of = |(point, &skin): (&Option<GarmentPoint>, &DVec3)| {
            point.map_or(skin, |point| point.position(&self.garment.vertices))
        };
        points.iter().zip(&self.body.vertices).map(of).collect()
    }

    /// Moves, of each body edge across a hem, the end closer to the hem onto it, unless that would
    /// flatten or turn a triangle.
    fn snap_to_hems(&self, points: &mut [Option<GarmentPoint>]) {
        let hem = self.boundary_edges();
        let mut laid = self.laid(points);
        let mut moves: Vec<(f64, u32, GarmentPoint)> = Vec::new();
        for &[a, b] in &self.graph.edges {
            let (inner, outer) = match (points[a as usize], points[b as usize]) {
                (Some(_), None) => (a, b),
                (None, Some(_)) => (b, a),
                _ => continue,
            };
            let offset = laid[inner as usize] - self.body.vertices[inner as usize];
            let beyond = self.closest_on_hem(&hem, self.body.vertices[outer as usize] + offset);
            let within = self.closest_on_hem(&hem, laid[inner as usize]);
            let (Some(beyond), Some(within)) = (beyond, within) else { continue };
            let (distance, v, point) = if beyond.0 < within.0 {
                (beyond.0, outer, beyond.1)
            } else {
                (within.0, inner, within.1)
            };
            moves.push((distance, v, point));
        }
        moves.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut moved = vec![false; points.len()];
        let rest = self.normals_of_faces();
        for (_, v, point) in moves {
            if std::mem::replace(&mut moved[v as usize], true) {
                continue;
            }
            let before = self.graph.least_quality(v, &rest, &laid);
            let from =
                std::mem::replace(&mut laid[v as usize], point.position(&self.garment.vertices));
            let after = self.graph.least_quality(v, &rest, &laid);
            if after >= before.min(LEAST_QUALITY) {
                points[v as usize] = Some(point);
            } else {
                laid[v as usize] = from;
            }
        }
    }

    /// Edges of the garment's boundary with the third corner of their face.
    fn boundary_edges(&self) -> Vec<[u32; 3]> {
        let faces = self.garment.faces.iter().zip(self.garment.neighbours());
        let open = faces.flat_map(|(corners, across)| {
            let sides = (0..3).filter(move |&side| across[side].is_none());
            sides.map(|side| [0, 1, 2].map(|k| corners[(side + k) % 3]))
        });
        open.collect()
    }

    fn closest_on_hem(&self, hem: &[[u32; 3]], p: DVec3) -> Option<(f64, GarmentPoint)> {
        let on_edge = |&corners: &[u32; 3]| {
            let [a, b, _] = corners.map(|v| self.garment.vertices[v as usize]);
            let (nearest, [first, second, third]) = closest_on_triangle(p, [a, b, b]);
            let barycentric = [first, second + third, 0.0];
            (nearest.distance(p), GarmentPoint { garment: self.index, corners, barycentric })
        };
        hem.iter().map(on_edge).min_by(|a, b| a.0.total_cmp(&b.0))
    }
}

/// Least quality of a triangle, see [`MeshGraph::least_quality`], that moving a vertex onto a hem may
/// leave.
const LEAST_QUALITY: f64 = 0.15;
