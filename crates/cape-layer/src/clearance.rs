//! Clothing kept out of the body.

use cape_core::{
    SmplModel,
    geometry::{SurfaceIndex, SurfaceMesh, points},
};
use glam::DVec3;
use ndarray::{Array2, ArrayView2};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Least distance of predicted clothing from the body, metres.
pub(crate) const CLEARANCE: f64 = 0.002;

/// Rounds in which clothing is pushed out; neighbours that were moved along can get too near in each.
const ROUNDS: usize = 3;

/// Edges over which the displacement of a pushed vertex fades away.
const FADE: usize = 8;

/// Depth to which vertices inside the body are found, metres.
const REACH: f64 = 0.15;

/// Least distance of clothing from the body.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use cape_core::smpl::StandardPose;
/// use cape_layer::Clearance;
/// use cape_synth::synthetic_body;
///
/// // A patch on the skin, pushed 2 mm out of it.
/// let body = synthetic_body();
/// let set = patch(&body)?.0;
/// let posed = set.sequences[0].body(&body, 0, &StandardPose::default())?.posed;
/// let clearance = Clearance::new(0.002, &body, &set.faces, set.vertices());
/// let clothing = set.sequences[0].clothing.index_axis(ndarray::Axis(0), 0);
/// let (pushed, shares) = clearance.apply(posed, clothing);
/// assert_eq!((pushed.dim(), shares.after), ((3, 3), 0.0));
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct Clearance {
    /// Least distance from the body, metres.
    pub distance: f64,
    body_faces: Vec<[u32; 3]>,
    /// Adjacent faces of the body's faces.
    across: Vec<[Option<u32>; 3]>,
    /// Neighbours of the clothing vertices.
    neighbours: Vec<Vec<u32>>,
}

/// Shares of the clothing vertices that are inside the body, 0 to 1.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct InsideShares {
    /// Before clothing is pushed out.
    pub before: f64,
    /// Afterwards.
    pub after: f64,
}

impl Clearance {
    /// A least distance in metres from the surface of `model` for clothing with the triangles `faces` of
    /// `vertices` vertices.
    pub fn new(distance: f64, model: &SmplModel, faces: &[[u32; 3]], vertices: usize) -> Self {
        let body = SurfaceMesh { vertices: Vec::new(), faces: model.faces.clone() };
        let mut neighbours = vec![Vec::new(); vertices];
        let sides = faces.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]);
        for (a, b) in sides.flat_map(|(a, b)| [(a, b), (b, a)]) {
            if let Some(around) = neighbours.get_mut(a as usize) {
                around.push(b);
            }
        }
        for around in &mut neighbours {
            around.sort_unstable();
            around.dedup();
        }
        Self { distance, across: body.neighbours(), body_faces: body.faces, neighbours }
    }

    /// Clothing `[n_v, 3]`, metres, at least at the distance from the body with the vertices `posed`, and
    /// the shares inside the body. Vertices that are too near move along the body's normal; the vertices
    /// around them follow smoothly. What is further than 15 cm inside is left.
    pub fn apply(
        &self,
        posed: Vec<DVec3>,
        clothing: ArrayView2<'_, f64>,
    ) -> (Array2<f64>, InsideShares) {
        let body = SurfaceMesh { vertices: posed.clone(), faces: self.body_faces.clone() };
        let body = SurfaceIndex::moving(&body, posed, self.across.clone());
        let mut at = points(clothing);
        let before = inside(&body, &at);
        for _ in 0..ROUNDS {
            let pushes = self.pushes(&body, &at);
            if pushes.iter().all(Option::is_none) {
                break;
            }
            let faded = self.fade(&pushes);
            at.iter_mut().zip(faded).for_each(|(x, push)| *x += push);
        }
        // What the neighbours' displacements brought too near.
        let last = self.pushes(&body, &at);
        at.iter_mut().zip(last).for_each(|(x, push)| *x += push.unwrap_or_default());
        let shares = InsideShares { before, after: inside(&body, &at) };
        (Array2::from_shape_fn(clothing.dim(), |(vertex, axis)| at[vertex][axis]), shares)
    }

    /// Displacements of the vertices that are too near.
    fn pushes(&self, body: &SurfaceIndex, at: &[DVec3]) -> Vec<Option<DVec3>> {
        let push = |x: &DVec3| {
            let near = body.closest(*x, REACH)?;
            let missing = self.distance - near.signed_distance;
            (missing > 0.0).then(|| near.outward * missing)
        };
        at.par_iter().map(push).collect()
    }

    /// Displacements that fade away from the pushed vertices.
    fn fade(&self, pushes: &[Option<DVec3>]) -> Vec<DVec3> {
        let mut field: Vec<DVec3> = pushes.iter().map(|push| push.unwrap_or_default()).collect();
        for _ in 0..FADE {
            field = (0..field.len())
                .into_par_iter()
                .map(|vertex| match (pushes[vertex], &self.neighbours[vertex][..]) {
                    (Some(push), _) => push,
                    (None, []) => DVec3::ZERO,
                    (None, around) => {
                        let sum: DVec3 = around.iter().map(|&n| field[n as usize]).sum();
                        sum / around.len() as f64
                    }
                })
                .collect();
        }
        field
    }
}

