use std::path::Path;

use cape_core::Progress;
use cape_stats::pca::{Pca, PcaOptions};

use crate::{PackedSet, Part, Result, Statistics};

/// Principal components of the training frames, less validation, of the packed set in `data`:
/// displacements in metres.
///
/// # Errors
/// As of [`Pca::fit`], or if the set cannot be read.
pub fn principal_components(
    data: &Path,
    options: &PcaOptions,
    progress: &mut Progress,
) -> Result<Pca> {
    let set = PackedSet::open(data, Part::Train)?;
    let statistics = Statistics::of_packed(data, &mut cape_core::silent)?;
    let rows = statistics.training_rows(set.frames());
    let read = |row: usize| set.displacement_row(row);
    Pca::fit(rows.len(), 3 * set.vertices(), options, &read, progress)
}
