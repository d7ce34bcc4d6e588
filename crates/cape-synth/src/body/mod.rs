//! A synthetic body in SMPL's layout, built from an implicit surface.
//!
//! A signed distance field ([`figure`]) is polygonised ([`polygonise`]) and remeshed ([`remesh`]) to
//! SMPL's numbers of vertices and faces; blend weights and joint regressor ([`rig`]), shape directions
//! ([`shape`]) and pose directions ([`blend`]) derive from the mesh and the joint positions.

mod blend;
mod embedded;
#[cfg(test)]
mod embedded_tests;
mod figure;
mod polygonise;
mod remesh;
mod rig;
mod sdf;
mod shape;
mod stored;
mod surface;
#[cfg(test)]
mod tests;
mod volume;

pub use embedded::embedded_body;
pub use stored::HalfBody;

use ndarray::{Array2, Array3};

use cape_core::{
    SmplModel,
    joints::{JOINTS, PARENTS},
};

/// Number of vertices of the synthetic body, that of SMPL.
pub const VERTICES: usize = 6890;
/// Number of triangles of the synthetic body, that of SMPL.
pub const FACES: usize = 13776;

/// Synthetic body: a neutral adult of 1.70 m in SMPL's axes, T-pose and kinematic tree, with 6890
/// vertices, 13776 faces, 10 shape directions and 207 pose directions.
///
/// The mesh is closed, of genus 0, symmetric in x = 0, and the same on every call. Shape directions,
/// one standard deviation each: stature, weight, limb length, leg length relative to the trunk, shoulder
/// width, hip width, belly, chest, muscle, head size.
///
/// ```
/// use cape_synth::{BODY_VERTICES, synthetic_body};
///
/// let body = synthetic_body();
/// assert_eq!((body.vertices(), body.joints(), body.betas()), (BODY_VERTICES, 24, 10));
/// ```
pub fn synthetic_body() -> SmplModel {
    let skin = surface::symmetric_mesh(&figure::body_sdf());
    let joints = figure::joints();
    let weights = rig::blend_weights(&skin);
    let regressor = rig::joint_regressor(&skin, &joints);
    let shapes = shape::shape_directions(&skin, &weights, &joints);
    let poses = blend::pose_directions(&skin.vertices, &weights, &joints);

    let count = skin.vertices.len();
    let mut joint_regressor = Array2::zeros((JOINTS, count));
    for (joint, row) in regressor.iter().enumerate() {
        for &(v, w) in row {
            joint_regressor[[joint, v]] = w;
        }
    }
    let columns = (JOINTS - 1) * 9;
    SmplModel {
        v_template: Array2::from_shape_fn((count, 3), |(v, c)| skin.vertices[v][c]),
        shapedirs: Array3::from_shape_fn((count, 3, shape::DIRECTIONS), |(v, c, d)| {
            shapes[d][v][c]
        }),
        posedirs: Array3::from_shape_fn((count, 3, columns), |(v, c, d)| poses[v][d][c]),
        joint_regressor,
        weights: Array2::from_shape_fn((count, JOINTS), |(v, j)| weights[v][j]),
        parents: PARENTS.to_vec(),
        faces: skin.faces,
    }
}
