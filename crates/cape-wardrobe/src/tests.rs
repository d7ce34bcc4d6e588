use std::{collections::BTreeMap, fs, path::Path};

use cape_core::{
    Outfit, SmplModel,
    geometry::{SurfaceMesh, points, primitives::sphere},
    smpl::StandardPose,
};
use cape_synth::{Motion, MotionStyle, SynthSpec, synthetic_body};
use glam::DVec3;

use crate::{
    OutfitCut, Shard, SimulatedCaptures, SurfaceTransfer, WardrobeOptions,
    canonical::CanonicalBody, mesh_graph::MeshGraph, take::DressedSubject, transfer::PosedBody,
};

/// The synthetic body in the A-pose.
fn standing(model: &SmplModel) -> SurfaceMesh {
    let pose = StandardPose::A.angles(24);
    let posed = model.pose(&[], &pose, [0.0; 3], None).unwrap().vertices;
    SurfaceMesh::from_rows("body", posed.view(), &model.faces).unwrap()
}

/// The faces of `body` with all corners where `inside` holds, moved along the normals.
fn offset(body: &SurfaceMesh, distance: f64, inside: impl Fn(DVec3) -> bool) -> SurfaceMesh {
    let moved = body.vertices.iter().zip(body.vertex_normals());
    let all = |face: &&[u32; 3]| face.iter().all(|&v| inside(body.vertices[v as usize]));
    SurfaceMesh {
        vertices: moved.map(|(&p, normal)| p + normal * distance).collect(),
        faces: body.faces.iter().filter(all).copied().collect(),
    }
}

#[test]
fn the_offset_surface_of_the_body_gives_normal_offsets() {
    // On a sphere the closest points of the offset surface are the offset vertices.
    let body = sphere(0.3, 4);
    let garment = offset(&body, 0.01, |_| true);
    let transfer = SurfaceTransfer::fit(&body, std::slice::from_ref(&garment));
    let laid = transfer.lay(&body.vertices, &garment.vertices);
    for ((p, skin), normal) in laid.iter().zip(&body.vertices).zip(body.vertex_normals()) {
        assert!((*p - *skin - normal * 0.01).length() < 1e-9, "{p} {skin}");
    }
}

#[test]
fn a_hem_lies_on_the_boundary_without_turned_triangles() {
    let body = sphere(0.3, 4);
    // A cap that is cut between the vertices of the body: a finer sphere's.
    let garment = offset(&sphere(0.312, 5), 0.0, |p| p.y > 0.07);
    let transfer = SurfaceTransfer::fit(&body, std::slice::from_ref(&garment));
    let laid = transfer.lay(&body.vertices, &garment.vertices);
    let graph = MeshGraph::new(&body);
    assert!(graph.turned(body.face_normals(), &laid).is_empty());
    // Above the hem all are covered, and no skin within an edge of the hem is.
    let edge = body.mean_edge();
    for (p, point) in body.vertices.iter().zip(transfer.points()) {
        if p.y > 0.07 + edge {
            assert!(point.is_some(), "{p}");
        }
        if p.y < 0.07 - edge {
            assert!(point.is_none(), "{p}");
        }
    }
    // Edges across the hem begin on it: its height is that of the last row of vertices.
    let hem = garment.boundary();
    let heights = garment.vertices.iter().zip(hem).filter(|(_, hem)| *hem).map(|(p, _)| p.y);
    let (low, high) = heights.fold((1.0f64, 0.0f64), |(l, h), y| (l.min(y), h.max(y)));
    let (mut on_hem, mut others) = (0, 0);
    for &[a, b] in &graph.edges {
        let ends = [a, b].map(|v| transfer.points()[v as usize].is_some());
        if ends[0] != ends[1] {
            let covered = if ends[0] { a } else { b };
            let y = laid[covered as usize].y;
            if (low - 1e-6..=high + 1e-6).contains(&y) { on_hem += 1 } else { others += 1 }
        }
    }
    assert!(on_hem > 9 * others, "{on_hem} on the hem, {others} elsewhere");
}

