//! Recovery of clothed bodies of a model with random weights from keypoints and silhouette.

use cape_core::{ClothingMask, Outfit, devices};
use cape_data::DisplacementStatistics;
use cape_infer::{ClothedModel, ClothedModelParts, RunConfig, build_graphs};
use cape_model::{Cape, CapeConfig};
use cape_synth::{Motion, MotionStyle};
use glam::DVec3;
use ndarray::Array2;
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

use crate::{
    BodyParameters, ClothedConfig, DressedBody, FitWorkers, ImageObservation, Keypoint,
    KeypointLayout, Keypoints, Mask, PinholeCamera, PosePrior, SilhouetteLevel, Smplify,
    SmplifyConfig, aligned_error,
    silhouette::{SilhouetteTerms, render},
    testing::BODY,
};

pub(crate) fn dressed(outfit: Outfit) -> DressedBody {
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
    let graphs = build_graphs(&config, &*BODY, device).unwrap();
    let model = Cape::new(&config.model, &graphs, 3, device).unwrap();
    // Clothes lie outwards of the body.
    let rows = BODY.v_template.rows().into_iter().map(|v| {
        let out = DVec3::new(v[0], 0.0, v[2]).normalize_or_zero() * 0.015;
        out.to_array()
    });
    let mean = Array2::from(rows.collect::<Vec<_>>());
    let statistics =
        DisplacementStatistics::new(mean.clone(), Array2::from_elem(mean.dim(), 0.006), 0).unwrap();
    let parts = ClothedModelParts {
        config,
        body: BODY.clone(),
        mask: ClothingMask::from_weights(&BODY).unwrap(),
        statistics,
    };
    let model = ClothedModel::new(parts, model.generator, device).unwrap();
    DressedBody::new(&model, outfit).unwrap()
}

pub(crate) fn truth() -> (BodyParameters, Vec<f64>) {
    let pose = Motion::MoveArms.pose(&MotionStyle::default(), 0.7).to_vec();
    let mut body = BodyParameters::new(pose, vec![0.6, -1.0]).unwrap();
    body.transl = [0.05, 0.25, -3.2];
    (body, vec![1.2, -0.8, 0.5, 1.5, -1.0, 0.3])
}

#[test]
fn gradients_agree_with_finite_differences() {
    let dressed = dressed(Outfit::LONG_SHORT);
    let (mut body, code) = truth();
    // Near the origin, where single precision is finest.
    body.transl = [0.0; 3];
    let surface = dressed.surface(&body, &code).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let forces: Vec<DVec3> = surface
        .vertices()
        .iter()
        .map(|v| {
            let mut random = || rng.random_range(-1.0..1.0);
            DVec3::new(v.x, 0.3 * random(), v.z)
        })
        .collect();
    let found = surface.pull_back(&forces).unwrap();
    let value = |body: &BodyParameters, code: &[f64]| -> f64 {
        let surface = dressed.surface(body, code).unwrap();
        surface.vertices().iter().zip(&forces).map(|(v, f)| v.dot(*f)).sum()
    };
    let step = 4e-3;
    let check = |name: &str, found: &[f64], tolerance: f64, change: &dyn Fn(usize, f64) -> f64| {
        let expected: Vec<f64> = (0..found.len())
            .map(|at| (change(at, step) - change(at, -step)) / (2.0 * step))
            .collect();
        let scale = expected.iter().fold(0.0f64, |most, x| most.max(x.abs()));
        for (at, (found, expected)) in found.iter().zip(&expected).enumerate() {
            let off = (found - expected).abs();
            assert!(off < tolerance * scale, "{name} {at}: {found} {expected} of {scale}");
        }
    };
    // A random network has kinks everywhere.
    check("code", &found.code, 0.15, &|at, by| {
        let mut code = code.clone();
        code[at] += by;
        value(&body, &code)
    });
    check("pose", &found.pose, 0.03, &|at, by| {
        let mut body = body.clone();
        body.pose[at] += by;
        value(&body, &code)
    });
    check("betas", &found.betas, 0.03, &|at, by| {
        let mut body = body.clone();
        body.betas[at] += by;
        value(&body, &code)
    });
    check("transl", &found.transl, 0.03, &|at, by| {
        let mut body = body.clone();
        body.transl[at] += by;
        value(&body, &code)
    });
}

