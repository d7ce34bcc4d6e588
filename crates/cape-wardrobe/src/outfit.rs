use cape_cloth::{ClothMaterial, Garment, GarmentKind, GarmentMesh};
use cape_core::{Outfit, SmplModel, geometry::SurfaceMesh};
use cape_synth::GarmentLengths;
use glam::DVec3;
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use rand_distr::StandardNormal;
use serde::Serialize;

use crate::Result;

/// Least difference of the widths of upper and lower garment, so that the upper one is outside: 7 mm
/// of ease.
const LAYERS: f64 = 0.05;

/// Fabrics of shorts and trousers, besides cotton shirting. Knits, whose stiffness is known at the
/// smallest strains only, would stretch under their own weight by more than real ones.
const TROUSERS: [ClothMaterial; 1] = [ClothMaterial::DENIM];

/// Share of long-sleeved shirts, and of long trousers of a fabric other than denim, with elastic cuffs.
const CUFFED: [f64; 2] = [0.5, 0.5];

/// Garments of one subject in one outfit: cuts, size and material.
///
/// ```
/// use cape_core::Outfit;
/// use cape_wardrobe::OutfitCut;
///
/// let cut = OutfitCut::random(Outfit::SHORT_LONG, &[0.5, -1.0], 7)?;
/// // Short sleeves end above the elbow, long legs below the knee.
/// assert!(cut.upper.sleeve < 1.0 && cut.lower.length > 1.0);
/// // Of one seed there is one cut.
/// assert_eq!(cut, OutfitCut::random(Outfit::SHORT_LONG, &[0.5, -1.0], 7)?);
/// # Ok::<(), cape_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct OutfitCut {
    /// Shirt.
    pub upper: Garment,
    /// Shorts or trousers.
    pub lower: Garment,
    /// Material of the shirt.
    pub upper_material: ClothMaterial,
    /// Material of the shorts or trousers.
    pub lower_material: ClothMaterial,
    /// Shape coefficients of the body that the garments are sewn for, which is their size.
    pub size: Vec<f64>,
}

impl OutfitCut {
    /// Draws the garments of a subject with the shape coefficients `betas`. Their size follows the
    /// subject's shape to nine tenths.
    ///
    /// # Errors
    /// If the outfit is none of the paper's four.
    pub fn random(outfit: Outfit, betas: &[f64], seed: u64) -> Result<Self> {
        let lengths = GarmentLengths::from_outfit(outfit)?;
        let rng = &mut ChaCha8Rng::seed_from_u64(seed);
        let mut between = |low: f64, high: f64| rng.random_range(low..high);
        let lower = Garment {
            length: if lengths.long_legs { between(1.7, 1.9) } else { between(0.6, 0.95) },
            width: between(1.05, 1.12),
            ..Garment::new(GarmentKind::Shorts)
        };
        let upper = Garment {
            length: between(1.0, 1.2),
            width: lower.width + between(LAYERS, LAYERS + 0.08),
            sleeve: if lengths.long_sleeves { between(1.65, 1.85) } else { between(0.45, 0.8) },
            ..Garment::new(GarmentKind::TShirt)
        };
        let (_, upper_material) = fabric(&[], rng);
        let (cloth, lower_material) = fabric(&TROUSERS, rng);
        let size = betas.iter().map(|beta| 0.9 * beta + 0.15 * normal(rng)).collect();
        let upper = Garment { cuffs: lengths.long_sleeves && rng.random_bool(CUFFED[0]), ..upper };
        let cuffed = lengths.long_legs && rng.random_bool(CUFFED[1]);
        let lower = Garment { cuffs: cuffed && cloth != ClothMaterial::DENIM, ..lower };
        Ok(Self { upper, lower, upper_material, lower_material, size })
    }

    /// The cut with edges of `resolution` metres.
    #[must_use]
    pub fn with_resolution(mut self, resolution: f64) -> Self {
        self.upper.resolution = resolution;
        self.lower.resolution = resolution;
        self
    }

    /// Sews both garments around the body of their size.
    ///
    /// # Errors
    /// If the body does not have SMPL's 24 joints, or a cut is out of range or leaves no surface.
    pub fn sew(&self, model: &SmplModel) -> Result<SewnOutfit> {
        let shape = model.rest_shape(&self.size)?;
        let lower = self.lower.sew(model, &shape)?;
        let upper = self.upper.sew(model, &shape)?;
        Ok(SewnOutfit { lower, upper })
    }
}

/// Sewn garments around the body of their size.
#[derive(Debug, Clone, PartialEq)]
pub struct SewnOutfit {
    /// Shorts or trousers, the inner garment.
    pub lower: GarmentMesh,
    /// Shirt, the outer garment.
    pub upper: GarmentMesh,
}

impl SewnOutfit {
    /// Surfaces of the lower and the upper garment with the vertices of both, first the lower's, metres.
    pub fn layers(&self) -> [SurfaceMesh; 2] {
        let (lower, upper) = (&self.lower.surface, &self.upper.surface);
        let first = lower.vertices.len() as u32;
        let vertices: Vec<DVec3> = lower.vertices.iter().chain(&upper.vertices).copied().collect();
        let moved = upper.faces.iter().map(|face| face.map(|v| v + first)).collect();
        [lower.faces.clone(), moved].map(|faces| SurfaceMesh { vertices: vertices.clone(), faces })
    }
}

/// A fabric of a list, or cotton shirting, and the same with properties of its own.
fn fabric(fabrics: &[ClothMaterial], rng: &mut ChaCha8Rng) -> (ClothMaterial, ClothMaterial) {
    let chosen = rng.random_range(0..=fabrics.len());
    let fabric = fabrics.get(chosen).copied().unwrap_or_default();
    let mut about = |spread: f64| (spread * normal(rng)).exp();
    let own = ClothMaterial {
        density: fabric.density * about(0.15),
        stretch: fabric.stretch.scaled(about(0.3)),
        bend: fabric.bend * about(0.4),
        friction: fabric.friction * about(0.2),
        ..fabric
    };
    (fabric, own)
}

/// Standard normal sample, clamped to ±2.
fn normal(rng: &mut ChaCha8Rng) -> f64 {
    rng.sample::<f64, _>(StandardNormal).clamp(-2.0, 2.0)
}
