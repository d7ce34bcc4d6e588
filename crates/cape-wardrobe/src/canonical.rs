//! Laid garments as displacements in canonical space.

use cape_core::{
    SmplModel,
    geometry::{SurfaceMesh, points},
};
use glam::{DAffine3, DVec3};
use ndarray::Array2;

use crate::{Result, mesh_graph::MeshGraph};

/// Determinant of a vertex's blended transform below which its displacement is interpolated.
const LEAST_DETERMINANT: f64 = 0.15;

/// Rounds of the relaxation of turned triangles; the region grows by a ring after each `GROWTH`, so that
/// the rest of the garment keeps its folds.
const ROUNDS: usize = 80;
const GROWTH: usize = 20;

/// Rounds of the separation of intersecting triangles, and the factors on displacements of their
/// corners and of the vertices beside them.
const SEPARATIONS: usize = 20;
const SHRINKAGE: [f64; 2] = [0.7, 0.92];

/// Transforms of the body's vertices from canonical space to a frame, and the pose blend shapes,
/// metres, `[V]`.
#[derive(Debug, Clone)]
pub(crate) struct CanonicalFrame {
    transforms: Vec<DAffine3>,
    offsets: Vec<DVec3>,
}

/// Body of a subject in canonical space, to which laid garments are unposed.
#[derive(Debug, Clone)]
pub(crate) struct CanonicalBody<'a> {
    model: &'a SmplModel,
    minimal: &'a Array2<f64>,
    rest: Vec<DVec3>,
    normals: Vec<DVec3>,
    pub(crate) graph: MeshGraph,
}

impl<'a> CanonicalBody<'a> {
    pub(crate) fn new(model: &'a SmplModel, minimal: &'a Array2<f64>) -> Result<Self> {
        let surface = SurfaceMesh::from_rows("body", minimal.view(), &model.faces)?;
        Ok(Self {
            model,
            minimal,
            normals: surface.face_normals(),
            graph: MeshGraph::new(&surface),
            rest: points(minimal.view()),
        })
    }

    /// Transforms of a pose and translation in metres.
    pub(crate) fn frame(&self, pose: &[f64], transl: [f64; 3]) -> Result<CanonicalFrame> {
        Ok(CanonicalFrame {
            transforms: self.model.vertex_transforms(self.minimal, pose, transl)?,
            offsets: points(self.model.pose_offsets(pose)?.view()),
        })
    }

    /// Displacements of the covered vertices of the laid surface `[V]`, metres, from the minimal shape
    /// in canonical space; zero for the others. Inverse of [`posed`](Self::posed).
    pub(crate) fn displacement(
        &self,
        frame: &CanonicalFrame,
        laid: &[DVec3],
        covered: &[bool],
    ) -> Vec<DVec3> {
        let mut displacement: Vec<Option<DVec3>> = (0..laid.len())
            .map(|v| {
                if !covered[v] {
                    return Some(DVec3::ZERO);
                }
                let transform = frame.transforms[v];
                let regular = transform.matrix3.determinant() > LEAST_DETERMINANT;
                regular.then(|| {
                    transform.inverse().transform_point3(laid[v]) - frame.offsets[v] - self.rest[v]
                })
            })
            .collect();
        self.graph.fill(&mut displacement, &vec![true; laid.len()], 20);
        displacement.into_iter().map(Option::unwrap_or_default).collect()
    }

    /// Posed body with displacements, metres, `[V]`.
    pub(crate) fn posed(&self, frame: &CanonicalFrame, displacement: &[DVec3]) -> Vec<DVec3> {
        let moved = self.rest.iter().zip(displacement).zip(&frame.offsets);
        let moved = moved.zip(&frame.transforms);
        moved.map(|(((&p, &d), &o), transform)| transform.transform_point3(p + d + o)).collect()
    }

    /// Reduces displacements of the covered vertices where triangles intersect others that those of
    /// the unclothed body `skin` do not: each round shrinks them, and smooths turned triangles.
    pub(crate) fn separate(
        &self,
        frame: &CanonicalFrame,
        skin: &[bool],
        displacement: &mut [DVec3],
        covered: &[bool],
    ) {
        for _ in 0..SEPARATIONS {
            let crossing = self.graph.intersecting(&self.posed(frame, displacement));
            let faces = crossing.iter().zip(skin).enumerate();
            let new: Vec<u32> =
                faces.filter(|(_, (now, bare))| **now && !**bare).map(|(f, _)| f as u32).collect();
            if new.is_empty() {
                return;
            }
            let corners = self.graph.corners(&new);
            let shrink = |v: u32| {
                let [at, beside] = SHRINKAGE;
                let ratio = if corners.binary_search(&v).is_ok() { at } else { beside };
                (v as usize, displacement[v as usize] * ratio)
            };
            let region = self.graph.grown(&corners).into_iter();
            let smaller: Vec<(usize, DVec3)> =
                region.filter(|&v| covered[v as usize]).map(shrink).collect();
            for (v, value) in smaller {
                displacement[v] = value;
            }
            self.relax(displacement, covered);
        }
    }

    /// Smooths displacements of the covered vertices around triangles that are turned against the
    /// body's. Returns the number of triangles that were turned, and of those that still are.
    pub(crate) fn relax(&self, displacement: &mut [DVec3], covered: &[bool]) -> [usize; 2] {
        let moved = |displacement: &[DVec3]| -> Vec<DVec3> {
            self.rest.iter().zip(displacement).map(|(&p, &d)| p + d).collect()
        };
        let mut turned = self.graph.turned(&self.normals, &moved(displacement));
        let before = turned.len();
        for round in 0..ROUNDS {
            if turned.is_empty() {
                break;
            }
            let mut region = self.graph.corners(&turned);
            for _ in 0..round / GROWTH {
                region = self.graph.grown(&region);
            }
            let smooth = |&v: &u32| {
                let mean = self.graph.mean(v, |n| displacement[n as usize]);
                (v as usize, displacement[v as usize].lerp(mean, 0.5))
            };
            let region = region.iter().filter(|&&v| covered[v as usize]);
            let smoothed: Vec<(usize, DVec3)> = region.map(smooth).collect();
            for (v, value) in smoothed {
                displacement[v] = value;
            }
            turned = self.graph.turned(&self.normals, &moved(displacement));
        }
        [before, turned.len()]
    }
}
