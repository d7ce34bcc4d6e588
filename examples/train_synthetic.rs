//! Trains a small model on synthetic captures, evaluates it and decodes a sample.
//!
//! ```sh
//! cargo run --release --example train_synthetic
//! ```

use std::ops::ControlFlow;

use cape::{
    burn::tensor::Device,
    core::{Outfit, silent, smpl::Gender},
    data::{PackOptions, SequenceList, SplitSpec, pack},
    eval::{EvalOptions, evaluate},
    infer::{BodySpec, Run, RunConfig, TrainConfig},
    model::CapeConfig,
    synth::{CaptureGenerator, Motion, SynthSpec, embedded_body},
    train::{TrainEvent, Trainer, TrainerOptions},
};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let directory = tempfile::tempdir()?;
    let [raw, packed, run] = ["raw", "packed", "run"].map(|name| directory.path().join(name));

    // Captures in the release's raw layout: one subject, two movements that train, one that tests.
    let body = embedded_body(Gender::Neutral)?;
    let spec = SynthSpec {
        subjects: 1,
        frames_per_sequence: 8,
        motions: vec![Motion::WalkMarch, Motion::Squats, Motion::Soccer],
        ..SynthSpec::default()
    };
    let names = |motions: Vec<Motion>| SequenceList {
        sequences: motions.iter().map(|motion| motion.name().to_owned()).collect(),
        exclude: Vec::new(),
    };
    let split = SplitSpec {
        subjects: spec.subject_names(),
        outfits: spec.outfits.clone(),
        train: names(spec.train_motions()),
        test: names(spec.test_motions()),
        ..SplitSpec::default()
    };
    CaptureGenerator::new(&body, spec)?.write(&raw, &mut silent)?;
    let report = pack(&raw, &packed, &split, PackOptions::default(), &mut silent)?;
    println!("{} training and {} test frames", report.train_frames, report.test_frames);

    let config = RunConfig {
        model: CapeConfig::tiny(),
        train: TrainConfig { epochs: 3, batch: 4, warmup_epochs: 1.0, ..TrainConfig::default() },
        ..RunConfig::default()
    };
    let device = Device::default();
    let mut trainer = Trainer::create(&run, TrainerOptions::new(&packed, config), &device)?;
    trainer.run(&mut |event| {
        if let TrainEvent::Validation { epoch, millimetres, .. } = event {
            println!("epoch {epoch}: {millimetres:.2} mm");
        }
        ControlFlow::Continue(())
    })?;

    let run = Run::open(&run, &device)?;
    let report = evaluate(&run, &packed, EvalOptions::default(), &mut silent)?;
    let [model, mean] = [report.model.overall.mean, report.mean_shape.overall.mean];
    println!("held out: {model:.2} mm; the mean shape has {mean:.2} mm");

    let body = BodySpec { betas: Vec::new(), pose: [0.0; 72], outfit: Outfit::LONG_LONG };
    let displacements = run.decode_displacements(&run.sample_codes(1, 7), &[body])?;
    println!("a sample of long sleeves and trousers: {:?}", displacements.shape());
    Ok(())
}
