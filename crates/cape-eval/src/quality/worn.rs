//! Clothing of training captures in place of samples.

use std::{
    collections::{BTreeMap, HashMap},
    path::Path,
};

use cape_core::Outfit;
use cape_data::Split;
use cape_infer::Run;
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

use crate::Result;

/// For each frame of an outfit and a capture the displacements of a training frame, `[frames][3 V]`,
/// metres, as they are: all frames of a capture get those of one training capture of the outfit, chosen at
/// random. `None` if an outfit has no training frames. A training frame whose capture is unknown is one of
/// its own.
pub(super) fn training_clothing(
    run: &Run,
    data: &Path,
    outfits: &[Outfit],
    captures: &[usize],
    seed: u64,
) -> Result<Option<Vec<Vec<f32>>>> {
    let set = run.open_set(data, Split::Train)?;
    let mut names: HashMap<(Outfit, String), usize> = HashMap::new();
    let mut worn: BTreeMap<Outfit, Vec<Vec<usize>>> = BTreeMap::new();
    for row in run.statistics().training_rows(set.frames()) {
        let outfit = set.outfits()[row];
        let own = worn.entry(outfit).or_default();
        let name = set.capture(row).unwrap_or_else(|| row.to_string());
        let capture = *names.entry((outfit, name)).or_insert(own.len());
        if capture == own.len() {
            own.push(Vec::new());
        }
        own[capture].push(row);
    }
    let mut frames = Vec::with_capacity(outfits.len());
    for (index, (outfit, &capture)) in outfits.iter().zip(captures).enumerate() {
        let Some(own) = worn.get(outfit) else {
            return Ok(None);
        };
        // The same choice for all frames of a capture.
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(capture as u64);
        let rows = &own[rng.random_range(0..own.len())];
        let row = rows[index % rows.len()];
        frames.push(set.displacement_row(row)?.iter().map(|&x| x as f32).collect());
    }
    Ok(Some(frames))
}
