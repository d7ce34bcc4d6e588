use cape_core::BodyMotion;
use ndarray::{Array2, Axis, concatenate, s};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

use super::*;

fn random(rows: usize, columns: usize, seed: u64) -> Array2<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    Array2::from_shape_simple_fn((rows, columns), || rng.random_range(-1.0..1.0))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn the_gradient_agrees_with_finite_differences(seed: u64, hidden in 1usize..5, rows in 1usize..150) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let network = Network::random(&[3, hidden, 4, 2], &mut rng).unwrap();
        let at = network.parameters().mapv(|x| x + rng.random_range(-0.3..0.3));
        let (x, y) = (random(rows, 3, seed ^ 1), random(rows, 2, seed ^ 2));
        let (value, gradient) = network.error_and_gradient(&at, x.view(), y.view());
        let plain = Network::new(&[3, hidden, 4, 2], at.clone()).unwrap();
        let off = plain.forward(x.view()).unwrap() - &y;
        prop_assert!((value - off.mapv(|d| d * d).mean().unwrap()).abs() < 1e-12);
        for k in 0..at.len() {
            let probe = |by: f64| {
                let mut moved = at.clone();
                moved[k] += by;
                network.error_and_gradient(&moved, x.view(), y.view()).0
            };
            let numeric = (probe(1e-5) - probe(-1e-5)) / 2e-5;
            prop_assert!((numeric - gradient[k]).abs() < 1e-8, "{k}: {numeric} {}", gradient[k]);
        }
    }
}

fn smooth_data(rows: usize, seed: u64) -> (Array2<f64>, Array2<f64>) {
    let x = random(rows, 4, seed) * 3.0 + 10.0;
    let y = Array2::from_shape_fn((rows, 3), |(i, k)| {
        let u = x.row(i).mapv(|v| (v - 10.0) / 3.0);
        100.0 + 7.0 * (u[k] * 2.0).sin() + 3.0 * u[k] * u[3]
    });
    (x, y)
}

#[test]
fn a_smooth_function_is_learned_and_generalises() {
    let (x, y) = smooth_data(900, 5);
    let training = TrainingOptions { patience: Some(20), ..TrainingOptions::default() };
    let x = RegressionInputs::new(x);
    let outcome = training.train(&x, y.view(), &mut |_| {}).unwrap();
    assert_eq!(outcome.validation_frames.len(), 180);
    assert_eq!(outcome.training_frames.len(), 720);
    let (new_x, new_y) = smooth_data(200, 6);
    let off = outcome.regressor.predict(new_x.view()).unwrap() - &new_y;
    let rms = off.mapv(|d| d * d).mean().unwrap().sqrt();
    let spread = new_y.std_axis(Axis(0), 0.0).mean().unwrap();
    assert!(rms < 0.05 * spread, "{rms} of {spread} after {}", outcome.epochs.len());
    // The same result for any number of threads.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let again = pool.install(|| training.train(&x, y.view(), &mut |_| {}).unwrap());
    assert_eq!(again, outcome);
}

#[test]
fn inputs_far_from_all_seen_count_no_further() {
    let (x, y) = smooth_data(60, 3);
    let training = TrainingOptions { hidden: vec![4], ..TrainingOptions::default() };
    let inputs = RegressionInputs::new(x.clone());
    let outcome = training.train(&inputs, y.view(), &mut |_| {}).unwrap();
    let at = |value: f64| {
        let mut row = x.slice(s![..1, ..]).to_owned();
        row[(0, 0)] = value;
        outcome.regressor.predict(row.view()).unwrap()
    };
    assert_eq!(at(1e3), at(1e6));
    assert_ne!(at(1e3), at(-1e3));
}

#[test]
fn training_stops_when_validation_rises() {
    // Pure noise: only overfitting reduces the training error.
    let (x, y) = (random(60, 5, 1), random(60, 2, 2));
    let inputs = RegressionInputs { noisy: vec![true; 5], ..RegressionInputs::new(x) };
    let training =
        TrainingOptions { copies: 2, patience: Some(0), noise: 0.05, ..TrainingOptions::default() };
    let outcome = training.train(&inputs, y.view(), &mut |_| {}).unwrap();
    let errors: Vec<f64> = outcome.epochs.iter().map(|e| e.validation).collect();
    let (last, before) = errors.split_last().unwrap();
    assert!(before.windows(2).all(|pair| pair[1] <= pair[0]), "{errors:?}");
    assert!(before.last().is_none_or(|b| last > b), "{errors:?}");
    // All iterations, and the weights of the best.
    let patient = TrainingOptions { patience: None, ..training };
    let all = patient.train(&inputs, y.view(), &mut |_| {}).unwrap();
    assert!(all.epochs.len() > outcome.epochs.len());
    assert_eq!(all.epochs[..outcome.epochs.len()], outcome.epochs);
}

