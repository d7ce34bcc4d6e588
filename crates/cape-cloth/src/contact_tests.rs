//! Contact with bodies at production settings, measured by [`Penetration`], and that measure itself.

use cape_core::{
    BodyMotion,
    geometry::{
        SurfaceIndex, SurfaceMesh,
        primitives::{grid, sphere},
    },
};
use cape_synth::{Motion, MotionStyle, synthetic_body};
use glam::DVec3;
use ndarray::Array2;

use crate::{Cloth, ClothMaterial, Garment, GarmentKind, Penetration, SimulationOptions};

/// A patch of 6 cm around the point of a ball of radius 0.1 m, `depth` metres inside it.
fn patch_in_ball(depth: f64, cells: usize) -> Penetration {
    let ball = sphere(0.1, 5);
    let patch = grid(cells + 1, cells + 1, |u, v| {
        DVec3::new(0.06 * (u - 0.5), 0.1 - depth, 0.06 * (0.5 - v))
    });
    Penetration::measure(&patch, &ball)
}

#[test]
fn depths_in_a_ball_are_exact_between_vertices_too() {
    // One cell: all its corners are 1 cm outside, its middle is inside.
    let coarse = patch_in_ball(0.003, 1);
    assert_eq!(coarse.inside, 0);
    assert!(coarse.intersections > 0 && (coarse.depth - 0.003).abs() < 3e-4, "{coarse:?}");
    let fine = patch_in_ball(0.003, 20);
    assert!(fine.inside > 0 && (fine.depth - 0.003).abs() < 3e-4, "{fine:?}");
    // Vertices of a disc of radius √(R² − (R − d)²).
    let radius = (0.1f64.powi(2) - 0.097f64.powi(2)).sqrt();
    let expected = std::f64::consts::PI * (radius / 0.003).powi(2);
    assert!((fine.inside as f64 / expected - 1.0).abs() < 0.1, "{fine:?}, expected {expected}");
    assert_eq!(patch_in_ball(-0.001, 20), Penetration::default());
}

#[test]
fn windings_are_those_of_brute_force() {
    // Sum of solid angles (Van Oosterom and Strackee 1983) of two balls that overlap.
    let [one, other] = [0.0, 0.12].map(|x| {
        let mut ball = sphere(0.1, 2);
        ball.vertices.iter_mut().for_each(|p| p.x += x);
        ball
    });
    let both = crate::sheet::joined([&one, &other].into_iter());
    let solid_angle = |p: DVec3| -> f64 {
        let angle = |face: usize| {
            let [a, b, c] = both.corners(face).map(|q| q - p);
            let [la, lb, lc] = [a, b, c].map(DVec3::length);
            let below = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
            2.0 * a.dot(b.cross(c)).atan2(below)
        };
        (0..both.faces.len()).map(angle).sum::<f64>() / (4.0 * std::f64::consts::PI)
    };
    let cloud = grid(13, 13, |u, v| DVec3::new(0.4 * u - 0.13, 0.01, 0.3 * v - 0.15));
    let found = Penetration::measure(&cloud, &both);
    let windings: Vec<f64> = cloud.vertices.iter().map(|&p| solid_angle(p)).collect();
    let count = |n: f64| windings.iter().filter(|&&w| (w - n).abs() < 0.1).count();
    assert_eq!(count(0.0) + count(1.0) + count(2.0), windings.len());
    assert_eq!(found.inside, count(1.0));
    assert!(count(2.0) > 0 && found.hidden >= count(2.0), "{found:?}");
}