/// Share of the points inside the body.
fn inside(body: &SurfaceIndex, at: &[DVec3]) -> f64 {
    let is_inside =
        |x: &&DVec3| body.closest(**x, REACH).is_some_and(|near| near.signed_distance < 0.0);
    at.par_iter().filter(is_inside).count() as f64 / at.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use cape_cloth::{Garment, GarmentKind};
    use cape_core::smpl::StandardPose;
    use cape_synth::synthetic_body;

    use super::*;
    use crate::BodyFrame;

    /// A skirt in the shape it was sewn in, around a body with a raised knee.
    #[test]
    fn a_raised_thigh_pushes_the_skirt_and_leaves_what_is_far() {
        let model = synthetic_body();
        let shape = model.rest_shape(&[]).unwrap();
        let skirt = Garment::new(GarmentKind::Skirt).sew(&model, &shape).unwrap().surface;
        let mut pose = vec![0.0; 72];
        pose[3] = -0.9;
        let posed =
            BodyFrame::new(&model, &shape, &pose, [0.0; 3], &StandardPose::T).unwrap().posed;
        let rows =
            Array2::from_shape_fn((skirt.vertices.len(), 3), |(v, axis)| skirt.vertices[v][axis]);
        let clearance = Clearance::new(0.003, &model, &skirt.faces, skirt.vertices.len());
        let (pushed, shares) = clearance.apply(posed.clone(), rows.view());
        assert!(shares.before > 0.01 && shares.after == 0.0, "{shares:?}");
        let body = SurfaceMesh { vertices: posed, faces: model.faces.clone() };
        let index = SurfaceIndex::new(&body);
        let distance = |x: DVec3| index.closest(x, 0.3).map_or(0.3, |near| near.signed_distance);
        let (before, after) = (points(rows.view()), points(pushed.view()));
        let near = after.iter().filter(|x| distance(**x) < 0.003 - 1e-4).count();
        // The closest point of a vertex that moved along the normal can be another one, a little nearer.
        assert!(near <= after.len() / 50, "{near} of {}", after.len());
        let still = before.iter().zip(&after).filter(|(a, b)| a == b).count();
        assert!(still > after.len() / 3, "{still} of {} did not move", after.len());
    }

    #[test]
    fn clothing_that_is_far_enough_is_returned() {
        let model = synthetic_body();
        let shape = model.rest_shape(&[]).unwrap();
        let posed =
            BodyFrame::new(&model, &shape, &[0.0; 72], [0.0; 3], &StandardPose::T).unwrap().posed;
        let away = Array2::from_elem((3, 3), 5.0);
        let clearance = Clearance::new(0.002, &model, &[[0, 1, 2]], 3);
        assert_eq!(clearance.apply(posed, away.view()), (away.clone(), InsideShares::default()));
    }
}
