use glam::DVec3;
use rayon::prelude::*;

use super::{elastic::GRAIN, point_grid::PointGrid};
use cape_core::geometry::{
    BoxTree, SurfaceMesh, bounds, closest_on_triangle, ray_triangle_distance,
};

/// Time between two searches for close pairs, seconds.
const INTERVAL: f64 = 1.0 / 120.0;

/// Margin of the search for close pairs, metres: the approach of two parts between two searches.
const SLACK: f64 = 0.008;

/// Least sine of the angle between two edges whose sides can be distinguished.
const PARALLEL: f64 = 0.02;

/// Self-collision constraints of a cloth: vertices keep a distance from faces and edges from edges,
/// each on its side before the step, with friction.
#[derive(Debug, Clone)]
pub(super) struct SelfCollision {
    /// Thickness of each layer, metres.
    thicknesses: Vec<f64>,
    /// Layer of each vertex.
    layers: Vec<u8>,
    rest: SurfaceMesh,
    edges: Vec<[u32; 2]>,
    /// Neighbours of each vertex.
    beside: Vec<Vec<u32>>,
    /// Faces at each vertex and at its neighbours, ascending.
    around: Vec<Vec<u32>>,
    pairs: Vec<ClosePair>,
    /// Time since the last search, seconds.
    since: f64,
}

/// Two close parts and the distance that they keep, metres.
#[derive(Debug, Clone, Copy)]
enum ClosePair {
    /// A vertex and a face.
    Vertex(u32, [u32; 3], f64),
    /// Two edges.
    Edges([u32; 2], [u32; 2], f64),
}

impl SelfCollision {
    /// Self-collision of layers of the given thicknesses, metres; `layers` has the layer of each
    /// vertex.
    pub(super) fn new(rest: &SurfaceMesh, layers: Vec<u8>, thicknesses: Vec<f64>) -> Self {
        let edges = rest.edges();
        let mut beside = vec![Vec::new(); rest.vertices.len()];
        for &[a, b] in &edges {
            beside[a as usize].push(b);
            beside[b as usize].push(a);
        }
        let at_vertex = rest.vertex_faces();
        let around = (0..rest.vertices.len())
            .map(|v| {
                let vertices = beside[v].iter().map(|&n| n as usize).chain([v]);
                let mut near: Vec<u32> = vertices.flat_map(|n| at_vertex[n].clone()).collect();
                near.sort_unstable();
                near.dedup();
                near
            })
            .collect();
        let (pairs, since) = (Vec::new(), f64::INFINITY);
        Self { thicknesses, layers, edges, beside, around, rest: rest.clone(), pairs, since }
    }

    /// Separates close pairs, one after the other. `before` are the positions before the step of `dt`
    /// seconds, metres.
    pub(super) fn resolve(
        &mut self,
        before: &[DVec3],
        positions: &mut [DVec3],
        inverse_masses: &[f64],
        (friction, dt): (f64, f64),
    ) {
        // A step may end a hair before the interval.
        if self.since > INTERVAL - 1e-6 {
            self.find_pairs(before);
            self.since = 0.0;
        }
        self.since += dt;
        let mut corners = CornerPositions { before, positions, inverse_masses, friction };
        for pair in &self.pairs {
            match *pair {
                ClosePair::Vertex(vertex, face, least) => corners.part_vertex(vertex, face, least),
                ClosePair::Edges(one, other, least) => corners.part_edges(one, other, least),
            }
        }
    }

