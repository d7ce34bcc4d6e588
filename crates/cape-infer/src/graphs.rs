//! Mesh graphs of a configuration.

use burn::tensor::Device;
use cape_graph::{DevicePyramid, MeshPyramid, SparseMatrix, Surface};
use cape_model::Graphs;
use sprs::{CsMat, TriMat};

use crate::{Result, RunConfig};

/// Pyramids and edge operator of a mesh on the host.
#[derive(Debug, Clone)]
pub(crate) struct MeshGraphs {
    generator: MeshPyramid,
    discriminator: Option<MeshPyramid>,
    edges: CsMat<f64>,
}

impl MeshGraphs {
    /// The graphs of a mesh that the networks of `config` run on.
    pub(crate) fn build(config: &RunConfig, mesh: impl Into<Surface>) -> Result<Self> {
        let surface = mesh.into();
        let pyramid = |factors: &[u32]| -> Result<MeshPyramid> {
            let factors: Vec<f64> = factors.iter().map(|&factor| f64::from(factor)).collect();
            Ok(MeshPyramid::build(surface.clone(), &factors, config.weighting)?)
        };
        let discriminator = config.model.discriminator.as_ref();
        let edges = surface.edges();
        let mut difference = TriMat::new((edges.len(), surface.vertices.len()));
        for (row, [a, b]) in edges.into_iter().enumerate() {
            difference.add_triplet(row, a as usize, 1.0);
            difference.add_triplet(row, b as usize, -1.0);
        }
        Ok(Self {
            generator: pyramid(&config.model.factors)?,
            discriminator: discriminator.map(|config| pyramid(&config.factors)).transpose()?,
            edges: difference.to_csr(),
        })
    }

    /// The generator's pyramid.
    pub(crate) fn generator(&self) -> &MeshPyramid {
        &self.generator
    }

    /// The graphs on a device.
    pub(crate) fn upload(&self, device: &Device) -> Graphs {
        Graphs {
            generator: DevicePyramid::upload(&self.generator, device),
            discriminator: self.discriminator.as_ref().map(|p| DevicePyramid::upload(p, device)),
            edges: SparseMatrix::new(&self.edges, device),
        }
    }
}

/// Builds the pyramids and the edge operator of a mesh that the networks of `config` run on.
pub fn build_graphs(
    config: &RunConfig,
    mesh: impl Into<Surface>,
    device: &Device,
) -> Result<Graphs> {
    Ok(MeshGraphs::build(config, mesh)?.upload(device))
}
