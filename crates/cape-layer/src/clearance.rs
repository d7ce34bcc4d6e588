//! Clothing kept out of the body.

use cape_core::{
    SmplModel,
    geometry::{SurfaceIndex, SurfaceMesh, points},
};
use glam::DVec3;
use ndarray::{Array2, ArrayView2};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Least distance of predicted clothing from the body, metres.
pub(crate) const CLEARANCE: f64 = 0.002;

/// Rounds in which clothing is pushed out; what was moved along can get too near in each.
const ROUNDS: usize = 5;

/// Edges over which the displacement of a pushed vertex fades away.
const FADE: usize = 8;

/// Depth to which clothing inside the body is found, metres.
const REACH: f64 = 0.15;

/// Least distance of clothing from the body.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use cape_core::smpl::StandardPose;
/// use cape_layer::Clearance;
/// use cape_synth::synthetic_body;
///
/// // A patch on the skin, pushed 2 mm out of it.
/// let body = synthetic_body();
/// let set = patch(&body)?.0;
/// let posed = set.sequences[0].body(&body, 0, &StandardPose::default())?.posed;
/// let clearance = Clearance::new(0.002, &body, &set.faces, set.vertices());
/// let clothing = set.sequences[0].clothing.index_axis(ndarray::Axis(0), 0);
/// let (pushed, shares) = clearance.apply(posed, clothing);
/// assert_eq!((pushed.dim(), shares.after), ((3, 3), 0.0));
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct Clearance {
    /// Least distance from the body, metres.
    pub distance: f64,
    body_faces: Vec<[u32; 3]>,
    /// Adjacent faces of the body's faces.
    across: Vec<[Option<u32>; 3]>,
    /// Triangles of the clothing.
    faces: Vec<[u32; 3]>,
    /// Middles of the edges and of the triangles of the clothing, which are kept out of the body beside the
    /// vertices.
    between: Vec<MiddlePoint>,
    /// Neighbours of the clothing vertices.
    neighbours: Vec<Vec<u32>>,
}

/// Shares of the clothing's surface that are inside the body, by area, 0 to 1.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct InsideShares {
    /// Before clothing is pushed out.
    pub before: f64,
    /// Afterwards.
    pub after: f64,
}

/// Middle of an edge or of a triangle.
#[derive(Debug, Clone, Copy)]
enum MiddlePoint {
    Edge([u32; 2]),
    Face([u32; 3]),
}

impl MiddlePoint {
    fn corners(&self) -> &[u32] {
        match self {
            Self::Edge(ends) => ends,
            Self::Face(corners) => corners,
        }
    }

    fn position(&self, at: &[DVec3]) -> DVec3 {
        let corners = self.corners();
        let sum: DVec3 = corners.iter().map(|&corner| at[corner as usize]).sum();
        sum / corners.len() as f64
    }
}

/// Distance of a point from the body, as last measured. Distances change by no more than the point moves, so
/// that a point far away need not be measured again.
#[derive(Debug, Clone, Copy)]
struct KnownDistance {
    /// Position of the measurement, metres.
    at: DVec3,
    /// Signed distance, metres.
    signed: f64,
}

impl KnownDistance {
    /// A measurement at `x`, and the direction out of the body if it is within reach.
    fn measure(body: &SurfaceIndex, x: DVec3) -> (Self, Option<DVec3>) {
        let near = body.closest(x, REACH);
        let signed = near.map_or(REACH, |near| near.signed_distance);
        (Self { at: x, signed }, near.map(|near| near.outward))
    }

    /// Displacement that brings a point at `x` to the `distance` from the body, if it is nearer.
    fn push(&mut self, body: &SurfaceIndex, x: DVec3, distance: f64) -> Option<DVec3> {
        if self.signed - x.distance(self.at) >= distance {
            return None;
        }
        let outward;
        (*self, outward) = Self::measure(body, x);
        let (outward, missing) = (outward?, distance - self.signed);
        (missing > 0.0).then(|| outward * missing)
    }
}

impl Clearance {
    /// A least distance in metres from the surface of `model` for clothing with the triangles `faces` of
    /// `vertices` vertices.
    pub fn new(distance: f64, model: &SmplModel, faces: &[[u32; 3]], vertices: usize) -> Self {
        let body = SurfaceMesh { vertices: Vec::new(), faces: model.faces.clone() };
        let fits = |face: &&[u32; 3]| face.iter().all(|&corner| (corner as usize) < vertices);
        let faces: Vec<[u32; 3]> = faces.iter().filter(fits).copied().collect();
        let clothing = SurfaceMesh { vertices: Vec::new(), faces: faces.clone() };
        let edges = clothing.edges();
        let mut neighbours = vec![Vec::new(); vertices];
        for &[a, b] in &edges {
            neighbours[a as usize].push(b);
            neighbours[b as usize].push(a);
        }
        let middles = edges.into_iter().map(MiddlePoint::Edge);
        let between = middles.chain(faces.iter().copied().map(MiddlePoint::Face)).collect();
        let across = body.neighbours();
        Self { distance, across, body_faces: body.faces, faces, between, neighbours }
    }

