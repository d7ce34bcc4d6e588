//! Trained clothing models and SMPL bodies as ONNX graphs, for other languages, engines and browsers.
//!
//! Three graphs make a dressed body: the decoder, from a latent code, a pose and an outfit to
//! displacements in metres; the encoder back; and SMPL, from shape, pose, translation and displacements
//! to vertices and joints. Inputs and outputs are f32 with a dynamic batch; operators are those of opset
//! 18, without extensions.
//!
//! ```
//! use cape_onnx::WeightPrecision;
//!
//! let model = cape_weights::pretrained(&burn::tensor::Device::default())?;
//! let directory = tempfile::tempdir()?;
//! let files = cape_onnx::export_model(&model, directory.path(), WeightPrecision::Single)?;
//! assert!(files[0].path.ends_with("decoder.onnx"));
//! assert_eq!(files[0].inputs, ["code [batch, 32]", "pose [batch, 72]", "outfit [batch, 4]"]);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod body;
mod error;
mod graph;
mod layers;
mod metadata;
mod model;
mod networks;
mod precision;
mod proto;
mod rotations;
mod sparse;

pub use body::export_body;
pub use error::{Error, Result};
pub use model::{ExportedFile, GraphTensor, OnnxModel, export_model};
pub use networks::{export_decoder, export_encoder};
pub use precision::WeightPrecision;

/// Modules in JavaScript, by name, that compute the graphs in browsers and in Node without anything else:
/// `new Graph(bytes).run(inputs)` of `graph.js`, with the numbers of each input by name.
pub const JAVASCRIPT: [(&str, &str); 5] = [
    ("graph.js", include_str!("../web/graph.js")),
    ("onnx.js", include_str!("../web/onnx.js")),
    ("operators.js", include_str!("../web/operators.js")),
    ("products.js", include_str!("../web/products.js")),
    ("sparse.js", include_str!("../web/sparse.js")),
];

#[cfg(test)]
mod tests;
