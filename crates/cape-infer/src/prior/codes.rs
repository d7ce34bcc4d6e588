//! Latent codes of training frames.

use std::{collections::BTreeSet, path::Path};

use cape_core::Outfit;
use ndarray::Array2;

use crate::{Error, Result, Run};
use cape_core::ProgressFn;
use cape_data::{PackedSet, Split};

/// Posterior means of frames, each with its outfit.
#[derive(Debug, Clone)]
pub struct LatentCodes {
    latent: usize,
    rows: Vec<(Outfit, Vec<f64>)>,
    /// Training step of the checkpoint that encoded them, if known.
    step: Option<u64>,
}

impl LatentCodes {
    /// Codes with their outfits, each of `latent` numbers.
    ///
    /// # Errors
    /// If a code has another length.
    pub fn new(latent: usize, rows: Vec<(Outfit, Vec<f64>)>) -> Result<Self> {
        match rows.iter().find(|(_, code)| code.len() != latent) {
            Some((_, code)) => {
                Err(Error::argument(format!("a code of {} numbers, expected {latent}", code.len())))
            }
            None => Ok(Self { latent, rows, step: None }),
        }
    }

    /// Posterior means of at most `frames` training frames of the packed set in `data`, evenly
    /// spaced.
    pub fn from_training(
        run: &Run,
        data: &Path,
        frames: usize,
        progress: &mut ProgressFn,
    ) -> Result<Self> {
        Self::from_set(run, &run.open_set(data, Split::Train)?, frames, progress)
    }

    /// Posterior means of at most `frames` training frames of `set`, evenly spaced.
    pub fn from_set(
        run: &Run,
        set: &PackedSet,
        frames: usize,
        progress: &mut ProgressFn,
    ) -> Result<Self> {
        let rows = run.statistics().training_rows(set.frames());
        let step = rows.len().div_ceil(frames.max(1)).max(1);
        let rows: Vec<usize> = rows.step_by(step).collect();
        let latent = run.latent();
        let mut codes = Vec::with_capacity(rows.len());
        for chunk in rows.chunks(crate::BATCH) {
            for (&row, mean) in chunk.iter().zip(run.encode_frames(set, chunk)?.rows()) {
                let code = mean.iter().map(|&x| f64::from(x)).collect();
                codes.push((set.outfits()[row], code));
            }
            progress(codes.len(), rows.len());
        }
        Ok(Self { step: Some(run.progress().step), ..Self::new(latent, codes)? })
    }

    /// Length of a code.
    pub fn latent(&self) -> usize {
        self.latent
    }

    /// Training step of the checkpoint that encoded them, if known.
    pub fn step(&self) -> Option<u64> {
        self.step
    }

    /// Number of codes.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// True if there are no codes.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// Outfits that there are codes of.
    pub fn outfits(&self) -> BTreeSet<Outfit> {
        self.rows.iter().map(|(outfit, _)| *outfit).collect()
    }

    /// Codes of one outfit, or all, `[n, latent]`.
    pub fn for_outfit(&self, outfit: Option<Outfit>) -> Array2<f64> {
        let rows = || self.rows.iter().filter(|(worn, _)| outfit.is_none_or(|o| o == *worn));
        let mut codes = Array2::zeros((rows().count(), self.latent));
        for (mut to, (_, from)) in codes.rows_mut().into_iter().zip(rows()) {
            for (to, from) in to.iter_mut().zip(from) {
                *to = *from;
            }
        }
        codes
    }
}
