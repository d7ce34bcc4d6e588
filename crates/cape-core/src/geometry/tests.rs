use std::f64::consts::{PI, TAU};

use glam::DVec3;
use proptest::prelude::*;

use super::{primitives::sphere, *};

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
fn queries_of_a_moving_surface_equal_those_of_the_static_one() {
    let ball = sphere(1.0, 3);
    let to: Vec<DVec3> = ball.vertices.iter().map(|&v| v * 2.0 + DVec3::X).collect();
    let mut moving = SurfaceIndex::moving(&ball, to, ball.neighbours());
    moving.set_time(0.5);
    let still = SurfaceIndex::new(moving.surface());
    for k in 0..40 {
        let p =
            DVec3::new((f64::from(k)).sin(), (f64::from(k) * 2.3).cos(), 0.1 * f64::from(k) - 2.0);
        let (a, b) = (moving.closest(p, 10.0).unwrap(), still.closest(p, 10.0).unwrap());
        assert!((a.signed_distance - b.signed_distance).abs() < 1e-12);
        assert!(moving.position_at(a.face, a.barycentric, 0.5).distance(a.point) < 1e-12);
    }
    assert!(moving.closest(DVec3::X * 10.0, 1.0).is_none());
}

#[test]
fn unusable_meshes_are_refused() {
    let text = |v: Vec<DVec3>, f| SurfaceMesh::new("clothing", v, f).unwrap_err().to_string();
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
        let found = SurfaceIndex::new(&ball).cast(origin, direction, reach);
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
        let found = SurfaceIndex::new(&ball).closest(p, f64::INFINITY).unwrap();
        prop_assert!((found.signed_distance.abs() - brute).abs() < 1e-12);
        // A point is inside a convex surface if it is behind all faces.
        let normals = ball.face_normals();
        let inside = (0..ball.faces.len())
            .all(|face| (p - ball.corners(face)[0]).dot(normals[face]) < 0.0);
        prop_assert_eq!(found.signed_distance < 0.0, inside);
        let step = p + found.outward * 1e-6;
        let beyond = SurfaceIndex::new(&ball).closest(step, f64::INFINITY).unwrap();
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

/// Reference ray–triangle test: intersection with the plane, then the side of each edge.
fn by_plane(origin: DVec3, direction: DVec3, [a, b, c]: [DVec3; 3]) -> Option<f64> {
    let normal = (b - a).cross(c - a);
    let t = normal.dot(a - origin) / normal.dot(direction);
    let p = origin + direction * t;
    let beside = |q: DVec3, r: DVec3| normal.dot((r - q).cross(p - q)) >= 0.0;
    (t >= 0.0 && beside(a, b) && beside(b, c) && beside(c, a)).then_some(t)
}