#[test]
fn of_two_garments_the_outer_one_is_taken() {
    let body = sphere(0.3, 3);
    let inner = offset(&body, 0.005, |_| true);
    let upper = offset(&body, 0.015, |p| p.y > 0.0);
    let count = inner.vertices.len() as u32;
    let vertices: Vec<DVec3> = inner.vertices.iter().chain(&upper.vertices).copied().collect();
    let layers = [
        SurfaceMesh { vertices: vertices.clone(), faces: inner.faces.clone() },
        SurfaceMesh {
            vertices: vertices.clone(),
            faces: upper.faces.iter().map(|face| face.map(|v| v + count)).collect(),
        },
    ];
    let transfer = SurfaceTransfer::fit(&body, &layers);
    for (p, point) in body.vertices.iter().zip(transfer.points()) {
        let on_outer = point.unwrap().corners[0] >= count;
        if p.y.abs() > 0.06 {
            assert_eq!(on_outer, p.y > 0.0, "{p}");
        }
    }
}

/// A garment that is turned about the axis slides along a sphere.
#[test]
fn sliding_is_taken_back_and_hems_stay() {
    let body = sphere(0.3, 4);
    let garment = offset(&sphere(0.312, 5), 0.0, |p| p.y > 0.07);
    let transfer = SurfaceTransfer::fit(&body, std::slice::from_ref(&garment));
    let turn = glam::DQuat::from_rotation_y(0.2);
    let turned = SurfaceMesh {
        vertices: garment.vertices.iter().map(|&p| turn * p).collect(),
        ..garment.clone()
    };
    let graph = MeshGraph::new(&body);
    let posed = PosedBody { surface: &body, graph: &graph };
    let lay = |kept| transfer.lay_sliding(&posed, std::slice::from_ref(&turned), kept);
    assert_eq!(lay(1.0), transfer.lay(&body.vertices, &turned.vertices));
    let before = transfer.lay(&body.vertices, &garment.vertices);
    let farthest = |laid: &[DVec3]| {
        let moved = laid.iter().zip(&before).map(|(a, b)| a.distance(*b));
        moved.fold(0.0, f64::max)
    };
    // All of the sliding: 0.2 rad at a radius of 0.3 m. None: what smoothing leaves.
    assert!(farthest(&lay(1.0)) > 0.055, "{}", farthest(&lay(1.0)));
    assert!(farthest(&lay(0.0)) < 0.012, "{}", farthest(&lay(0.0)));
    let half = lay(0.5);
    assert!((0.025..0.04).contains(&farthest(&half)), "{}", farthest(&half));
    for kept in [0.0, 0.5] {
        let laid = lay(kept);
        assert!(graph.turned(body.face_normals(), &laid).is_empty());
        let edge = body.mean_edge();
        let worn = before.iter().zip(&laid).zip(transfer.points()).filter(|(_, p)| p.is_some());
        for ((before, after), _) in worn {
            assert!((after.y - before.y).abs() < 0.3 * edge, "{before} {after}");
            assert!((after.length() - 0.312).abs() < 0.002, "{after}");
        }
    }
}

#[test]
fn unposing_undoes_posing() {
    let model = synthetic_body();
    let minimal = model.rest_shape(&[0.8, -0.6]).unwrap();
    let canonical = CanonicalBody::new(&model, &minimal).unwrap();
    let pose = Motion::WalkMarch.pose(&MotionStyle::default(), 0.4);
    let given = ndarray::Array2::from_shape_fn((6890, 3), |(v, axis)| {
        0.02 * ((v * 3 + axis) as f64 * 0.7).sin()
    });
    let transl = [0.1, 0.2, -0.3];
    let posed = model.pose_shape(&minimal, &pose, transl, Some(&given)).unwrap().vertices;
    let covered = vec![true; 6890];
    let frame = canonical.frame(&pose, transl).unwrap();
    let laid = points(posed.view());
    let found = canonical.displacement(&frame, &laid, &covered);
    for (again, given) in canonical.posed(&frame, &found).iter().zip(&laid) {
        assert!((*again - *given).length() < 1e-6, "{again} {given}");
    }
    for (found, given) in found.iter().zip(points(given.view())) {
        assert!((*found - given).length() < 1e-6, "{found} {given}");
    }
}

