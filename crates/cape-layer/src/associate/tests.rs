use std::time::Instant;

use glam::DVec3;

use super::*;
use crate::geometry::Geodesics;
use cape_core::geometry::primitives::{grid, sphere};

/// A sphere of 10 cm and a looser one of other topology around its upper part.
fn ball_and_hat() -> (SurfaceMesh, SurfaceMesh) {
    let body = sphere(0.1, 4);
    let hat = grid(40, 12, |u, v| {
        let (turn, down) = (0.123 - std::f64::consts::TAU * u, 0.2 + 1.2 * v);
        DVec3::new(down.sin() * turn.cos(), down.sin() * turn.sin(), down.cos()) * 0.12
    });
    (body, hat)
}

#[test]
fn pairs_agree_with_brute_force_rays() {
    let (body, hat) = ball_and_hat();
    let found = SparseCorrespondences::find(&body, &hat, 0.15).unwrap();
    let normals = body.vertex_normals();
    let mut kept: Vec<Option<Correspondence>> = vec![None; hat.vertices.len()];
    let mut hits = 0;
    for (vertex, &origin) in body.vertices.iter().enumerate() {
        let first = (0..hat.faces.len())
            .filter_map(|face| {
                let [a, b, c] = hat.corners(face);
                let n = (b - a).cross(c - a);
                let t = n.dot(a - origin) / n.dot(normals[vertex]);
                let p = origin + normals[vertex] * t;
                let beside = |p0: DVec3, p1: DVec3| n.dot((p1 - p0).cross(p - p0)) >= -1e-18;
                let within = beside(a, b) && beside(b, c) && beside(c, a);
                ((0.0..=0.15).contains(&t) && within).then_some((t, face, p))
            })
            .min_by(|x, y| x.0.total_cmp(&y.0));
        let Some((distance, face, p)) = first else { continue };
        hits += 1;
        let far = |v: &u32| hat.vertices[*v as usize].distance(p);
        let corners = hat.faces[face];
        let clothing = *corners.iter().min_by(|v, w| far(v).total_cmp(&far(w))).unwrap();
        let place = &mut kept[clothing as usize];
        if place.is_none_or(|held| distance < held.distance - 1e-15) {
            *place = Some(Correspondence { clothing, body: vertex as u32, distance });
        }
    }
    let expected: Vec<Correspondence> = kept.into_iter().flatten().collect();
    assert_eq!(found.statistics.hits, hits);
    assert_eq!(found.pairs.len(), expected.len());
    for (found, expected) in found.pairs.iter().zip(&expected) {
        assert_eq!(found.clothing, expected.clothing);
        assert!((found.distance - expected.distance).abs() < 1e-12);
    }
    assert!(!found.statistics.clothing_is_flipped());
    assert_eq!(found.statistics.inside, 0);
}

