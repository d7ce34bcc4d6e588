//! Evaluation of the body in `f64` on the host, for data preparation and as the reference in tests.

use glam::{DAffine3, DMat3, DVec3};
use ndarray::{Array1, Array2, ArrayView1, s};

use super::SmplModel;
use crate::{Error, Result, joints::rotation};

/// Vertices and joints of a posed body.
#[derive(Debug, Clone, PartialEq)]
pub struct PosedBody {
    /// Vertices, metres, `[V, 3]`.
    pub vertices: Array2<f64>,
    /// Joints, metres, `[J, 3]`.
    pub joints: Array2<f64>,
}

impl SmplModel {
    /// Unclothed rest shape `T̄ + B_S(β)`, metres, `[V, 3]`; missing coefficients are zero.
    pub fn rest_shape(&self, betas: &[f64]) -> Result<Array2<f64>> {
        if betas.len() > self.betas() {
            return Err(Error::Argument(format!(
                "{} betas, but the body has {}",
                betas.len(),
                self.betas()
            )));
        }
        let mut shape = self.v_template.clone();
        for (direction, &beta) in betas.iter().enumerate() {
            shape.scaled_add(beta, &self.shapedirs.slice(s![.., .., direction]));
        }
        Ok(shape)
    }

    /// Rest joints of a rest shape, `J_regressor · shape`, metres, `[J, 3]`.
    pub fn rest_joints(&self, shape: &Array2<f64>) -> Result<Array2<f64>> {
        self.expect_vertices("shape", shape)?;
        Ok(self.joint_regressor.dot(shape))
    }

    /// Pose blend shapes `B_P(θ)` of axis-angles `[3·J]`, metres, `[V, 3]`.
    pub fn pose_offsets(&self, pose: &[f64]) -> Result<Array2<f64>> {
        Ok(self.offsets(&self.rotations(pose)?))
    }

    /// Unposed body `T(β, θ)` (CAPE eq. 1), metres, `[V, 3]`.
    pub fn unposed_template(&self, betas: &[f64], pose: &[f64]) -> Result<Array2<f64>> {
        Ok(self.rest_shape(betas)? + self.pose_offsets(pose)?)
    }

    /// Posed body (CAPE eq. 2) with the joints of the unclothed body; clothed if `displacement`
    /// `[V, 3]`, metres, is given (eq. 3–4).
    pub fn pose(
        &self,
        betas: &[f64],
        pose: &[f64],
        transl: [f64; 3],
        displacement: Option<&Array2<f64>>,
    ) -> Result<PosedBody> {
        self.pose_shape(&self.rest_shape(betas)?, pose, transl, displacement)
    }

    /// [`pose`](Self::pose) for a body given by its unclothed rest shape `[V, 3]`, such as a
    /// subject's minimal shape.
    pub fn pose_shape(
        &self,
        shape: &Array2<f64>,
        pose: &[f64],
        transl: [f64; 3],
        displacement: Option<&Array2<f64>>,
    ) -> Result<PosedBody> {
        let rest_joints = self.rest_joints(shape)?;
        let rotations = self.rotations(pose)?;
        let mut vertices = shape + &self.offsets(&rotations);
        if let Some(displacement) = displacement {
            self.expect_vertices("displacement", displacement)?;
            vertices += displacement;
        }
        let globals = self.global_transforms(&rotations, &rest_joints);
        let transl = DVec3::from_array(transl);
        let joints = globals.iter().flat_map(|g| (g.translation + transl).to_array());
        let joints = Array1::from_iter(joints);
        let transforms = relative_to_rest(&globals, &rest_joints);
        for (mut vertex, weights) in vertices.rows_mut().into_iter().zip(self.weights.rows()) {
            let moved = blend(&transforms, weights).transform_point3(point(vertex.view())) + transl;
            vertex.assign(&ArrayView1::from(&moved.to_array()));
        }
        let joints = joints
            .into_shape_with_order((self.joints(), 3))
            .map_err(|source| Error::Argument(source.to_string()))?;
        Ok(PosedBody { vertices, joints })
    }