#[test]
fn a_difference_counts_the_same_in_every_target() {
    // The second target has a hundredth of the first one's spread, and is noise: it must not decide.
    let (x, y) = smooth_data(400, 8);
    let noise = random(400, 1, 77);
    let y = concatenate![Axis(1), y.slice(s![.., ..1]), noise * 0.05];
    let inputs = RegressionInputs::new(x);
    let training = TrainingOptions { hidden: vec![12], ..TrainingOptions::default() };
    let outcome = training.train(&inputs, y.view(), &mut |_| {}).unwrap();
    let off = outcome.regressor.predict(inputs.rows.view()).unwrap() - &y;
    let rms = off.column(0).mapv(|d| d * d).mean().unwrap().sqrt();
    assert!(rms < 0.2, "{rms} of {}", y.column(0).std(0.0));
}

#[test]
fn decay_makes_parameters_smaller() {
    let (x, y) = smooth_data(100, 4);
    let inputs = RegressionInputs::new(x);
    let length = |decay: f64| {
        let training = TrainingOptions { decay, ..TrainingOptions::default() };
        let outcome = training.train(&inputs, y.view(), &mut |_| {}).unwrap();
        let parameters = outcome.regressor.network().parameters().clone();
        parameters.dot(&parameters)
    };
    assert!(length(1.0) < 0.8 * length(0.0));
}

#[test]
fn whole_groups_are_validated_on() {
    let groups: Vec<usize> = (0..50).map(|frame| frame / 10).collect();
    let inputs = RegressionInputs {
        groups: Some(groups.clone()),
        ..RegressionInputs::new(random(50, 2, 1))
    };
    let outcome = TrainingOptions { hidden: vec![2], ..TrainingOptions::default() }
        .train(&inputs, random(50, 1, 2).view(), &mut |_| {})
        .unwrap();
    assert_eq!((outcome.training_frames.len(), outcome.validation_frames.len()), (40, 10));
    let group = groups[outcome.validation_frames[0]];
    assert!(outcome.validation_frames.iter().all(|&frame| groups[frame] == group));
}

#[test]
fn inputs_that_hardly_vary_keep_their_unit() {
    let mut x = random(40, 2, 1);
    x.column_mut(0).mapv_inplace(|value| 1e-6 * value);
    let y = random(40, 1, 2);
    let predict = |floors: Vec<f64>, by: f64| {
        let inputs = RegressionInputs { floors, ..RegressionInputs::new(x.clone()) };
        let training = TrainingOptions { hidden: vec![3], ..TrainingOptions::default() };
        let regressor = training.train(&inputs, y.view(), &mut |_| {}).unwrap().regressor;
        regressor.predict(ndarray::arr2(&[[by, 0.2]]).view()).unwrap()[(0, 0)]
    };
    let change =
        |floors: [f64; 2]| (predict(floors.to_vec(), 1e-5) - predict(floors.to_vec(), 0.0)).abs();
    assert!(change([0.05; 2]) < 1e-3 && change([0.0; 2]) > 1e-2);
}

#[test]
fn a_regressor_is_one_file() {
    let (x, y) = smooth_data(60, 9);
    let training = TrainingOptions { hidden: vec![5], ..TrainingOptions::default() };
    let inputs = RegressionInputs::new(x.clone());
    let regressor = training.train(&inputs, y.view(), &mut |_| {}).unwrap().regressor;
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("regressor.npz");
    regressor.save(&path).unwrap();
    let back = Regressor::load(&path).unwrap();
    assert_eq!(back, regressor);
    // Frame by frame equals all at once.
    let whole = back.predict(x.view()).unwrap();
    let one = back.predict(x.slice(s![7..8, ..])).unwrap();
    assert!((&one.row(0) - &whole.row(7)).iter().all(|d| d.abs() < 1e-12));
    assert!(back.predict(x.slice(s![.., ..3])).unwrap_err().to_string().contains("3 inputs"));
}