#[test]
fn silhouettes_bring_clothed_bodies_closer() {
    let dressed = dressed(Outfit::LONG_SHORT);
    let camera = PinholeCamera::new(256, 256, None).unwrap();
    let (body, code) = truth();
    let true_surface = dressed.surface(&body, &code).unwrap();
    let mask = render(true_surface.vertices(), dressed.faces(), &camera).unwrap().mask().clone();
    let keypoints = seen(&camera, &body);
    let prior = PosePrior::synthetic().unwrap();
    let smplify = Smplify::new(&BODY, prior, SmplifyConfig::default()).unwrap();
    let bare = smplify.fit(&camera, &keypoints, None).unwrap();
    let image = observed(&camera, &keypoints, &mask);
    let config = ClothedConfig {
        levels: vec![
            SilhouetteLevel { side: 128, rounds: 3, steps: 8 },
            SilhouetteLevel { side: 256, rounds: 2, steps: 8 },
        ],
        ..ClothedConfig::default()
    };
    let fit = smplify.fit_clothed(&dressed, &image, &bare, &config).unwrap();
    let all: Vec<usize> = (0..true_surface.vertices().len()).collect();
    let off = |vertices: &[DVec3]| {
        1000.0 * aligned_error(vertices, true_surface.vertices(), &all).unwrap().distance
    };
    let posed = BODY
        .pose(&bare.parameters.betas, &bare.parameters.pose, bare.parameters.transl, None)
        .unwrap();
    let rows = posed.vertices.rows().into_iter();
    let bare_vertices: Vec<DVec3> = rows.map(|v| DVec3::new(v[0], v[1], v[2])).collect();
    let clothed = dressed.surface(&fit.parameters, &fit.code).unwrap();
    let [before, after] = [off(&bare_vertices), off(clothed.vertices())];
    assert!(fit.problem.is_none(), "{:?}", fit.problem);
    assert!(fit.intersection_over_union > Some(0.92), "{:?}", fit.intersection_over_union);
    assert!(after < 0.5 * before, "{before} {after}");
    assert!(fit.curves.iter().all(|curve| curve.windows(2).all(|pair| pair[1] <= pair[0])));

    // The same result for the same input, better than in another outfit.
    let outfits = [Outfit::SHORT_SHORT, Outfit::LONG_SHORT].map(self::dressed);
    let fits = smplify
        .fit_outfits(&outfits, &image, &bare, &config, &FitWorkers::new().unwrap(), &mut |_, _| {})
        .unwrap();
    assert_eq!(fits[0], fit);
    assert!(fits[1].terms.weighted(&config) > fit.terms.weighted(&config));

    let empty = Mask::new(256, 256, vec![false; 256 * 256]).unwrap();
    let nobody = observed(&camera, &keypoints, &empty);
    let refused = smplify.fit_clothed(&dressed, &nobody, &bare, &config);
    assert!(refused.unwrap_err().to_string().contains("empty"));

    // Without a mask: the body of the keypoints in the clothing of the code 0.
    let unseen = ImageObservation { mask: None, ..image };
    let fit = smplify.fit_clothed(&dressed, &unseen, &bare, &config).unwrap();
    assert_eq!((fit.intersection_over_union, &fit.code), (None, &vec![0.0; 6]));
    assert_eq!(fit.terms.silhouette, SilhouetteTerms::default());
    assert!(fit.terms.weighted(&config) <= bare.terms.weighted(&config.body) + 1e-6);
    assert!(fit.problem.is_none(), "{:?}", fit.problem);
}

fn observed<'a>(
    camera: &'a PinholeCamera,
    keypoints: &'a Keypoints,
    mask: &'a Mask,
) -> ImageObservation<'a> {
    ImageObservation { camera, keypoints, mask: Some(mask), occluders: None }
}

