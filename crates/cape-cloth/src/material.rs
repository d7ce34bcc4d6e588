use serde::Serialize;

use crate::{Error, Result};

/// Resistance of a cloth to deformation in its plane, N/m: the entries of the orthotropic stiffness
/// matrix that takes Green strain to stress, force per length.
///
/// ```
/// use cape_cloth::{ClothMaterial, StretchStiffness};
///
/// // Denim resists stretch along its warp five times as much as along its weft.
/// let StretchStiffness { weft, warp, .. } = ClothMaterial::DENIM.stretch;
/// assert!((4.5..5.5).contains(&(warp / weft)));
/// assert_eq!(ClothMaterial::DENIM.stretch.scaled(2.0).warp, 2.0 * warp);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct StretchStiffness {
    /// Stiffness along the weft, horizontal in garments, N/m.
    pub weft: f64,
    /// Stiffness along the warp, vertical in garments, N/m.
    pub warp: f64,
    /// Coupling of both directions, N/m.
    pub coupling: f64,
    /// Stiffness in shear, N/m.
    pub shear: f64,
}

impl StretchStiffness {
    /// The same stiffness in all directions: Young's modulus times thickness, N/m, and Poisson's ratio.
    pub fn isotropic(modulus: f64, poisson: f64) -> Self {
        let along = modulus / (1.0 - poisson * poisson);
        let shear = 0.5 * modulus / (1.0 + poisson);
        Self { weft: along, warp: along, coupling: poisson * along, shear }
    }

    /// All entries times `ratio`.
    #[must_use]
    pub fn scaled(self, ratio: f64) -> Self {
        let Self { weft, warp, coupling, shear } = self;
        Self {
            weft: weft * ratio,
            warp: warp * ratio,
            coupling: coupling * ratio,
            shear: shear * ratio,
        }
    }
}

/// Material of a cloth.
///
/// The constants with a name of a fabric have densities, stretch stiffnesses at small strains and mean
/// bending stiffnesses as Wang, O'Brien and Ramamoorthi measured them (*Data-driven elastic models for
/// cloth: modeling and measurement*, SIGGRAPH 2011).
///
/// ```
/// use cape_cloth::ClothMaterial;
///
/// let light = ClothMaterial { density: 0.1, ..ClothMaterial::DENIM };
/// light.check()?;
/// // Densities are on a logarithmic scale.
/// assert_eq!(light.numbers()[0], -1.0);
/// let nothing = ClothMaterial { density: 0.0, ..light };
/// assert!(nothing.check().unwrap_err().to_string().contains("density"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ClothMaterial {
    /// Mass per area, kg/m².
    pub density: f64,
    /// Stiffness in the plane.
    pub stretch: StretchStiffness,
    /// Bending stiffness (flexural rigidity), N·m.
    pub bend: f64,
    /// Damping of deformation: stress per rate of strain relative to the stiffness, seconds.
    pub damping: f64,
    /// Coefficient of Coulomb friction against the body and other cloth.
    pub friction: f64,
    /// Distance from the body and between layers, metres.
    pub thickness: f64,
}

impl Default for ClothMaterial {
    /// Cotton shirting: nominal values between the knits and the denim of Wang et al.
    fn default() -> Self {
        Self {
            density: 0.2,
            stretch: StretchStiffness { weft: 200.0, warp: 300.0, coupling: 40.0, shear: 60.0 },
            ..Self::INTERLOCK
        }
    }
}

impl ClothMaterial {
    /// Interlock knit ("Gray Interlock": 60 % cotton, 40 % polyester).
    pub const INTERLOCK: Self = Self {
        density: 0.187,
        stretch: StretchStiffness { weft: 16.6, warp: 34.5, coupling: -14.7, shear: 36.9 },
        bend: 2.2e-5,
        damping: 2e-3,
        friction: 0.3,
        thickness: 0.003,
    };

    /// Ponte knit ("Camel Ponte Roma").
    pub const PONTE: Self = Self {
        density: 0.284,
        stretch: StretchStiffness { weft: 31.1, warp: 44.0, coupling: -12.8, shear: 31.9 },
        bend: 3.5e-5,
        ..Self::INTERLOCK
    };

    /// Rib knit ("Ivory Rib Knit").
    pub const RIB: Self = Self {
        density: 0.276,
        stretch: StretchStiffness { weft: 42.9, warp: 65.2, coupling: -0.2, shear: 83.2 },
        bend: 4.1e-5,
        ..Self::INTERLOCK
    };

    /// Denim ("11oz Black Denim").
    pub const DENIM: Self = Self {
        density: 0.324,
        stretch: StretchStiffness { weft: 205.4, warp: 1013.9, coupling: 10.2, shear: 53.4 },
        bend: 7.2e-5,
        ..Self::INTERLOCK
    };

    /// Light silk (habotai): nominal values.
    pub const SILK: Self = Self {
        density: 0.06,
        stretch: StretchStiffness { weft: 300.0, warp: 400.0, coupling: 20.0, shear: 30.0 },
        bend: 3e-6,
        friction: 0.2,
        thickness: 0.002,
        ..Self::INTERLOCK
    };

    /// Semantic parameters for regression: decimal logarithms of density, mean stiffness in stretch
    /// and bending stiffness, then damping and friction, `[5]`.
    pub fn numbers(&self) -> [f64; 5] {
        let log = |x: f64| x.max(1e-12).log10();
        let stretch = (self.stretch.weft.max(0.0) * self.stretch.warp.max(0.0)).sqrt();
        [log(self.density), log(stretch), log(self.bend), self.damping, self.friction]
    }

    /// Checks the ranges of the parameters.
    ///
    /// # Errors
    /// If one is out of range; the error has its name.
    pub fn check(&self) -> Result<()> {
        let Self { density, stretch, bend, damping, friction, thickness } = *self;
        for (name, value, least) in [
            ("density", density, f64::MIN_POSITIVE),
            ("stretch along the weft", stretch.weft, 0.0),
            ("stretch along the warp", stretch.warp, 0.0),
            ("shear", stretch.shear, 0.0),
            ("bend", bend, 0.0),
            ("damping", damping, 0.0),
            ("friction", friction, 0.0),
            ("thickness", thickness, 0.0),
        ] {
            if !(value.is_finite() && value >= least) {
                return Err(Error::argument(format!(
                    "material: {name} {value}, expected {}",
                    if least > 0.0 { "above 0" } else { "0 or more" }
                )));
            }
        }
        let most = (stretch.weft * stretch.warp).sqrt();
        if stretch.coupling.is_nan() || stretch.coupling.abs() > most {
            return Err(Error::argument(format!(
                "material: coupling {}, expected at most {most} N/m, the geometric mean of weft and warp",
                stretch.coupling
            )));
        }
        Ok(())
    }
}