#[test]
fn rays_that_other_parts_of_the_body_block_or_send_are_left_out() {
    // Two legs in a tube that the hand, a smaller ball outside of it, nearly touches.
    let ball = |radius: f64, at: DVec3| SurfaceMesh {
        vertices: sphere(radius, 3).vertices.into_iter().map(|v| v + at).collect(),
        faces: sphere(radius, 3).faces,
    };
    let parts =
        [ball(0.05, DVec3::X * -0.055), ball(0.05, DVec3::X * 0.055), ball(0.03, DVec3::X * 0.19)];
    let mut body = SurfaceMesh::default();
    let mut starts = Vec::new();
    for part in parts {
        let first = body.vertices.len() as u32;
        starts.push(first);
        body.vertices.extend(part.vertices);
        body.faces.extend(part.faces.iter().map(|f| f.map(|v| v + first)));
    }
    let tube = grid(60, 20, |u, v| {
        let turn = -std::f64::consts::TAU * u;
        DVec3::new(0.13 * turn.cos(), 0.08 * turn.sin(), 0.1 - 0.2 * v)
    });
    let found = SparseCorrespondences::find(&body, &tube, 0.15).unwrap();
    assert!(!found.statistics.clothing_is_flipped());
    let RayStatistics { on_outer_side, blocked, .. } = found.statistics;
    assert!(on_outer_side > 20 && blocked > 10, "{:?}", found.statistics);
    let normals = body.vertex_normals();
    for pair in &found.pairs {
        assert!(pair.body < starts[2], "{pair:?} is of the hand");
        // The ray keeps clear of the other leg, up to the ball's facets.
        let at = body.vertices[pair.body as usize];
        let other = DVec3::X * -0.055 * at.x.signum();
        let along = normals[pair.body as usize];
        let closest = along.dot(other - at).clamp(0.0, pair.distance);
        assert!((at + along * closest).distance(other) > 0.048, "{pair:?} crosses a leg");
    }
    let turned = SurfaceMesh {
        faces: tube.faces.iter().map(|&[a, b, c]| [a, c, b]).collect(),
        vertices: tube.vertices.clone(),
    };
    let again = SparseCorrespondences::find(&body, &turned, 0.15).unwrap();
    assert!(again.statistics.clothing_is_flipped());
    let RayStatistics { hits, .. } = found.statistics;
    assert_eq!((again.statistics.hits, again.statistics.blocked), (hits, blocked));
    assert_eq!(again.statistics.on_outer_side, hits - on_outer_side);
    assert!(again.pairs.iter().all(|pair| pair.body < starts[2]), "the hand is still left out");
}

#[test]
fn weights_agree_with_the_formula() {
    let (body, hat) = ball_and_hat();
    let options = AssociateOptions { neighbours: 5, ..AssociateOptions::default() };
    let found = options.associate(&body, &hat).unwrap();
    let pairs = SparseCorrespondences::find(&body, &hat, options.reach).unwrap().pairs;
    let all = |surface: &SurfaceMesh, v: u32| {
        let mut distances = vec![f64::INFINITY; surface.vertices.len()];
        for (at, d) in Geodesics::new(surface, options.metric).within(v, options.support) {
            distances[at as usize] = d;
        }
        distances
    };
    let on_body: Vec<Vec<f64>> = pairs.iter().map(|p| all(&body, p.body)).collect();
    for vertex in (0..hat.vertices.len()).step_by(37) {
        let on_hat = all(&hat, vertex as u32);
        let mut votes: Vec<(f64, u32)> = (0..body.vertices.len())
            .map(|l| {
                let vote = pairs.iter().zip(&on_body).map(|(pair, on_body)| {
                    let r = on_hat[pair.clothing as usize].powi(2) + on_body[l].powi(2);
                    (-r / options.sigma.powi(2)).exp()
                });
                (vote.sum(), l as u32)
            })
            .collect();
        votes.sort_by(|p, q| q.0.total_cmp(&p.0));
        votes.truncate(5);
        let sum: f64 = votes.iter().map(|v| v.0).sum();
        for (k, (vote, _)) in votes.into_iter().enumerate() {
            let weight = found.weights[(vertex, k)];
            assert!((weight - vote / sum).abs() < 1e-9, "{vertex} {k}: {weight} {}", vote / sum);
        }
    }
    assert!(found.weights.rows().into_iter().all(|w| (w.sum() - 1.0).abs() < 1e-12));
    let grey = vec![[10, 20, 30]; body.vertices.len()];
    assert!(found.colours(&grey).unwrap().iter().all(|&c| c == [10, 20, 30]));
    assert!(found.colours(&grey[..1]).is_err());
}

