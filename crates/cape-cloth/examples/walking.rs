//! A T-shirt and trousers on a walking body, for comparison with other simulators:
//! `walking simulate DIR EDGE_MM FRAMES STEPS` writes the scene and the simulated frames to DIR,
//! `walking measure DIR NAME` measures the frames `NAME.npy` there. Both print JSON.

use std::{error::Error, path::Path, time::Instant};

use cape_cloth::{
    Cloth, ClothMaterial, Garment, GarmentKind, GarmentMesh, Penetration, SimulationOptions,
};
use cape_core::{
    BodyMotion, SmplModel,
    geometry::{SurfaceMesh, points},
    npy::{read_f64, read_i64, write_npy},
    smpl::StandardPose,
};
use cape_synth::{Motion, MotionStyle, synthetic_body};
use glam::{DQuat, DVec3};
use ndarray::{Array1, Array2, Array3, Axis, concatenate, s};

/// Frames in which the body moves from the sewing pose into the walk, and frames per second.
const RUN_UP: usize = 30;
const RATE: f64 = 30.0;

/// Frames from one that is measured to the next.
const MEASURED: usize = 4;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let arguments: Vec<&str> = arguments.iter().skip(1).map(String::as_str).collect();
    match arguments[..] {
        ["simulate", directory, edge, frames, steps] => {
            simulate(Path::new(directory), 1e-3 * edge.parse::<f64>()?, [frames, steps])
        }
        ["measure", directory, name] => measure(Path::new(directory), name),
        _ => Err("expected simulate DIR EDGE_MM FRAMES STEPS or measure DIR NAME".into()),
    }
}

/// A walk along z that begins in the sewing pose.
fn walk(model: &SmplModel, frames: usize) -> cape_core::Result<BodyMotion> {
    let style = MotionStyle { amplitude: 0.55, ..MotionStyle::default() };
    let standing = StandardPose::A.angles(model.joints());
    let mut poses = Array2::zeros((RUN_UP + frames, 3 * model.joints()));
    let mut translations = Array2::zeros((RUN_UP + frames, 3));
    for frame in 0..RUN_UP + frames {
        let time = (frame as f64 - RUN_UP as f64) / RATE;
        let t = (frame as f64 / RUN_UP as f64).min(1.0);
        let share = t * t * (3.0 - 2.0 * t);
        let walking = Motion::WalkMarch.pose(&style, time);
        for joint in 0..model.joints() {
            let [a, b] = [&standing[..], &walking[..]].map(|pose| {
                DQuat::from_scaled_axis(DVec3::from_slice(&pose[3 * joint..3 * joint + 3]))
            });
            let turned = a.slerp(b, share).to_scaled_axis().to_array();
            poses.slice_mut(s![frame, 3 * joint..3 * joint + 3]).assign(&Array1::from_iter(turned));
        }
        // 1.2 m/s, reached at a constant acceleration.
        let seconds = RUN_UP as f64 / RATE;
        translations[(frame, 2)] = 1.2
            * if time < 0.0 {
                0.5 * (time + seconds).powi(2) / seconds
            } else {
                0.5 * seconds + time
            };
    }
    BodyMotion::new(RATE, poses, translations)
}

fn simulate(directory: &Path, edge: f64, [frames, steps]: [&str; 2]) -> Result<(), Box<dyn Error>> {
    let (frames, substeps) = (frames.parse::<usize>()?, steps.parse::<usize>()?);
    std::fs::create_dir_all(directory)?;
    let model = synthetic_body();
    let shape = model.rest_shape(&[])?;
    let motion = walk(&model, frames)?;
    let sew = |kind, length, width| {
        Garment { resolution: edge, length, width, ..Garment::new(kind) }.sew(&model, &shape)
    };
    let worn = [sew(GarmentKind::Shorts, 1.8, 1.12)?, sew(GarmentKind::TShirt, 1.15, 1.2)?];
    let material = ClothMaterial::default();
    // The body's first frame is the sewing pose; quality is measured afterwards.
    let options = SimulationOptions {
        substeps,
        settle: 0.0,
        measure_from: motion.frames(),
        ..SimulationOptions::default()
    };
    let start = Instant::now();
    let outfit = worn.each_ref().map(|garment| (garment, &material));
    let simulated = options.run_outfit(&model, &shape, &outfit, &motion, &mut |_, _| {})?;
    let seconds = start.elapsed().as_secs_f64() / motion.frames() as f64;
    let parts = simulated.iter().map(|garment| garment.frames.view()).collect::<Vec<_>>();
    write_npy(directory.join("ours.npy"), &concatenate(Axis(1), &parts)?.mapv(|x| x as f32))?;
    write_scene(directory, &model, &motion, &worn)?;
    let vertices: usize = worn.iter().map(|garment| garment.surface.vertices.len()).sum();
    println!(
        "{}",
        serde_json::json!({"vertices": vertices, "frames": motion.frames(), "seconds": seconds})
    );
    Ok(())
}

