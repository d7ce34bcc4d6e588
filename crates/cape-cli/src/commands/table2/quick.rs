//! Data and recipe of `--quick`.

use std::{
    fs,
    path::{Path, PathBuf},
};

use cape_core::synth::{Synth, SynthSpec, synthetic_body};
use cape_model::{CapeConfig, LossConfig};
use cape_train::{
    RunConfig, TrainConfig,
    data::{PackOptions, Split, pack},
};

use crate::{
    commands::synth::split_of,
    console::Console,
    error::{Error, Result},
};

/// The demo's recipe: in so few steps the code must be worth using early, and many small steps get
/// further.
pub(super) fn config() -> RunConfig {
    RunConfig {
        model: CapeConfig::narrow(),
        loss: LossConfig { kl: 1e-5, gan: 0.02, ..LossConfig::default() },
        train: TrainConfig {
            epochs: 5,
            batch: 2,
            peak_rate: 0.03,
            warmup_epochs: 0.3,
            decay: 0.6,
            keep: 1,
            preload: true,
            ..TrainConfig::default()
        },
        ..RunConfig::default()
    }
}

/// Synthetic captures, packed, in `out/data`; those of an earlier call are kept.
pub(super) fn data(out: &Path, console: Console) -> Result<PathBuf> {
    let packed = out.join("data");
    if packed.join("stats.txt").exists() {
        return Ok(packed);
    }
    let raw = out.join("raw");
    if raw.exists() {
        fs::remove_dir_all(&raw).map_err(|error| Error::io(&raw, error))?;
    }
    let body = synthetic_body();
    let spec =
        SynthSpec { subjects: 8, frames_per_sequence: 2, frame_rate: 1.5, ..SynthSpec::default() };
    // Many takes of few frames, all of which are kept: clothes differ more between takes.
    let split = Split { cut: 0, ..split_of(&spec) };
    let synth = Synth::new(&body, spec)?;
    console.while_showing("synth", "frames", |progress| synth.write(&raw, progress))?;
    let options = PackOptions { strict: true, ..PackOptions::default() };
    console.while_showing("pack", "frames", |progress| {
        pack(&raw, &packed, &split, options, progress)
    })?;
    fs::remove_dir_all(&raw).map_err(|error| Error::io(&raw, error))?;
    Ok(packed)
}
