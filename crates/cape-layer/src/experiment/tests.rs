use cape_core::SmplModel;
use cape_synth::{Motion, MotionStyle, synthetic_body};
use ndarray::{Array2, Array3, Axis};

use super::*;
use crate::{
    AssociateOptions, Association, BodyIdentity, BodyMeasurements, Layer, LayerSet, PredictedFrame,
    sequence::Sequence,
};
use cape_cloth::{Garment, GarmentKind};
use cape_core::{
    BodyMotion,
    geometry::{SurfaceIndex, SurfaceMesh},
    smpl::StandardPose,
};
use glam::DVec3;

/// A skirt that follows the hips and swings with the knees, in 60 frames of a march, and its association.
pub(super) fn march(model: &SmplModel) -> (LayerSet, Association) {
    let set = marching_set(model);
    let body = set.sequences[0].body(model, 0, &StandardPose::default()).unwrap();
    let body = SurfaceMesh::new("body", body.posed, model.faces.clone()).unwrap();
    let clothing = set.clothing(0, 0).unwrap();
    let association = AssociateOptions::default().associate(&body, &clothing).unwrap();
    (set, association)
}

fn marching_set(model: &SmplModel) -> LayerSet {
    let (frames, rate) = (60, 30.0);
    let style = MotionStyle::default();
    let poses: Vec<f64> =
        (0..frames).flat_map(|f| Motion::WalkMarch.pose(&style, f as f64 / rate)).collect();
    let poses = Array2::from_shape_vec((frames, 72), poses).unwrap();
    let motion = BodyMotion::new(rate, poses, Array2::zeros((frames, 3))).unwrap();
    let shape = model.rest_shape(&[]).unwrap();
    let skirt = Garment::new(GarmentKind::Skirt).sew(model, &shape).unwrap().surface;
    let clothing = Array3::from_shape_fn((frames, skirt.vertices.len(), 3), |(f, v, axis)| {
        let p = skirt.vertices[v];
        let knees = motion.poses[(f, 12)] - motion.poses[(f, 15)];
        p[axis] + if axis == 2 { 0.1 * knees * (-0.1 - p.y).max(0.0) * p.x } else { 0.0 }
    });
    let sequence = Sequence {
        name: "march".into(),
        clothing,
        betas: vec![],
        motion,
        parameters: vec![("length".into(), 0.85)],
    };
    LayerSet::new(skirt.faces, vec![sequence]).unwrap()
}

#[test]
fn sizes_are_ratios_to_the_wearer() {
    let model = synthetic_body();
    let (mut set, association) = march(&model);
    let larger = Sequence { betas: vec![1.5], name: "larger".into(), ..set.sequences[0].clone() };
    set.sequences.push(larger);
    let standard = StandardPose::default();
    let unposed = UnposedSet::new(&model, &set, &association, &standard).unwrap();
    let learning = LearningOptions { wearer_ratios: true, ..LearningOptions::default() };
    let semantics = unposed.semantics(&[0, 1], &learning).unwrap();
    assert_eq!(semantics.names(), ["length_ratio", "beta_1"]);
    let features = FeatureOptions::default();
    let inputs = unposed.inputs(&features, &semantics).unwrap();
    // The cut length is the same, and its ratio to the larger wearer less or more, as this is taller or not.
    let measured = [&set.sequences[0], &set.sequences[1]]
        .map(|s| BodyMeasurements::new(&model, &s.shape(&model).unwrap()).unwrap().neck_to_knee);
    assert!((measured[1] / measured[0] - 1.0).abs() > 0.005, "{measured:?}");
    let row = |length: f64, beta: f64| semantics.reduced(&[length, beta]).unwrap();
    let tail = |frame: usize| inputs.rows.row(frame).to_vec().split_off(features.len(24));
    let near = |a: Vec<f64>, b: Vec<f64>| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9);
    assert!(near(tail(0), row(0.85, 0.0)), "{:?}", tail(0));
    assert!(near(tail(60), row(0.85 * measured[0] / measured[1], 1.5)), "{:?}", tail(60));
    // As they are cut, without the option.
    let cut = unposed.semantics(&[0, 1], &LearningOptions::default()).unwrap();
    assert_eq!(cut.names(), ["length", "beta_1"]);
    assert_eq!(cut.with(&[]).unwrap(), [0.85, 0.75]);
    // Clothing over the dressed surface: a skirt is about a third of it.
    let share = unposed.clothing_share().unwrap();
    assert!((0.15..0.6).contains(&share), "{share}");
}

/// Share of the clothing vertices inside the body.
fn vertices_inside(model: &SmplModel, predicted: &PredictedFrame) -> f64 {
    let body = SurfaceMesh { vertices: predicted.body.posed.clone(), faces: model.faces.clone() };
    let index = SurfaceIndex::new(&body);
    let is_inside = |row: &ndarray::ArrayView1<'_, f64>| {
        let x = DVec3::new(row[0], row[1], row[2]);
        index.closest(x, 0.15).is_some_and(|near| near.signed_distance < 0.0)
    };
    let rows = predicted.clothing.rows();
    rows.into_iter().filter(is_inside).count() as f64 / predicted.clothing.nrows() as f64
}

