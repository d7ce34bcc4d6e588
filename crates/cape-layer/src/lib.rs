//! A clothing layer of its own topology over a moving body (Yang et al., "Analyzing Clothing Layer
//! Deformation Statistics of 3D Human Motions", ECCV 2018).
//!
//! [`associate`] ties every clothing vertex to a few body vertices; [`offsets`] takes the pose out
//! of clothing and puts it back; [`pca`] compresses what is left, and [`regress`] predicts it from
//! motion, size and material. [`cloth`] simulates garments to learn from. Units are metres,
//! seconds, kilograms and radians; y points up.
//!
//! ```
//! # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/sets.rs"));
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use cape_synth::synthetic_body;
//! use cape_core::smpl::StandardPose;
//! use cape_layer::{ComponentSelection, LayerPca, experiment::UnposedSet};
//!
//! // A patch on the skin of a body that marches, and the body vertices that it follows.
//! let body = synthetic_body();
//! let (set, association) = patch(&body)?;
//! // Freed from the poses it only rises and falls: one component holds all of that.
//! let unposed = UnposedSet::new(&body, &set, &association, &StandardPose::default())?;
//! let pca = LayerPca::fit(unposed.rows.view(), ComponentSelection::Components(1))?;
//! assert!(pca.explained() > 1.0 - 1e-9);
//! # Ok(())
//! # }
//! ```

pub mod associate;
mod error;
pub mod experiment;
pub mod geometry;
mod layer;
pub mod offsets;
pub mod pca;
pub mod regress;
pub mod sequence;
pub mod synth;

pub use associate::{AssociateOptions, Association};
pub use error::{Error, Result};
pub use layer::{Layer, LayerStream, PredictedFrame};
pub use offsets::{BodyFrame, OffsetFrame};
pub use pca::{ComponentSelection, LayerPca};
pub use sequence::{LayerSet, Sequence, import, import_motion};