    /// Inverse of [`pose`](Self::pose): maps posed, possibly clothed vertices `[V, 3]` to the
    /// canonical space of the rest shape, `T̄ + B_S(β) + S_clo` (pose blend shapes removed), so that
    /// `unpose(…) − rest_shape(β)` is the clothing displacement.
    pub fn unpose(
        &self,
        vertices: &Array2<f64>,
        betas: &[f64],
        pose: &[f64],
        transl: [f64; 3],
    ) -> Result<Array2<f64>> {
        self.unpose_shape(vertices, &self.rest_shape(betas)?, pose, transl)
    }

    /// [`unpose`](Self::unpose) for a body given by its unclothed rest shape `[V, 3]`.
    pub fn unpose_shape(
        &self,
        vertices: &Array2<f64>,
        shape: &Array2<f64>,
        pose: &[f64],
        transl: [f64; 3],
    ) -> Result<Array2<f64>> {
        self.expect_vertices("vertices", vertices)?;
        let rest_joints = self.rest_joints(shape)?;
        let rotations = self.rotations(pose)?;
        let globals = self.global_transforms(&rotations, &rest_joints);
        let transforms = relative_to_rest(&globals, &rest_joints);
        let transl = DVec3::from_array(transl);
        let mut canonical = vertices.clone();
        let rows = canonical.rows_mut().into_iter().zip(self.weights.rows());
        for (index, (mut vertex, weights)) in rows.enumerate() {
            let blended = blend(&transforms, weights);
            let determinant = blended.matrix3.determinant();
            if determinant.abs() < SINGULAR {
                return Err(singular(index, determinant));
            }
            let rest = blended.inverse().transform_point3(point(vertex.view()) - transl);
            vertex.assign(&ArrayView1::from(&rest.to_array()));
        }
        Ok(canonical - self.offsets(&rotations))
    }

    /// Blended joint transforms `T_j(θ) = Σ_k w_{j,k} G_k(θ)` plus `transl`, from unposed to posed
    /// vertices, `[V]`, of a body given by its unclothed rest shape `[V, 3]`.
    pub fn vertex_transforms(
        &self,
        shape: &Array2<f64>,
        pose: &[f64],
        transl: [f64; 3],
    ) -> Result<Vec<DAffine3>> {
        let rest_joints = self.rest_joints(shape)?;
        let globals = self.global_transforms(&self.rotations(pose)?, &rest_joints);
        let transforms = relative_to_rest(&globals, &rest_joints);
        let transl = DVec3::from_array(transl);
        let moved = |weights| {
            let mut blended = blend(&transforms, weights);
            blended.translation += transl;
            blended
        };
        Ok(self.weights.rows().into_iter().map(moved).collect())
    }

    pub(super) fn expect_vertices(&self, name: &str, array: &Array2<f64>) -> Result<()> {
        let expected = [self.vertices(), 3];
        if array.shape() == expected {
            return Ok(());
        }
        let found = array.shape();
        Err(Error::Argument(format!("{name}: shape {found:?}, expected {expected:?}")))
    }

    fn rotations(&self, pose: &[f64]) -> Result<Vec<DMat3>> {
        let (joints, rest) = pose.as_chunks::<3>();
        if joints.len() != self.joints() || !rest.is_empty() {
            return Err(Error::Argument(format!(
                "pose of {} numbers, expected {}",
                pose.len(),
                3 * self.joints()
            )));
        }
        Ok(joints.iter().map(|&joint| rotation(joint)).collect())
    }

    fn offsets(&self, rotations: &[DMat3]) -> Array2<f64> {
        let feature = rotations.iter().skip(1).flat_map(|&r| {
            // Column-major of the transpose is row-major.
            (r - DMat3::IDENTITY).transpose().to_cols_array()
        });
        let feature = Array1::from_iter(feature);
        let mut offsets = Array2::zeros((self.vertices(), 3));
        for axis in 0..3 {
            offsets.column_mut(axis).assign(&self.posedirs.slice(s![.., axis, ..]).dot(&feature));
        }
        offsets
    }

