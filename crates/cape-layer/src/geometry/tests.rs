use std::f64::consts::PI;

use cape_core::geometry::{
    SurfaceMesh,
    primitives::{grid, sphere},
};
use glam::DVec3;

use super::*;

/// Largest relative error from vertex `source`, against `exact`, over vertices further than `near`.
fn error(
    surface: &SurfaceMesh,
    metric: GeodesicMetric,
    source: u32,
    near: f64,
    exact: impl Fn(DVec3, DVec3) -> f64,
) -> f64 {
    let found = Geodesics::new(surface, metric).within(source, f64::INFINITY);
    assert_eq!(found.len(), surface.vertices.len());
    let from = surface.vertices[source as usize];
    found
        .iter()
        .map(|&(v, d)| (d, exact(from, surface.vertices[v as usize])))
        .filter(|&(_, e)| e > near)
        .map(|(d, e)| (d - e).abs() / e)
        .fold(0.0, f64::max)
}

#[test]
fn geodesics_of_a_plane_are_straight() {
    let plane = grid(13, 9, |u, v| {
        // Uneven, with obtuse triangles, and convex.
        let inner = (PI * u).sin() * (PI * v).sin();
        let (x, y) = (0.05 * inner * (9.0 * v).sin(), 0.05 * inner * (17.0 * u).sin());
        DVec3::new(u + x, 0.8 * v + y, 0.0)
    });
    for source in [0, 40, 58] {
        let straight = |a: DVec3, b: DVec3| a.distance(b);
        assert!(error(&plane, GeodesicMetric::Unfolded, source, 0.0, straight) < 1e-9);
        assert!(error(&plane, GeodesicMetric::Graph, source, 0.0, straight) > 0.04);
    }
}

#[test]
fn geodesics_of_a_cylinder_unroll() {
    // Half a cylinder of radius 1: a plane of width π, up to the chords of its 24 facets.
    let rolled = grid(25, 17, |u, v| DVec3::new((PI * u).cos(), 2.0 * v, (PI * u).sin()));
    let angle = |p: DVec3| p.z.atan2(p.x);
    let chord = 24.0 * 2.0 * (PI / 48.0).sin() / PI;
    let exact = |a: DVec3, b: DVec3| ((angle(a) - angle(b)) * chord).hypot(a.y - b.y);
    assert!(error(&rolled, GeodesicMetric::Unfolded, 0, 0.0, exact) < 1e-9);
    assert!(error(&rolled, GeodesicMetric::Graph, 0, 0.0, exact) > 0.04);
}

#[test]
fn geodesics_of_a_sphere_are_great_circles() {
    let exact = |a: DVec3, b: DVec3| a.angle_between(b);
    let [coarse, fine] = [3, 5].map(|splits| sphere(1.0, splits));
    let [first, second] =
        [&coarse, &fine].map(|s| error(s, GeodesicMetric::Unfolded, 0, 0.3, exact));
    let edges = error(&fine, GeodesicMetric::Graph, 0, 0.3, exact);
    assert!(first < 0.05 && second < 0.015, "{first} {second}");
    assert!(edges > 0.05, "refining does not help Dijkstra: {edges}");
}

/// Lengths of all straight lines between vertices of a polyhedron through all sequences of faces
/// within `reach`, by brute force.
pub(super) fn straight_lines(surface: &SurfaceMesh, reach: f64) -> Vec<Vec<f64>> {
    let across = surface.neighbours();
    let count = surface.vertices.len();
    let mut lines = vec![vec![f64::INFINITY; count]; count];
    for (vertex, lines) in lines.iter_mut().enumerate() {
        for (face, corners) in surface.faces.iter().enumerate() {
            let Some(i) = corners.iter().position(|&v| v as usize == vertex) else { continue };
            let [_, b, c] = [0, 1, 2].map(|k| corners[(i + k) % 3] as usize);
            let length = |p: usize, q: usize| surface.vertices[p].distance(surface.vertices[q]);
            for near in [b, c] {
                lines[near] = lines[near].min(length(vertex, near));
            }
            // The source at the origin, the side in front of it in the plane.
            let (ob, oc, bc) = (length(vertex, b), length(vertex, c), length(b, c));
            let x = (ob * ob + oc * oc - bc * bc) / (2.0 * ob);
            let [pb, pc] = [[ob, 0.0], [x, (oc * oc - x * x).max(0.0).sqrt()]];
            let window = Window { face, side: (i + 1) % 3, ends: [pb, pc], cone: [pb, pc] };
            window.spread(surface, &across, reach, lines);
        }
    }
    lines
}

