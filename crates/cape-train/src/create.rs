//! Directory of a new run.

use std::{fs, path::Path};

use cape_data::{DisplacementStatistics, PackedSet, Split};
use cape_infer::{DataIdentity, RunConfig, RunPaths, body_and_clothing, write_json};

use crate::{Error, Result, TrainerOptions};

/// Creates the directory of a run with its configuration, displacement statistics, body and
/// clothing vertices: everything that sampling from the run needs.
///
/// Returns its paths and configuration, with the outfits of the set.
pub(crate) fn create(root: &Path, options: &TrainerOptions) -> Result<(RunPaths, RunConfig)> {
    let TrainerOptions { data, body, clothing, config } = options;
    config.validate()?;
    if fs::read_dir(root).is_ok_and(|mut entries| entries.next().is_some()) {
        return Err(Error::argument(format!(
            "{}: the directory is not empty: choose another one, or resume the run in it",
            root.display()
        )));
    }
    let set = PackedSet::open(data, Split::Train)?;
    let config = config.clone().with_outfits_of(&set);
    let set = set.with_vocabulary(&config.model.outfits)?;
    let statistics = DisplacementStatistics::from_packed(data, &mut cape_core::silent)?;
    let (model, mask) = body_and_clothing(data, &set, body.as_ref(), clothing.as_deref())?;

    let paths = RunPaths::new(root);
    fs::create_dir_all(root).map_err(|source| Error::io(root, source))?;
    statistics.save(paths.statistics())?;
    model.save(paths.body())?;
    mask.save(paths.clothing())?;
    let identity =
        DataIdentity { path: data.clone(), frames: set.frames(), vertices: set.vertices() };
    write_json(&paths.data(), &identity)?;
    config.save(&paths.config())?;
    Ok((paths, config))
}