#[test]
fn turned_triangles_are_smoothed_and_others_kept() {
    let model = synthetic_body();
    let minimal = model.rest_shape(&[]).unwrap();
    let canonical = CanonicalBody::new(&model, &minimal).unwrap();
    let mut displacement = vec![DVec3::ZERO; 6890];
    let covered = vec![true; 6890];
    // A vertex far beyond its neighbours.
    let tip = 3000;
    displacement[tip] = DVec3::new(0.03, 0.02, -0.04);
    let kept: Vec<DVec3> = displacement.clone();
    let [before, after] = canonical.relax(&mut displacement, &covered);
    assert!(before > 0);
    assert_eq!(after, 0);
    let changed = displacement.iter().zip(&kept).filter(|(a, b)| a != b).count();
    assert!(changed < 60, "{changed}");
    let mut smooth = vec![DVec3::new(0.01, 0.0, 0.005); 6890];
    assert_eq!(canonical.relax(&mut smooth, &covered), [0, 0]);
    assert!(smooth.iter().all(|d| *d == DVec3::new(0.01, 0.0, 0.005)));
}

#[test]
fn intersecting_triangles_are_separated() {
    let model = synthetic_body();
    let minimal = model.rest_shape(&[]).unwrap();
    let canonical = CanonicalBody::new(&model, &minimal).unwrap();
    let frame = canonical.frame(&[0.0; 72], [0.0; 3]).unwrap();
    let skin = points(minimal.view());
    let bare = canonical.graph.intersecting(&skin);
    // Both legs 8 cm thicker intersect each other.
    let surface = SurfaceMesh::from_rows("body", minimal.view(), &model.faces).unwrap();
    let hip = minimal.column(1).iter().copied().fold(f64::INFINITY, f64::min) + 0.75;
    let normals = surface.vertex_normals();
    let covered: Vec<bool> = skin.iter().map(|p| p.y < hip && p.y > hip - 0.4).collect();
    let thick = covered.iter().zip(&normals);
    let mut displacement: Vec<DVec3> =
        thick.map(|(&on, &normal)| if on { normal * 0.08 } else { DVec3::ZERO }).collect();
    let new = |displacement: &[DVec3]| {
        let crossing = canonical.graph.intersecting(&canonical.posed(&frame, displacement));
        crossing.iter().zip(&bare).filter(|(now, bare)| **now && !**bare).count()
    };
    let before = new(&displacement);
    canonical.separate(&frame, &bare, &mut displacement, &covered);
    let after = new(&displacement);
    assert!(before > 100 && after < before / 10, "{before} {after}");
}

#[test]
fn four_outfits_cover_what_their_names_say() {
    let model = synthetic_body();
    let minimal = model.rest_shape(&[]).unwrap();
    let body = standing(&model);
    let joints =
        points(model.pose(&[], &StandardPose::A.angles(24), [0.0; 3], None).unwrap().joints.view());
    for outfit in Outfit::PAPER {
        let cut = OutfitCut::random(outfit, &[], 3).unwrap().with_resolution(0.03);
        let dressed = DressedSubject::new(&model, minimal.clone(), cut).unwrap();
        let transfer = dressed.transfer();
        // Share of covered vertices around a point.
        let near = |at: DVec3, radius: f64| {
            let around = body.vertices.iter().zip(transfer.points());
            let around = around.filter(|(p, _)| p.distance(at) < radius);
            let covered: Vec<bool> = around.map(|(_, point)| point.is_some()).collect();
            covered.iter().filter(|&&c| c).count() as f64 / covered.len() as f64
        };
        let lengths = cape_synth::GarmentLengths::from_outfit(outfit).unwrap();
        let torso = [9, 0].map(|joint| near(joints[joint], 0.14));
        assert!(torso.iter().all(|&share| share > 0.9), "{outfit}: {torso:?}");
        let elbow = near(joints[18], 0.07);
        assert_eq!(elbow > 0.5, lengths.long_sleeves, "{outfit}: {elbow}");
        let shin = near(joints[5].lerp(joints[8], 0.4), 0.08);
        assert_eq!(shin > 0.5, lengths.long_legs, "{outfit}: {shin}");
        for joint in [15, 22, 23, 10, 11] {
            let bare = near(joints[joint], 0.12);
            assert!(bare < 0.2, "{outfit}: joint {joint} {bare}");
        }
    }
}