/// A person cut off at the knees by the border, and one behind a table of the same height: the legs
/// that are not seen stay where they are not seen.
#[test]
fn people_who_are_cut_off_are_not_pulled_inside() {
    let dressed = dressed(Outfit::LONG_SHORT);
    let (mut body, code) = truth();
    let camera = PinholeCamera::new(256, 256, Some(400.0)).unwrap();
    let joints = |body: &BodyParameters| {
        let joints = BODY.pose(&body.betas, &body.pose, body.transl, None).unwrap().joints;
        let at = |joint: usize| {
            let row = joints.row(joint);
            camera.project(DVec3::new(row[0], row[1], row[2]))
        };
        [4, 5, 7, 8].map(at)
    };
    // Knees at the lower border.
    let knee = joints(&body)[0].y;
    body.transl[1] -= (256.0 - knee) * 3.2 / 400.0;
    let [left_knee, _, left_ankle, right_ankle] = joints(&body);
    assert!((left_knee.y - 256.0).abs() < 8.0, "{left_knee}");
    let overshoot = left_ankle.y.min(right_ankle.y) - 256.0;
    assert!(overshoot > 30.0, "{overshoot}");
    let surface = dressed.surface(&body, &code).unwrap();
    let mask = render(surface.vertices(), dressed.faces(), &camera).unwrap().mask().clone();
    let all = seen(&camera, &body);
    let inside = |point: &Keypoint| (0.0..256.0).contains(&point.y);
    let points = all.points().iter().map(|p| if inside(p) { *p } else { Keypoint::UNSEEN });
    let keypoints = Keypoints::new(all.layout(), points.collect()).unwrap();
    let prior = PosePrior::synthetic().unwrap();
    let smplify = Smplify::new(&BODY, prior, SmplifyConfig::default()).unwrap();
    let bare = smplify.fit(&camera, &keypoints, None).unwrap();
    let config = ClothedConfig {
        levels: vec![SilhouetteLevel { side: 128, rounds: 4, steps: 10 }],
        ..ClothedConfig::default()
    };
    let fit = smplify
        .fit_clothed(&dressed, &observed(&camera, &keypoints, &mask), &bare, &config)
        .unwrap();
    let found = joints(&fit.parameters);
    let below = found[2].y.min(found[3].y) - 256.0;
    assert!(below > 0.6 * overshoot, "{below} {overshoot}");
    assert!(fit.intersection_over_union > Some(0.85), "{:?}", fit.intersection_over_union);

    // The same image with a lower border, and a table in front of what is there.
    let tall = PinholeCamera::new(256, 384, Some(400.0)).unwrap();
    let taller = |covered: &dyn Fn(usize) -> bool| {
        Mask::new(256, 384, (0..256 * 384).map(covered).collect()).unwrap()
    };
    // The principal point is 64 pixels lower.
    let mask = taller(&|at| (64..320).contains(&(at / 256)) && mask.covered()[at - 64 * 256]);
    let table = taller(&|at| at / 256 >= 320);
    let points = keypoints.points().iter().map(|p| match p.confidence {
        0.0 => Keypoint::UNSEEN,
        _ => Keypoint { y: p.y + 64.0, ..*p },
    });
    let keypoints = Keypoints::new(all.layout(), points.collect()).unwrap();
    let hidden = ImageObservation { occluders: Some(&table), ..observed(&tall, &keypoints, &mask) };
    let behind = smplify.fit_clothed(&dressed, &hidden, &bare, &config).unwrap();
    let found = joints(&behind.parameters);
    let below = found[2].y.min(found[3].y) - 256.0;
    assert!(below > 0.6 * overshoot, "{below} {overshoot}");
}

pub(crate) fn seen(camera: &PinholeCamera, body: &BodyParameters) -> Keypoints {
    let joints = BODY.pose(&body.betas, &body.pose, body.transl, None).unwrap().joints;
    let detector = KeypointLayout::Body25;
    let mut points = vec![Keypoint { x: 0.0, y: 0.0, confidence: 0.0 }; detector.points()];
    for &(point, joint) in detector.joints() {
        let row = joints.row(joint);
        let at = camera.project(DVec3::new(row[0], row[1], row[2]));
        points[point] = Keypoint { x: at.x, y: at.y, confidence: 1.0 };
    }
    Keypoints::new(detector, points).unwrap()
}
