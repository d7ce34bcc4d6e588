//! A new run's directory.

use std::{fs, path::Path};

use cape_data::{DisplacementStatistics, PackedSet, Split};
use cape_infer::{DataIdentity, RunConfig, RunPaths, body_and_clothing, write_json};

use crate::{Error, Result};

/// Creates a run's directory: configuration, statistics, body and clothing vertices, so that
/// nothing outside is needed later to sample from it.
pub(crate) fn create(
    root: &Path,
    data: &Path,
    body: Option<&Path>,
    clothing: Option<&Path>,
    config: &RunConfig,
) -> Result<RunPaths> {
    config.validate()?;
    if fs::read_dir(root).is_ok_and(|mut entries| entries.next().is_some()) {
        return Err(Error::argument(format!(
            "{}: is not empty: choose another directory, or resume the run in it",
            root.display()
        )));
    }
    let set = PackedSet::open(data, Split::Train)?;
    let statistics = DisplacementStatistics::from_packed(data, &mut cape_core::silent)?;
    let (model, mask) = body_and_clothing(data, &set, body, clothing)?;

    let paths = RunPaths::new(root);
    fs::create_dir_all(root).map_err(|source| Error::io(root, source))?;
    statistics.save(paths.statistics())?;
    model.save(paths.body())?;
    mask.save(paths.clothing())?;
    let identity =
        DataIdentity { path: data.to_owned(), frames: set.frames(), vertices: set.vertices() };
    write_json(&paths.data(), &identity)?;
    config.save(&paths.config())?;
    Ok(paths)
}
