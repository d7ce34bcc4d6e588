//! Measures of single clothed bodies: the effect of the pose on clothing, clothing transferred to other
//! bodies, and the smoothness of clothing in motion.

use cape_core::{
    BodyPose, Mesh,
    geometry::{SurfaceIndex, SurfaceMesh},
    joints::JOINT_NAMES,
};
use cape_infer::ClothedModel;
use cape_stats::errors::{distance_mm, mean_distance_mm};
use ndarray::{Array2, Array3, ArrayView2, Axis};
use serde::Serialize;

use crate::{Error, Result};

/// Depth under the skin from which on clothing counts as inside, metres.
const INSIDE: f64 = 0.001;
/// Largest distance from the skin at which its closest point is searched, metres.
const REACH: f64 = 0.5;

/// Change of the displacements of one code between two poses (CAPE figure 6).
#[derive(Debug, Clone, PartialEq)]
pub struct PoseEffect {
    /// Length of the change at every vertex, millimetres, `[V]`.
    pub changes_mm: Vec<f64>,
    /// Mean over clothing vertices, millimetres.
    pub mean_mm: f64,
    /// Largest at a clothing vertex, millimetres.
    pub largest_mm: f64,
    /// Mean over the clothing vertices that each joint moves most, millimetres, largest first.
    pub by_joint: Vec<(String, f64)>,
}

impl PoseEffect {
    /// Compares displacements `[V, 3]` in metres under two poses.
    ///
    /// # Errors
    /// If the displacements have another number of vertices than the model.
    pub fn new(
        model: &ClothedModel,
        before: ArrayView2<'_, f32>,
        after: ArrayView2<'_, f32>,
    ) -> Result<Self> {
        let expected = (model.body().vertices(), 3);
        if before.dim() != expected || after.dim() != expected {
            return Err(Error::argument(format!(
                "displacements {:?} and {:?}, expected {expected:?}",
                before.dim(),
                after.dim()
            )));
        }
        let point = |row: ndarray::ArrayView1<f32>| [row[0], row[1], row[2]];
        let pairs = before.rows().into_iter().zip(after.rows());
        let changes_mm: Vec<f64> = pairs.map(|(a, b)| distance_mm(point(a), point(b))).collect();
        let clothing = model.clothing();
        let of_clothing = || clothing.iter().map(|&vertex| changes_mm[vertex]);
        Ok(Self {
            mean_mm: of_clothing().sum::<f64>() / clothing.len().max(1) as f64,
            largest_mm: of_clothing().fold(0.0, f64::max),
            by_joint: by_joint(model, &changes_mm),
            changes_mm,
        })
    }
}

/// Mean of `values` `[V]` over the clothing vertices that each joint moves most, largest first.
fn by_joint(model: &ClothedModel, values: &[f64]) -> Vec<(String, f64)> {
    let mut sums = vec![(0.0, 0usize); JOINT_NAMES.len()];
    for &vertex in model.clothing() {
        let weights = model.body().weights.row(vertex);
        let most = weights.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1));
        if let Some(sum) = most.and_then(|(joint, _)| sums.get_mut(joint)) {
            *sum = (sum.0 + values[vertex], sum.1 + 1);
        }
    }
    let named = JOINT_NAMES.iter().zip(sums).filter(|(_, (_, count))| *count > 0);
    let mut means: Vec<(String, f64)> =
        named.map(|(name, (sum, count))| ((*name).to_owned(), sum / count as f64)).collect();
    means.sort_by(|a, b| b.1.total_cmp(&a.1));
    means
}

/// Mean distance of the vertices of two meshes, millimetres.
pub fn mean_vertex_distance_mm(a: &Mesh, b: &Mesh, vertices: &[usize]) -> f64 {
    mean_distance_mm(vertices.iter().map(|&vertex| (a.vertices[vertex], b.vertices[vertex])))
}

/// Measures of clothing on another body than the one that it comes from.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ClothingTransfer {
    /// Mean distance of the clothing from the skin at clothing vertices, millimetres.
    pub distance_mm: f64,
    /// Mean relative change of the lengths of edges between clothing vertices from body to body.
    pub stretch: f64,
    /// Share of clothing vertices that are more than a millimetre under the skin.
    pub inside: f64,
    /// The same share on the body that the clothing comes from.
    pub inside_before: f64,
}

impl ClothingTransfer {
    /// Compares displacements `[V, 3]` in metres on two bodies in one pose, given by their unclothed
    /// rest shapes `[V, 3]`, metres: the one that the clothing comes from, and its target.
    ///
    /// # Errors
    /// If sizes disagree.
    pub fn measure(
        model: &ClothedModel,
        [source, target]: [&Array2<f64>; 2],
        pose: &BodyPose,
        displacement: ArrayView2<'_, f32>,
    ) -> Result<Self> {
        let displacement = at_clothing(model, displacement);
        let covered = model.mask().covered();
        let lengths = |minimal: &Array2<f64>| -> Result<Vec<f64>> {
            let mesh = pose_minimal_shape(model, minimal, pose, Some(&displacement))?;
            let at = |v: u32| glam::Vec3::from(mesh.vertices[v as usize]);
            let edges = mesh.edges().into_iter();
            let edges = edges.filter(|edge| edge.iter().all(|&v| covered[v as usize]));
            Ok(edges.map(|[a, b]| f64::from(at(a).distance(at(b)))).collect())
        };
        let (old, new) = (lengths(source)?, lengths(target)?);
        let stretch = old.iter().zip(&new).map(|(old, new)| (new / old.max(1e-9) - 1.0).abs());
        let count = model.clothing().len().max(1) as f64;
        let distance = model.clothing().iter().map(|&v| {
            let row = displacement.row(v);
            row.dot(&row).sqrt()
        });
        Ok(Self {
            distance_mm: 1000.0 * distance.sum::<f64>() / count,
            stretch: stretch.sum::<f64>() / old.len().max(1) as f64,
            inside: share_inside(model, target, pose, &displacement)?,
            inside_before: share_inside(model, source, pose, &displacement)?,
        })
    }
}

