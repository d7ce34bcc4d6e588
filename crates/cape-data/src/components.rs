use std::path::Path;

use cape_core::ProgressFn;
use cape_stats::pca::{Pca, PcaOptions};

use crate::{DisplacementStatistics, PackedSet, Result, Split};

/// Principal components of the displacements, in metres, of the training frames without validation
/// frames of the packed set in `data`.
///
/// # Errors
/// As for [`Pca::fit`], or if the set cannot be read.
pub fn principal_components(
    data: impl AsRef<Path>,
    options: &PcaOptions,
    progress: &mut ProgressFn,
) -> Result<Pca> {
    let data = data.as_ref();
    let set = PackedSet::open(data, Split::Train)?;
    let statistics = DisplacementStatistics::from_packed(data, &mut cape_core::silent)?;
    let rows = statistics.training_rows(set.frames());
    let read = |row: usize| set.displacement_row(row);
    Pca::fit(rows.len(), 3 * set.vertices(), options, &read, progress)
}
