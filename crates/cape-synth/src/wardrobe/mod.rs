//! Clothing as displacements of a body's rest vertices.
//!
//! Garments are described in garment coordinates (`regions`): a sleeve ends at a fraction of the arm,
//! a hem at a height above the hips, so that the same garment fits any body in SMPL's layout. An
//! [`OutfitStyle`] has the parameters of the garments of one subject in one sequence; the pose adds
//! folds at elbows, shoulders, waist, hips and knees, shifts the cloth along the body and lets it sag.

mod drape;
mod drape_offsets;
mod garment_lengths;
mod joint_bends;
mod outfit_style;

use glam::DVec3;
use ndarray::Array2;
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use rand_distr::StandardNormal;

use super::regions::{Regions, joint};
use crate::{Error, Result};
use cape_core::{Outfit, SmplModel};
use drape::{DrapeContext, HemDistances};
use drape_offsets::{DrapeOffsets, drape_offsets};
pub use garment_lengths::GarmentLengths;
use joint_bends::JointBends;
pub use outfit_style::OutfitStyle;

/// Standard deviation of the simulated scan noise, metres.
const SCAN_NOISE: f64 = 0.00015;

/// Procedural garments for a body.
///
/// ```
/// use cape_core::Outfit;
/// use cape_synth::{Wardrobe, synthetic_body};
///
/// let body = synthetic_body();
/// let wardrobe = Wardrobe::new(&body, 7)?;
/// let fitted = wardrobe.fit(wardrobe.outfit_style(0, Outfit::SHORT_SHORT, 0)?);
/// assert_eq!(fitted.outfit_style().outfit, Outfit::SHORT_SHORT);
/// // Displacements are zero outside both garments.
/// let displacement = wardrobe.displacement(&fitted, &[0.0; 72], 0.0, None)?;
/// for (vertex, [upper, lower]) in displacement.rows().into_iter().zip(fitted.coverage()) {
///     assert!(upper || lower || vertex.iter().all(|&x| x == 0.0));
/// }
/// # Ok::<(), cape_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Wardrobe<'a> {
    model: &'a SmplModel,
    regions: Regions,
    drape_offsets: Vec<DrapeOffsets>,
    seed: u64,
}

/// Outfit fitted to the body: style, and coverage of the vertices, which are independent of the pose.
#[derive(Debug, Clone)]
pub struct FittedOutfit {
    style: OutfitStyle,
    hem_distances: Vec<HemDistances>,
}

impl FittedOutfit {
    /// Style of the outfit.
    pub fn outfit_style(&self) -> &OutfitStyle {
        &self.style
    }

    /// Cover flags of upper and lower garment, `[V, 2]`.
    pub fn coverage(&self) -> Vec<[bool; 2]> {
        self.hem_distances
            .iter()
            .map(|hems| [hems.shirt.cover > 0.0, hems.trousers.cover > 0.0])
            .collect()
    }
}

impl<'a> Wardrobe<'a> {
    /// Creates the wardrobe of a random `seed` for `model`.
    ///
    /// # Errors
    /// If the body does not have SMPL's 24 joints.
    pub fn new(model: &'a SmplModel, seed: u64) -> Result<Self> {
        let regions = Regions::new(model)?;
        Ok(Self { model, drape_offsets: drape_offsets(&regions), regions, seed })
    }

    /// Indices of the vertices that garments may cover (all but head, hands and feet), ascending.
    pub fn clothing_vertices(&self) -> Vec<usize> {
        let sites = self.regions.sites.iter().enumerate();
        sites.filter(|(_, site)| site.clothed).map(|(index, _)| index).collect()
    }

    /// Shape coefficients of a subject, at most 10.
    pub fn betas(&self, subject: usize) -> Vec<f64> {
        let rng = &mut ChaCha8Rng::seed_from_u64(mix_seed(self.seed, &[1, subject as u64]));
        (0..self.model.betas().min(10))
            .map(|_| 0.9 * rng.sample::<f64, _>(StandardNormal).clamp(-1.8, 1.8))
            .collect()
    }

    /// Style of `outfit` on `subject` in the sequence of index `sequence`.
    ///
    /// # Errors
    /// If the outfit is none of the paper's four.
    pub fn outfit_style(
        &self,
        subject: usize,
        outfit: Outfit,
        sequence: usize,
    ) -> Result<OutfitStyle> {
        let lengths = GarmentLengths::from_outfit(outfit)?;
        let path = [2, subject as u64, outfit.stream(), sequence as u64];
        let random = |path| OutfitStyle::random(outfit, lengths, mix_seed(self.seed, path));
        Ok(random(&path[..3]).with_fit_of(random(&path)))
    }

    /// Fits an outfit to the body.
    pub fn fit(&self, style: OutfitStyle) -> FittedOutfit {
        let sites = self.regions.sites.iter();
        let hem_distances =
            sites.map(|site| HemDistances::new(&self.regions, site, &style)).collect();
        FittedOutfit { style, hem_distances }
    }

    /// Clothing displacement in canonical space, metres, `[V, 3]`.
    ///
    /// `pose` is in axis-angle, `[72]`; `time` (seconds) drives sway and slow shifts; `noise` is the
    /// seed of the scan noise of a frame, with a smooth registration error of about a millimetre;
    /// `None` leaves both out.
    ///
    /// # Errors
    /// If the pose does not have 72 numbers.
    pub fn displacement(
        &self,
        fitted: &FittedOutfit,
        pose: &[f64],
        time: f64,
        noise: Option<u64>,
    ) -> Result<Array2<f64>> {
        let (joints, rest) = pose.as_chunks::<3>();
        if joints.len() != joint::COUNT || !rest.is_empty() {
            return Err(Error::Argument(format!("pose of {} numbers: expected 72", pose.len())));
        }
        let pose: Vec<DVec3> = joints.iter().map(|&angles| DVec3::from(angles)).collect();
        let bends = JointBends::new(self.model, &self.regions, &pose);
        let context = DrapeContext { style: &fitted.style, bends: &bends, time };
        let mut rng = noise
            .map(|number| ChaCha8Rng::seed_from_u64(mix_seed(fitted.style.seed, &[3, number])));
        let mut values = Vec::with_capacity(3 * self.regions.sites.len());
        let per_site = self.drape_offsets.iter().zip(&fitted.hem_distances);
        for (site, (drape, hems)) in self.regions.sites.iter().zip(per_site) {
            let displacement = context.displacement(site, drape, hems);
            let Some(rng) = &mut rng else {
                values.extend(displacement.to_array());
                continue;
            };
            let scanned = displacement + fitted.style.registration_error(site.position);
            for value in scanned.to_array() {
                values.push(value + SCAN_NOISE * rng.sample::<f64, _>(StandardNormal));
            }
        }
        Array2::from_shape_vec((self.regions.sites.len(), 3), values)
            .map_err(|source| Error::Argument(source.to_string()))
    }
}

/// Derives a seed from `seed` and a path of indices by SplitMix64.
pub fn mix_seed(seed: u64, path: &[u64]) -> u64 {
    path.iter().fold(seed, |state, &step| {
        let mut z = state
            .wrapping_add(0x9e37_79b9_7f4a_7c15)
            .wrapping_add(step.wrapping_mul(0xd1b5_4a32_d192_ed03));
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    })
}
