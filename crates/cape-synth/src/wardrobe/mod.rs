//! Clothes as displacements of a body's rest vertices.
//!
//! Garments are described in a tailor's coordinates (`regions`): a shirt ends at a fraction of
//! the arm and at a height above the hips, so that the same garment fits any body in SMPL's layout.
//! A [`OutfitStyle`] is one person's, put on anew for every sequence; the pose then throws folds at elbows, shoulders, waist,
//! hips and knees, shifts the cloth along the body and lets it sag.

mod drape;
mod drape_offsets;
mod garment;
mod joint_bends;

use glam::DVec3;
use ndarray::Array2;
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use rand_distr::StandardNormal;

use super::regions::{Regions, joint};
use crate::{Error, Result};
use cape_core::{Outfit, SmplModel};
use drape::{DrapeContext, HemDistances};
use drape_offsets::{DrapeOffsets, drape_offsets};
pub use garment::OutfitStyle;
use joint_bends::JointBends;

/// Standard deviation of the simulated scanner's noise, metres.
const SCAN_NOISE: f64 = 0.00015;

/// Garments for a body.
///
/// ```
/// use cape_core::Outfit;
/// use cape_synth::{Wardrobe, synthetic_body};
///
/// let body = synthetic_body();
/// let wardrobe = Wardrobe::new(&body, 7)?;
/// let fitting = wardrobe.fit(wardrobe.outfit_style(0, Outfit::ShortShort, 0));
/// assert_eq!(fitting.outfit_style().outfit, Outfit::ShortShort);
/// // Clothes are where either garment covers the body, and nowhere else.
/// let clothes = wardrobe.displacement(&fitting, &[0.0; 72], 0.0, None)?;
/// for (moved, [upper, lower]) in clothes.rows().into_iter().zip(fitting.coverage()) {
///     assert!(upper || lower || moved.iter().all(|&x| x == 0.0));
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

/// A garment laid out on its wearer: what does not depend on the pose.
///
/// See [`Wardrobe`] for an example.
#[derive(Debug, Clone)]
pub struct FittedOutfit {
    garment: OutfitStyle,
    hem_distances: Vec<HemDistances>,
}

impl FittedOutfit {
    /// What is worn.
    pub fn outfit_style(&self) -> &OutfitStyle {
        &self.garment
    }

    /// Whether upper and lower garment cover each vertex, `[vertices]`.
    pub fn coverage(&self) -> Vec<[bool; 2]> {
        self.hem_distances
            .iter()
            .map(|reach| [reach.shirt.cover > 0.0, reach.trousers.cover > 0.0])
            .collect()
    }
}

impl<'a> Wardrobe<'a> {
    /// A wardrobe for `model`, which must have SMPL's 24 joints; all of it follows from `seed`.
    pub fn new(model: &'a SmplModel, seed: u64) -> Result<Self> {
        let regions = Regions::new(model)?;
        Ok(Self { model, drape_offsets: drape_offsets(&regions), regions, seed })
    }

    /// Vertices that clothes may cover: all but head, hands and feet, ascending.
    pub fn clothing_vertices(&self) -> Vec<usize> {
        let sites = self.regions.sites.iter().enumerate();
        sites.filter(|(_, site)| site.clothed).map(|(index, _)| index).collect()
    }

    /// The shape coefficients of a subject, at most 10 of the body's.
    pub fn betas(&self, subject: usize) -> Vec<f64> {
        let rng = &mut ChaCha8Rng::seed_from_u64(mix_seed(self.seed, &[1, subject as u64]));
        (0..self.model.betas().min(10))
            .map(|_| 0.9 * rng.sample::<f64, _>(StandardNormal).clamp(-1.8, 1.8))
            .collect()
    }

    /// The state of `outfit` on `subject` in the sequence numbered `sequence`.
    pub fn outfit_style(&self, subject: usize, outfit: Outfit, sequence: usize) -> OutfitStyle {
        let path = [2, subject as u64, outfit.index() as u64, sequence as u64];
        let random = |path| OutfitStyle::random(outfit, mix_seed(self.seed, path));
        random(&path[..3]).with_fit_of(random(&path))
    }

    /// Lays `garment` out on the body.
    pub fn fit(&self, garment: OutfitStyle) -> FittedOutfit {
        let sites = self.regions.sites.iter();
        let hem_distances =
            sites.map(|site| HemDistances::new(&self.regions, site, &garment)).collect();
        FittedOutfit { garment, hem_distances }
    }

    /// The clothing displacement in canonical space, metres, `[vertices, 3]`.
    ///
    /// `pose` holds 24 axis-angles `[72]`; `time` (seconds) drives sway and slow shifts; `noise`
    /// numbers the frame's scan, whose registration also misses the wearer's minimal shape smoothly
    /// by a millimetre; `None` leaves both out.
    pub fn displacement(
        &self,
        fitting: &FittedOutfit,
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
        let frame = DrapeContext { garment: &fitting.garment, bends: &bends, time };
        let mut rng = noise
            .map(|number| ChaCha8Rng::seed_from_u64(mix_seed(fitting.garment.seed, &[3, number])));
        let mut values = Vec::with_capacity(3 * self.regions.sites.len());
        let laid = self.drape_offsets.iter().zip(&fitting.hem_distances);
        for (site, (hang, reach)) in self.regions.sites.iter().zip(laid) {
            let moved = frame.displacement(site, hang, reach);
            let Some(rng) = &mut rng else {
                values.extend(moved.to_array());
                continue;
            };
            let moved = moved + fitting.garment.misfit(site.position);
            for value in moved.to_array() {
                values.push(value + SCAN_NOISE * rng.sample::<f64, _>(StandardNormal));
            }
        }
        Array2::from_shape_vec((self.regions.sites.len(), 3), values)
            .map_err(|source| Error::Argument(source.to_string()))
    }
}

/// A seed for one thing out of many, by SplitMix64 over its path.
pub(super) fn mix_seed(seed: u64, path: &[u64]) -> u64 {
    path.iter().fold(seed, |state, &step| {
        let mut z = state
            .wrapping_add(0x9e37_79b9_7f4a_7c15)
            .wrapping_add(step.wrapping_mul(0xd1b5_4a32_d192_ed03));
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    })
}