/// Displacements `[V, 3]` in metres of clothing vertices; zero elsewhere.
pub fn at_clothing(model: &ClothedModel, displacement: ArrayView2<'_, f32>) -> Array2<f64> {
    let covered = model.mask().covered();
    Array2::from_shape_fn(displacement.dim(), |(vertex, axis)| {
        if covered[vertex] { f64::from(displacement[[vertex, axis]]) } else { 0.0 }
    })
}

/// Mesh of an unclothed rest shape `[V, 3]` under a pose, with displacements `[V, 3]`; all in metres.
///
/// # Errors
/// If sizes disagree.
pub fn pose_minimal_shape(
    model: &ClothedModel,
    minimal: &Array2<f64>,
    pose: &BodyPose,
    displacement: Option<&Array2<f64>>,
) -> Result<Mesh> {
    let pose = pose.map(f64::from);
    let posed = model.body().pose_shape(minimal, &pose, [0.0; 3], displacement)?;
    Ok(model.body().mesh_with(&posed.vertices))
}

/// Share of clothing vertices that are under the skin.
fn share_inside(
    model: &ClothedModel,
    minimal: &Array2<f64>,
    pose: &BodyPose,
    displacement: &Array2<f64>,
) -> Result<f64> {
    let unclothed = pose_minimal_shape(model, minimal, pose, None)?;
    let skin = SurfaceIndex::new(&SurfaceMesh::from_mesh("body", &unclothed)?);
    let clothed = pose_minimal_shape(model, minimal, pose, Some(displacement))?;
    let under = |&&vertex: &&usize| {
        let at = glam::DVec3::from_array(clothed.vertices[vertex].map(f64::from));
        skin.closest(at, REACH).is_some_and(|closest| closest.signed_distance < -INSIDE)
    };
    let count = model.clothing().iter().filter(under).count();
    Ok(count as f64 / model.clothing().len().max(1) as f64)
}

/// Mean speed, mm/s, and mean acceleration, m/s², of displacements `[frames, V, 3]` in metres at the
/// clothing vertices, at `rate` frames per second.
///
/// ```
/// // x = 0.5 · 2 m/s² · t² at 10 frames per second.
/// let moved = ndarray::Array3::from_shape_fn((5, 1, 3), |(frame, _, axis)| {
///     if axis == 0 { (0.1 * frame as f32).powi(2) } else { 0.0 }
/// });
/// let [speed, acceleration] = cape_eval::clothing::smoothness(&moved, &[0], 10.0);
/// assert!((speed - 400.0).abs() < 0.1 && (acceleration - 2.0).abs() < 1e-4);
/// ```
pub fn smoothness(displacement: &Array3<f32>, clothing: &[usize], rate: f64) -> [f64; 2] {
    let frames = displacement.dim().0;
    let frame = |index: usize| displacement.index_axis(Axis(0), index);
    let mean = |order: usize, of: &dyn Fn(usize, usize, usize) -> f64| {
        let mut sum = 0.0;
        for index in order..frames {
            for &vertex in clothing {
                sum += (0..3).map(|axis| of(index, vertex, axis).powi(2)).sum::<f64>().sqrt();
            }
        }
        sum / (frames.saturating_sub(order) * clothing.len()).max(1) as f64
    };
    let at = |frame: ArrayView2<f32>, vertex: usize, axis: usize| f64::from(frame[[vertex, axis]]);
    let speed = mean(1, &|i, v, a| at(frame(i), v, a) - at(frame(i - 1), v, a));
    let change = mean(2, &|i, v, a| {
        at(frame(i), v, a) - 2.0 * at(frame(i - 1), v, a) + at(frame(i - 2), v, a)
    });
    [1000.0 * speed * rate, change * rate * rate]
}

#[cfg(test)]
mod tests {
    use ndarray::s;

    use super::*;

    #[test]
    fn smoothness_is_that_of_a_parabola() {
        // x = 0.5 · 2 m/s² · t² at 10 frames a second.
        let x = |frame: usize| (0.1 * frame as f64).powi(2) as f32;
        let moved =
            Array3::from_shape_fn(
                (5, 2, 3),
                |(frame, vertex, axis)| {
                    if vertex == 1 && axis == 0 { x(frame) } else { 0.0 }
                },
            );
        let [speed, acceleration] = smoothness(&moved, &[1], 10.0);
        assert!((acceleration - 2.0).abs() < 1e-4, "{acceleration}");
        assert!((speed - 400.0).abs() < 0.1, "{speed}");
        assert_eq!(smoothness(&moved, &[0], 10.0), [0.0, 0.0]);
        assert_eq!(smoothness(&moved.slice(s![..1, .., ..]).to_owned(), &[1], 10.0), [0.0, 0.0]);
    }
}
