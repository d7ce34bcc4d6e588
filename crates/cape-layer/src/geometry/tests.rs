use std::f64::consts::{PI, TAU};

use glam::DVec3;
use proptest::prelude::*;

use super::*;

/// A grid of `n × m` vertices in a map of (u, v) in the unit square, triangles alternating.
pub(crate) fn grid(n: usize, m: usize, place: impl Fn(f64, f64) -> DVec3) -> Surface {
    let at = |i: usize, j: usize| (i * m + j) as u32;
    let mut surface = Surface::default();
    for i in 0..n {
        for j in 0..m {
            let (u, v) = (i as f64 / (n - 1) as f64, j as f64 / (m - 1) as f64);
            surface.vertices.push(place(u, v));
        }
    }
    for i in 0..n - 1 {
        for j in 0..m - 1 {
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            surface.faces.extend(if (i + j) % 2 == 0 {
                [[a, b, c], [a, c, d]]
            } else {
                [[a, b, d], [b, c, d]]
            });
        }
    }
    surface
}

/// A closed sphere around the origin, outward: an octahedron whose faces are split `splits` times.
pub(crate) fn sphere(radius: f64, splits: usize) -> Surface {
    let mut vertices = vec![DVec3::X, DVec3::Y, DVec3::Z, -DVec3::X, -DVec3::Y, -DVec3::Z];
    let mut faces: Vec<[u32; 3]> = vec![
        [0, 1, 2],
        [1, 3, 2],
        [3, 4, 2],
        [4, 0, 2],
        [1, 0, 5],
        [3, 1, 5],
        [4, 3, 5],
        [0, 4, 5],
    ];
    for _ in 0..splits {
        let mut middles = std::collections::HashMap::new();
        let mut middle = |p: u32, q: u32| {
            *middles.entry([p.min(q), p.max(q)]).or_insert_with(|| {
                vertices.push((vertices[p as usize] + vertices[q as usize]).normalize());
                vertices.len() as u32 - 1
            })
        };
        faces = faces
            .iter()
            .flat_map(|&[a, b, c]| {
                let [ab, bc, ca] = [middle(a, b), middle(b, c), middle(c, a)];
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            })
            .collect();
    }
    Surface { vertices: vertices.into_iter().map(|v| v * radius).collect(), faces }
}

/// Largest relative error from vertex `source`, against `exact`, over vertices further than `near`.
fn error(
    surface: &Surface,
    metric: Metric,
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
        assert!(error(&plane, Metric::Unfolded, source, 0.0, straight) < 1e-9);
        assert!(error(&plane, Metric::Graph, source, 0.0, straight) > 0.04);
    }
}

#[test]
fn geodesics_of_a_cylinder_unroll() {
    // Half a cylinder of radius 1: a plane of width π, up to the chords of its 24 facets.
    let rolled = grid(25, 17, |u, v| DVec3::new((PI * u).cos(), 2.0 * v, (PI * u).sin()));
    let angle = |p: DVec3| p.z.atan2(p.x);
    let chord = 24.0 * 2.0 * (PI / 48.0).sin() / PI;
    let exact = |a: DVec3, b: DVec3| ((angle(a) - angle(b)) * chord).hypot(a.y - b.y);
    assert!(error(&rolled, Metric::Unfolded, 0, 0.0, exact) < 1e-9);
    assert!(error(&rolled, Metric::Graph, 0, 0.0, exact) > 0.04);
}

#[test]
fn geodesics_of_a_sphere_are_great_circles() {
    let exact = |a: DVec3, b: DVec3| a.angle_between(b);
    let [coarse, fine] = [3, 5].map(|splits| sphere(1.0, splits));
    let [first, second] = [&coarse, &fine].map(|s| error(s, Metric::Unfolded, 0, 0.3, exact));
    let edges = error(&fine, Metric::Graph, 0, 0.3, exact);
    assert!(first < 0.05 && second < 0.015, "{first} {second}");
    assert!(edges > 0.05, "refining does not help Dijkstra: {edges}");
}

