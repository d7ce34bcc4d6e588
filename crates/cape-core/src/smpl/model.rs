use ndarray::{Array2, Array3};

use crate::Mesh;

/// The arrays of an SMPL-like body: what `M(β, θ) = W(T̄ + B_S(β) + B_P(θ), J(β), θ, 𝒲)` (CAPE
/// eq. 1–2) is made of.
///
/// `V` vertices, `J` joints (24), `B` shape directions (10 to 300). Metres.
#[derive(Debug, Clone, PartialEq)]
pub struct SmplModel {
    /// Template `T̄`, `[V, 3]`.
    pub v_template: Array2<f64>,
    /// Shape directions of `B_S`, `[V, 3, B]`.
    pub shapedirs: Array3<f64>,
    /// Pose directions of `B_P`, `[V, 3, 9·(J − 1)]`.
    pub posedirs: Array3<f64>,
    /// Rows that average rest vertices into rest joints, `[J, V]`.
    pub joint_regressor: Array2<f64>,
    /// Blend weights `𝒲`, `[V, J]`.
    pub weights: Array2<f64>,
    /// Each joint's parent, which comes before it; `None` for the root, joint 0. `[J]`.
    pub parents: Vec<Option<usize>>,
    /// Vertex indices of each triangle, `[faces, 3]`.
    pub faces: Vec<[u32; 3]>,
}

impl SmplModel {
    /// Number of vertices `V`.
    pub fn vertices(&self) -> usize {
        self.v_template.nrows()
    }

    /// Number of joints `J`.
    pub fn joints(&self) -> usize {
        self.weights.ncols()
    }

    /// Number of shape directions `B`.
    pub fn betas(&self) -> usize {
        self.shapedirs.dim().2
    }

    /// The template as a mesh.
    pub fn mesh(&self) -> Mesh {
        self.mesh_with(&self.v_template)
    }

    /// The body's triangles with other vertices, metres, `[V, 3]`.
    pub fn mesh_with(&self, vertices: &Array2<f64>) -> Mesh {
        let vertices =
            vertices.rows().into_iter().map(|v| [v[0] as f32, v[1] as f32, v[2] as f32]).collect();
        Mesh { vertices, faces: self.faces.clone() }
    }
}
