//! Mesh graphs of a configuration.

use burn::tensor::Device;
use cape_graph::{DevicePyramid, MeshPyramid, SparseMatrix, Surface};
use cape_model::Graphs;
use sprs::TriMat;

use crate::{Result, RunConfig};

/// Builds the pyramids and the edge operator of a mesh that the networks of `config` run on.
pub fn build_graphs(
    config: &RunConfig,
    mesh: impl Into<Surface>,
    device: &Device,
) -> Result<Graphs> {
    let surface = mesh.into();
    let pyramid = |factors: &[u32]| -> Result<DevicePyramid> {
        let factors: Vec<f64> = factors.iter().map(|&factor| f64::from(factor)).collect();
        let pyramid = MeshPyramid::build(surface.clone(), &factors, config.weighting)?;
        Ok(DevicePyramid::upload(&pyramid, device))
    };
    let discriminator = config.model.discriminator.as_ref();
    let edges = surface.edges();
    let mut difference = TriMat::new((edges.len(), surface.vertices.len()));
    for (row, [a, b]) in edges.into_iter().enumerate() {
        difference.add_triplet(row, a as usize, 1.0);
        difference.add_triplet(row, b as usize, -1.0);
    }
    Ok(Graphs {
        generator: pyramid(&config.model.factors)?,
        discriminator: discriminator.map(|config| pyramid(&config.factors)).transpose()?,
        edges: SparseMatrix::new(&difference.to_csr(), device),
    })
}