    fn find_pairs(&mut self, at: &[DVec3]) {
        let reach = self.thicknesses.iter().copied().fold(0.0, f64::max) + SLACK;
        let place = |v: u32| at[v as usize];
        let at_rest = |v: u32| self.rest.vertices[v as usize];
        let least = |v: u32, face: [u32; 3]| {
            let nearest = || closest_on_triangle(at_rest(v), face.map(at_rest)).0;
            self.distance(v, face[0], || nearest().distance(at_rest(v)))
        };
        // Elements are found by spheres around them.
        let sphere = |face: &[u32; 3]| {
            let corners = face.map(place);
            let centre = corners.iter().sum::<DVec3>() / 3.0;
            (centre, corners.map(|corner| corner.distance(centre)).into_iter().fold(0.0, f64::max))
        };
        let (centres, radii): (Vec<DVec3>, Vec<f64>) = self.rest.faces.iter().map(sphere).unzip();
        let halves: Vec<f64> =
            (0..at.len() as u32).map(|v| 0.5 * self.longest_edge(v, at)).collect();
        let widest = radii.iter().copied().fold(0.0, f64::max);
        let faces = PointGrid::new(&centres, 2.0 * reach);
        // Pairs of each vertex, and whether its edges may be close to others.
        let near: Vec<(Vec<ClosePair>, bool)> = (0..at.len() as u32)
            .into_par_iter()
            .with_min_len(GRAIN)
            .map(|v| {
                let half = halves[v as usize];
                let (mut pairs, mut alert) = (Vec::new(), false);
                faces.for_near(place(v), reach + half + widest, |index, squared| {
                    let face = self.rest.faces[index as usize];
                    let gap = squared.sqrt() - radii[index as usize];
                    if gap > reach + half || face.contains(&v) {
                        return;
                    }
                    if gap < reach {
                        let (nearest, _) = closest_on_triangle(place(v), face.map(place));
                        if nearest.distance(place(v)) < reach {
                            pairs.push(ClosePair::Vertex(v, face, least(v, face)));
                            alert = true;
                        }
                    }
                    alert = alert || self.around[v as usize].binary_search(&index).is_err();
                });
                (pairs, alert)
            })
            .collect();
        let on_alert = |edge: &&[u32; 2]| edge.iter().any(|&v| near[v as usize].1);
        let edges: Vec<[u32; 2]> = self.edges.iter().filter(on_alert).copied().collect();
        let (middles, halves): (Vec<DVec3>, Vec<f64>) = edges
            .iter()
            .map(|edge| edge.map(place))
            .map(|[a, b]| (a.midpoint(b), 0.5 * a.distance(b)))
            .unzip();
        // Half the edges of the boxes around the edges.
        let extent = |[a, b]: &[u32; 2]| 0.5 * (place(*a) - place(*b)).abs();
        let extents: Vec<DVec3> = edges.iter().map(extent).collect();
        let longest = halves.iter().copied().fold(0.0, f64::max);
        let grid = PointGrid::new(&middles, 2.0 * reach);
        let crossing: Vec<Vec<ClosePair>> = edges
            .par_iter()
            .enumerate()
            .with_min_len(GRAIN)
            .map(|(index, &one)| {
                let half = halves[index];
                let mut pairs = Vec::new();
                grid.for_near(middles[index], reach + half + longest, |other, squared| {
                    let most = reach + half + halves[other as usize];
                    if other as usize <= index || squared > most * most {
                        return;
                    }
                    let between = middles[index] - middles[other as usize];
                    let extent = extents[index] + extents[other as usize] + DVec3::splat(reach);
                    if between.abs().cmpgt(extent).any() {
                        return;
                    }
                    let other = edges[other as usize];
                    if other.iter().any(|v| one.contains(v))
                        || between_segments(one.map(place), other.map(place)).1 >= reach
                    {
                        return;
                    }
                    let at_rest = || between_segments(one.map(at_rest), other.map(at_rest)).1;
                    let least = self.distance(one[0], other[0], at_rest);
                    pairs.push(ClosePair::Edges(one, other, least));
                });
                pairs
            })
            .collect();
        self.pairs = near.into_iter().flat_map(|(pairs, _)| pairs).collect();
        self.pairs.extend(crossing.into_iter().flatten());
    }

    /// Distance that parts at two vertices keep, metres: the mean of their thicknesses, or their
    /// distance at rest if they are of one layer and closer.
    fn distance(&self, one: u32, other: u32, at_rest: impl FnOnce() -> f64) -> f64 {
        let [a, b] = [one, other].map(|v| usize::from(self.layers[v as usize]));
        let both = 0.5 * (self.thicknesses[a] + self.thicknesses[b]);
        if a == b { both.min(at_rest()) } else { both }
    }

    /// Length of the longest edge at a vertex, metres.
    fn longest_edge(&self, v: u32, at: &[DVec3]) -> f64 {
        let lengths =
            self.beside[v as usize].iter().map(|&n| at[n as usize].distance(at[v as usize]));
        lengths.fold(0.0, f64::max)
    }
}

/// Positions before and after the step.
struct CornerPositions<'a> {
    before: &'a [DVec3],
    positions: &'a mut [DVec3],
    inverse_masses: &'a [f64],
    friction: f64,
}

