//! Recovery of a moving clothed body of a model with random weights.

use cape_core::Outfit;
use cape_synth::{Motion, MotionStyle};
use glam::DVec3;

use super::*;
use crate::{
    Keypoints, Mask, PinholeCamera, PosePrior, SilhouetteLevel, SmplifyConfig,
    clothed_tests::{dressed, seen},
    testing::BODY,
};

const FRAMES: usize = 5;
const MISSING: usize = 2;
/// Frames per second.
const RATE: f64 = 15.0;

/// Keypoints with an error of some pixels that changes from frame to frame.
fn disturbed(keypoints: &Keypoints, frame: usize) -> Keypoints {
    let mut points = keypoints.points().to_vec();
    for (at, point) in points.iter_mut().enumerate().filter(|(_, p)| p.confidence > 0.0) {
        point.x += 1.5 * (12.9 * at as f64 + 78.2 * frame as f64).sin();
        point.y += 1.5 * (4.1 * at as f64 + 37.7 * frame as f64).sin();
    }
    Keypoints::new(keypoints.layout(), points).unwrap()
}

#[test]
fn videos_are_fitted_better_than_their_frames() {
    let bodies = [Outfit::SHORT_SHORT, Outfit::LONG_SHORT].map(dressed);
    let worn = &bodies[1];
    let camera = PinholeCamera::new(128, 128, None).unwrap();
    let (betas, code) = (vec![0.6, -1.0], vec![1.2, -0.8, 0.5, 1.5, -1.0, 0.3]);
    let truth: Vec<BodyParameters> = (0..FRAMES)
        .map(|frame| BodyParameters {
            transl: [0.05 + 0.02 * frame as f64, 0.25, -3.2],
            pose: Motion::MoveArms
                .pose(&MotionStyle::default(), 0.7 + frame as f64 / RATE)
                .to_vec(),
            betas: betas.clone(),
        })
        .collect();
    let observations: Vec<(Keypoints, Mask)> = truth
        .iter()
        .enumerate()
        .map(|(frame, body)| {
            let surface = worn.surface(body, &code).unwrap();
            let drawn = render(surface.vertices(), worn.faces(), &camera).unwrap();
            (disturbed(&seen(&camera, body), frame), drawn.mask().clone())
        })
        .collect();
    let images: Vec<Option<ImageObservation<'_>>> = observations
        .iter()
        .enumerate()
        .map(|(frame, (keypoints, mask))| {
            (frame != MISSING).then_some(ImageObservation {
                camera: &camera,
                keypoints,
                mask: Some(mask),
                occluders: None,
            })
        })
        .collect();
    let prior = PosePrior::synthetic().unwrap();
    let smplify = Smplify::new(&BODY, prior, SmplifyConfig::default()).unwrap();
    let clothed = ClothedConfig {
        levels: vec![SilhouetteLevel { side: 128, rounds: 3, steps: 8 }],
        ..ClothedConfig::default()
    };
    let temporal = TemporalConfig { frame_rate: RATE, ..TemporalConfig::default() };
    let config = SequenceConfig { clothed: &clothed, temporal };
    let fit = |workers: &FitWorkers| {
        smplify.fit_sequence(&bodies, &images, config, workers, &mut |_| {}).unwrap()
    };
    let found = fit(&FitWorkers::new().unwrap());
    // The same numbers on one thread.
    assert_eq!(found, fit(&FitWorkers::sequential()));
    assert_eq!((found.outfit, found.frames.len()), (Outfit::LONG_SHORT, FRAMES));
    let shapes = found.frames.iter().all(|frame| frame.body.betas == found.betas);
    assert!(shapes && found.code.iter().any(|z| *z != 0.0));
    let joints = |body: &BodyParameters| -> Vec<DVec3> {
        let transl = DVec3::from_array(body.transl);
        smplify.skeleton().pose(&body.betas, &body.pose, transl).unwrap().joints().to_vec()
    };
    // Relative to the pelvis, metres: the distance from the camera is not observable.
    let error = |body: &BodyParameters, truth: &BodyParameters| {
        let (a, b) = (joints(body), joints(truth));
        a.iter().zip(&b).map(|(p, q)| ((*p - a[0]) - (*q - b[0])).length()).sum::<f64>() / 24.0
    };
    let together: Vec<f64> =
        found.frames.iter().zip(&truth).map(|(frame, truth)| error(&frame.body, truth)).collect();
    let alone: Vec<f64> = observations
        .iter()
        .zip(&truth)
        .map(|((keypoints, _), truth)| {
            error(&smplify.fit(&camera, keypoints, None).unwrap().parameters, truth)
        })
        .collect();
    eprintln!("{together:?} {alone:?}");
    let mean = |errors: &[f64]| errors.iter().sum::<f64>() / errors.len() as f64;
    assert!(mean(&together) < 0.85 * mean(&alone), "{together:?} {alone:?}");
    for (at, frame) in found.frames.iter().enumerate() {
        assert_eq!(frame.observed, at != MISSING);
        assert!(frame.problem.is_none(), "{at}: {:?}", frame.problem);
        let overlap = frame.intersection_over_union;
        assert!(overlap.is_none_or(|overlap| overlap > 0.88), "{at}: {overlap:?}");
        assert_eq!(overlap.is_some(), frame.observed);
    }
    // The frame without observation is as good as the others.
    assert!(together[MISSING] < 1.5 * mean(&together), "{together:?}");
}

#[test]
fn videos_without_observations_or_outfits_are_refused() {
    let prior = PosePrior::synthetic().unwrap();
    let smplify = Smplify::new(&BODY, prior, SmplifyConfig::default()).unwrap();
    let clothed = ClothedConfig::default();
    let fit = |temporal: TemporalConfig| {
        let config = SequenceConfig { clothed: &clothed, temporal };
        let workers = FitWorkers::sequential();
        let found = smplify.fit_sequence(&[], &[None, None], config, &workers, &mut |_| {});
        found.unwrap_err().to_string()
    };
    assert!(fit(TemporalConfig::default()).contains("no frame has keypoints"));
    let still = TemporalConfig { frame_rate: 0.0, ..TemporalConfig::default() };
    assert!(fit(still).contains("frame_rate"));
}