    /// Clothing `[n_v, 3]`, metres, at least at the distance from the body with the vertices `posed`, and
    /// the shares of its surface inside the body. Vertices that are too near move along the body's normal,
    /// and so do the corners of edges and triangles whose middle is too near; the vertices around them follow
    /// smoothly. What is further than 15 cm inside is left.
    pub fn apply(
        &self,
        posed: Vec<DVec3>,
        clothing: ArrayView2<'_, f64>,
    ) -> (Array2<f64>, InsideShares) {
        let body = SurfaceMesh { vertices: posed.clone(), faces: self.body_faces.clone() };
        let body = SurfaceIndex::moving(&body, posed, self.across.clone());
        let mut at = points(clothing);
        let mut known = self.measured(&body, &at);
        let before = self.share_inside(&body, &at, &known);
        for _ in 0..ROUNDS {
            let pushes = self.pushes(&body, &at, &mut known);
            if pushes.iter().all(Option::is_none) {
                break;
            }
            let moves = self.fade(&pushes);
            at.iter_mut().zip(moves).for_each(|(x, push)| *x += push);
        }
        // Vertices that were moved along with others, alone.
        let last = self.vertex_pushes(&body, &at, &mut known);
        at.iter_mut().zip(last).for_each(|(x, push)| *x += push.unwrap_or_default());
        let shares = InsideShares { before, after: self.share_inside(&body, &at, &known) };
        (Array2::from_shape_fn(clothing.dim(), |(vertex, axis)| at[vertex][axis]), shares)
    }

    /// Distances of the vertices, and for the points between them those of a corner.
    fn measured(&self, body: &SurfaceIndex, at: &[DVec3]) -> Vec<KnownDistance> {
        let measure = |&x: &DVec3| KnownDistance::measure(body, x).0;
        let mut known: Vec<KnownDistance> = at.par_iter().map(measure).collect();
        let corner = |point: &MiddlePoint| known[point.corners()[0] as usize];
        let between: Vec<KnownDistance> = self.between.iter().map(corner).collect();
        known.extend(between);
        known
    }

    /// Displacements of the vertices that are too near.
    fn vertex_pushes(
        &self,
        body: &SurfaceIndex,
        at: &[DVec3],
        known: &mut [KnownDistance],
    ) -> Vec<Option<DVec3>> {
        let points = known.par_iter_mut().zip(at);
        points.map(|(known, &x)| known.push(body, x, self.distance)).collect()
    }

    /// Displacements of the vertices that are too near or corners of an edge or a triangle whose middle is:
    /// the longest of those that are needed.
    fn pushes(
        &self,
        body: &SurfaceIndex,
        at: &[DVec3],
        known: &mut [KnownDistance],
    ) -> Vec<Option<DVec3>> {
        let (vertices, between) = known.split_at_mut(at.len());
        let mut pushes = self.vertex_pushes(body, at, vertices);
        let middles: Vec<Option<DVec3>> = between
            .par_iter_mut()
            .zip(&self.between)
            .map(|(known, point)| known.push(body, point.position(at), self.distance))
            .collect();
        for (point, push) in self.between.iter().zip(middles) {
            let Some(push) = push else { continue };
            for &corner in point.corners() {
                let longest = &mut pushes[corner as usize];
                if longest.is_none_or(|other| other.length_squared() < push.length_squared()) {
                    *longest = Some(push);
                }
            }
        }
        pushes
    }

    /// Displacements that fade away from the pushed vertices.
    fn fade(&self, pushes: &[Option<DVec3>]) -> Vec<DVec3> {
        let mut field: Vec<DVec3> = pushes.iter().map(|push| push.unwrap_or_default()).collect();
        for _ in 0..FADE {
            field = (0..field.len())
                .into_par_iter()
                .map(|vertex| match (pushes[vertex], &self.neighbours[vertex][..]) {
                    (Some(push), _) => push,
                    (None, []) => DVec3::ZERO,
                    (None, around) => {
                        let sum: DVec3 = around.iter().map(|&n| field[n as usize]).sum();
                        sum / around.len() as f64
                    }
                })
                .collect();
        }
        field
    }

