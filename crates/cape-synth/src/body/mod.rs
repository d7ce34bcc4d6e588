//! A synthetic body in SMPL's layout, made from nothing but numbers.
//!
//! An implicit figure ([`figure`]) is polygonised ([`polygonise`]) and remeshed ([`remesh`]) to
//! SMPL's counts; weights and regressor ([`rig`]), shape directions ([`shape`]) and pose
//! directions ([`blend`]) are derived from the mesh and the figure's joints.

mod blend;
mod figure;
mod polygonise;
mod remesh;
mod rig;
mod sdf;
mod shape;
mod surface;
#[cfg(test)]
mod tests;

use ndarray::{Array2, Array3};

use cape_core::{
    SmplModel,
    joints::{JOINTS, PARENTS},
};

/// Vertices of the synthetic body, as many as SMPL's.
pub const VERTICES: usize = 6890;
/// Triangles of the synthetic body, as many as SMPL's.
pub const FACES: usize = 13776;

/// The synthetic body: a neutral adult of 1.70 m in SMPL's axes, T-pose and kinematic tree, with
/// 6890 vertices, 13776 faces, 10 shape and 207 pose directions.
///
/// The same on every call. Closed, of genus 0, its own mirror image in x = 0. Shape directions, one
/// standard deviation each: stature, weight, limb length, legs against trunk, shoulder width, hip
/// width, belly, chest, muscle, head size.
pub fn synthetic_body() -> SmplModel {
    let skin = surface::symmetric_mesh(&figure::body_sdf());
    let joints = figure::joints();
    let weights = rig::blend_weights(&skin);
    let regressor = rig::joint_regressor(&skin, &joints);
    let shapes = shape::shape_directions(&skin, &weights, &joints);
    let poses = blend::pose_directions(&skin, &weights, &joints);

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
