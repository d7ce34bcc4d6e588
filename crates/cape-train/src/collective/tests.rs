use std::{ops::ControlFlow, path::Path};

use burn::tensor::{Device, Tensor};
use cape_core::Mesh;
use cape_infer::{DeviceBatch, OptimiserKind, RunConfig, TrainConfig, build_graphs, checkpoint};
use cape_model::{Cape, CapeConfig, LossConfig, losses::LossWeights, weights::Weights};

use super::{threads::in_threads, *};
use crate::{
    Trainer, TrainerOptions,
    objective::{Evaluation, StepInput, evaluate},
    optim::collect_gradients,
};

// Data sets of the examples.
include!(concat!(env!("CARGO_MANIFEST_DIR"), "/../cape-data/doc/sets.rs"));

fn device() -> Device {
    cape_core::parse_device(cape_core::DEVICES[0]).unwrap()
}

/// Batches of three frames, which four processes cannot share evenly, in ten steps.
fn config() -> RunConfig {
    let model = CapeConfig { filters: vec![4, 6], factors: vec![2, 2], ..CapeConfig::tiny() };
    let train = TrainConfig {
        epochs: 10,
        batch: 3,
        warmup_epochs: 1.0,
        optimiser: OptimiserKind::Sgd,
        ema: 0.9,
        keep: 20,
        ..TrainConfig::default()
    };
    RunConfig { model, train, ..RunConfig::default() }
}

/// Largest difference of two sets of arrays, relative to the largest value of each array.
fn difference(found: &Weights, expected: &Weights) -> f64 {
    assert!(found.keys().eq(expected.keys()));
    let of_array = |(name, array): (&String, &cape_model::weights::HostArray)| {
        let largest = array.values.iter().fold(1e-6f32, |most, x| most.max(x.abs()));
        let pairs = found[name].values.iter().zip(&array.values);
        pairs.map(|(a, b)| f64::from((a - b).abs() / largest)).fold(0.0, f64::max)
    };
    expected.iter().map(of_array).fold(0.0, f64::max)
}

fn newest(run: &Path) -> checkpoint::Checkpoint {
    let (_, path) = checkpoint::list(&run.join("checkpoints")).unwrap().pop().unwrap();
    checkpoint::Checkpoint::load(&path).unwrap()
}

fn train(run: &Path, packed: &Path, threads: usize) -> Vec<Weights> {
    let finish = |processes: Arc<dyn Collective>| {
        let options = TrainerOptions::new(packed, config());
        let mut trainer = Trainer::create_together(run, options, &device(), processes).unwrap();
        let outcome = trainer.run(&mut |_| ControlFlow::Continue(())).unwrap();
        assert!(outcome.finished && outcome.best_validation.is_some());
        assert_eq!(outcome.steps, 10);
        cape_model::weights::collect(trainer.model())
    };
    if threads == 1 { vec![finish(Arc::new(SingleProcess))] } else { in_threads(threads, finish) }
}

#[test]
fn several_processes_train_as_one_with_their_whole_batch() {
    let directory = captures().unwrap();
    let [packed, one] = ["packed", "one"].map(|name| directory.path().join(name));
    let expected = train(&one, &packed, 1).remove(0);
    let initial = checkpoint::list(&one.join("checkpoints")).unwrap().remove(0);
    let initial = checkpoint::Checkpoint::load(&initial.1).unwrap();
    assert!(difference(&initial.model, &expected) > 1e-3, "training changes the weights");
    for threads in [2, 4] {
        let [first, second] = ["a", "b"].map(|name| {
            let run = directory.path().join(format!("{name}{threads}"));
            let weights = train(&run, &packed, threads);
            // All processes have the same bits.
            assert!(weights.iter().all(|own| *own == weights[0]));
            let saved = newest(&run);
            assert_eq!(saved.model, weights[0]);
            assert_eq!(saved.progress.step, 10);
            saved
        });
        assert_eq!(first.model, second.model, "results depend on timing");
        assert_eq!(first.average, second.average);
        let off = difference(&first.model, &expected);
        println!("{threads} processes: {off:.1e} of the largest weight");
        assert!(off < 2e-5, "{threads} processes: {off:e}");
        let momentum = difference(&first.generator_momentum, &newest(&one).generator_momentum);
        assert!(momentum < 1e-3, "{threads} processes: {momentum:e}");
    }
}