    /// Share of the clothing's surface inside the body: by area, over the middles of the nine equal parts of
    /// each triangle, which are not among the points that are kept out.
    fn share_inside(&self, body: &SurfaceIndex, at: &[DVec3], known: &[KnownDistance]) -> f64 {
        let parts = parts();
        let inside_and_area = |(face, known): (&[u32; 3], &KnownDistance)| {
            let corners = face.map(|corner| at[corner as usize]);
            let [a, b, c] = corners;
            // No part of the triangle is further from where the distance is known.
            let radius =
                corners.map(|corner| corner.distance(known.at)).into_iter().fold(0.0, f64::max);
            let share = if known.signed > radius {
                0.0
            } else if known.signed < -radius {
                1.0
            } else {
                let is_inside = |weights: &&[f64; 3]| {
                    let x = a * weights[0] + b * weights[1] + c * weights[2];
                    body.closest(x, REACH).is_some_and(|near| near.signed_distance < 0.0)
                };
                parts.iter().filter(is_inside).count() as f64 / parts.len() as f64
            };
            let area = (b - a).cross(c - a).length();
            (share * area, area)
        };
        // The triangles' middles are the last of the known distances.
        let known = &known[known.len() - self.faces.len()..];
        let sums: Vec<(f64, f64)> = self.faces.par_iter().zip(known).map(inside_and_area).collect();
        let area: f64 = sums.iter().map(|(_, area)| area).sum();
        if area > 0.0 { sums.iter().map(|(inside, _)| inside).sum::<f64>() / area } else { 0.0 }
    }
}

/// Barycentric coordinates of the middles of the nine equal parts of a triangle.
fn parts() -> [[f64; 3]; 9] {
    let upright = [[0, 0, 2], [0, 2, 0], [2, 0, 0], [0, 1, 1], [1, 0, 1], [1, 1, 0]];
    let inverted = [[0, 0, 1], [0, 1, 0], [1, 0, 0]];
    let middle = |cell: [i32; 3], share: f64| cell.map(|k| (f64::from(k) + share) / 3.0);
    let mut parts = [[0.0; 3]; 9];
    let all = upright.map(|cell| middle(cell, 1.0 / 3.0)).into_iter();
    let all = all.chain(inverted.map(|cell| middle(cell, 2.0 / 3.0)));
    parts.iter_mut().zip(all).for_each(|(to, part)| *to = part);
    parts
}

#[cfg(test)]
mod tests {
    use cape_cloth::{Garment, GarmentKind};
    use cape_core::smpl::StandardPose;
    use cape_synth::synthetic_body;

    use super::*;
    use crate::BodyFrame;

    /// A skirt in the shape it was sewn in, and a body with a thigh turned up by an angle in radians.
    fn skirt_and_thigh(resolution: f64, turn: f64) -> (SmplModel, SurfaceMesh, Vec<DVec3>) {
        let model = synthetic_body();
        let shape = model.rest_shape(&[]).unwrap();
        let garment = Garment { resolution, ..Garment::new(GarmentKind::Skirt) };
        let skirt = garment.sew(&model, &shape).unwrap().surface;
        let mut pose = vec![0.0; 72];
        pose[3] = -turn;
        let posed =
            BodyFrame::new(&model, &shape, &pose, [0.0; 3], &StandardPose::T).unwrap().posed;
        (model, skirt, posed)
    }

    fn rows_of(vertices: &[DVec3]) -> Array2<f64> {
        Array2::from_shape_fn((vertices.len(), 3), |(v, axis)| vertices[v][axis])
    }

    #[test]
    fn a_raised_thigh_pushes_the_skirt_and_leaves_what_is_far() {
        let (model, skirt, posed) = skirt_and_thigh(0.02, 0.9);
        let rows = rows_of(&skirt.vertices);
        let clearance = Clearance::new(0.003, &model, &skirt.faces, skirt.vertices.len());
        let (pushed, shares) = clearance.apply(posed.clone(), rows.view());
        // All the way through, the thigh stays between vertices above and below it.
        assert!(shares.before > 0.01 && shares.after < 0.6 * shares.before, "{shares:?}");
        let body = SurfaceMesh { vertices: posed, faces: model.faces.clone() };
        let index = SurfaceIndex::new(&body);
        let distance = |x: DVec3| index.closest(x, 0.3).map_or(0.3, |near| near.signed_distance);
        let (before, after) = (points(rows.view()), points(pushed.view()));
        assert!(after.iter().all(|x| distance(*x) > 0.0), "a vertex is inside");
        let near = after.iter().filter(|x| distance(**x) < 0.003 - 1e-4).count();
        // The closest point of a vertex that moved along the normal can be another one, a little nearer.
        assert!(near <= after.len() / 50, "{near} of {}", after.len());
        let still = before.iter().zip(&after).filter(|(a, b)| a == b).count();
        assert!(still > after.len() / 3, "{still} of {} did not move", after.len());
    }