fn small(model: &SmplModel) -> SimulatedCaptures<'_> {
    let spec = SynthSpec {
        subjects: 1,
        frames_per_sequence: 2,
        outfits: vec![Outfit::SHORT_SHORT],
        motions: vec![Motion::Simple, Motion::WalkMarch],
        ..SynthSpec::default()
    };
    let options = WardrobeOptions { resolution: 0.05, noise: 5e-4, ..WardrobeOptions::default() };
    SimulatedCaptures::new(model, spec, options).unwrap()
}

/// Contents of the files below a directory, by path.
fn files(root: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(root).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if path.is_dir() {
            found.extend(files(&path).into_iter().map(|(below, x)| (format!("{name}/{below}"), x)));
        } else if !cape_core::is_temporary(&name) {
            found.insert(name, fs::read(&path).unwrap());
        }
    }
    found
}

#[test]
fn shards_make_the_same_bytes_as_one_machine() {
    let model = synthetic_body();
    let captures = small(&model);
    let [one, two] = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    captures.write(one.path(), Shard::default(), &mut |_, _| {}).unwrap();
    let mut calls = Vec::new();
    for index in [1, 0] {
        let shard = Shard { index, of: 2 };
        captures.write(two.path(), shard, &mut |done, all| calls.push((done, all))).unwrap();
        assert_eq!(two.path().join("quality.json").exists(), index == 0);
    }
    assert_eq!(calls, [(0, 1), (1, 1), (0, 1), (1, 1)]);
    let expected = files(one.path());
    // Body, clothing vertices, settings, quality, minimal shape; two frames and a record of each take.
    assert_eq!(expected.len(), 5 + 2 * 3, "{:?}", expected.keys());
    assert_eq!(files(two.path()), expected);
    // Frames are on the body, and takes within bounds of quality.
    for record in captures.write(one.path(), Shard::default(), &mut |_, _| {}).unwrap() {
        assert!(record.quality.turned < 1e-3, "{record:?}");
        assert!(record.quality.simulation.penetration < 0.02, "{record:?}");
        assert!((0.01..0.1).contains(&record.quality.displacement), "{record:?}");
    }
    let take = &captures.takes()[0];
    let (frames, _) = captures.simulate(take).unwrap();
    let frame = &frames[1];
    let minimal =
        model.rest_shape(&cape_synth::Wardrobe::new(&model, 1).unwrap().betas(0)).unwrap();
    let displacement = frame.v_cano.mapv(f64::from) - &minimal;
    let transl = [0, 1, 2].map(|axis| frame.transl[axis]);
    let posed =
        model.pose_shape(&minimal, frame.pose.as_slice().unwrap(), transl, Some(&displacement));
    let apart = (posed.unwrap().vertices - frame.v_posed.mapv(f64::from)).mapv(f64::abs);
    assert!(apart.iter().all(|&x| x < 1e-6));
}

#[test]
fn unusable_requests_are_errors() {
    let model = synthetic_body();
    let spec = SynthSpec::default;
    let message = |options: WardrobeOptions| {
        SimulatedCaptures::new(&model, spec(), options).unwrap_err().to_string()
    };
    let options = WardrobeOptions::default;
    assert!(message(WardrobeOptions { takes: 0, ..options() }).contains("0 takes"));
    assert!(message(WardrobeOptions { noise: f64::NAN, ..options() }).contains("registration"));
    let captures = small(&model);
    let place = tempfile::tempdir().unwrap();
    let failed = captures.write(place.path(), Shard { index: 2, of: 2 }, &mut |_, _| {});
    assert!(failed.unwrap_err().to_string().contains("shard 3 of 2"));
}
