//! Packs a raw data set if necessary, trains CAPE on it and evaluates it on the test frames.
//!
//! ```sh
//! cargo run --release --example train_cape -- data/cape_release male data/smpl/SMPL_MALE.pkl runs/male
//! cargo run --release --example train_cape -- data/packed/male male data/smpl/SMPL_MALE.pkl runs/male
//! ```
//!
//! The arguments are the raw or packed set, the split (`male`, `female` or a `split.toml`), the body
//! (`-` for the set's own), the directory of the run, and optionally a configuration. Run the same
//! command again to resume.

use std::{
    env,
    error::Error,
    ops::ControlFlow,
    path::{Path, PathBuf},
};

use cape::{
    burn::tensor::Device,
    core::{SmplModel, silent},
    data::{PackOptions, SplitSpec, pack},
    eval::{EvalOptions, evaluate},
    infer::{Run, RunConfig, RunPaths, checkpoint},
    train::{TrainEvent, Trainer, TrainerOptions},
};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let (data, split, body, out, config) = match &arguments[..] {
        [data, split, body, out] => (data, split, body, out, None),
        [data, split, body, out, config] => (data, split, body, out, Some(config)),
        _ => return Err("usage: train_cape DATA male|female|SPLIT.toml BODY|- OUT [CONFIG]".into()),
    };
    let packed = packed_set(Path::new(data), split)?;

    let device = Device::default();
    let config = match config {
        Some(path) => RunConfig::load(Path::new(path))?,
        None => RunConfig::default(),
    };
    let options = TrainerOptions {
        body: if body == "-" { None } else { Some(SmplModel::load(body)?) },
        ..TrainerOptions::new(&packed, config)
    };
    let begun = !checkpoint::list(&RunPaths::new(Path::new(out)).checkpoints())?.is_empty();
    let mut trainer = if begun {
        Trainer::resume(out, Some(&packed), &device)?
    } else {
        Trainer::create(out, options, &device)?
    };
    let (steps, epochs) = (trainer.steps_per_epoch(), trainer.config().train.epochs);
    println!("{epochs} epochs of {steps} updates");
    trainer.run(&mut |event| {
        match event {
            TrainEvent::Step { epoch, step, losses, seconds, .. } if step % 100 == 0 => {
                println!(
                    "epoch {epoch}, step {step}: {:.4}, {seconds:.2} s",
                    losses.reconstruction
                );
            }
            TrainEvent::Validation { epoch, millimetres, .. } => {
                println!("epoch {epoch}: {millimetres:.2} mm on the validation frames");
            }
            _ => {}
        }
        ControlFlow::Continue(())
    })?;

    let run = Run::open(out, &device)?;
    let report = evaluate(&run, &packed, EvalOptions::default(), &mut silent)?;
    let [model, mean] = [&report.model.overall, &report.mean_shape.overall];
    println!(
        "{} test frames, {} clothing vertices: {:.2} ± {:.2} mm, median {:.2}; mean shape {:.2} mm",
        report.frames, report.clothing_vertices, model.mean, model.std, model.median, mean.mean
    );
    Ok(())
}

/// The packed set itself, or one packed from a raw tree beside it.
fn packed_set(data: &Path, split: &str) -> Result<PathBuf, Box<dyn Error>> {
    if data.join("train/train_disp.npy").exists() {
        return Ok(data.to_owned());
    }
    let split = if Path::new(split).extension().is_some_and(|extension| extension == "toml") {
        SplitSpec::from_file(split)?
    } else {
        SplitSpec::preset(split)?
    };
    let packed = data.with_file_name(format!(
        "{}-packed",
        data.file_name().ok_or("the data set has no name")?.to_string_lossy()
    ));
    if !packed.exists() {
        let report = pack(data, &packed, &split, PackOptions::default(), &mut silent)?;
        println!("{} training and {} test frames", report.train_frames, report.test_frames);
        for frame in &report.broken {
            println!("left out {}: {}", frame.path.display(), frame.reason);
        }
    }
    Ok(packed)
}