#[test]
fn an_arm_at_six_metres_per_second_sweeps_cloth_along() {
    // An arm of 0.8 m along x moves along z at 6 m/s; cloth hangs in its way from a bar.
    let (length, radius, speed) = (0.8, 0.045, 6.0);
    let mut arm = sphere(radius, 3);
    arm.vertices.iter_mut().filter(|p| p.x > 1e-9).for_each(|p| p.x += length);
    let across = arm.neighbours();
    let at = |z: f64| SurfaceMesh {
        vertices: arm.vertices.iter().map(|p| *p + DVec3::new(0.0, 0.0, z)).collect(),
        faces: arm.faces.clone(),
    };
    let sheet = grid(21, 31, |u, v| DVec3::new(0.2 + 0.4 * u, 0.25 - 0.6 * v, 0.1));
    let options = SimulationOptions::default();
    let mut cloth = Cloth::new(&sheet, &ClothMaterial::default())
        .unwrap()
        .with_air(options.air)
        .with_strain_limit(options.strain_limit)
        .with_layer_collision();
    (0..sheet.vertices.len()).filter(|&v| sheet.vertices[v].y > 0.249).for_each(|v| cloth.pin(v));
    for frame in 0..3 {
        let [from, to] = [frame, frame + 1].map(|f| speed * f64::from(f) / 30.0);
        let mut solid = SurfaceIndex::moving(&at(from), at(to).vertices, across.clone());
        options.advance(&mut cloth, &mut solid, 1.0 / 30.0, |_, _, _| ());
        let now = SurfaceMesh { vertices: cloth.positions.clone(), faces: sheet.faces.clone() };
        let found = Penetration::measure(&now, solid.surface());
        let strain = cloth.strain();
        println!("frame {frame}: {found:?}, strain {strain:?}");
        assert!(found.inside == 0 && found.depth < 3e-3, "frame {frame}: {found:?}");
        assert!(strain[0] < 0.25 && strain[1] < 0.8, "frame {frame}: {strain:?}");
        // From the bar down, each thread passes before the arm, not behind it.
        for thread in cloth.positions.chunks(31) {
            let first = thread.iter().find(|x| x.y < 0.0).unwrap();
            assert!(first.z > to, "frame {frame}: {first}");
        }
    }
    let furthest = cloth.positions.iter().map(|x| x.z).fold(0.0, f64::max);
    assert!(furthest > 0.6, "swept along to {furthest} m");
}

#[test]
fn a_shirt_stays_over_trousers_on_a_walking_body() {
    let model = synthetic_body();
    let shape = model.rest_shape(&[]).unwrap();
    let sew = |kind, length, width| {
        let garment = Garment { resolution: 0.03, length, width, ..Garment::new(kind) };
        garment.sew(&model, &shape).unwrap()
    };
    let trousers = sew(GarmentKind::Shorts, 1.8, 1.12);
    let shirt = sew(GarmentKind::TShirt, 1.2, 1.2);
    let style = MotionStyle { amplitude: 0.55, ..MotionStyle::default() };
    let frames = 12;
    let poses = (0..frames).flat_map(|f| Motion::WalkMarch.pose(&style, f as f64 / 30.0)).collect();
    let poses = Array2::from_shape_vec((frames, 72), poses).unwrap();
    let motion = BodyMotion::new(30.0, poses, Array2::zeros((frames, 3))).unwrap();
    let outfit = [(&trousers, &ClothMaterial::DENIM), (&shirt, &ClothMaterial::default())];
    let options = SimulationOptions::default();
    let worn = options.run_outfit(&model, &shape, &outfit, &motion, &mut |_, _| {}).unwrap();
    for (garment, name) in worn.iter().zip(["trousers", "shirt"]) {
        let quality = garment.quality();
        println!("{name}: {quality:?}");
        // Edges of 30 mm do not follow knees and hips between vertices.
        assert!(quality.penetration < 5e-3, "{name}: {quality:?}");
        assert!(quality.crossings <= 2 && quality.mean_strain < 0.03, "{name}: {quality:?}");
    }
    // Vertices of the shirt well over the trousers are outside them.
    let last = |k: usize, surface: &SurfaceMesh| {
        let rows = worn[k].frames.index_axis(ndarray::Axis(0), frames - 1);
        SurfaceMesh { vertices: cape_core::geometry::points(rows), faces: surface.faces.clone() }
    };
    let under = last(0, &trousers.surface);
    let boundary = under.boundary();
    let index = SurfaceIndex::new(&under);
    let mut over = 0;
    for x in last(1, &shirt.surface).vertices {
        let Some(near) = index.closest(x, 0.03) else { continue };
        let corners = under.faces[near.face as usize];
        if corners.iter().any(|&v| boundary[v as usize]) {
            continue;
        }
        over += 1;
        assert!(near.signed_distance > 0.0, "{x}: {} m", near.signed_distance);
    }
    assert!(over > 50, "{over} vertices over the trousers");
    let alone = options.run_outfit(&model, &shape, &[], &motion, &mut |_, _| {});
    assert!(alone.unwrap_err().to_string().contains("no garment"));
}
