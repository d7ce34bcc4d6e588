//! Garments over a moving body, simulated by linearly implicit steps (Baraff and Witkin 1998).
//!
//! A step solves for velocities under stretch and shear of triangles with orthotropic stiffness,
//! bending by dihedral angles, hems, elastic cuffs, gravity, drag and the attachment of a waistband; then it resolves
//! contact with the body at vertices and at the centres of faces, self-collision, and last the strain
//! limit of edges. The order of sums is fixed, so that results do not depend on the number of threads.
//!
//! ```
//! use cape_cloth::{ClothMaterial, Garment, GarmentKind, SimulationOptions};
//! use cape_core::BodyMotion;
//! use cape_synth::synthetic_body;
//! use ndarray::Array2;
//!
//! // A coarse skirt on a standing body.
//! let body = synthetic_body();
//! let shape = body.rest_shape(&[])?;
//! let skirt = Garment { resolution: 0.05, ..Garment::new(GarmentKind::Skirt) }.sew(&body, &shape)?;
//! let motion = BodyMotion::new(30.0, Array2::zeros((1, 72)), Array2::zeros((1, 3)))?;
//! let options = SimulationOptions { settle: 0.1, ..SimulationOptions::default() };
//! let worn = (&skirt, &ClothMaterial::default());
//! let simulated = options.run(&body, &shape, worn, &motion, &mut |_, _| {})?;
//! assert_eq!(simulated.frames.dim(), (1, skirt.surface.vertices.len(), 3));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod contact;
#[cfg(test)]
mod contact_tests;
mod elastic;
mod garment;
mod implicit;
mod isosurface;
mod material;
mod outfit;
mod pattern;
mod penetration;
#[cfg(test)]
mod physics_tests;
mod point_grid;
mod reinforce;
mod self_collision;
mod sheet;
mod simulate;
#[cfg(test)]
mod tests;

pub use cape_core::{Error, Result};

/// Version of the simulator: results of different versions differ, and must not be mixed in one set. The
/// first version had no number.
pub const SIMULATOR_VERSION: u32 = 5;

pub use contact::Contact;
pub use garment::{Garment, GarmentKind, GarmentMesh};
pub use material::{ClothMaterial, StretchStiffness};
pub use penetration::Penetration;
pub use reinforce::ElasticBand;
pub use sheet::Cloth;
pub use simulate::{SimulatedGarment, SimulationOptions, SimulationQuality, StepReport};
