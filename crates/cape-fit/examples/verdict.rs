//! Calibration of the verdict on image fits: people of a model with random weights, whose masks have
//! what no body model has (hair, shoes, gloves, rackets, skis, bags, ragged outlines), and inputs that
//! do not belong together (joints in the order of another layout, sides swapped, a mirrored image, the
//! mask of another person, another image size).
//!
//! `cargo run --release -p cape-fit --example verdict -- 10 > verdict.csv` writes a line for each fit of
//! ten people: mean joint error, share of the rendered silhouette on the mask (`inside`), share of the
//! mask that the body explains (`explained`), and the error against the true body.

use std::{env, error::Error};

use cape_core::{ClothingMask, Outfit, SmplModel, devices};
use cape_data::DisplacementStatistics;
use cape_fit::{
    BodyParameters, ClothedConfig, DressedBody, ImageObservation, Keypoint, KeypointLayout,
    Keypoints, Mask, PinholeCamera, PosePrior, SilhouetteLevel, Smplify, SmplifyConfig,
    aligned_error, silhouette::render,
};
use cape_infer::{ClothedModel, ClothedModelParts, RunConfig, build_graphs};
use cape_model::{Cape, CapeConfig};
use cape_synth::{Motion, MotionStyle, synthetic_body};
use glam::{DVec2, DVec3};
use ndarray::Array2;
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use rand_distr::StandardNormal;

const SIDE: u32 = 320;
const DISTANCE: f64 = 3.3;

/// Additions to a mask; each is of a person whose input is right.
const ADDITIONS: [&str; 7] = ["none", "hair and shoes", "racket", "skis", "bag", "ragged", "all"];
/// Faults of the input.
const FAULTS: [&str; 6] =
    ["other layout", "sides swapped", "mirrored", "other person", "size 0.75", "size 1.3"];

type Result<T, E = Box<dyn Error>> = std::result::Result<T, E>;

/// A body in clothing of a model with random weights.
fn dressed(body: &SmplModel) -> Result<DressedBody> {
    let config = RunConfig {
        model: CapeConfig {
            filters: vec![32, 32, 32],
            factors: vec![2, 2, 2],
            latent: 6,
            reduce: 8,
            discriminator: None,
            deviation: 0.3,
            ..CapeConfig::paper()
        },
        ..RunConfig::default()
    };
    let device = &devices()[0];
    let graphs = build_graphs(&config, body, device)?;
    let model = Cape::new(&config.model, &graphs, 3, device)?;
    let out = |v: ndarray::ArrayView1<'_, f64>| {
        (DVec3::new(v[0], 0.0, v[2]).normalize_or_zero() * 0.015).to_array()
    };
    let mean = Array2::from(body.v_template.rows().into_iter().map(out).collect::<Vec<_>>());
    let deviation = Array2::from_elem(mean.dim(), 0.006);
    let parts = ClothedModelParts {
        config,
        body: body.clone(),
        mask: ClothingMask::from_weights(body)?,
        statistics: DisplacementStatistics::new(mean, deviation, 0)?,
    };
    let model = ClothedModel::new(parts, model.generator, device)?;
    Ok(DressedBody::new(&model, Outfit::LONG_LONG)?)
}

/// A person in an image.
struct Person {
    vertices: Vec<DVec3>,
    /// SMPL's joints, pixels, `[24]`.
    joints: Vec<DVec2>,
    mask: Mask,
}

struct Study {
    body: SmplModel,
    dressed: DressedBody,
    camera: PinholeCamera,
    smplify: Smplify,
    config: ClothedConfig,
}

impl Study {
    fn person(&self, rng: &mut ChaCha8Rng) -> Result<Person> {
        let motion = Motion::CAPTURED[rng.random_range(0..Motion::CAPTURED.len())];
        let pose = motion.pose(&MotionStyle::default(), rng.random_range(0.0..4.0)).to_vec();
        let betas = (0..2).map(|_| rng.sample(StandardNormal)).collect();
        let mut body = BodyParameters::new(pose, betas)?;
        body.transl = [rng.random_range(-0.2..0.2), 0.15, -DISTANCE];
        let code: Vec<f64> = (0..6).map(|_| rng.sample(StandardNormal)).collect();
        let surface = self.dressed.surface(&body, &code)?;
        let posed = self.body.pose(&body.betas, &body.pose, body.transl, None)?;
        let project =
            |j: ndarray::ArrayView1<'_, f64>| self.camera.project(DVec3::new(j[0], j[1], j[2]));
        let joints = posed.joints.rows().into_iter().map(project).collect();
        let mask = render(surface.vertices(), self.dressed.faces(), &self.camera)?.mask().clone();
        Ok(Person { vertices: surface.vertices().to_vec(), joints, mask })
    }