/// Exact distances on a polyhedron: straight lines joined at vertices.
pub(super) fn exact(lines: &[Vec<f64>], source: u32) -> Vec<f64> {
    let count = lines.len();
    let mut best = vec![f64::INFINITY; count];
    best[source as usize] = 0.0;
    loop {
        let before = best.clone();
        for p in (0..count).filter(|&p| before[p].is_finite()) {
            for q in 0..count {
                best[q] = best[q].min(best[p] + lines[p][q]);
            }
        }
        if best == before {
            return best;
        }
    }
}

/// The view of a source through one side of a face, unfolded into the plane: the ends of the side,
/// and the directions that bound the view.
struct Window {
    face: usize,
    side: usize,
    ends: [[f64; 2]; 2],
    cone: [[f64; 2]; 2],
}

impl Window {
    fn spread(
        &self,
        surface: &SurfaceMesh,
        across: &[[Option<u32>; 3]],
        reach: f64,
        lines: &mut [f64],
    ) {
        let Some(next) = across[self.face][self.side] else { return };
        let next = next as usize;
        let corners = surface.faces[next];
        let [p, q] = [0, 1].map(|k| surface.faces[self.face][(self.side + k) % 3]);
        let Some(i) = (0..3).find(|&i| corners[i] != p && corners[i] != q) else { return };
        let at = |v: u32| surface.vertices[v as usize];
        let [e0, e1] = self.ends;
        let base = (e1[0] - e0[0]).hypot(e1[1] - e0[1]);
        let along = [(e1[0] - e0[0]) / base, (e1[1] - e0[1]) / base];
        let up = [along[1], -along[0]];
        let offset = at(corners[i]) - at(p);
        let direction = (at(q) - at(p)) / base;
        let x = offset.dot(direction);
        let y = (offset - direction * x).length();
        let apex = [0, 1].map(|k| e0[k] + along[k] * x + up[k] * y);
        let cross = |a: [f64; 2], b: [f64; 2]| a[0] * b[1] - a[1] * b[0];
        // Counter-clockwise from the first direction to the second.
        let after = cross(self.cone[0], apex);
        let before = cross(apex, self.cone[1]);
        let tiny = 1e-12;
        let length = apex[0].hypot(apex[1]);
        if after >= -tiny && before >= -tiny {
            let line = &mut lines[corners[i] as usize];
            *line = line.min(length);
        }
        let distance = {
            let t = (-(e0[0] * along[0] + e0[1] * along[1])).clamp(0.0, base);
            (e0[0] + along[0] * t).hypot(e0[1] + along[1] * t)
        };
        if distance > reach {
            return;
        }
        // The side from p to the apex, and that from the apex to q.
        let side_of = |v: u32, w: u32| {
            (0..3).find(|&s| {
                let pair = [corners[s], corners[(s + 1) % 3]];
                pair == [v, w] || pair == [w, v]
            })
        };
        let parts = [
            (p, [e0, apex], [self.cone[0], if before < 0.0 { self.cone[1] } else { apex }]),
            (q, [apex, e1], [if after < 0.0 { self.cone[0] } else { apex }, self.cone[1]]),
        ];
        for (v, ends, cone) in parts {
            let Some(side) = side_of(v, corners[i]) else { continue };
            if cross(cone[0], cone[1]) <= tiny {
                continue;
            }
            // The next window's ends follow its face's side.
            let Window { face, side, ends, cone } = Window { face: next, side, ends, cone };
            Window { face, side, ends, cone }.spread(surface, across, reach, lines);
        }
    }
}

#[test]
fn unfolding_agrees_with_exact_geodesics_of_a_bumpy_mesh() {
    let bumpy = grid(7, 7, |u, v| DVec3::new(u, v, 0.12 * (5.0 * u).sin() * (4.0 * v).cos()));
    let (source, reach) = (24, 0.45);
    let exact = exact(&straight_lines(&bumpy, reach), source);
    let found = Geodesics::new(&bumpy, GeodesicMetric::Unfolded).within(source, reach);
    let edges = Geodesics::new(&bumpy, GeodesicMetric::Graph).within(source, f64::INFINITY);
    let off = |found: &[(u32, f64)]| {
        let near = found.iter().filter(|&&(v, _)| v != source && exact[v as usize] < reach);
        near.map(|&(v, d)| (d - exact[v as usize]) / exact[v as usize])
            .fold((0.0, 0.0), |(low, high), e: f64| (e.min(low), e.max(high)))
    };
    let (low, high) = off(&found);
    assert!(low > -0.01 && high < 0.02, "{low} {high}");
    assert!(off(&edges).1 > 0.05, "{:?}", off(&edges));
    assert!(off(&edges).0 > -1e-12, "the oracle is never longer than a path along edges");
}
