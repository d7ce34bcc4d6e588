//! CAPE's networks: Chebyshev graph convolutions, condition nets, encoder, decoder, patchwise
//! discriminator and the terms of the training objective.
//!
//! A [`CapeConfig`] describes an architecture, [`Graphs`] hold the mesh pyramids and the edge
//! operator on a device, and [`Cape`] is the model. Displacements enter and leave as
//! `[batch, vertices, 3]`, normalised per vertex and coordinate.
//!
//! ```
//! use burn::tensor::{Device, Tensor};
//! use cape_core::Outfit;
//! use cape_synth::synthetic_body;
//! use cape_graph::{
//!     DevicePyramid, MeshPyramid, SparseMatrix, Surface, Weighting, sparse_from_triplets,
//! };
//! use cape_model::{Cape, CapeConfig, Graphs};
//!
//! let config = CapeConfig { discriminator: None, ..CapeConfig::tiny() };
//! let device = Device::default();
//! let surface = Surface::from(&synthetic_body());
//! let pyramid = MeshPyramid::build(&surface, &[1., 2., 1., 1.], Weighting::Barycentric)?;
//! let edges: Vec<[i64; 2]> = surface.edges().iter().map(|edge| edge.map(i64::from)).collect();
//! let rows: Vec<i64> = (0..edges.len() as i64).flat_map(|row| [row; 2]).collect();
//! let shape = (edges.len(), surface.vertices.len());
//! let signs = [1., -1.].repeat(edges.len());
//! let difference = sparse_from_triplets("edges", shape, &rows, edges.as_flattened(), &signs)?;
//! let graphs = Graphs {
//!     generator: DevicePyramid::upload(&pyramid, &device),
//!     discriminator: None,
//!     edges: SparseMatrix::new(&difference, &device),
//! };
//!
//! let model = Cape::new(&config, &graphs, 1, &device)?;
//! let outfits = [Outfit::SHORT_LONG, Outfit::LONG_LONG].map(|outfit| config.outfits.one_hot(outfit));
//! let [a, b] = outfits;
//! let outfits = [a?, b?].concat();
//! let clothes = model.generator.decode(
//!     Tensor::zeros([2, 6], &device),
//!     Tensor::zeros([2, 126], &device),
//!     Tensor::<1>::from_floats(&outfits[..], &device).reshape([2, 4]),
//!     &graphs,
//! );
//! assert_eq!(clothes.dims(), [2, 6890, 3]);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod condition;
mod config;
mod cost;
mod decoder;
mod discriminator;
mod encoder;
mod error;
mod init;
pub mod layers;
pub mod losses;
mod model;
pub mod release;
pub mod tensorflow;
pub mod weights;

pub use condition::{ConditionNet, ConditionNets};
pub use config::{
    CapeConfig, DecoderBlock, DecoderConditions, DiscriminatorConfig, LEAKY_SLOPE, POSE_FEATURE,
};
pub use cost::update_flops;
pub use decoder::{Decoder, DecoderLayer};
pub use discriminator::Discriminator;
pub use encoder::{Encoder, EncoderBlock, Posterior};
pub use error::{Error, Result};
pub use init::Initialiser;
pub use losses::{AdversarialLoss, DisplacementUnit, LossConfig, ReconstructionLoss};
pub use model::{Cape, Generator, Graphs};
