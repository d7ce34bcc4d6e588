//! Encodes a held-out registration, and gives its wearer another outfit and another pose.
//!
//! ```sh
//! cargo run --release --example redress -- demo/run
//! ```

use std::path::PathBuf;

use cape::{data::Split, infer::registration, prelude::*, synth::poses};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = PathBuf::from(std::env::args().nth(1).ok_or("expected a run's directory")?);
    let run = Run::open(&path, &Device::default())?;
    let set = run.open_set(run.data()?, Split::Test)?;
    let (displacement, seen) = registration(&set, 0)?;
    let code = run.encode(&displacement, std::slice::from_ref(&seen))?;

    let pose = poses::preset("squats").ok_or("no such pose")?;
    let squatting = BodySpec { pose, ..seen.clone() };
    let other = BodySpec { outfit: Outfit::SHORT_SHORT, ..seen.clone() };
    // The code's place among those of the other outfit.
    let moved = match run.prior()? {
        Some(prior) => prior.transport_codes(&code, seen.outfit, other.outfit)?,
        None => code.clone(),
    };
    let bodies = [("seen", seen, &code), ("squatting", squatting, &code), ("other", other, &moved)];
    for (name, wearer, code) in bodies {
        run.dress(code, &[wearer])?[0].save(format!("{name}.obj"))?;
    }
    Ok(())
}