#[test]
fn a_stop_of_one_process_is_heard_by_all_and_any_number_resumes() {
    let directory = captures().unwrap();
    let [packed, one, cut] = ["packed", "one", "cut"].map(|name| directory.path().join(name));
    let expected = train(&one, &packed, 1).remove(0);
    let steps = in_threads(2, |processes| {
        let options = TrainerOptions::new(&packed, config());
        let (rank, device) = (processes.rank(), device());
        let mut trainer = Trainer::create_together(&cut, options, &device, processes).unwrap();
        let outcome = trainer
            .run(&mut |event| match event {
                crate::TrainEvent::Step { total_step: 4, .. } if rank == 1 => {
                    ControlFlow::Break(())
                }
                _ => ControlFlow::Continue(()),
            })
            .unwrap();
        assert!(!outcome.finished);
        outcome.steps
    });
    assert_eq!(steps, [5, 5]);
    let weights = in_threads(3, |processes| {
        let mut trainer = Trainer::resume_together(&cut, None, &device(), processes).unwrap();
        assert_eq!(trainer.step(), 5);
        assert!(trainer.run(&mut |_| ControlFlow::Continue(())).unwrap().finished);
        cape_model::weights::collect(trainer.model())
    });
    assert!(weights.iter().all(|own| *own == weights[0]));
    let off = difference(&weights[0], &expected);
    assert!(off < 2e-5, "{off:e}");
}

/// A tetrahedron's model, created with `seed`, and three frames.
fn tetrahedron(seed: u64) -> (Cape, cape_model::Graphs, DeviceBatch) {
    let tetrahedron = Mesh {
        vertices: vec![[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.]],
        faces: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
    };
    let model = CapeConfig {
        filters: vec![4],
        factors: vec![1],
        discriminator: None,
        ..CapeConfig::tiny()
    };
    let config = RunConfig { model, ..RunConfig::default() };
    let device = device().autodiff();
    let graphs = build_graphs(&config, &tetrahedron, &device).unwrap();
    let model = Cape::new(&config.model, &graphs, seed, &device).unwrap();
    let ramp = Tensor::<1, burn::tensor::Int>::arange(0..36, &device).float().reshape([3, 4, 3]);
    let frames = DeviceBatch {
        displacement: ramp / 10.0,
        pose_feature: Tensor::ones([3, 126], &device),
        outfit: Tensor::zeros([3, 4], &device),
    };
    (model, graphs, frames)
}

fn evaluation(frames: std::ops::Range<usize>) -> (Cape, Evaluation) {
    let (model, graphs, all) = tetrahedron(1);
    let DeviceBatch { displacement, pose_feature, outfit } = all;
    let frames = DeviceBatch {
        displacement: displacement.slice([frames.clone()]),
        pose_feature: pose_feature.slice([frames.clone()]),
        outfit: outfit.slice([frames]),
    };
    let input = StepInput { frames, encoded: None, epsilon: None, real: None };
    let found = evaluate(&model, &graphs, &LossConfig::default(), &LossWeights::default(), &input);
    (model, found)
}

