//! Garments over a moving body, simulated by extended position-based dynamics (Macklin et al. 2016)
//! with many small steps of one iteration each (Macklin et al. 2019).
//!
//! A step integrates velocities, then projects constraints: lengths of edges (stretch) and
//! distances between the opposite corners of neighbouring triangles (bending), attachment of a
//! waistband, contact with the body at vertices and at the centres of faces, self-collision, and
//! last the strain limit of edges. The order is fixed, so that results do not depend on the number
//! of threads.
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
mod garment;
mod isosurface;
mod pattern;
mod self_collision;
mod sheet;
mod simulate;
#[cfg(test)]
mod tests;

pub use cape_core::{Error, Result};

pub use contact::Contact;
pub use garment::{Garment, GarmentKind, GarmentMesh};
pub use sheet::{Cloth, ClothMaterial};
pub use simulate::{SimulatedGarment, SimulationOptions, SimulationQuality, StepReport};
