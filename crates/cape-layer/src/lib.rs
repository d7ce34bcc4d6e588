//! A clothing layer of its own topology over a moving body (Yang et al., "Analyzing Clothing Layer
//! Deformation Statistics of 3D Human Motions", ECCV 2018).
//!
//! [`associate`] finds the body vertices that each clothing vertex follows (§3.1, eq. 2);
//! [`offsets`] removes the pose from clothing and applies it again (eq. 3–4); principal components
//! ([`Pca`], §3.2) compress the offsets, and [`regress`] predicts their coordinates from motion,
//! garment size and material (§3.3). [`experiment`] measures both on a [`LayerSet`] (§4–5), which
//! [`synth`] simulates or [`import`] reads. Units are metres, seconds, kilograms and radians; y
//! points up.
//!
//! ```
//! # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/sets.rs"));
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use cape_synth::synthetic_body;
//! use cape_core::smpl::StandardPose;
//! use cape_layer::{ComponentSelection, Pca, experiment::UnposedSet};
//!
//! // A patch on the skin of a body that marches, and the body vertices that it follows.
//! let body = synthetic_body();
//! let (set, association) = patch(&body)?;
//! // Without the poses only one motion remains, up and down: one component explains it.
//! let unposed = UnposedSet::new(&body, &set, &association, &StandardPose::default())?;
//! let pca = Pca::from_snapshots(unposed.rows.view(), ComponentSelection::Components(1))?;
//! assert!(pca.explained() > 1.0 - 1e-9);
//! # Ok(())
//! # }
//! ```

pub mod associate;
mod body_identity;
mod clearance;
mod error;
pub mod experiment;
pub mod geometry;
mod import;
mod layer;
pub mod offsets;
pub mod regress;
pub mod sequence;
pub mod synth;
mod wearer;

pub use cape_stats::pca::{ComponentSelection, Pca};

pub use associate::{AssociateOptions, Association};
pub use body_identity::BodyIdentity;
pub use clearance::{Clearance, InsideShares};
pub use error::{Error, Result};
pub use import::{ImportRates, import};
pub use layer::{Layer, LayerOptions, LayerStream, PredictedFrame};
pub use offsets::{BodyFrame, OffsetFrame};
pub use sequence::{LayerSet, Sequence};
pub use wearer::BodyMeasurements;
