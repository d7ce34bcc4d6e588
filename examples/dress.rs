//! Dresses a body in clothes drawn from a trained model.
//!
//! ```sh
//! cape demo && cargo run --release --example dress -- demo/run
//! ```

use std::path::PathBuf;

use cape::{prelude::*, synth::poses};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = PathBuf::from(std::env::args().nth(1).ok_or("expected a run's directory")?);
    let run = Run::open(&path, &Device::default())?;
    let code = run.sample_codes(1, 7);
    let pose = poses::preset("walk").ok_or("no such pose")?;
    let wearer = BodySpec { betas: vec![1.0, -0.5], pose, outfit: Outfit::LONG_LONG };
    run.dress(&code, std::slice::from_ref(&wearer))?[0].save("dressed.obj")?;
    AnimatedBody::from_body("dressed", &code, &wearer).save(&run, "dressed.glb")?;
    Ok(())
}
