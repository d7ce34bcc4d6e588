//! Clothed 3D people in Rust.

pub use cape_core as core;
pub use cape_graph as graph;
pub use cape_model as model;
pub use cape_render as render;
pub use cape_train as train;

/// The README's examples, compiled as documentation tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct ReadmeExamples;