#[test]
fn vertices_without_hits_are_completed_and_counted() {
    let body = sphere(0.1, 4);
    // A long cone, far below the ball's reach, and a scrap that touches nothing.
    let mut skirt = grid(40, 30, |u, v| {
        let turn = 0.123 + std::f64::consts::TAU * u;
        DVec3::new(turn.cos(), turn.sin(), 0.0) * (0.11 + 0.1 * v) - DVec3::Z * 0.6 * v
    });
    let scrap = skirt.vertices.len() as u32;
    skirt.vertices.extend([DVec3::X, DVec3::X * 1.1, DVec3::new(1.0, 0.1, 0.0)]);
    skirt.faces.push([scrap, scrap + 1, scrap + 2]);
    let association = AssociateOptions::default().associate(&body, &skirt).unwrap();
    assert_eq!(association.completion.isolated, 3);
    assert!(association.completion.total() > 300, "{:?}", association.completion);
    assert!(association.weights.rows().into_iter().all(|w| (w.sum() - 1.0).abs() < 1e-12));
    // The hem follows the side of the ball it is on.
    for vertex in (29..1200).step_by(30) {
        let body_vertex = body.vertices[association.indices[(vertex, 0)] as usize];
        let flat = skirt.vertices[vertex].with_z(0.0).normalize();
        let side = body_vertex.with_z(0.0).normalize();
        assert!(side.dot(flat) > 0.8, "{vertex}: {side} {flat}");
    }
}

#[test]
fn unusable_pairs_of_meshes_are_told_apart() {
    let (body, hat) = ball_and_hat();
    let options = AssociateOptions::default();
    let away = |surface: &SurfaceMesh, by: DVec3| SurfaceMesh {
        vertices: surface.vertices.iter().map(|&v| v + by).collect(),
        faces: surface.faces.clone(),
    };
    let turned = |surface: &SurfaceMesh| SurfaceMesh {
        vertices: surface.vertices.clone(),
        faces: surface.faces.iter().map(|&[a, b, c]| [a, c, b]).collect(),
    };
    let missed = options.associate(&body, &away(&hat, DVec3::X * 3.0)).unwrap_err();
    assert!(matches!(missed, Error::NoHits { .. }), "{missed}");
    let short = AssociateOptions { reach: 0.1, ..options };
    let flipped = short.associate(&turned(&body), &hat).unwrap_err();
    assert!(matches!(flipped, Error::FlippedBody { .. } | Error::NoHits { .. }), "{flipped}");
    let inside_out = options.associate(&body, &turned(&hat)).unwrap();
    assert!(inside_out.statistics.clothing_is_flipped());
    let sunk = options.associate(&body, &away(&hat, DVec3::Z * -0.025)).unwrap();
    assert!(sunk.statistics.inside > 0);
    let none = AssociateOptions { neighbours: 0, ..options };
    assert!(none.associate(&body, &hat).unwrap_err().to_string().contains("0 body vertices"));
    let nan = AssociateOptions { sigma: f64::NAN, ..options };
    assert!(nan.associate(&body, &hat).is_err());
}

#[test]
fn a_dress_of_twenty_thousand_vertices_is_quick() {
    // A body of 6,500 vertices about as large as a torso, and a skirt of 2 m² around it.
    let body = grid(100, 65, |u, v| {
        let turn = -std::f64::consts::TAU * u;
        DVec3::new(0.15 * turn.cos(), 1.0 * v, 0.15 * turn.sin())
    });
    let dress = grid(200, 100, |u, v| {
        let turn = -std::f64::consts::TAU * u;
        DVec3::new(turn.cos(), 0.0, turn.sin()) * (0.18 + 0.25 * v) + DVec3::Y * (0.9 - 0.9 * v)
    });
    let normals = body.vertex_normals();
    assert!(normals[500].dot(body.vertices[500].with_y(0.0)) > 0.0);
    let start = Instant::now();
    let association = AssociateOptions::default().associate(&body, &dress).unwrap();
    let seconds = start.elapsed().as_secs_f64();
    println!("{} pairs, {:?}, {seconds:.2} s", association.pairs, association.completion);
    assert!(seconds < 10.0, "{seconds}");
}
