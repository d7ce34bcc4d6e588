use cape_cloth::{ClothMaterial, Garment, GarmentKind, GarmentMesh};
use cape_core::{Outfit, SmplModel, geometry::SurfaceMesh};
use cape_synth::GarmentLengths;
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use rand_distr::StandardNormal;
use serde::Serialize;

use crate::Result;

/// Least difference of the widths of upper and lower garment, so that the upper one is outside: 7 mm
/// of ease.
const LAYERS: f64 = 0.05;

/// Fabrics that garments are made of, besides cotton shirting.
const FABRICS: [ClothMaterial; 3] =
    [ClothMaterial::PONTE, ClothMaterial::RIB, ClothMaterial::DENIM];

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
    /// Material of both.
    pub material: ClothMaterial,
    /// Shape coefficients of the body that the garments are sewn for, which is their size.
    pub size: Vec<f64>,
}

impl OutfitCut {
    /// Draws the garments of a subject with the shape coefficients `betas`. Their size follows the
    /// subject's shape to three quarters.
    ///
    /// # Errors
    /// If the outfit is none of the paper's four.
    pub fn random(outfit: Outfit, betas: &[f64], seed: u64) -> Result<Self> {
        let lengths = GarmentLengths::from_outfit(outfit)?;
        let rng = &mut ChaCha8Rng::seed_from_u64(seed);
        let mut between = |low: f64, high: f64| rng.random_range(low..high);
        let lower = Garment {
            length: if lengths.long_legs { between(1.7, 1.9) } else { between(0.6, 0.95) },
            width: between(1.055, 1.1),
            ..Garment::new(GarmentKind::Shorts)
        };
        let upper = Garment {
            length: between(1.0, 1.2),
            width: lower.width + between(LAYERS, LAYERS + 0.07),
            sleeve: if lengths.long_sleeves { between(1.65, 1.85) } else { between(0.45, 0.8) },
            ..Garment::new(GarmentKind::TShirt)
        };
        let chosen = rng.random_range(0..=FABRICS.len());
        let fabric = FABRICS.get(chosen).copied().unwrap_or_default();
        let mut about = |spread: f64| (spread * normal(rng)).exp();
        let material = ClothMaterial {
            density: fabric.density * about(0.15),
            stretch: fabric.stretch.scaled(about(0.3)),
            bend: fabric.bend * about(0.4),
            friction: fabric.friction * about(0.2),
            ..fabric
        };
        let size = betas.iter().map(|beta| 0.75 * beta + 0.3 * normal(rng)).collect();
        Ok(Self { upper, lower, material, size })
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
        let inner = lower.surface.vertices.len() as u32;
        let inner_faces = lower.surface.faces.len();
        let mut surface = lower.surface;
        surface.vertices.extend(upper.surface.vertices);
        surface.faces.extend(upper.surface.faces.iter().map(|face| face.map(|v| v + inner)));
        let mesh = GarmentMesh { surface, waistband: lower.waistband, ..upper };
        Ok(SewnOutfit { mesh, inner_faces })
    }
}

/// Sewn garments as one sheet: first the lower, inner one, then the upper, outer one.
#[derive(Debug, Clone, PartialEq)]
pub struct SewnOutfit {
    /// Both garments, around the body of their size.
    pub mesh: GarmentMesh,
    /// Number of faces of the lower garment.
    pub inner_faces: usize,
}

impl SewnOutfit {
    /// Surfaces of the lower and the upper garment with the vertices of both, metres.
    pub fn layers(&self) -> [SurfaceMesh; 2] {
        let (inner, outer) = self.mesh.surface.faces.split_at(self.inner_faces);
        [inner, outer].map(|faces| SurfaceMesh {
            vertices: self.mesh.surface.vertices.clone(),
            faces: faces.to_vec(),
        })
    }
}

/// Standard normal sample, clamped to ±2.
fn normal(rng: &mut ChaCha8Rng) -> f64 {
    rng.sample::<f64, _>(StandardNormal).clamp(-2.0, 2.0)
}
