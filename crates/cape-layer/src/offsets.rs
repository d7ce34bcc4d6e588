//! Clothing as offsets from the body in a standard pose (Yang et al. 2018, eq. 1, 3 and 4).

use cape_core::{SmplModel, smpl::StandardPose};
use glam::{DAffine3, DVec3};
use ndarray::{Array2, Array3, ArrayView1, ArrayView2, ArrayView3};

use crate::{Error, Result, associate::Association};
use cape_core::expect_finite;
use cape_core::geometry::points;

/// Least determinant of a blended transform that is inverted; a rigid motion has 1.
const NEARLY_SINGULAR: f64 = 1e-3;

/// A body in one frame, and the transform of each vertex from the standard pose.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use cape_synth::synthetic_body;
/// use cape_core::smpl::StandardPose;
/// use cape_layer::BodyFrame;
///
/// // A body in its standard pose, raised by 1 m.
/// let body = synthetic_body();
/// let (shape, standard) = (body.rest_shape(&[])?, StandardPose::T);
/// let frame = BodyFrame::new(&body, &shape, &[0.0; 72], [0.0, 1.0, 0.0], &standard)?;
/// assert!((frame.posed[0] - frame.standard[0] - glam::DVec3::Y).length() < 1e-9);
/// // Offsets give the clothing back.
/// let (set, association) = patch(&body)?;
/// let clothing = set.sequences[0].clothing.index_axis(ndarray::Axis(0), 3);
/// let offsets = association.offsets(&frame, clothing)?;
/// let again = association.offset_frame(&frame)?.dress(&association, offsets.view())?;
/// assert!((&again - &clothing).iter().all(|gap| gap.abs() < 1e-9));
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct BodyFrame {
    /// Vertices in the pose of the frame, with its pose blend shapes, metres, `[V]`.
    pub posed: Vec<DVec3>,
    /// Vertices in the standard pose, with the pose blend shapes of the frame, metres, `[V]`.
    pub standard: Vec<DVec3>,
    /// Transforms `T_j(θ)` from the standard pose to the frame, translation included, `[V]` (eq. 1).
    pub transforms: Vec<DAffine3>,
}

impl BodyFrame {
    /// Poses the unclothed rest shape `shape` `[V, 3]`, metres, by axis-angles `[3 · joints]`,
    /// radians, and a translation, metres.
    ///
    /// # Errors
    /// If sizes do not fit the body, numbers are not finite, or the standard pose is degenerate.
    pub fn new(
        model: &SmplModel,
        shape: &Array2<f64>,
        pose: &[f64],
        transl: [f64; 3],
        standard: &StandardPose,
    ) -> Result<Self> {
        expect_finite("pose", pose)?;
        expect_finite("transl", &transl)?;
        let angles = standard.angles(model.joints());
        let to_standard = model.vertex_transforms(shape, &angles, [0.0; 3])?;
        let to_frame = model.vertex_transforms(shape, pose, transl)?;
        let unposed = points((shape + &model.pose_offsets(pose)?).view());
        let moved = |transforms: &[DAffine3]| {
            let pairs = transforms.iter().zip(&unposed);
            pairs.map(|(t, &p)| t.transform_point3(p)).collect()
        };
        let mut transforms = Vec::with_capacity(to_frame.len());
        for (vertex, (frame, standard)) in to_frame.iter().zip(&to_standard).enumerate() {
            let determinant = standard.matrix3.determinant();
            if determinant.abs() < NEARLY_SINGULAR {
                return Err(Error::argument(format!(
                    "standard pose: the transform of body vertex {vertex} is nearly singular \
                     (determinant {determinant:.2e})"
                )));
            }
            transforms.push(*frame * standard.inverse());
        }
        Ok(Self { posed: moved(&to_frame), standard: moved(&to_standard), transforms })
    }
}

impl Association {
    /// Blended transform `Σ_i ω_i T_{I_j[i]}(θ)` of each clothing vertex, `[n_v]` (eq. 3).
    fn blends(&self, body: &BodyFrame) -> Result<Vec<DAffine3>> {
        self.check_body(body)?;
        let rows = self.indices.rows().into_iter().zip(self.weights.rows());
        let mut blends = Vec::with_capacity(self.clothing_vertices());
        for (vertex, (indices, weights)) in rows.enumerate() {
            let mut sum = DAffine3::ZERO;
            for (&index, &weight) in indices.iter().zip(weights) {
                let transform = &body.transforms[index as usize];
                sum.matrix3 += transform.matrix3 * weight;
                sum.translation += transform.translation * weight;
            }
            let determinant = sum.matrix3.determinant();
            if determinant.is_nan() || determinant < NEARLY_SINGULAR {
                return Err(Error::Singular { vertex, determinant });
            }
            blends.push(sum);
        }
        Ok(blends)
    }