    /// Share of the surface inside the body by area, over 100 points of each triangle, and the greatest depth
    /// in metres.
    fn densely_sampled(skirt: &SurfaceMesh, at: &[DVec3], body: &SurfaceIndex) -> (f64, f64) {
        const SPLITS: usize = 10;
        let (mut inside, mut area, mut deepest) = (0.0, 0.0, 0.0f64);
        for face in &skirt.faces {
            let [a, b, c] = face.map(|corner| at[corner as usize]);
            let part = (b - a).cross(c - a).length() / (SPLITS * SPLITS) as f64;
            for (i, j) in (0..SPLITS).flat_map(|i| (0..SPLITS).map(move |j| (i, j))) {
                // The square of cells folded onto the triangle.
                let [u, v] = [i, j].map(|k| (k as f64 + 0.5) / SPLITS as f64);
                let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
                let x = a + (b - a) * u + (c - a) * v;
                let depth = -body.closest(x, 0.3).map_or(0.3, |near| near.signed_distance);
                inside += if depth > 0.0 { part } else { 0.0 };
                area += part;
                deepest = deepest.max(depth);
            }
        }
        (inside / area, deepest)
    }

    #[test]
    fn the_body_does_not_come_through_between_the_vertices_of_a_coarse_skirt() {
        // A skirt that is too tight by up to a few centimetres.
        let (model, mut skirt, posed) = skirt_and_thigh(0.05, 0.0);
        let middle = skirt.vertices.iter().sum::<DVec3>() / skirt.vertices.len() as f64;
        for vertex in &mut skirt.vertices {
            *vertex = middle + (*vertex - middle) * DVec3::new(0.75, 1.0, 0.75);
        }
        let rows = rows_of(&skirt.vertices);
        let index =
            SurfaceIndex::new(&SurfaceMesh { vertices: posed.clone(), faces: model.faces.clone() });
        let whole = Clearance::new(0.002, &model, &skirt.faces, skirt.vertices.len());
        // The vertices alone, for comparison.
        let vertices = Clearance { between: Vec::new(), faces: Vec::new(), ..whole.clone() };
        let sampled = |rows: &Array2<f64>| densely_sampled(&skirt, &points(rows.view()), &index);
        let pushed = |clearance: &Clearance| {
            let (pushed, shares) = clearance.apply(posed.clone(), rows.view());
            (sampled(&pushed), shares)
        };
        let before = sampled(&rows);
        let (by_vertices, _) = pushed(&vertices);
        let (by_surface, shares) = pushed(&whole);
        println!("{before:?} {by_vertices:?} {by_surface:?} {shares:?}");
        assert!(before.0 > 0.005 && by_vertices.0 > 5e-4, "{before:?} {by_vertices:?}");
        assert!(by_surface.0 < 0.1 * by_vertices.0, "{by_vertices:?} {by_surface:?}");
        assert!(by_surface.1 < 0.002, "{by_surface:?}");
        // The reported shares are those of the dense sample.
        assert!((shares.before - before.0).abs() < 0.1 * before.0, "{shares:?} {before:?}");
        assert!(shares.after <= by_surface.0 + 2e-4, "{shares:?} {by_surface:?}");
    }

    #[test]
    fn parts_of_a_triangle_are_equal() {
        let mean =
            parts().iter().fold([0.0; 3], |sum, part| [0, 1, 2].map(|k| sum[k] + part[k] / 9.0));
        assert!(mean.iter().all(|x| (x - 1.0 / 3.0).abs() < 1e-12), "{mean:?}");
        assert!(parts().iter().all(|part| (part.iter().sum::<f64>() - 1.0).abs() < 1e-12));
    }

    #[test]
    fn clothing_that_is_far_enough_is_returned() {
        let model = synthetic_body();
        let shape = model.rest_shape(&[]).unwrap();
        let posed =
            BodyFrame::new(&model, &shape, &[0.0; 72], [0.0; 3], &StandardPose::T).unwrap().posed;
        let away = Array2::from_elem((3, 3), 5.0);
        let clearance = Clearance::new(0.002, &model, &[[0, 1, 2]], 3);
        assert_eq!(clearance.apply(posed, away.view()), (away.clone(), InsideShares::default()));
    }
}