#[test]
fn bad_frames_are_refused() {
    let (x, mut y) = smooth_data(20, 3);
    let train = |x: &Array2<f64>, y: &Array2<f64>, training: TrainingOptions| {
        let inputs = RegressionInputs::new(x.clone());
        training.train(&inputs, y.view(), &mut |_| {}).unwrap_err().to_string()
    };
    let default = TrainingOptions::default;
    assert!(train(&random(3, 4, 1), &y, default()).contains("3 rows"));
    assert!(train(&x, &y, TrainingOptions { validation: 1.0, ..default() }).contains("share"));
    y[(3, 1)] = f64::NAN;
    assert!(train(&x, &y, default()).contains("not finite"));
}

#[test]
fn features_are_angles_and_their_rates() {
    let (frames, rate) = (40, 30.0);
    // The whole body turned to face +x, walking that way; joint 1 turns about x at 2 rad/s.
    let poses = Array2::from_shape_fn((frames, 6), |(frame, k)| match k {
        1 => std::f64::consts::FRAC_PI_2,
        3 => 2.0 * frame as f64 / rate,
        _ => 0.0,
    });
    let translations =
        Array2::from_shape_fn(
            (frames, 3),
            |(frame, k)| {
                if k == 0 { 1.5 * frame as f64 / rate } else { 0.9 }
            },
        );
    let motion = BodyMotion::new(rate, poses, translations).unwrap();
    let features = FeatureOptions { smoothing: 0.05, ..FeatureOptions::default() };
    let rows = features.rows(&motion);
    assert_eq!(rows.dim(), (frames, features.len(2)));
    for (frame, row) in rows.rows().into_iter().enumerate() {
        let expected = [
            0.0,
            0.0,
            1.5,
            0.0,
            -1.0,
            0.0,
            2.0 * frame as f64 / rate,
            0.0,
            0.0,
            0.0,
            0.0,
            0.0,
            2.0,
            0.0,
            0.0,
        ];
        for (found, expected) in row.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-9, "{frame}: {row}");
        }
    }
    assert!(BodyMotion::new(0.0, Array2::zeros((2, 3)), Array2::zeros((2, 3))).is_err());
    assert!(BodyMotion::new(30.0, Array2::zeros((2, 3)), Array2::zeros((3, 3))).is_err());
}

/// Frames of five motions, as of a body: many inputs of few causes, and targets of falling variance.
fn motions(inputs: usize, outputs: usize, seed: u64) -> (Array2<f64>, Array2<f64>) {
    const MOTIONS: usize = 5;
    const FRAMES: usize = 60;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut table = |columns: usize, density: f64| {
        Array2::from_shape_simple_fn((MOTIONS * 5, columns), || {
            let weight = rng.random_range(-1.0..1.0);
            if rng.random_range(0.0..1.0) < density { weight } else { 0.0 }
        })
    };
    let (to_inputs, to_outputs) = (table(inputs, 0.4), table(outputs, 1.0));
    let causes = Array2::from_shape_fn((MOTIONS * FRAMES, MOTIONS * 5), |(row, column)| {
        let (motion, phase) = (row / FRAMES, 0.21 * (row % FRAMES) as f64);
        if column / 5 != motion {
            return 0.0;
        }
        [1.0, phase.sin(), phase.cos(), (2.0 * phase).sin(), (2.0 * phase).cos()][column % 5]
    });
    let y = causes.dot(&to_outputs);
    let y = Array2::from_shape_fn(y.dim(), |(row, k)| y[(row, k)] / (1.0 + k as f64));
    (causes.dot(&to_inputs), y)
}

#[test]
fn many_inputs_do_not_slow_the_training_down() {
    // In units in which all layers are equally curved, 20 iterations leave 0.0033 of the variance, in the
    // parameters' own 0.0060.
    let (x, y) = motions(400, 40, 1);
    let mut training = TrainingOptions { seed: 4, ..TrainingOptions::default() };
    training.minimiser.steps = 20;
    let outcome = training.train(&RegressionInputs::new(x), y.view(), &mut |_| {}).unwrap();
    let last = outcome.epochs.last().unwrap();
    assert!(last.training < 0.0045 && last.validation < 0.01, "{last:?}");
}