#[test]
fn a_skirt_survives_the_round_trip_and_is_learned() {
    let model = synthetic_body();
    let (set, association) = march(&model);
    let standard = StandardPose::default();
    let unposed = UnposedSet::new(&model, &set, &association, &standard).unwrap();
    let frames: Vec<usize> = (0..set.frames()).collect();
    let exact = unposed.errors(&frames, unposed.rows.view()).unwrap();
    assert!(exact.iter().all(|e| e.largest < 1e-6), "{exact:?}");
    let table = unposed.reconstruction(&[1, 5, 20]).unwrap();
    let means: Vec<f64> = table[0].iter().map(|e| e.mean).collect();
    println!("reconstruction with 1, 5, 20 and all components: {means:?} mm");
    assert!(means.windows(2).all(|pair| pair[1] <= pair[0]) && means[3] < 1e-3, "{means:?}");
    let learning = LearningOptions { components: Some(10), ..LearningOptions::default() };
    let regression = unposed.regression(&[0], &learning, &mut |_, _| {}).unwrap();
    println!("regression: {:?} {:?}", regression.train, regression);
    assert!(regression.train.mean < 5.0 && regression.predict.mean < 20.0);
    assert!(regression.space.mean <= regression.predict.mean);
    assert_eq!(regression.held.len(), 12);
    let twice = LearningOptions { trainings: 2, ..learning.clone() };
    let twice = unposed.regression(&[0], &twice, &mut |_, _| {}).unwrap();
    assert_eq!((twice.held.len(), twice.predict_each[0]), (12, regression.predict.mean));
    assert_ne!(twice.predict_each[1], twice.predict_each[0]);
    let baselines = regression.baselines;
    let others = [baselines.mean_mm, baselines.nearest_pose_mm];
    assert!(others.iter().all(|&other| regression.predict.mean < other), "{baselines:?}");
    assert!(baselines.interpolation_mm.is_some() && baselines.same_moment_mm.is_none());

    let mut two = set.clone();
    two.sequences.push(Sequence { name: "again".into(), ..set.sequences[0].clone() });
    let both = UnposedSet::new(&model, &two, &association, &standard).unwrap();
    let same = both.leave_out(&[1], &learning, &mut |_, _| {}).unwrap();
    assert!(same.predict.mean < regression.train.mean.max(regression.predict.mean));
    let moment = same.baselines.same_moment_mm;
    assert!(moment.is_none(), "`again` is another motion: {moment:?}");
    assert_eq!(same.baselines.interpolation_mm, None);
    assert!(both.leave_out(&[], &learning, &mut |_, _| {}).is_err());
    let many = LearningOptions { components: Some(60), ..learning };
    let error = unposed.regression(&[0], &many, &mut |_, _| {}).unwrap_err().to_string();
    assert!(error.contains("60 principal components of 38 frames"), "{error}");

    let layer = Layer {
        standard: StandardPose::Other(StandardPose::A.angles(24)),
        body: Some(BodyIdentity::new("synthetic body", &model)),
        ..unposed.layer(&regression.trained_model, FeatureOptions::default())
    };
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("layer.npz");
    layer.save(&path).unwrap();
    let back = Layer::load_for(&path, &model).unwrap();
    assert_eq!(back.body, layer.body);
    let mut other = model.clone();
    other.weights[(0, 0)] += 1e-3;
    let message = Layer::load_for(&path, &other).unwrap_err().to_string();
    assert!(message.contains("layer.npz is of another body, `synthetic body`"), "{message}");
    assert_eq!(
        (&back.regressor, &back.pca, &back.faces),
        (&layer.regressor, &layer.pca, &layer.faces)
    );
    assert_eq!((&back.semantics, &back.standard), (&layer.semantics, &layer.standard));
    let sequence = &set.sequences[0];
    let shape = sequence.shape(&model).unwrap();
    let mut errors = Vec::new();
    let mut stream = back
        .stream(&model, &shape, sequence.motion.frame_rate, &[0.85])
        .unwrap()
        .with_clearance(None);
    let mut measure = |predicted: PredictedFrame| {
        assert_eq!(predicted.inside, None);
        let truth = sequence.clothing.index_axis(Axis(0), predicted.frame);
        errors.push(LayerError::between(predicted.clothing.view(), truth));
    };
    for frame in 0..60 {
        let pose = sequence.motion.poses.row(frame).to_vec();
        stream.push(&pose, [0.0; 3]).unwrap().into_iter().for_each(&mut measure);
    }
    while let Some(predicted) = stream.finish().unwrap() {
        measure(predicted);
    }
    let pushed = back.stream(&model, &shape, sequence.motion.frame_rate, &[0.85]).unwrap();
    assert!(
        pushed.predict_frame(&sequence.motion, 60).unwrap_err().to_string().contains("60 frames")
    );
    let mut outside = 0;
    back.predict(&model, &shape, &sequence.motion, &[0.85], &mut |predicted| {
        let inside = predicted.inside.unwrap();
        // The thighs of this march are all the way through the skirt, between vertices that are outside.
        assert!(inside.after <= inside.before, "{inside:?}");
        let vertices = vertices_inside(&model, &predicted);
        assert!(vertices <= 0.002, "{vertices} of the vertices are inside");
        if outside % 17 == 3 {
            assert_eq!(pushed.predict_frame(&sequence.motion, predicted.frame).unwrap(), predicted);
        }
        outside += 1;
        Ok(())
    })
    .unwrap();
    assert_eq!(outside, 60);
    assert_eq!(errors.len(), 60);
    let known: Vec<usize> = (0..60).filter(|frame| !regression.held.contains(frame)).collect();
    let held = regression
        .trained_model
        .outcome
        .training_frames
        .iter()
        .map(|&f| errors[known[f]])
        .collect::<Vec<_>>();
    assert!((LayerError::over(&held).mean - regression.train.mean).abs() < 1e-9);
    let none = back.predict(&model, &shape, &sequence.motion, &[], &mut |_| Ok(()));
    assert!(none.unwrap_err().to_string().contains("expected 1: length"));
    assert!(Layer::load(&path, 10).is_err());
    assert!(Layer::is_at(&path) && !Layer::is_at(directory.path()));
    let body = directory.path().join("body.npz");
    model.save(&body).unwrap();
    assert!(!Layer::is_at(&body));
}