    /// Pixels of a length at the person's distance.
    fn pixels(&self, metres: f64) -> f64 {
        metres * self.camera.focal() / DISTANCE
    }

    fn add(&self, person: &Person, what: &str, rng: &mut ChaCha8Rng) -> Result<Mask> {
        let mut drawing = Drawing { covered: person.mask.covered().to_vec() };
        let j = &person.joints;
        let m = |metres: f64| self.pixels(metres);
        let all = what == "all";
        if all || what == "hair and shoes" {
            let up = (j[15] - j[12]).normalize_or_zero();
            drawing.capsule(j[15] + up * m(0.16), j[15] + up * m(0.05), m(0.15));
            for (ankle, foot) in [(7, 10), (8, 11)] {
                let along = (j[foot] - j[ankle]).normalize_or_zero();
                drawing.capsule(j[ankle], j[foot] + along * m(0.1), m(0.075));
            }
            for hand in [22, 23] {
                drawing.capsule(j[hand], j[hand], m(0.1));
            }
        }
        if all || what == "racket" {
            let along = (j[22] - j[18]).normalize_or_zero();
            drawing.capsule(j[22], j[22] + along * m(0.35), m(0.02));
            drawing.capsule(j[22] + along * m(0.45), j[22] + along * m(0.55), m(0.13));
        }
        if what == "skis" {
            for foot in [10, 11] {
                let along = DVec2::from_angle(rng.random_range(-0.3..0.3));
                drawing.capsule(j[foot] - along * m(0.7), j[foot] + along * m(0.9), m(0.04));
            }
            for hand in [22, 23] {
                drawing.capsule(j[hand], j[hand] + DVec2::new(m(0.2), m(0.9)), m(0.012));
            }
        }
        if all || what == "bag" {
            let side = if rng.random::<bool>() { 1 } else { 2 };
            let away = (j[side] - j[0]).normalize_or_zero();
            let at = j[side] + away * m(0.2);
            drawing.capsule(at - DVec2::Y * m(0.1), at + DVec2::Y * m(0.15), m(0.17));
        }
        if all || what == "ragged" {
            (0..4).for_each(|_| drawing.tear(0.35, rng));
        }
        Ok(Mask::new(SIDE, SIDE, drawing.covered)?)
    }

    /// Prints the result of one fit.
    fn fit(
        &self,
        (name, case, faulty): (usize, &str, bool),
        keypoints: &Keypoints,
        mask: &Mask,
        truth: &[DVec3],
    ) -> Result<()> {
        let Self { camera, dressed, smplify, config, .. } = self;
        let image = ImageObservation { camera, keypoints, mask: Some(mask), occluders: None };
        let start = format!("{name},{case},{}", u8::from(faulty));
        let fit = mask
            .check_keypoints(keypoints, None)
            .and_then(|()| smplify.fit(camera, keypoints, None))
            .and_then(|bare| Ok((smplify.fit_clothed(dressed, &image, &bare, config)?, bare)));
        let (fit, bare) = match fit {
            Ok(fit) => fit,
            Err(error) => {
                println!("{start},refused,,,,,{}", error.to_string().replace(',', ";"));
                return Ok(());
            }
        };
        let surface = dressed.surface(&fit.parameters, &fit.code)?;
        let rendered = render(surface.vertices(), dressed.faces(), camera)?.mask().clone();
        let both = rendered.area() - rendered.without(mask)?.area();
        let all: Vec<usize> = (0..truth.len()).collect();
        let error = aligned_error(surface.vertices(), truth, &all)?;
        println!(
            "{start},fitted,{:.1},{:.4},{:.4},{:.4},{:.1}",
            1000.0 * fit.joint_error * bare.pixel,
            fit.intersection_over_union.unwrap_or(f64::NAN),
            both as f64 / rendered.area() as f64,
            both as f64 / mask.area() as f64,
            1000.0 * error.distance
        );
        Ok(())
    }
}

