//! Directory of a new run.

use std::{
    fs,
    path::{Path, PathBuf},
};

use cape_core::{DirectoryLock, is_temporary};
use cape_data::{DisplacementStatistics, PackedSet, Split};
use cape_infer::{DataIdentity, RunConfig, RunPaths, body_and_clothing, write_json};

use crate::{Error, Result, TrainerOptions};

/// Creates the directory of a run with its configuration, displacement statistics, body and
/// clothing vertices: everything that sampling from the run needs.
///
/// Returns its paths, its configuration with the outfits of the set, and the lock on the directory.
pub(crate) fn create(
    root: &Path,
    options: &TrainerOptions,
) -> Result<(RunPaths, RunConfig, DirectoryLock)> {
    let TrainerOptions { data, body, clothing, config } = options;
    config.validate()?;
    let paths = RunPaths::new(root);
    require_free(&paths)?;
    let set = PackedSet::open(data, Split::Train)?;
    let config = config.clone().with_outfits_of(&set);
    let set = set.with_vocabulary(&config.model.outfits)?;
    let statistics = DisplacementStatistics::from_packed(data, &mut cape_core::silent)?;
    let (model, mask) = body_and_clothing(data, &set, body.as_ref(), clothing.as_deref())?;

    fs::create_dir_all(root).map_err(|source| Error::io(root, source))?;
    let lock = DirectoryLock::acquire(root)?;
    // Another process may have created a run since.
    require_free(&paths)?;
    statistics.save(paths.statistics())?;
    model.save(paths.body())?;
    mask.save(paths.clothing())?;
    let identity =
        DataIdentity { path: data.clone(), frames: set.frames(), vertices: set.vertices() };
    write_json(&paths.data(), &identity)?;
    // Last: a directory with it is a run.
    config.save(&paths.config())?;
    Ok((paths, config, lock))
}

/// Returns an error unless the directory is missing, empty, or holds nothing but what is written before
/// the configuration, by a process that was killed then.
fn require_free(paths: &RunPaths) -> Result<()> {
    let before = [paths.statistics(), paths.body(), paths.clothing(), paths.data()];
    let locked = DirectoryLock::was_in(paths.root());
    let begun = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        is_temporary(&name) || locked && before.contains(path)
    };
    let mut entries = fs::read_dir(paths.root()).into_iter().flatten().flatten();
    if entries.all(|entry| begun(&entry.path())) {
        return Ok(());
    }
    Err(Error::argument(format!(
        "{}: the directory is not empty: choose another one, or resume the run in it",
        paths.root().display()
    )))
}
