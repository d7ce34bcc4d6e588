//! CAPE's networks: Chebyshev graph convolutions, condition nets, encoder, decoder, patchwise
//! discriminator and the terms of the objective.
//!
//! A [`CapeConfig`] describes an architecture, [`Graphs`] hold what it needs of a mesh on a device,
//! and [`Cape`] is the model. Displacements enter and leave as `[batch, vertices, 3]`, normalised.

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
    CapeConfig, DecoderBlock, DecoderConditions, DiscriminatorConfig, LEAKY_SLOPE, OUTFITS,
    POSE_FEATURE,
};
pub use cost::update_flops;
pub use decoder::{Decoder, DecoderLayer};
pub use discriminator::Discriminator;
pub use encoder::{Encoder, EncoderBlock, Posterior};
pub use error::{Error, Result};
pub use init::Init;
pub use losses::{Adversary, LossConfig, Reconstruction};
pub use model::{Cape, Generator, Graphs};