/// Keypoints in a layout, with noise; points that are no joint of SMPL are at the head.
fn keypoints_of(
    joints: &[DVec2],
    layout: KeypointLayout,
    rng: &mut ChaCha8Rng,
) -> Result<Keypoints> {
    let noise = |rng: &mut ChaCha8Rng| 1.5 * rng.sample::<f64, _>(StandardNormal);
    let mut points = vec![joints[15]; layout.points()];
    layout.joints().iter().for_each(|&(point, joint)| points[point] = joints[joint]);
    let point = |at: DVec2, rng: &mut ChaCha8Rng| Keypoint {
        x: at.x + noise(rng),
        y: at.y + noise(rng),
        confidence: 0.9,
    };
    Ok(Keypoints::new(layout, points.into_iter().map(|at| point(at, rng)).collect())?)
}

/// Flags of an image to draw on.
struct Drawing {
    covered: Vec<bool>,
}

impl Drawing {
    /// Covers what is within `radius` of a segment.
    fn capsule(&mut self, a: DVec2, b: DVec2, radius: f64) {
        for (at, covered) in self.covered.iter_mut().enumerate() {
            let p =
                DVec2::new(f64::from(at as u32 % SIDE) + 0.5, f64::from(at as u32 / SIDE) + 0.5);
            let t = (p - a).dot(b - a) / (b - a).length_squared().max(1e-9);
            *covered |= p.distance(a + (b - a) * t.clamp(0.0, 1.0)) < radius;
        }
    }

    /// Flips a share of the pixels beside the outline.
    fn tear(&mut self, share: f64, rng: &mut ChaCha8Rng) {
        let side = SIDE as usize;
        let before = self.covered.clone();
        for y in 1..side - 1 {
            for x in 1..side - 1 {
                let at = y * side + x;
                let edge = [at - 1, at + 1, at - side, at + side]
                    .into_iter()
                    .any(|other| before[other] != before[at]);
                if edge && rng.random::<f64>() < share {
                    self.covered[at] = !before[at];
                }
            }
        }
    }
}

/// The joints with left and right exchanged.
fn swapped(joints: &[DVec2]) -> Vec<DVec2> {
    let mut joints = joints.to_vec();
    for (left, right) in [(1, 2), (4, 5), (7, 8), (10, 11), (16, 17), (18, 19), (20, 21), (22, 23)]
    {
        joints.swap(left, right);
    }
    joints
}

fn main() -> Result<()> {
    let people: usize = env::args().nth(1).map_or(Ok(2), |text| text.parse())?;
    let body = synthetic_body();
    let study = Study {
        dressed: dressed(&body)?,
        camera: PinholeCamera::new(SIDE, SIDE, None)?,
        smplify: Smplify::new(&body, PosePrior::synthetic()?, SmplifyConfig::default())?,
        config: ClothedConfig {
            levels: vec![SilhouetteLevel { side: 128, rounds: 2, steps: 10 }],
            ..ClothedConfig::default()
        },
        body,
    };
    println!("person,case,faulty,outcome,joint_mm,iou,inside,explained,error_mm");
    for name in 0..people {
        let mut rng = ChaCha8Rng::seed_from_u64(name as u64);
        let person = study.person(&mut rng)?;
        let other = study.person(&mut rng)?;
        let layout = KeypointLayout::Body25;
        let keypoints = keypoints_of(&person.joints, layout, &mut rng)?;
        for case in ADDITIONS {
            let mask = study.add(&person, case, &mut rng)?;
            study.fit((name, case, false), &keypoints, &mask, &person.vertices)?;
        }
        for case in FAULTS {
            // Real masks have hair and shoes.
            let own = study.add(&person, "hair and shoes", &mut rng)?;
            let (given, mask) = match case {
                "other layout" => {
                    let coco = keypoints_of(&person.joints, KeypointLayout::Coco17, &mut rng)?;
                    (Keypoints::new(KeypointLayout::H36m17, coco.points().to_vec())?, own)
                }
                "sides swapped" => (keypoints_of(&swapped(&person.joints), layout, &mut rng)?, own),
                "mirrored" => {
                    let flip = |at: &DVec2| DVec2::new(f64::from(SIDE) - at.x, at.y);
                    let joints: Vec<DVec2> = person.joints.iter().map(flip).collect();
                    (keypoints_of(&joints, layout, &mut rng)?, own)
                }
                "other person" => {
                    (keypoints.clone(), study.add(&other, "hair and shoes", &mut rng)?)
                }
                size => {
                    let scale = size.rsplit(' ').next().unwrap_or("1").parse()?;
                    (keypoints.scaled(scale), own)
                }
            };
            study.fit((name, case, true), &given, &mask, &person.vertices)?;
        }
    }
    Ok(())
}
