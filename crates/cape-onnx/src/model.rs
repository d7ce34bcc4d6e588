//! ONNX models and their files.

use std::{
    io::Write,
    path::{Path, PathBuf},
};

use cape_infer::ClothedModel;
use prost::Message;
use serde::Serialize;

use crate::{
    Result, WeightPrecision, export_body, export_decoder, export_encoder,
    proto::{Dimension, ModelProto, StringStringEntryProto, ValueInfoProto},
};

/// A computation in the ONNX format: f32 inputs and outputs whose first dimension is the batch.
///
/// ```
/// use cape_core::ClothingMask;
/// use cape_onnx::WeightPrecision;
///
/// let body = cape_synth::synthetic_body();
/// let mask = ClothingMask::from_weights(&body)?;
/// let model = cape_onnx::export_body(&body, &mask, WeightPrecision::Half)?
///     .with_entry("licence", "CC0");
/// assert!(model.entries().any(|entry| entry == ("units", "metres, radians")));
/// let directory = tempfile::tempdir()?;
/// model.save(directory.path().join("smpl.onnx"))?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct OnnxModel {
    proto: ModelProto,
}

/// An input or output of a graph.
///
/// ```
/// use cape_core::ClothingMask;
///
/// let body = cape_synth::synthetic_body();
/// let mask = ClothingMask::from_weights(&body)?;
/// let graph = cape_onnx::export_body(&body, &mask, Default::default())?;
/// let shapes: Vec<String> = graph.inputs().iter().map(ToString::to_string).collect();
/// assert_eq!(shapes[..2], ["betas [batch, 10]", "pose [batch, 72]"]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GraphTensor {
    /// Name in the graph.
    pub name: String,
    /// Extents; `None` is the batch.
    pub shape: Vec<Option<usize>>,
}

/// A file of an exported model.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct ExportedFile {
    /// Path of the file.
    pub path: PathBuf,
    /// Inputs with their shapes.
    pub inputs: Vec<String>,
    /// Outputs with their shapes.
    pub outputs: Vec<String>,
    /// Number of operators.
    pub nodes: usize,
    /// Size of the file.
    pub bytes: usize,
}

/// Writes `decoder.onnx`, `encoder.onnx` and `smpl.onnx` of a model into `directory`, which must exist.
///
/// # Errors
/// If a file cannot be written, the model's body does not have SMPL's joints, or a weight is too large
/// for half precision.
pub fn export_model(
    model: &ClothedModel,
    directory: impl AsRef<Path>,
    precision: WeightPrecision,
) -> Result<Vec<ExportedFile>> {
    let graphs = [
        ("decoder.onnx", export_decoder(model, precision)?),
        ("encoder.onnx", export_encoder(model, precision)?),
        ("smpl.onnx", export_body(model.body(), model.mask(), precision)?),
    ];
    graphs
        .into_iter()
        .map(|(name, graph)| {
            let path = directory.as_ref().join(name);
            let bytes = graph.save(&path)?;
            let lines =
                |tensors: Vec<GraphTensor>| tensors.iter().map(ToString::to_string).collect();
            Ok(ExportedFile {
                inputs: lines(graph.inputs()),
                outputs: lines(graph.outputs()),
                nodes: graph.nodes(),
                bytes,
                path,
            })
        })
        .collect()
}

impl OnnxModel {
    pub(crate) fn new(proto: ModelProto) -> Self {
        Self { proto }
    }

    #[cfg(test)]
    pub(crate) fn proto(&self) -> &ModelProto {
        &self.proto
    }

    /// The same with an entry of the metadata.
    #[must_use]
    pub fn with_entry(mut self, key: &str, value: &str) -> Self {
        let entry = StringStringEntryProto { key: key.to_owned(), value: value.to_owned() };
        self.proto.metadata_props.push(entry);
        self
    }

    /// Entries of the metadata: names and values.
    pub fn entries(&self) -> impl Iterator<Item = (&str, &str)> {
        let entries = self.proto.metadata_props.iter();
        entries.map(|entry| (entry.key.as_str(), entry.value.as_str()))
    }

    /// Inputs in their order.
    pub fn inputs(&self) -> Vec<GraphTensor> {
        self.proto.graph.iter().flat_map(|graph| &graph.input).map(GraphTensor::new).collect()
    }

    /// Outputs in their order.
    pub fn outputs(&self) -> Vec<GraphTensor> {
        self.proto.graph.iter().flat_map(|graph| &graph.output).map(GraphTensor::new).collect()
    }

    /// Number of operators.
    pub fn nodes(&self) -> usize {
        self.proto.graph.as_ref().map_or(0, |graph| graph.node.len())
    }

    /// Bytes of the file.
    pub fn encode(&self) -> Vec<u8> {
        self.proto.encode_to_vec()
    }

    /// Writes the file, atomically, and returns its size in bytes.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<usize> {
        let bytes = self.encode();
        cape_core::write_atomically(path.as_ref(), |file| file.write_all(&bytes))?;
        Ok(bytes.len())
    }
}

impl GraphTensor {
    fn new(info: &ValueInfoProto) -> Self {
        let tensor = info.r#type.as_ref().and_then(|kind| kind.tensor_type.as_ref());
        let extents = tensor.and_then(|tensor| tensor.shape.as_ref());
        let shape = extents.iter().flat_map(|shape| &shape.dim).map(|dim| match dim.value {
            Some(Dimension::Value(extent)) => usize::try_from(extent).ok(),
            _ => None,
        });
        Self { name: info.name.clone(), shape: shape.collect() }
    }
}

impl std::fmt::Display for GraphTensor {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let extents = self.shape.iter().map(|extent| {
            extent.map_or_else(|| crate::graph::BATCH.to_owned(), |extent| extent.to_string())
        });
        write!(f, "{} [{}]", self.name, extents.collect::<Vec<_>>().join(", "))
    }
}