    /// Global transforms of the joint frames, `[J]`.
    fn global_transforms(&self, rotations: &[DMat3], rest: &Array2<f64>) -> Vec<DAffine3> {
        let mut globals: Vec<DAffine3> = Vec::with_capacity(rotations.len());
        for (joint, (&rotation, parent)) in rotations.iter().zip(&self.parents).enumerate() {
            let at = point(rest.row(joint));
            globals.push(match *parent {
                None => DAffine3::from_mat3_translation(rotation, at),
                Some(parent) => {
                    let offset = at - point(rest.row(parent));
                    globals[parent] * DAffine3::from_mat3_translation(rotation, offset)
                }
            });
        }
        globals
    }
}

/// Smallest determinant of a blended transform that is inverted.
pub(super) const SINGULAR: f64 = 1e-6;

pub(super) fn singular(vertex: usize, determinant: f64) -> Error {
    Error::Argument(format!(
        "vertex {vertex} cannot be unposed: its blended transform is singular (determinant \
         {determinant:e})"
    ))
}

fn point(row: ArrayView1<f64>) -> DVec3 {
    DVec3::new(row[0], row[1], row[2])
}

/// Joint transforms of rest positions, from transforms of joint-local positions.
fn relative_to_rest(globals: &[DAffine3], rest: &Array2<f64>) -> Vec<DAffine3> {
    let moved = |(global, rest): (&DAffine3, _)| *global * DAffine3::from_translation(-point(rest));
    globals.iter().zip(rest.rows()).map(moved).collect()
}

