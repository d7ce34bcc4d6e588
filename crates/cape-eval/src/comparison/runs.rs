//! Checks that runs can be compared.

use std::{fs, path::PathBuf};

use cape_core::smpl::ClothingMask;

use crate::{Error, Result};
use cape_data::PackedSet;
use cape_infer::{RunConfig, RunPaths, checkpoint, read_identity};

/// The packed set that all runs were trained on.
///
/// # Errors
/// If a run has no record of its packed set, the set does not exist, or the runs differ in it.
pub fn common_data(runs: &[PathBuf]) -> Result<PathBuf> {
    let mut common: Option<(&PathBuf, PathBuf, PathBuf)> = None;
    for root in runs {
        let paths = RunPaths::new(root);
        RunConfig::load(&paths.config())?;
        let run = root.display();
        if !paths.data().exists() {
            return Err(Error::argument(format!(
                "{run}: the run has no record of its packed set: give its directory"
            )));
        }
        let data = read_identity(&paths.data())?.path;
        let Ok(place) = fs::canonicalize(&data) else {
            return Err(Error::data(format!(
                "{run}: trained on {}, which does not exist: give the directory of the packed set",
                data.display()
            )));
        };
        match &common {
            None => common = Some((root, data, place)),
            Some((first, other, first_place)) if *first_place != place => {
                return Err(Error::data(format!(
                    "{run}: trained on {}, but {} on {}: give the packed set to compare them on",
                    data.display(),
                    first.display(),
                    other.display()
                )));
            }
            Some(_) => {}
        }
    }
    common
        .map(|(_, data, _)| data)
        .ok_or_else(|| Error::argument("no runs to compare: give at least one"))
}

/// Checks that all runs are trained, and that they match the frames of `set` and each other in the
/// clothing vertices, before any of them is measured.
pub fn check_comparable(runs: &[PathBuf], set: &PackedSet) -> Result<()> {
    let mut first: Option<(&PathBuf, ClothingMask)> = None;
    for root in runs {
        let paths = RunPaths::new(root);
        RunConfig::load(&paths.config())?;
        checkpoint::best(&paths.checkpoints())?;
        let mask = ClothingMask::load(paths.clothing(), set.vertices())?;
        match &first {
            None => first = Some((root, mask)),
            Some((other, expected)) if *expected != mask => {
                return Err(Error::data(format!(
                    "{}: the {} clothing vertices differ from the {} of {}: errors at different \
                     vertices cannot be compared",
                    root.display(),
                    mask.count(),
                    expected.count(),
                    other.display()
                )));
            }
            Some(_) => {}
        }
    }
    Ok(())
}

/// Training time of a run until its newest checkpoint, seconds.
pub fn training_seconds(paths: &RunPaths) -> Result<f64> {
    match checkpoint::list(&paths.checkpoints())?.last() {
        Some((_, newest)) => Ok(checkpoint::load_progress(newest)?.seconds),
        None => Ok(0.0),
    }
}