/// Lengths of all straight lines between vertices of a polyhedron through all sequences of faces
/// within `reach`, by brute force.
pub(super) fn straight_lines(surface: &Surface, reach: f64) -> Vec<Vec<f64>> {
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

/// What a source sees through one side of a face, unfolded into the plane: the side's ends, and the
/// directions between which it is seen.
struct Window {
    face: usize,
    side: usize,
    ends: [[f64; 2]; 2],
    cone: [[f64; 2]; 2],
}

impl Window {
    fn spread(
        &self,
        surface: &Surface,
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
    let found = Geodesics::new(&bumpy, Metric::Unfolded).within(source, reach);
    let edges = Geodesics::new(&bumpy, Metric::Graph).within(source, f64::INFINITY);
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

#[test]
fn a_sphere_is_closed_and_outward() {
    let ball = sphere(2.0, 4);
    assert!((ball.volume() - 8.0 * 4.0 * PI / 3.0).abs() < 0.5);
    assert!(ball.neighbours().iter().flatten().all(Option::is_some));
    assert!(ball.boundary().iter().all(|on| !on));
    for (v, n) in ball.vertices.iter().zip(ball.vertex_normals()) {
        assert!(v.normalize().dot(n) > 0.999);
    }
}

#[test]
fn a_moving_solid_is_where_it_is_said_to_be() {
    let ball = sphere(1.0, 3);
    let to: Vec<DVec3> = ball.vertices.iter().map(|&v| v * 2.0 + DVec3::X).collect();
    let mut moving = Solid::moving(&ball, to, ball.neighbours());
    moving.at(0.5);
    let still = Solid::new(moving.surface());
    for k in 0..40 {
        let p =
            DVec3::new((f64::from(k)).sin(), (f64::from(k) * 2.3).cos(), 0.1 * f64::from(k) - 2.0);
        let (a, b) = (moving.closest(p, 10.0).unwrap(), still.closest(p, 10.0).unwrap());
        assert!((a.signed_distance - b.signed_distance).abs() < 1e-12);
        assert!(moving.riding(a.face, a.barycentric, 0.5).distance(a.point) < 1e-12);
    }
    assert!(moving.closest(DVec3::X * 10.0, 1.0).is_none());
}

#[test]
fn unusable_meshes_are_refused() {
    let text = |v: Vec<DVec3>, f| Surface::new("clothing", v, f).unwrap_err().to_string();
    assert!(text(vec![DVec3::ZERO], vec![]).contains("no faces"));
    assert!(text(vec![DVec3::ZERO], vec![[0, 0, 7]]).contains("face 0"));
    assert!(text(vec![DVec3::NAN; 3], vec![[0, 1, 2]]).contains("not finite"));
}

fn unit() -> impl Strategy<Value = DVec3> {
    (-1.0f64..1.0, 0.0..TAU).prop_map(|(z, turn)| {
        let r = (1.0 - z * z).sqrt();
        DVec3::new(r * turn.cos(), r * turn.sin(), z)
    })
}

proptest! {
    #[test]
    fn rays_agree_with_all_triangles(
        origin in prop::array::uniform3(-2.0f64..2.0), direction in unit(), reach in 0.1f64..4.0,
    ) {
        let ball = sphere(1.0, 3);
        let origin = DVec3::from(origin);
        let brute = (0..ball.faces.len())
            .filter_map(|face| by_plane(origin, direction, ball.corners(face)))
            .filter(|&t| t <= reach)
            .fold(f64::INFINITY, f64::min);
        let found = Solid::new(&ball).cast(origin, direction, reach);
        match found {
            Some(hit) => prop_assert!((hit.distance - brute).abs() < 1e-9, "{} {brute}", hit.distance),
            None => prop_assert!(brute.is_infinite(), "{brute}"),
        }
    }

    #[test]
    fn closest_points_agree_with_all_triangles(point in prop::array::uniform3(-2.0f64..2.0)) {
        let ball = sphere(1.0, 2);
        let p = DVec3::from(point);
        let brute = (0..ball.faces.len())
            .map(|face| {
                let near = closest_on_triangle(p, ball.corners(face)).0;
                near.distance(p)
            })
            .fold(f64::INFINITY, f64::min);
        let found = Solid::new(&ball).closest(p, f64::INFINITY).unwrap();
        prop_assert!((found.signed_distance.abs() - brute).abs() < 1e-12);
        // Inside where every face is in front.
        let normals = ball.face_normals();
        let inside = (0..ball.faces.len())
            .all(|face| (p - ball.corners(face)[0]).dot(normals[face]) < 0.0);
        prop_assert_eq!(found.signed_distance < 0.0, inside);
        let step = p + found.outward * 1e-6;
        let beyond = Solid::new(&ball).closest(step, f64::INFINITY).unwrap();
        prop_assert!(beyond.signed_distance > found.signed_distance);
    }

    #[test]
    fn the_closest_point_of_a_triangle_is_closest(
        p in prop::array::uniform3(-2.0f64..2.0),
        corners in prop::array::uniform3(prop::array::uniform3(-1.0f64..1.0)),
    ) {
        let [a, b, c] = corners.map(DVec3::from);
        let (near, w) = closest_on_triangle(DVec3::from(p), [a, b, c]);
        prop_assert!(w.iter().all(|&w| (-1e-12..=1.0 + 1e-12).contains(&w)));
        prop_assert!((a * w[0] + b * w[1] + c * w[2]).distance(near) < 1e-9);
        for i in 0..=20 {
            for j in 0..=20 - i {
                let (u, v) = (f64::from(i) / 20.0, f64::from(j) / 20.0);
                let other = a * (1.0 - u - v) + b * u + c * v;
                prop_assert!(near.distance(DVec3::from(p)) <= other.distance(DVec3::from(p)) + 1e-9);
            }
        }
    }
}

/// Where the ray meets the plane, then on which side of each edge that is.
fn by_plane(origin: DVec3, direction: DVec3, [a, b, c]: [DVec3; 3]) -> Option<f64> {
    let normal = (b - a).cross(c - a);
    let t = normal.dot(a - origin) / normal.dot(direction);
    let p = origin + direction * t;
    let beside = |q: DVec3, r: DVec3| normal.dot((r - q).cross(p - q)) >= 0.0;
    (t >= 0.0 && beside(a, b) && beside(b, c) && beside(c, a)).then_some(t)
}