#[test]
fn gradients_of_parts_sum_to_those_of_the_batch() {
    let (model, whole) = evaluation(0..3);
    let expected = collect_gradients(&model.generator, &whole.generator);
    // The last thread has no frame of its own, and is the only one that asks to stop.
    let found = in_threads(3, |processes| {
        let (rows, share) =
            [(0..1, 1.0 / 3.0), (1..3, 2.0 / 3.0), (0..1, 0.0)][processes.rank()].clone();
        let (model, mut part) = evaluation(rows);
        let stop = processes.rank() == 2;
        let agreed = sum_step(&*processes, &model, &mut part, share, stop).unwrap();
        assert_eq!(agreed, StepAgreement { stop: true, non_finite: Vec::new() });
        (collect_gradients(&model.generator, &part.generator), part.losses)
    });
    for (gradients, losses) in found {
        // Relative to the largest of all: some are sums of large terms that cancel.
        let values = |of: &Weights| of.values().flat_map(|a| a.values.clone()).collect::<Vec<_>>();
        let largest = values(&expected).into_iter().fold(0.0f32, |most, x| most.max(x.abs()));
        assert!(gradients.keys().eq(expected.keys()) && largest > 0.1);
        for (found, expected) in values(&gradients).into_iter().zip(values(&expected)) {
            assert!((found - expected).abs() < 1e-6 * largest, "{found} {expected}");
        }
        let pairs = losses.named_values().into_iter().zip(whole.losses.named_values());
        for ((name, found), (_, expected)) in pairs {
            assert!((found - expected).abs() <= 1e-5 * expected.abs(), "{name}");
        }
    }
}

#[test]
fn a_loss_that_is_not_finite_is_known_to_all_with_its_process() {
    for share in [0.5, 0.0] {
        let agreed = in_threads(2, |processes| {
            let (model, mut part) = evaluation(0..1);
            let rank = processes.rank();
            if rank == 1 {
                part.losses.edge = f64::NAN;
            }
            let share = if rank == 1 { share } else { 0.5 };
            let agreed = sum_step(&*processes, &model, &mut part, share, false).unwrap();
            (agreed.non_finite, part.losses.non_finite())
        });
        // What does not count does no harm.
        let expected = if share > 0.0 { (vec![1], Some("edge")) } else { (vec![], None) };
        assert_eq!(agreed, [expected.clone(), expected]);
    }
}

#[test]
fn other_weights_in_one_process_are_an_error_of_all() {
    let check = |seeds: [u64; 3]| {
        in_threads(3, |processes| {
            let (model, ..) = tetrahedron(seeds[processes.rank()]);
            require_same_weights(&*processes, &model, 7).map_err(|error| error.to_string())
        })
    };
    assert_eq!(check([4, 4, 4]), [Ok(()), Ok(()), Ok(())]);
    let errors: Vec<String> = check([4, 5, 4]).into_iter().map(Result::unwrap_err).collect();
    assert!(errors[0].contains("weights of process 1 differ"), "{}", errors[0]);
    assert!(errors[0].contains("at step 7"), "{}", errors[0]);
    assert_eq!(errors[1..], ["process 0 failed and ended the training"; 2]);
}

#[test]
fn an_error_of_one_process_ends_all() {
    let argument = || Err::<(), _>(Error::argument("disk full"));
    let said = |result: Result<()>| result.unwrap_err().to_string();
    let found = in_threads(3, |processes| {
        let own = if processes.rank() == 2 { argument() } else { Ok(()) };
        (said(in_first(&*processes, argument).map(drop)), said(agree(&*processes, own)))
    });
    let texts = |rank: usize| [found[rank].0.as_str(), found[rank].1.as_str()];
    let [zero, two] =
        ["process 0", "process 2"].map(|name| format!("{name} failed and ended the training"));
    assert_eq!(texts(0), ["disk full", &two]);
    assert_eq!(texts(1), [&zero, &two]);
    assert_eq!(texts(2), [&zero, "disk full"]);
    // An error in creating a run.
    let created = in_threads(2, |processes| {
        let options = TrainerOptions::new("nowhere", config());
        said(Trainer::create_together("no run", options, &device(), processes).map(drop))
    });
    assert!(created[0].contains("nowhere") && created[1] == zero, "{created:?}");
}