/// Writes the body's frames and the garments, both in one surface: at rest, and the waistbands.
fn write_scene(
    directory: &Path,
    model: &SmplModel,
    motion: &BodyMotion,
    worn: &[GarmentMesh; 2],
) -> Result<(), Box<dyn Error>> {
    let shape = model.rest_shape(&[])?;
    let mut body = Array3::zeros((motion.frames(), model.vertices(), 3));
    for frame in 0..motion.frames() {
        let pose = motion.poses.row(frame).to_vec();
        let posed = model.pose_shape(&shape, &pose, motion.translation(frame), None)?;
        body.index_axis_mut(Axis(0), frame).assign(&posed.vertices.mapv(|x| x as f32));
    }
    write_npy(directory.join("body.npy"), &body)?;
    let indices = |faces: &[[u32; 3]], first: u32| {
        Array2::from_shape_fn((faces.len(), 3), |(f, k)| i64::from(faces[f][k] + first))
    };
    write_npy(directory.join("body_faces.npy"), &indices(&model.faces, 0))?;
    let (mut faces, mut rest, mut bands) = (Vec::new(), Vec::new(), Vec::new());
    for garment in worn {
        let first = rest.len() as u32;
        faces.push(indices(&garment.surface.faces, first));
        rest.extend(garment.surface.vertices.iter().map(|x| x.as_vec3().to_array()));
        bands.extend(garment.waistband.iter().map(|&v| i64::from(v + first)));
    }
    let faces: Vec<_> = faces.iter().map(|part| part.view()).collect();
    write_npy(directory.join("faces.npy"), &concatenate(Axis(0), &faces)?)?;
    let rest = Array2::from_shape_fn((rest.len(), 3), |(v, axis)| rest[v][axis]);
    write_npy(directory.join("rest.npy"), &rest)?;
    write_npy(directory.join("waistband.npy"), &Array1::from_vec(bands))?;
    Ok(())
}

/// A surface of a scene: vertices, metres, and faces.
fn surface(
    rows: ndarray::ArrayView2<'_, f64>,
    faces: &Path,
) -> Result<SurfaceMesh, Box<dyn Error>> {
    let faces = read_i64(faces)?.into_dimensionality::<ndarray::Ix2>()?;
    let faces = faces.rows().into_iter().map(|row| [0, 1, 2].map(|k| row[k] as u32)).collect();
    Ok(SurfaceMesh::new("scene", points(rows), faces)?)
}

fn measure(directory: &Path, name: &str) -> Result<(), Box<dyn Error>> {
    let read = |name: &str| -> Result<Array3<f64>, Box<dyn Error>> {
        Ok(read_f64(directory.join(name).with_extension("npy"))?.into_dimensionality()?)
    };
    let (frames, body) = (read(name)?, read("body")?);
    let rest = read_f64(directory.join("rest.npy"))?.into_dimensionality::<ndarray::Ix2>()?;
    let rest = surface(rest.view(), &directory.join("faces.npy"))?;
    let mut cloth = Cloth::new(&rest, &ClothMaterial::default())?;
    let (mut mean, mut largest, mut crossings, mut count) = (0.0, 0.0f64, 0, 0);
    let mut worst = Penetration::default();
    for frame in (RUN_UP..frames.dim().0).step_by(MEASURED) {
        let solid = surface(body.index_axis(Axis(0), frame), &directory.join("body_faces.npy"))?;
        cloth.positions = points(frames.index_axis(Axis(0), frame));
        let worn = SurfaceMesh { vertices: cloth.positions.clone(), faces: rest.faces.clone() };
        let found = Penetration::measure(&worn, &solid);
        worst.depth = worst.depth.max(found.depth);
        worst.inside = worst.inside.max(found.inside);
        worst.intersections = worst.intersections.max(found.intersections);
        crossings = crossings.max(cloth.crossings());
        let [strain, most] = cloth.strain();
        (mean, largest, count) = (mean + strain, largest.max(most), count + 1);
    }
    let result = serde_json::json!({
        "mean_strain": mean / f64::from(count.max(1)),
        "largest_strain": largest,
        "penetration_mm": 1e3 * worst.depth,
        "vertices_inside": worst.inside,
        "intersections": worst.intersections,
        "crossings": crossings,
    });
    println!("{result}");
    Ok(())
}
