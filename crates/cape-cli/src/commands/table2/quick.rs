//! Data and configuration of `--quick`.

use std::{path::PathBuf, thread, time::Duration};

use cape_core::{DirectoryLock, SmplModel};
use cape_data::{PackOptions, pack, raw::BODY_FILE};
use cape_eval::store::ResultStore;
use cape_infer::{OptimiserKind, RateSchedule, RunConfig, TrainConfig};
use cape_synth::CaptureGenerator;

use crate::{
    commands::demo,
    console::Console,
    error::{Error, Result},
};

/// Number of subjects and frames per sequence: about twice the demo's frames, for steadier test errors.
const SUBJECTS: usize = 12;
const FRAMES: usize = 3;
/// Time between two attempts to lock the directory.
const POLL: Duration = Duration::from_millis(500);

/// The demo's configuration with Adam, which converges faster than momentum in few steps.
pub(super) fn config() -> RunConfig {
    let mut config = demo::recipe(1);
    // Codes closer to the prior generalise better to new frames.
    config.loss.kl = 1e-4;
    config.train = TrainConfig {
        epochs: 3,
        optimiser: OptimiserKind::Adam,
        peak_rate: 1e-3,
        schedule: RateSchedule::Cosine,
        ..config.train
    };
    config
}

/// Waits until no other process makes the data.
fn locked(store: &ResultStore, console: Console) -> Result<DirectoryLock> {
    let mut told = false;
    loop {
        if let Some(lock) = store.try_lock()? {
            return Ok(lock);
        }
        if !told {
            console.note("waiting for the data that another process makes");
            told = true;
        }
        thread::sleep(POLL);
    }
}

/// Packed synthetic captures of `body` in `data` of the table's directory; those of an earlier call are
/// kept.
pub(super) fn data(
    store: &ResultStore,
    body: &SmplModel,
    overwrite: bool,
    console: Console,
) -> Result<PathBuf> {
    let [packed, raw] = ["data", "raw"].map(|name| store.path(name));
    let _lock = locked(store, console)?;
    if store.owns("data/") && packed.join("stats.txt").exists() {
        if SmplModel::load(packed.join(BODY_FILE)).is_ok_and(|own| own == *body) {
            return Ok(packed);
        }
        if !overwrite {
            return Err(Error::message(format!(
                "{}: captures of another body: choose another --out, or add --overwrite",
                packed.display()
            )));
        }
        store.discard("data/")?;
    }
    store.discard("raw/")?;
    for name in ["data/", ".data.cape-partial/", "raw/"] {
        store.list(name)?;
    }
    let (spec, split) = demo::captures(SUBJECTS, FRAMES, 1);
    let synth = CaptureGenerator::new(body, spec)?;
    console.while_showing("synth", "frames", |progress| synth.write(&raw, progress))?;
    let options = PackOptions { strict: true, ..PackOptions::default() };
    console.while_showing("pack", "frames", |progress| {
        pack(&raw, &packed, &split, options, progress)
    })?;
    store.discard("raw/")?;
    Ok(packed)
}
