//! Clothed 3D people in Rust: SMPL bodies, CAPE's generative clothing, and what it takes to train
//! and evaluate it, on [Burn](https://burn.dev).
//!
//! Clothing is a **displacement** of the vertices of a body in its rest pose,
//! `T_clo = T(β, θ) + S_clo(z, θ, c)`: the body with shape β and pose θ, dressed in the outfit c by
//! the latent code z. The crates, in the order data flow through them:
//!
//! - [`core`] — meshes, NumPy files, SMPL and the clothing term, outfits, the synthetic data;
//! - [`graph`] — mesh pyramids and graph operations on tensors;
//! - [`model`] — the networks and losses;
//! - [`fit`] — bodies and their clothes from keypoints and silhouettes (SMPLify, CAPE §6.3);
//! - [`layer`] — clothing of its own topology (Yang et al., ECCV 2018): association, statistics,
//!   regression, simulation;
//! - [`train`] — data sets, training, evaluation, and opening a trained [`Run`](train::Run);
//! - [`render`] — pictures.
//!
//! [`prelude`] has what most programs need.

pub use cape_core as core;
pub use cape_fit as fit;
pub use cape_graph as graph;
pub use cape_layer as layer;
pub use cape_model as model;
pub use cape_render as render;
pub use cape_train as train;

/// What most programs need.
pub mod prelude {
    pub use burn::tensor::{Device, Tensor};
    pub use cape_core::{
        BodyPose, Mesh, Outfit, SmplModel, parse_device,
        smpl::{ClothedSmpl, ClothingMask, Pose, Smpl, SmplInput, SmplOutput},
    };
    pub use cape_graph::{MeshPyramid, Weighting};
    pub use cape_infer::{Performance, Run, RunConfig, TrainConfig, Wearer};
    pub use cape_model::{Cape, CapeConfig, Generator, LossConfig};
    pub use cape_render::{Image, Object, Style, Tile, View, contact_sheet, portrait};
    pub use cape_synth::{poses, synthetic_body};
    pub use cape_train::Trainer;
}

/// The README's examples, compiled as documentation tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct ReadmeExamples;
