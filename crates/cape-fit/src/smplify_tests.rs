//! Recovery of known bodies from their keypoints.

use std::f64::consts::PI;

use cape_core::SmplModel;
use cape_synth::{Motion, MotionStyle};
use glam::{DQuat, DVec3};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

use crate::{
    BodyFit, BodyParameters, Keypoint, KeypointLayout, Keypoints, PinholeCamera, PosePrior,
    Smplify, SmplifyConfig, testing::BODY,
};

fn camera() -> PinholeCamera {
    PinholeCamera::new(512, 512, None).unwrap()
}

/// A body in a pose of `motion`, rotated by `orientation`, 3.5 m from the camera.
fn body(motion: Motion, orientation: DQuat) -> BodyParameters {
    let style = MotionStyle::default();
    let mut pose = motion.pose(&style, 0.6).to_vec();
    let own = DQuat::from_scaled_axis(DVec3::from_slice(&pose));
    pose[..3].copy_from_slice(&(orientation * own).to_scaled_axis().to_array());
    let mut body = BodyParameters::new(pose, vec![0.8, -0.6, 0.4]).unwrap();
    body.transl = [0.1, 0.2, -3.5];
    body
}

fn joints(model: &SmplModel, body: &BodyParameters) -> Vec<DVec3> {
    let posed = model.pose(&body.betas, &body.pose, body.transl, None).unwrap();
    posed.joints.rows().into_iter().map(|j| DVec3::new(j[0], j[1], j[2])).collect()
}

fn seen(
    model: &SmplModel,
    body: &BodyParameters,
    detector: KeypointLayout,
    noise: f64,
) -> Keypoints {
    let joints = joints(model, body);
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let mut points = vec![Keypoint { x: 0.0, y: 0.0, confidence: 0.0 }; detector.points()];
    for &(point, joint) in detector.joints() {
        let at = camera().project(joints[joint]);
        let mut off = || noise * rng.random_range(-1.7..1.7);
        points[point] = Keypoint { x: at.x + off(), y: at.y + off(), confidence: 0.9 };
    }
    Keypoints::new(detector, points).unwrap()
}

/// Mean distance of pelvis-relative joints from the ground truth, metres.
fn error(model: &SmplModel, truth: &BodyParameters, fit: &BodyFit) -> f64 {
    let [a, b] = [joints(model, truth), joints(model, &fit.parameters)];
    a.iter().zip(&b).map(|(p, q)| ((*p - a[0]) - (*q - b[0])).length()).sum::<f64>() / 24.0
}

fn smplify(model: &SmplModel) -> Smplify {
    Smplify::new(model, PosePrior::synthetic().unwrap(), SmplifyConfig::default()).unwrap()
}

#[test]
fn bodies_are_found_again_from_all_sides() {
    let model = &*BODY;
    let smplify = smplify(model);
    let turns = [
        DQuat::IDENTITY,
        DQuat::from_rotation_y(PI),
        DQuat::from_rotation_y(1.2),
        DQuat::from_rotation_z(3.0),
    ];
    let weights = SmplifyConfig::default().stages[3];
    for motion in [Motion::WalkMarch, Motion::MoveArms, Motion::PoseModel, Motion::Soccer] {
        for turn in turns {
            let truth = body(motion, turn);
            let keypoints = seen(model, &truth, KeypointLayout::Body25, 0.0);
            let fit = smplify.fit(&camera(), &keypoints, None).unwrap();
            assert!(fit.problem.is_none(), "{motion} {turn}: {:?}", fit.problem);
            let error = error(model, &truth, &fit);
            assert!(error < 0.09, "{motion} {turn}: {error}");
            // The minimum near the ground truth is not lower.
            let known = smplify.fit(&camera(), &keypoints, Some(&truth)).unwrap();
            let [found, known] = [&fit, &known].map(|fit| fit.terms.weighted(&weights));
            assert!(found < known + 0.5, "{motion} {turn}: {found} {known}");
        }
    }
}

#[test]
fn noise_and_missing_joints_are_borne() {
    let model = &*BODY;
    let smplify = smplify(model);
    let truth = body(Motion::WalkMarch, DQuat::from_rotation_y(0.4));
    let keypoints = seen(model, &truth, KeypointLayout::Coco17, 3.0);
    let mut points = keypoints.points().to_vec();
    points[9].confidence = 0.0;
    points[13].confidence = 0.0;
    // One outlier.
    points[15].x += 300.0;
    let keypoints = Keypoints::new(KeypointLayout::Coco17, points).unwrap();
    let fit = smplify.fit(&camera(), &keypoints, None).unwrap();
    let error = error(model, &truth, &fit);
    assert!(error < 0.12, "{error}");
}

#[test]
fn a_known_start_is_used() {
    let model = &*BODY;
    let smplify = smplify(model);
    let truth = body(Motion::PoseModel, DQuat::IDENTITY);
    let keypoints = seen(model, &truth, KeypointLayout::Body25, 0.0);
    let known = smplify.fit(&camera(), &keypoints, Some(&truth)).unwrap();
    let unknown = smplify.fit(&camera(), &keypoints, None).unwrap();
    let [known, unknown] = [&known, &unknown].map(|fit| error(model, &truth, fit));
    assert!(known < unknown + 0.01, "{known} {unknown}");
}

#[test]
fn impossible_observations_are_refused_or_said_to_have_failed() {
    let model = &*BODY;
    let smplify = smplify(model);
    let unseen = vec![Keypoint { x: 5.0, y: 5.0, confidence: 0.0 }; 25];
    let unseen = Keypoints::new(KeypointLayout::Body25, unseen).unwrap();
    let message = smplify.fit(&camera(), &unseen, None).unwrap_err().to_string();
    assert!(message.contains("0 joints"), "{message}");

    // Permuted joints.
    let truth = body(Motion::WalkMarch, DQuat::IDENTITY);
    let mut points = seen(model, &truth, KeypointLayout::Smpl24, 0.0).points().to_vec();
    let originals = points.clone();
    for (at, point) in points.iter_mut().enumerate() {
        *point = originals[(at * 7 + 3) % 24];
    }
    let keypoints = Keypoints::new(KeypointLayout::Smpl24, points).unwrap();
    let fit = smplify.fit(&camera(), &keypoints, None).unwrap();
    assert!(fit.problem.is_some(), "{}", fit.joint_error);

    let wrong = SmplifyConfig { stages: vec![], ..SmplifyConfig::default() };
    assert!(Smplify::new(model, PosePrior::synthetic().unwrap(), wrong).is_err());
}
