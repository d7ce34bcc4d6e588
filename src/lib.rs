//! Clothed 3D people in Rust: SMPL bodies, CAPE's generative clothing, and what it takes to train
//! and evaluate it, on [Burn](https://burn.dev).
//!
//! Clothing is a **displacement** of the vertices of a body in its rest pose,
//! `T_clo = T(β, θ) + S_clo(z, θ, c)`: the body with shape β and pose θ, dressed in the outfit c by
//! the latent code z. The crates, in the order data flow through them:
//!
//! - [`core`] — meshes and their files, SMPL and the clothing term, outfits;
//! - [`synth`] — built-in bodies, motions, a wardrobe and captures;
//! - [`data`] — raw and packed data sets, splits, normalisation, loaders;
//! - [`graph`] — mesh pyramids and graph operations on tensors;
//! - [`model`] — the networks and losses;
//! - [`infer`] — a trained [`Run`](infer::Run): sample, encode, decode, dress, animate;
//! - [`train`] — objective, optimisers, the [`Trainer`](train::Trainer);
//! - [`eval`] — evaluation, comparison, table 2, benchmarks;
//! - [`fit`] — bodies and their clothes from keypoints, silhouettes and scans (SMPLify, CAPE §6.3);
//! - [`cloth`] — a cloth simulator;
//! - [`layer`] — clothing of its own topology (Yang et al., ECCV 2018): association, statistics,
//!   regression;
//! - [`stats`] — principal components, densities, error statistics, paired tests;
//! - `weights` — the built-in model, with the feature of this name;
//! - [`study`] — perceptual studies (CAPE §6.2);
//! - [`render`] — pictures.
//!
//! [`prelude`] has what most programs need. [`burn`], [`glam`] and [`ndarray`], whose types are in
//! signatures, are re-exported.
//!
//! ```
//! use cape::{core::Outfit, synth::{Wardrobe, synthetic_body}};
//!
//! // The sculpted body in a T-shirt and long trousers, without any trained model.
//! let body = synthetic_body();
//! let wardrobe = Wardrobe::new(&body, 7)?;
//! let garment = wardrobe.fit(wardrobe.outfit_style(0, Outfit::SHORT_LONG, 0)?);
//! let clothes = wardrobe.displacement(&garment, &[0.0; 72], 0.0, None)?;
//! let dressed = body.pose(&[1.0, -0.5], &[0.0; 72], [0.0; 3], Some(&clothes))?;
//! assert_eq!(dressed.vertices.dim(), (6890, 3));
//! # Ok::<(), cape::core::Error>(())
//! ```

pub use burn;
pub use glam;
pub use ndarray;

pub use cape_cloth as cloth;
pub use cape_core as core;
pub use cape_data as data;
pub use cape_eval as eval;
pub use cape_fit as fit;
pub use cape_graph as graph;
pub use cape_infer as infer;
pub use cape_layer as layer;
pub use cape_model as model;
pub use cape_render as render;
pub use cape_stats as stats;
pub use cape_study as study;
pub use cape_synth as synth;
pub use cape_train as train;
pub use cape_wardrobe as wardrobe;
#[cfg(feature = "weights")]
pub use cape_weights as weights;

/// The names that most programs need.
pub mod prelude {
    pub use burn::tensor::{Device, Tensor};
    pub use cape_core::{BodyPose, Mesh, Outfit, SmplModel};
    pub use cape_graph::MeshPyramid;
    pub use cape_infer::{AnimatedBody, BodySpec, ClothedModel, Run, RunConfig};
    pub use cape_model::CapeConfig;
    pub use cape_train::Trainer;
}

/// The README's examples, compiled as documentation tests.
#[cfg(all(doctest, feature = "weights"))]
#[doc = include_str!("../README.md")]
struct ReadmeExamples;

/// The book's examples of the library, compiled as documentation tests.
#[cfg(doctest)]
#[doc = include_str!("../docs/book/src/guide/library.md")]
struct BookExamples;
