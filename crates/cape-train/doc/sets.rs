// Data sets and runs of the examples in the documentation.

include!("../../cape-data/doc/sets.rs");

/// Configuration of one graph convolution without discriminator, for one epoch.
#[allow(dead_code)]
fn small_config() -> cape_infer::RunConfig {
    cape_infer::RunConfig {
        model: cape_model::CapeConfig {
            filters: vec![4],
            factors: vec![1],
            discriminator: None,
            ..cape_model::CapeConfig::tiny()
        },
        train: cape_infer::TrainConfig {
            epochs: 1,
            batch: 2,
            warmup_epochs: 1.0,
            ..cape_infer::TrainConfig::default()
        },
        ..cape_infer::RunConfig::default()
    }
}

/// The [`captures`] and a `run` trained on them for one epoch.
#[allow(dead_code)]
fn trained() -> Result<tempfile::TempDir, Box<dyn std::error::Error>> {
    let directory = captures()?;
    let [packed, run] = ["packed", "run"].map(|name| directory.path().join(name));
    let device = burn::tensor::Device::default();
    let options = cape_train::TrainerOptions::new(&packed, small_config());
    cape_train::Trainer::create(&run, options, &device)?
        .run(&mut |_| std::ops::ControlFlow::Continue(()))?;
    Ok(directory)
}
