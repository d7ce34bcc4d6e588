//! Fits a density to the codes of the training set, draws one, and moves it through a walk.
//!
//! ```sh
//! cargo run --release --example animate -- demo/run
//! ```

use std::path::PathBuf;

use cape::{
    core::{KeyframeRule, motion::MotionOptions, silent},
    infer::prior::{DensityKind, LatentCodes, Prior},
    prelude::*,
    stats::density::MixtureOptions,
    synth::poses,
};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = PathBuf::from(std::env::args().nth(1).ok_or("expected a run's directory")?);
    let run = Run::open(&path, &Device::default())?;
    let seen = LatentCodes::from_training(&run, &run.data()?, 256, &mut silent)?;
    let prior = Prior::fit(&seen, DensityKind::Mixture(1), true, &MixtureOptions::default())?;
    let outfit = Outfit::SHORT_LONG;
    let performance = AnimatedBody {
        name: "walk",
        code: prior.sample(outfit, 1, 1.0, 3),
        betas: &[0.5],
        outfit,
        motion: poses::load_motion("walk", 2.0, 30.0, &MotionOptions::default())?.motion_of(
            run.body(),
            &[],
            None,
        )?,
        keyframes: KeyframeRule::default(),
        displacements: None,
        shape_targets: 0,
        colours: None,
        texture: None,
    };
    let written = performance.save(&run, "walk.glb")?;
    println!("{} keyframes, error {:.2} mm", written.keyframes, 1000.0 * written.error);
    Ok(())
}
