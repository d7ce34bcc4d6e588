//! A clothing layer of its own topology over a moving body (Yang et al., "Analyzing Clothing Layer
//! Deformation Statistics of 3D Human Motions", ECCV 2018).
//!
//! [`associate`] ties every clothing vertex to a few body vertices; [`offsets`] takes the pose out
//! of clothing and puts it back; [`pca`] compresses what is left, and [`regress`] predicts it from
//! motion, size and material. [`cloth`] simulates garments to learn from. Units are metres,
//! seconds, kilograms and radians; y points up.

pub mod associate;
pub mod cloth;
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
pub use layer::{Layer, LayerStream, Predicted};
pub use offsets::{BodyFrame, Carrier, StandardPose};
pub use pca::{Keep, LayerPca};
pub use sequence::{LayerSet, Sequence, import, import_motion};