impl CornerPositions<'_> {
    fn now(&self, v: u32) -> DVec3 {
        self.positions[v as usize]
    }

    fn then(&self, v: u32) -> DVec3 {
        self.before[v as usize]
    }

    /// Separates a vertex from a face.
    fn part_vertex(&mut self, vertex: u32, face: [u32; 3], least: f64) {
        let corners = face.map(|v| self.now(v));
        let (nearest, weights) = closest_on_triangle(self.now(vertex), corners);
        let along = self.now(vertex) - nearest;
        let length = along.length();
        let over = weights.iter().all(|&w| w > 0.0);
        let (direction, apart) = if over {
            let [a, b, c] = face.map(|v| self.then(v));
            let side = (self.then(vertex) - a).dot((b - a).cross(c - a));
            let [a, b, c] = corners;
            let normal = (b - a).cross(c - a).normalize_or_zero() * side.signum();
            (normal, along.dot(normal))
        } else {
            (along / length.max(f64::MIN_POSITIVE), length)
        };
        if apart < least && length < SLACK {
            let [a, b, c] = face;
            let [u, v, w] = weights;
            self.push([(vertex, 1.0), (a, -u), (b, -v), (c, -w)], direction, least - apart);
        }
    }

    /// Separates two edges.
    fn part_edges(&mut self, one: [u32; 2], other: [u32; 2], least: f64) {
        let [p, q] = one.map(|v| self.now(v));
        let [r, s] = other.map(|v| self.now(v));
        let ([t, u], length) = between_segments([p, q], [r, s]);
        let inner = |t: f64| t > 0.0 && t < 1.0;
        if length > SLACK || !inner(t) || !inner(u) {
            return;
        }
        let across = (q - p).cross(s - r);
        let (p0, q0) = (self.then(one[0]), self.then(one[1]));
        let (r0, s0) = (self.then(other[0]), self.then(other[1]));
        let across_then = (q0 - p0).cross(s0 - r0);
        let sine = across.length() / ((q - p).length() * (s - r).length());
        if sine.is_nan() || sine < PARALLEL || across.dot(across_then) <= 0.0 {
            return;
        }
        let direction = across.normalize() * (p0 - r0).dot(across_then).signum();
        let apart = (p.lerp(q, t) - r.lerp(s, u)).dot(direction);
        if apart < least {
            let ends = [(one[0], 1.0 - t), (one[1], t), (other[0], u - 1.0), (other[1], -u)];
            self.push(ends, direction, least - apart);
        }
    }

    /// Moves vertices along `direction` so that their weighted distance grows by `missing` metres, and
    /// applies Coulomb friction to their slip since the beginning of the step.
    fn push(&mut self, ends: [(u32, f64); 4], direction: DVec3, missing: f64) {
        let share = |&(v, weight): &(u32, f64)| self.inverse_masses[v as usize] * weight * weight;
        let sum: f64 = ends.iter().map(share).sum();
        if sum > 0.0 {
            let slip: DVec3 =
                ends.iter().map(|&(v, weight)| (self.now(v) - self.then(v)) * weight).sum();
            let slip = slip - direction * slip.dot(direction);
            let held = (self.friction * missing / slip.length().max(f64::MIN_POSITIVE)).min(1.0);
            let change = direction * missing - slip * held;
            for (v, weight) in ends {
                let v = v as usize;
                self.positions[v] += change * (self.inverse_masses[v] * weight / sum);
            }
        }
    }
}

/// Number of intersections of edges with faces that share no corner with them.
pub(super) fn crossings(faces: &[[u32; 3]], edges: &[[u32; 2]], at: &[DVec3]) -> usize {
    let tree = BoxTree::from_elements(faces, at);
    edges
        .par_iter()
        .map(|edge| {
            let [from, to] = edge.map(|v| at[v as usize]);
            let through = |face: &u32| {
                let face = faces[*face as usize];
                let corners = face.map(|v| at[v as usize]);
                !face.iter().any(|v| edge.contains(v))
                    && ray_triangle_distance(from, to - from, corners).is_some_and(|t| t <= 1.0)
            };
            tree.overlapping(box_around(edge, at, 0.0)).iter().filter(|face| through(face)).count()
        })
        .sum()
}

/// The box around vertices, larger by `reach` metres on all sides.
fn box_around(vertices: &[u32], at: &[DVec3], reach: f64) -> [DVec3; 2] {
    let [low, high] = bounds(vertices.iter().map(|&v| at[v as usize]));
    [low - DVec3::splat(reach), high + DVec3::splat(reach)]
}

/// Parameters of the closest points of two segments, 0 to 1, and their distance (Ericson 2005,
/// §5.1.9).
pub(super) fn between_segments([p, q]: [DVec3; 2], [r, s]: [DVec3; 2]) -> ([f64; 2], f64) {
    let (along, other, from) = (q - p, s - r, p - r);
    let (a, e, f) = (along.length_squared(), other.length_squared(), other.dot(from));
    let (b, c) = (along.dot(other), along.dot(from));
    let denominator = a * e - b * b;
    let ratio = |x: f64, y: f64| if y > 0.0 { (x / y).clamp(0.0, 1.0) } else { 0.0 };
    let mut t = ratio(b * f - c * e, denominator);
    let u = if e > 0.0 { (b * t + f) / e } else { 0.0 };
    let u = if u < 0.0 {
        t = ratio(-c, a);
        0.0
    } else if u > 1.0 {
        t = ratio(b - c, a);
        1.0
    } else {
        u
    };
    ([t, u], p.lerp(q, t).distance(r.lerp(s, u)))
}
