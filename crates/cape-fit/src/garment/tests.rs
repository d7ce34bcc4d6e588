use cape_cloth::{ClothMaterial, Garment, GarmentKind, SimulationOptions};
use cape_core::{
    BodyMotion,
    geometry::{SurfaceMesh, points},
};
use cape_synth::{Motion, MotionStyle};
use glam::DVec3;
use ndarray::{Array2, Axis};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use rand_distr::StandardNormal;

use super::{GarmentConfig, GarmentTracker};
use crate::{
    scan::{Scan, Unit, distances_to},
    testing::BODY,
};

/// Vertices of a T-shirt over a marching body, by frame, and its triangles.
fn shirt(frames: usize) -> (Vec<Vec<DVec3>>, Vec<[u32; 3]>) {
    let shape = BODY.rest_shape(&[]).unwrap();
    let garment = Garment { resolution: 0.025, ..Garment::new(GarmentKind::TShirt) };
    let sewn = garment.sew(&BODY, &shape).unwrap();
    let (style, rate) = (MotionStyle::default(), 30.0);
    let poses = (0..frames).flat_map(|f| Motion::WalkMarch.pose(&style, f as f64 / rate));
    let poses = Array2::from_shape_vec((frames, 72), poses.collect()).unwrap();
    let forward = Array2::from_shape_fn((frames, 3), |(f, axis)| 0.03 * (f * (axis / 2)) as f64);
    let motion = BodyMotion::new(rate, poses, forward).unwrap();
    let options = SimulationOptions { settle: 0.5, ..SimulationOptions::default() };
    let worn = (&sewn, &ClothMaterial::default());
    let found = options.run(&BODY, &shape, worn, &motion, &mut |_, _| {}).unwrap();
    let frames = found.frames.axis_iter(Axis(0)).map(|frame| points(frame)).collect();
    (frames, sewn.surface.faces)
}

/// A scan of a surface: triangles between midpoints of its edges and its vertices, in another order, with
/// normally distributed noise and round holes until a fifth is missing; as points if `cloud`.
fn scanned(at: &[DVec3], faces: &[[u32; 3]], (noise, cloud): (f64, bool), seed: u64) -> Scan {
    let rng = &mut ChaCha8Rng::seed_from_u64(seed);
    let surface = SurfaceMesh { vertices: at.to_vec(), faces: faces.to_vec() };
    let edges = surface.edges();
    let place = |a: u32, b: u32| edges.binary_search(&[a.min(b), a.max(b)]).unwrap() as u32;
    let middle = |&[a, b]: &[u32; 2]| at[a as usize].midpoint(at[b as usize]);
    let mut vertices: Vec<DVec3> = edges.iter().map(middle).collect();
    let first = vertices.len() as u32;
    vertices.extend(at);
    let split = |&[a, b, c]: &[u32; 3]| {
        let [ab, bc, ca] = [place(a, b), place(b, c), place(c, a)];
        [[ab, bc, ca], [first + a, ab, ca], [first + b, bc, ab], [first + c, ca, bc]]
    };
    let mut faces: Vec<[u32; 3]> = faces.iter().flat_map(split).collect();
    let all = faces.len();
    while faces.len() > all * 4 / 5 {
        let middle = vertices[rng.random_range(0..vertices.len())];
        faces.retain(|face| vertices[face[0] as usize].distance(middle) > 0.06);
    }
    let mut shift = || noise * rng.sample::<f64, _>(StandardNormal);
    for vertex in &mut vertices {
        *vertex += DVec3::new(shift(), shift(), shift());
    }
    if cloud {
        let mut seen: Vec<u32> = faces.into_iter().flatten().collect();
        seen.sort_unstable();
        seen.dedup();
        let points = seen.into_iter().map(|v| vertices[v as usize]).collect();
        return Scan::new(points, None, Vec::new(), Unit::M).unwrap();
    }
    Scan::new(vertices, None, faces, Unit::M).unwrap()
}

fn mean(all: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = all.fold((0.0, 0), |(sum, count), x| (sum + x, count + 1));
    sum / f64::from(count)
}

#[test]
fn a_shirt_is_followed_through_scans_with_noise_and_holes() {
    let (frames, faces) = shirt(16);
    let template = SurfaceMesh { vertices: frames[0].clone(), faces: faces.clone() };
    for (noise, cloud, bounds) in
        [(0.0, false, [6.5, 1.4]), (0.002, false, [7.0, 1.8]), (0.002, true, [5.0, 1.7])]
    {
        let mut tracker = GarmentTracker::new(&template, GarmentConfig::default()).unwrap();
        let mut errors = Vec::new();
        for (frame, truth) in frames.iter().enumerate() {
            let scan = scanned(truth, &faces, (noise, cloud), frame as u64);
            let fit = tracker.register(&scan).unwrap();
            let off =
                |all: &[DVec3]| mean(all.iter().zip(truth).map(|(a, b)| 1e3 * a.distance(*b)));
            let true_surface = Scan::new(truth.clone(), None, faces.clone(), Unit::M).unwrap();
            let surface = 1e3 * mean(distances_to(&true_surface, &fit.vertices).into_iter());
            errors.push([off(&fit.vertices), surface, off(&frames[0])]);
        }
        let by = |which: usize| mean(errors.iter().map(|error| error[which]));
        let last = errors[errors.len() - 1];
        println!(
            "noise {noise}, cloud {cloud}: vertices {:.2} mm (last frame {:.2}), surface {:.2} mm, \
             unmoved {:.1} mm",
            by(0),
            last[0],
            by(1),
            by(2)
        );
        assert!(by(0) < bounds[0] && by(1) < bounds[1] && last[0] < 1.5 * bounds[0], "{errors:?}");
        assert!(by(0) < 0.1 * by(2));
    }
}

#[test]
fn scans_elsewhere_and_templates_without_triangles_are_errors() {
    let (frames, faces) = shirt(1);
    let template = SurfaceMesh { vertices: frames[0].clone(), faces: faces.clone() };
    let mut tracker = GarmentTracker::new(&template, GarmentConfig::default()).unwrap();
    let away: Vec<DVec3> = frames[0].iter().map(|&x| x + 5.0 * DVec3::X).collect();
    let scan = Scan::new(away, None, faces, Unit::M).unwrap();
    assert!(tracker.register(&scan).unwrap_err().to_string().contains("no point of the scan"));
    let none = SurfaceMesh { faces: Vec::new(), ..template.clone() };
    let refused = GarmentTracker::new(&none, GarmentConfig::default()).unwrap_err();
    assert!(refused.to_string().contains("triangles"));
    let config = GarmentConfig { sliding: f64::NAN, ..GarmentConfig::default() };
    assert!(GarmentTracker::new(&template, config).is_err());
}