fn blend(transforms: &[DAffine3], weights: ArrayView1<f64>) -> DAffine3 {
    let mut sum = DAffine3::ZERO;
    for (transform, &weight) in transforms.iter().zip(weights).filter(|&(_, &weight)| weight != 0.0)
    {
        sum.matrix3 += transform.matrix3 * weight;
        sum.translation += transform.translation * weight;
    }
    sum
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use proptest::prelude::*;
    use rand::{SeedableRng, rngs::ChaCha8Rng};

    use super::*;
    use crate::smpl::test_model::{random, random_model};

    fn distance(a: &Array2<f64>, b: &Array2<f64>) -> f64 {
        (a - b).iter().fold(0.0, |most, d| d.abs().max(most))
    }

    #[test]
    fn rest_pose_is_the_shape() {
        let model = random_model();
        let posed = model.pose(&[0.3, -1.0], &[0.0; 12], [0.0; 3], None).unwrap();
        let shape = model.rest_shape(&[0.3, -1.0]).unwrap();
        assert!(distance(&posed.vertices, &shape) < 1e-14);
        assert!(distance(&posed.joints, &model.rest_joints(&shape).unwrap()) < 1e-14);
        assert_eq!(model.rest_shape(&[0.3]).unwrap(), model.rest_shape(&[0.3, 0.0]).unwrap());
    }

    #[test]
    fn turning_the_root_turns_the_body_about_it() {
        let mut model = random_model();
        model.posedirs.fill(0.0);
        let mut pose = [0.0; 12];
        pose[1] = PI / 2.0;
        let shape = model.rest_shape(&[]).unwrap();
        let root = model.rest_joints(&shape).unwrap().row(0).to_owned();
        let posed = model.pose(&[], &pose, [1.0, 2.0, 3.0], None).unwrap();
        for (rest, moved) in shape.rows().into_iter().zip(posed.vertices.rows()) {
            let d = &rest - &root;
            let expected = [root[0] + d[2] + 1.0, rest[1] + 2.0, root[2] - d[0] + 3.0];
            for axis in 0..3 {
                assert!((moved[axis] - expected[axis]).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn a_rigid_vertex_follows_its_chain() {
        // Chain of joints 0, 2, 3: a vertex of joint 3 alone moves by the product of the transforms.
        let mut model = random_model();
        model.posedirs.fill(0.0);
        model.weights.row_mut(0).assign(&ndarray::array![0.0, 0.0, 0.0, 1.0]);
        let pose = [0.1, 0.2, 0.3, 0.0, 0.0, 0.0, -0.4, 0.5, 0.6, 0.7, -0.8, 0.9];
        let rest = model.rest_joints(&model.v_template).unwrap();
        let about = |joint: usize, p: DVec3| {
            let at = point(rest.row(joint));
            rotation([pose[3 * joint], pose[3 * joint + 1], pose[3 * joint + 2]]) * (p - at) + at
        };
        let expected = about(0, about(2, about(3, point(model.v_template.row(0)))));
        let posed = model.pose(&[], &pose, [0.0; 3], None).unwrap();
        assert!(point(posed.vertices.row(0)).abs_diff_eq(expected, 1e-12));
        let joint = about(0, about(2, point(rest.row(3))));
        assert!(point(posed.joints.row(3)).abs_diff_eq(joint, 1e-12));
    }

    #[test]
    fn bad_arguments_are_named() {
        let model = random_model();
        let message = |result: Result<PosedBody>| result.unwrap_err().to_string();
        let pose = [0.0; 12];
        assert!(message(model.pose(&[0.0; 3], &pose, [0.0; 3], None)).contains("3 betas"));
        assert!(message(model.pose(&[], &pose[1..], [0.0; 3], None)).contains("expected 12"));
        let short = Array2::zeros((3, 3));
        let failed = message(model.pose(&[], &pose, [0.0; 3], Some(&short)));
        assert!(failed.contains("displacement") && failed.contains("[12, 3]"), "{failed}");
    }

    #[test]
    fn vertex_transforms_pose_the_unposed_body() {
        let model = random_model();
        let pose: Vec<f64> = (0..12).map(|k| (f64::from(k) * 1.7).sin()).collect();
        let shape = model.rest_shape(&[0.4, -0.3]).unwrap();
        let transforms = model.vertex_transforms(&shape, &pose, [1.0, 2.0, 3.0]).unwrap();
        let unposed = model.unposed_template(&[0.4, -0.3], &pose).unwrap();
        let posed = model.pose(&[0.4, -0.3], &pose, [1.0, 2.0, 3.0], None).unwrap().vertices;
        for ((transform, rest), posed) in transforms.iter().zip(unposed.rows()).zip(posed.rows()) {
            assert!(transform.transform_point3(point(rest)).abs_diff_eq(point(posed), 1e-12));
        }
    }

    #[test]
    fn a_singular_blend_is_an_error() {
        let mut model = random_model();
        model.weights.row_mut(5).assign(&ndarray::array![0.0, 0.5, 0.5, 0.0]);
        let mut pose = [0.0; 12];
        pose[3] = PI;
        let vertices = model.v_template.clone();
        let message = model.unpose(&vertices, &[], &pose, [0.0; 3]).unwrap_err().to_string();
        assert!(message.contains("vertex 5"), "{message}");
    }

    proptest! {
        #[test]
        fn unposing_undoes_posing(seed: u64) {
            let rng = &mut ChaCha8Rng::seed_from_u64(seed);
            let model = random_model();
            let pose: Array1<f64> = random(12, 1.0, rng);
            let pose = pose.to_vec();
            let betas = [0.7, -0.2];
            let clothes = random((12, 3), 0.1, rng);
            let transl = [0.3, -0.2, 5.0];
            let posed = model.pose(&betas, &pose, transl, Some(&clothes)).unwrap();
            if let Ok(canonical) = model.unpose(&posed.vertices, &betas, &pose, transl) {
                let found = canonical - model.rest_shape(&betas).unwrap();
                prop_assert!(distance(&found, &clothes) < 1e-7);
            }
        }
    }
}
