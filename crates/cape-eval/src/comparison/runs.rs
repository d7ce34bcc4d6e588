//! What runs must have in common to be compared.

use std::{fs, path::PathBuf};

use cape_core::smpl::ClothingMask;

use crate::{Error, Result};
use cape_data::PackedSet;
use cape_infer::{RunConfig, RunPaths, checkpoint, read_identity};

/// The packed set that all runs say they were trained on.
///
/// # Errors
/// If a run does not say it, the set is not there any more, or not the same for all.
pub fn common_data(runs: &[PathBuf]) -> Result<PathBuf> {
    let mut common: Option<(&PathBuf, PathBuf, PathBuf)> = None;
    for root in runs {
        let paths = RunPaths::new(root);
        RunConfig::load(&paths.config())?;
        let run = root.display();
        if !paths.data().exists() {
            return Err(Error::argument(format!(
                "{run}: does not say what it was trained on: name the packed set"
            )));
        }
        let data = read_identity(&paths.data())?.path;
        let Ok(place) = fs::canonicalize(&data) else {
            return Err(Error::data(format!(
                "{run}: was trained on {}, which is not there: name the packed set",
                data.display()
            )));
        };
        match &common {
            None => common = Some((root, data, place)),
            Some((first, other, first_place)) if *first_place != place => {
                return Err(Error::data(format!(
                    "{run}: was trained on {}, but {} on {}: name the packed set to compare them on",
                    data.display(),
                    first.display(),
                    other.display()
                )));
            }
            Some(_) => {}
        }
    }
    common.map(|(_, data, _)| data).ok_or_else(|| Error::argument("there are no runs to compare"))
}

/// Checks that all runs are trained and reconstruct frames like those of `set` at the same clothing
/// vertices, so that none fails when others are measured already.
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
                    "{}: has {} clothing vertices, not the {} of {}: errors would be of different \
                     places",
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

/// Seconds a run was trained for until its newest checkpoint.
pub fn training_seconds(paths: &RunPaths) -> Result<f64> {
    match checkpoint::list(&paths.checkpoints())?.last() {
        Some((_, newest)) => Ok(checkpoint::load_progress(newest)?.seconds),
        None => Ok(0.0),
    }
}