    /// Unposes the clothing of one frame, metres, `[n_v, 3]`: vertices `ṽ_j^C` in the standard
    /// pose, each by the inverse of its blended transform, metres, `[n_v, 3]` (eq. 3).
    ///
    /// # Errors
    /// If shapes do not fit, numbers are not finite, or a blended transform has no inverse.
    pub fn unpose(&self, body: &BodyFrame, clothing: ArrayView2<'_, f64>) -> Result<Array2<f64>> {
        self.check_clothing(clothing.shape())?;
        expect_finite("clothing", clothing)?;
        let blends = self.blends(body)?;
        let mut standard = Array2::zeros((self.clothing_vertices(), 3));
        for ((blend, at), mut row) in blends.iter().zip(points(clothing)).zip(standard.rows_mut()) {
            let unposed = blend.inverse().transform_point3(at).to_array();
            row.iter_mut().zip(unposed).for_each(|(to, from)| *to = from);
        }
        Ok(standard)
    }

    /// Offsets `d_{j,i} = ṽ_j^C − ṽ^B_{I_j[i]}` of the clothing of one frame, metres, `[n_v, 3]`,
    /// from the body in the standard pose: metres, `[n_v, n_f, 3]` (eq. 4).
    ///
    /// # Errors
    /// As of [`unpose`](Self::unpose).
    pub fn offsets(&self, body: &BodyFrame, clothing: ArrayView2<'_, f64>) -> Result<Array3<f64>> {
        let standard = points(self.unpose(body, clothing)?.view());
        let mut offsets = Array3::zeros((self.clothing_vertices(), self.neighbours(), 3));
        for (j, standard) in standard.into_iter().enumerate() {
            for (i, &index) in self.indices.row(j).iter().enumerate() {
                let offset = standard - body.standard[index as usize];
                for axis in 0..3 {
                    offsets[(j, i, axis)] = offset[axis];
                }
            }
        }
        Ok(offsets)
    }

    /// Inverse of [`offsets`](Self::offsets): clothing of offsets `[n_v, n_f, 3]` on a body,
    /// metres, `[n_v, 3]`. The paper does not number this step; here the `n_f` positions that the
    /// offsets of a vertex give, which differ if the offsets are predicted, are averaged by the
    /// weights `ω`.
    ///
    /// # Errors
    /// If shapes do not fit or a blended transform has no inverse.
    pub fn dress(&self, body: &BodyFrame, offsets: ArrayView3<'_, f64>) -> Result<Array2<f64>> {
        self.offset_frame(body)?.dress(self, offsets)
    }

    /// Clothing `[n_v, 3]`, metres, of the body `from` on the body `to`, at the same offsets: the transfer
    /// of captured clothing to another shape (figures 2 and 5 of the paper).
    ///
    /// # Errors
    /// As of [`offsets`](Self::offsets) and [`dress`](Self::dress).
    pub fn transfer(
        &self,
        from: &BodyFrame,
        clothing: ArrayView2<'_, f64>,
        to: &BodyFrame,
    ) -> Result<Array2<f64>> {
        self.dress(to, self.offsets(from, clothing)?.view())
    }

    /// Blended transforms and positions of a body for repeated calls of [`OffsetFrame::dress`].
    ///
    /// # Errors
    /// If the body has too few vertices or a blended transform has no inverse.
    pub fn offset_frame(&self, body: &BodyFrame) -> Result<OffsetFrame> {
        let blends = self.blends(body)?;
        let rows = self.indices.rows().into_iter().zip(self.weights.rows());
        let middle = |(indices, weights): (ArrayView1<'_, u32>, ArrayView1<'_, f64>)| {
            let near = indices.iter().map(|&index| body.standard[index as usize]);
            near.zip(weights).map(|(at, &weight)| at * weight).sum()
        };
        Ok(OffsetFrame { middles: rows.map(middle).collect(), blends })
    }

    fn check_body(&self, body: &BodyFrame) -> Result<()> {
        let most = self.indices.iter().copied().max().unwrap_or(0) as usize;
        if most < body.transforms.len() {
            return Ok(());
        }
        Err(Error::argument(format!(
            "association: body vertex {most} of {}: the association is of another body",
            body.transforms.len()
        )))
    }

    fn check_clothing(&self, found: &[usize]) -> Result<()> {
        let expected = [self.clothing_vertices(), 3];
        if found == expected {
            return Ok(());
        }
        Err(Error::argument(format!("clothing of shape {found:?}, expected {expected:?}")))
    }
}

/// Blended transforms and body positions of the clothing vertices in one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct OffsetFrame {
    /// Weighted mean of the body vertices that each clothing vertex follows, in the standard pose,
    /// metres, `[n_v]`.
    middles: Vec<DVec3>,
    /// Blended transforms, `[n_v]` (eq. 3).
    blends: Vec<DAffine3>,
}

