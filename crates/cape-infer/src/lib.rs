//! Trained clothing models: a run's directory, encoding, decoding and dressing bodies, densities of
//! latent codes, and animated glTF.
//!
//! ```
//! # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/../cape-train/doc/sets.rs"));
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use burn::tensor::Device;
//! use cape_core::Outfit;
//! use cape_infer::{Run, BodySpec};
//!
//! let directory = trained()?;
//! let run = Run::open(&directory.path().join("run"), &Device::default())?;
//! let wearer = BodySpec { betas: vec![1.0], pose: [0.0; 72], outfit: Outfit::LONG_LONG };
//! let dressed = run.dress(&run.sample_codes(1, 7), &[wearer])?;
//! assert_eq!(dressed[0].vertices.len(), 6890);
//! # Ok(())
//! # }
//! ```

mod animated_body;
mod batch;
mod body_spec;
pub mod checkpoint;
mod clothed_model;
mod codes;
mod config;
mod error;
mod garment_colours;
mod garment_labels;
mod graphs;
mod model_file;
mod normaliser;
pub mod prior;
mod run;

pub use animated_body::{AnimatedBody, AnimationReport};
pub use batch::{BATCH, DeviceBatch, batches, to_device};
pub use body_spec::{BodySpec, registration};
pub use clothed_model::{ClothedBody, ClothedModel, ClothedModelParts, Condition};
pub use codes::{directions_by_effect, interpolate_codes, normal, walk_codes};
pub use config::{OptimiserKind, RateSchedule, RunConfig, TrainConfig, WarmUp};
pub use error::{Error, Result};
pub use garment_colours::{GarmentColours, SKIN_COLOUR, TROUSERS_COLOUR, shirt_colour};
pub use garment_labels::GarmentTables;
pub use graphs::build_graphs;
pub use model_file::{ModelFile, WeightStorage};
pub use normaliser::Normaliser;
pub use run::{DataIdentity, MIXTURE, Run, RunPaths, body_and_clothing, read_identity, write_json};
