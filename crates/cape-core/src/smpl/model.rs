use ndarray::{Array, Array2, Array3, Dimension};
use sha2::{Digest, Sha256};

use crate::{Error, Mesh, Result};

/// Arrays of an SMPL-like body `M(β, θ) = W(T̄ + B_S(β) + B_P(θ), J(β), θ, 𝒲)` (CAPE eq. 1–2).
///
/// `V` vertices, `J` joints (24 in SMPL), `B` shape directions (10 to 300); lengths in metres.
///
/// ```
/// use cape_core::SmplModel;
/// use cape_synth::synthetic_body;
///
/// let body = synthetic_body();
/// assert_eq!((body.vertices(), body.joints(), body.betas()), (6890, 24, 10));
/// let directory = tempfile::tempdir()?;
/// let path = directory.path().join("body.npz");
/// body.save(&path)?;
/// assert_eq!(SmplModel::load(&path)?, body);
///
/// // Unposing is the inverse of posing.
/// let mut pose = [0.0; 72];
/// pose[3 * 18] = 0.8;
/// let betas = [1.0, -0.5];
/// let posed = body.pose(&betas, &pose, [0., 1., 0.], None)?;
/// let rest = body.unpose(&posed.vertices, &betas, &pose, [0., 1., 0.])?;
/// let difference = rest - body.rest_shape(&betas)?;
/// assert!(difference.iter().all(|x| x.abs() < 1e-9));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct SmplModel {
    /// Template vertices `T̄`, metres, `[V, 3]`.
    pub v_template: Array2<f64>,
    /// Shape directions of `B_S`, `[V, 3, B]`.
    pub shapedirs: Array3<f64>,
    /// Pose directions of `B_P`, `[V, 3, 9·(J − 1)]`.
    pub posedirs: Array3<f64>,
    /// Joint regressor, from rest vertices to rest joints, `[J, V]`.
    pub joint_regressor: Array2<f64>,
    /// Blend weights `𝒲`, `[V, J]`.
    pub weights: Array2<f64>,
    /// Parent of each joint, an earlier one; `None` for the root, joint 0. `[J]`.
    pub parents: Vec<Option<usize>>,
    /// Vertex indices of each triangle, `[faces, 3]`.
    pub faces: Vec<[u32; 3]>,
}

/// Error in one array of a body.
pub(super) struct FieldError {
    /// Name of the array in body files.
    pub(super) field: &'static str,
    /// Found and expected content.
    pub(super) message: String,
}

impl SmplModel {
    /// SHA-256 of the arrays, hexadecimal, which tells bodies apart whatever file they are in: of the
    /// little-endian `f64` of `v_template`, `shapedirs`, `posedirs`, `joint_regressor` and `weights`,
    /// then the parents (−1 for the root) and `faces` as `i64`.
    pub fn sha256(&self) -> String {
        let mut hash = Sha256::new();
        let tables = [&self.v_template, &self.joint_regressor, &self.weights];
        let [template, regressor, weights] = tables.map(|table| table.iter().copied());
        let directions = self.shapedirs.iter().chain(&self.posedirs).copied();
        let numbers = template.chain(directions).chain(regressor).chain(weights);
        let parents = self.parents.iter().map(|parent| parent.map_or(-1, |parent| parent as i64));
        let corners = self.faces.as_flattened().iter().map(|&corner| i64::from(corner));
        // In blocks: single numbers are slow to hash.
        let mut block = Vec::with_capacity(1 << 16);
        let words =
            numbers.map(f64::to_le_bytes).chain(parents.chain(corners).map(i64::to_le_bytes));
        for word in words {
            block.extend(word);
            if block.len() == block.capacity() {
                hash.update(&block);
                block.clear();
            }
        }
        hash.update(&block);
        crate::hex(hash.finalize())
    }

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

    /// Number of pose directions, `9·(J − 1)`.
    pub fn pose_blends(&self) -> usize {
        9 * self.joints().saturating_sub(1)
    }

    /// The template as a mesh.
    pub fn mesh(&self) -> Mesh {
        self.mesh_with(&self.v_template)
    }

    /// Mesh of the body's triangles and the given vertices, metres, `[V, 3]`.
    pub fn mesh_with(&self, vertices: &Array2<f64>) -> Mesh {
        let vertices =
            vertices.rows().into_iter().map(|v| [v[0] as f32, v[1] as f32, v[2] as f32]).collect();
        Mesh { vertices, faces: self.faces.clone() }
    }

    /// Checks shapes, the order of the joints, the range of the faces, and that all numbers are
    /// finite. [`load`](Self::load) does so too.
    pub fn validate(&self) -> Result<()> {
        self.check().map_err(|FieldError { field, message }| {
            Error::Argument(format!("body: `{field}`: {message}"))
        })
    }

    pub(super) fn check(&self) -> Result<(), FieldError> {
        let (v, j) = (self.vertices(), self.joints());
        let shape = |field, found: &[usize], expected: &[usize]| {
            if found == expected {
                return Ok(());
            }
            Err(FieldError { field, message: format!("shape {found:?}, expected {expected:?}") })
        };
        let require = |holds: bool, field, message: String| {
            if holds { Ok(()) } else { Err(FieldError { field, message }) }
        };
        require(v > 0, "v_template", "no vertices".into())?;
        shape("v_template", self.v_template.shape(), &[v, 3])?;
        shape("weights", self.weights.shape(), &[v, j])?;
        require(j > 1, "weights", format!("{j} joints, expected at least 2"))?;
        shape("shapedirs", self.shapedirs.shape(), &[v, 3, self.betas()])?;
        require(self.betas() > 0, "shapedirs", "no shape directions, expected at least 1".into())?;
        shape("posedirs", self.posedirs.shape(), &[v, 3, self.pose_blends()])?;
        shape("J_regressor", self.joint_regressor.shape(), &[j, v])?;
        shape("kintree_table", &[self.parents.len()], &[j])?;
        for (joint, &parent) in self.parents.iter().enumerate() {
            let expected = if joint == 0 { "none (2^32 - 1)" } else { "an earlier joint" };
            require(
                parent.map_or(joint == 0, |parent| parent < joint),
                "kintree_table",
                match parent {
                    Some(parent) => {
                        format!("joint {joint} has parent {parent}, expected {expected}")
                    }
                    None => format!("joint {joint} has no parent, expected {expected}"),
                },
            )?;
        }
        let outside = |face: &[u32; 3]| face.iter().any(|&corner| corner as usize >= v);
        if let Some(index) = self.faces.iter().position(outside) {
            let face = self.faces[index];
            let message = format!("face {index} is {face:?}, but there are {v} vertices");
            return Err(FieldError { field: "f", message });
        }
        finite("v_template", &self.v_template)?;
        finite("weights", &self.weights)?;
        finite("shapedirs", &self.shapedirs)?;
        finite("posedirs", &self.posedirs)?;
        finite("J_regressor", &self.joint_regressor)
    }
}

fn finite<D: Dimension>(field: &'static str, values: &Array<f64, D>) -> Result<(), FieldError> {
    // Without a branch for each number.
    if values.fold(true, |all, value| all & value.is_finite()) {
        return Ok(());
    }
    let at = values.iter().position(|value| !value.is_finite()).unwrap_or(0);
    Err(FieldError { field, message: format!("number {at} is not finite") })
}