impl OffsetFrame {
    /// Clothing of offsets `[n_v, n_f, 3]`, metres, `[n_v, 3]`: [`Association::dress`].
    ///
    /// # Errors
    /// If the offsets have another shape or the association has other clothing vertices.
    pub fn dress(
        &self,
        association: &Association,
        offsets: ArrayView3<'_, f64>,
    ) -> Result<Array2<f64>> {
        let expected = [self.blends.len(), association.neighbours(), 3];
        if offsets.shape() != expected || association.clothing_vertices() != self.blends.len() {
            return Err(Error::argument(format!(
                "offsets of shape {:?}, expected {expected:?}",
                offsets.shape()
            )));
        }
        let mut clothing = Array2::zeros((self.blends.len(), 3));
        for (j, (blend, &middle)) in self.blends.iter().zip(&self.middles).enumerate() {
            let mut standard = middle;
            for (i, &weight) in association.weights.row(j).iter().enumerate() {
                let offset = DVec3::from_array([0, 1, 2].map(|axis| offsets[(j, i, axis)]));
                standard += offset * weight;
            }
            let posed = blend.transform_point3(standard);
            for axis in 0..3 {
                clothing[(j, axis)] = posed[axis];
            }
        }
        Ok(clothing)
    }
}

#[cfg(test)]
mod tests {
    use ndarray::arr2;
    use proptest::prelude::*;

    use super::*;

    fn body(transforms: Vec<DAffine3>) -> BodyFrame {
        let standard: Vec<DVec3> =
            (0..transforms.len()).map(|k| DVec3::new(k as f64, 0.5, -0.2)).collect();
        let posed = transforms.iter().zip(&standard).map(|(t, &p)| t.transform_point3(p)).collect();
        BodyFrame { posed, standard, transforms }
    }

    fn association() -> Association {
        let indices = arr2(&[[0, 1], [1, 2], [2, 0]]);
        Association::new(indices, arr2(&[[0.5, 0.5], [0.9, 0.1], [1.0, 0.0]]), 3).unwrap()
    }

    proptest! {
        #[test]
        fn dressing_undoes_offsets(
            turns in prop::collection::vec(prop::array::uniform3(-1.0f64..1.0), 3),
            moves in prop::collection::vec(prop::array::uniform3(-2.0f64..2.0), 3),
            clothing in prop::collection::vec(-1.0f64..1.0, 9),
        ) {
            let transforms = turns.iter().zip(&moves).map(|(&turn, &shift)| {
                let turn = glam::DQuat::from_scaled_axis(DVec3::from(turn));
                DAffine3::from_rotation_translation(turn, DVec3::from(shift))
            });
            let body = body(transforms.collect());
            let clothing = Array2::from_shape_vec((3, 3), clothing).unwrap();
            let association = association();
            if let Ok(offsets) = association.offsets(&body, clothing.view()) {
                let back = association.dress(&body, offsets.view()).unwrap();
                prop_assert!((back - clothing).iter().all(|d| d.abs() < 1e-9));
            }
        }
    }

    #[test]
    fn at_rest_an_offset_is_a_difference() {
        let body = body(vec![DAffine3::IDENTITY; 3]);
        let clothing = arr2(&[[0.3, 0.4, 0.5], [1.0, 2.0, 3.0], [0.0, 0.0, 0.0]]);
        let offsets = association().offsets(&body, clothing.view()).unwrap();
        let expected = clothing[(1, 0)] - 2.0;
        assert!((offsets[(1, 1, 0)] - expected).abs() < 1e-15);
    }

    #[test]
    fn opposite_turns_cannot_be_undone() {
        let half = DAffine3::from_rotation_y(std::f64::consts::PI);
        let body = body(vec![DAffine3::IDENTITY, half, DAffine3::IDENTITY]);
        let clothing = Array2::zeros((3, 3));
        let error = association().offsets(&body, clothing.view()).unwrap_err();
        assert!(matches!(error, Error::Singular { vertex: 0, .. }), "{error}");
    }

    #[test]
    fn bad_input_is_named() {
        let body = body(vec![DAffine3::IDENTITY; 3]);
        let mut clothing = Array2::zeros((3, 3));
        clothing[(1, 1)] = f64::NAN;
        let text = association().offsets(&body, clothing.view()).unwrap_err().to_string();
        assert!(text.contains("number 4"), "{text}");
        let short = Array2::zeros((2, 3));
        let text = association().offsets(&body, short.view()).unwrap_err().to_string();
        assert!(text.contains("[2, 3]"), "{text}");
        assert!(Association::new(arr2(&[[3]]), arr2(&[[1.0]]), 3).is_err());
        assert!(Association::new(arr2(&[[0]]), arr2(&[[0.7]]), 3).is_err());
    }
}
