//! Bidirectional robust distance between a scan and the surface of a body.
//!
//! `E_D = Σ_i ρ(‖s_i − nearest on the body‖) / n + w Σ_v a_v ρ(‖b_v − nearest on the scan‖)` over
//! samples `s_i` of the scan and vertices `b_v` of the body with the shares `a_v` of its area, and
//! the Geman–McClure penalty ρ. Nearest points are updated at every evaluation. Sliding along a
//! surface does not change the distance to first order, so the gradient with nearest points fixed
//! to their triangles is exact.

use glam::DVec3;
use rand::{SeedableRng, rngs::ChaCha8Rng};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{
    Scan,
    nearest::{NearestPoint, SurfaceTree},
    sample::{SurfaceSample, sample_scan, vertex_frames},
};
use crate::body_energy::geman_mcclure;

/// Reach of the search for nearest points, in units of the Geman–McClure scale σ.
const REACH: f64 = 10.0;
/// Surface area of a person, m², for the spacing of the points of a scan.
const SURFACE: f64 = 1.9;
/// 99th percentile of the distance of a surface point from the nearest of random points, in units
/// of the square root of the area for each point.
const SIDEWAYS: f64 = 1.2;
/// Share of agreeing normals below which a scan is inside out.
const INSIDE_OUT: f64 = 0.35;

/// Samples and nearest-point index of a scan.
#[derive(Debug, Clone)]
pub(crate) struct ScanTarget<'a> {
    samples: Vec<SurfaceSample>,
    tree: SurfaceTree<'a>,
    /// Mean spacing of the points, metres; 0 for meshes.
    spacing: f64,
}

impl<'a> ScanTarget<'a> {
    /// Target with `count` samples of a mesh, or at most `count` points of a cloud.
    pub(crate) fn new(scan: &'a Scan, count: usize, seed: u64) -> Self {
        let samples = sample_scan(scan, count, &mut ChaCha8Rng::seed_from_u64(seed));
        if scan.faces().is_empty() {
            let normals = scan.normals().unwrap_or_default().to_vec();
            let spacing = (SURFACE / scan.points().len() as f64).sqrt();
            return Self {
                samples,
                tree: SurfaceTree::from_points(scan.points(), normals),
                spacing,
            };
        }
        Self { samples, tree: SurfaceTree::from_faces(scan.points(), scan.faces()), spacing: 0.0 }
    }

    /// Samples in random order.
    pub(crate) fn samples(&self) -> &[SurfaceSample] {
        &self.samples
    }

    /// Nearest-point index of the scan.
    pub(crate) fn tree(&self) -> &SurfaceTree<'a> {
        &self.tree
    }

    /// Mean spacing of the points, metres; 0 for meshes.
    pub(crate) fn spacing(&self) -> f64 {
        self.spacing
    }

    /// Reverses the normals of the scan if most disagree with those of a roughly placed body, or
    /// drops them if they are inconsistent. Returns true if they are kept as they are.
    pub(crate) fn orient(&mut self, vertices: &[DVec3], faces: &[[u32; 3]]) -> bool {
        let tree = SurfaceTree::from_faces(vertices, faces);
        let with: Vec<f64> = self
            .samples
            .par_iter()
            .take(1000)
            .filter(|sample| sample.normal != DVec3::ZERO)
            .filter_map(|sample| {
                let (face, _) = tree.nearest(sample.at, DVec3::ZERO, f64::MAX)?;
                Some(sample.normal.dot(tree.normal(face)))
            })
            .collect();
        let agree = with.iter().filter(|cosine| **cosine > 0.0).count() as f64;
        let share = agree / with.len().max(1) as f64;
        if with.is_empty() || share > 1.0 - INSIDE_OUT {
            return true;
        }
        if share < INSIDE_OUT {
            self.tree.flip();
            self.samples.iter_mut().for_each(|sample| sample.normal = -sample.normal);
        } else {
            self.tree.forget_normals();
            self.samples.iter_mut().for_each(|sample| sample.normal = DVec3::ZERO);
        }
        false
    }
}

/// Both directions of `E_D`, m².
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct ScanTerms {
    /// Mean penalty of the samples of the scan.
    pub to_body: f64,
    /// Area-weighted mean penalty of the vertices of the body.
    pub to_scan: f64,
}

/// The distance energy `E_D` of one stage.
#[derive(Debug, Clone)]
pub(crate) struct ScanEnergy<'a> {
    target: &'a ScanTarget<'a>,
    faces: &'a [[u32; 3]],
    /// Share of the area around each vertex, `[V]`; 0 over holes of the scan.
    shares: Vec<f64>,
    samples: usize,
    /// Geman–McClure scale σ (outlier threshold), metres.
    robust_scale: f64,
    /// Weight `w` of the direction from the body to the scan.
    back: f64,
}

impl<'a> ScanEnergy<'a> {
    /// Energy with at most `samples` samples of the scan, and the weight `back` for the direction
    /// from the body to the scan. Vertices over holes, determined for the surface at `vertices`,
    /// metres, are left out.
    pub(crate) fn new(
        target: &'a ScanTarget<'a>,
        vertices: &[DVec3],
        faces: &'a [[u32; 3]],
        samples: usize,
        robust_scale: f64,
        back: f64,
    ) -> Self {
        let (normals, mut shares) = vertex_frames(vertices, faces);
        let opposite = |(&vertex, &normal): (&DVec3, &DVec3)| {
            if back <= 0.0 {
                return None;
            }
            // Over a hole the nearest point of the scan is sideways.
            let (_, nearest) = target.tree.nearest(vertex, normal, REACH * robust_scale)?;
            let off = nearest.at - vertex;
            let sideways = off.reject_from_normalized(normal.try_normalize()?).length();
            Some(sideways <= (0.5 * off.length()).max(SIDEWAYS * target.spacing))
        };
        let there: Vec<bool> =
            vertices.par_iter().zip(&normals).map(|pair| opposite(pair).unwrap_or(false)).collect();
        let wanted = shares.iter_mut().zip(there).filter(|(_, there)| !there);
        wanted.for_each(|(share, _)| *share = 0.0);
        let samples = samples.min(target.samples.len());
        Self { target, faces, shares, samples, robust_scale, back }
    }

    /// Terms of a surface, vertices in metres, `[V]`; the gradient of `scale · E_D` is added to
    /// `forces` `[V]`.
    pub(crate) fn evaluate(
        &self,
        vertices: &[DVec3],
        scale: f64,
        forces: &mut [DVec3],
    ) -> ScanTerms {
        let reach = REACH * self.robust_scale;
        let samples = &self.target.samples[..self.samples];
        let body = SurfaceTree::from_faces(vertices, self.faces);
        let on_body: Vec<Option<(usize, NearestPoint)>> =
            samples.par_iter().map(|s| body.nearest(s.at, s.normal, reach)).collect();
        let (normals, _) = vertex_frames(vertices, self.faces);
        let on_scan: Vec<Option<(usize, NearestPoint)>> = vertices
            .par_iter()
            .zip(&normals)
            .zip(&self.shares)
            .map(|((&at, &normal), &share)| {
                (share > 0.0).then(|| self.target.tree.nearest(at, normal, reach)).flatten()
            })
            .collect();
        let (lost, _) = geman_mcclure(reach * reach, self.robust_scale);
        let mut terms = ScanTerms::default();
        let each = 1.0 / samples.len().max(1) as f64;
        for (sample, nearest) in samples.iter().zip(on_body) {
            let Some((_, NearestPoint { on, at })) = nearest else {
                terms.to_body += each * lost;
                continue;
            };
            let off = at - sample.at;
            let (penalty, slope) = geman_mcclure(off.length_squared(), self.robust_scale);
            terms.to_body += each * penalty;
            on.pull_back(off * (2.0 * scale * each * slope), forces);
        }
        for (vertex, nearest) in on_scan.into_iter().enumerate() {
            let share = self.shares[vertex];
            let Some((_, NearestPoint { at, .. })) = nearest else {
                terms.to_scan += share * lost;
                continue;
            };
            let off = vertices[vertex] - at;
            let (penalty, slope) = geman_mcclure(off.length_squared(), self.robust_scale);
            terms.to_scan += share * penalty;
            forces[vertex] += off * (2.0 * scale * self.back * share * slope);
        }
        terms
    }

    /// Energy `E_D`, m².
    pub(crate) fn total(&self, terms: &ScanTerms) -> f64 {
        terms.to_body + self.back * terms.to_scan
    }
}

/// Distance of each of `points` from a scan, metres.
pub fn distances_to(scan: &Scan, points: &[DVec3]) -> Vec<f64> {
    let target = ScanTarget::new(scan, 0, 0);
    let off = |&point: &DVec3| {
        let nearest = target.tree.nearest(point, DVec3::ZERO, f64::MAX);
        nearest.map_or(f64::INFINITY, |(_, nearest)| nearest.at.distance(point))
    };
    points.par_iter().map(off).collect()
}

/// Mean distance of points from a surface, millimetres.
pub(crate) fn surface_distance(points: &[DVec3], vertices: &[DVec3], faces: &[[u32; 3]]) -> f64 {
    let tree = SurfaceTree::from_faces(vertices, faces);
    let off = |&point: &DVec3| {
        let nearest = tree.nearest(point, DVec3::ZERO, f64::MAX);
        nearest.map_or(f64::INFINITY, |(_, nearest)| nearest.at.distance(point))
    };
    let all: Vec<f64> = points.par_iter().map(off).collect();
    1000.0 * all.iter().sum::<f64>() / points.len().max(1) as f64
}

/// Distances of the samples of a scan from a surface, millimetres.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct ScanDistance {
    /// Median distance.
    pub median: f64,
    /// Mean distance.
    pub mean: f64,
    /// 95th percentile of the distances.
    pub most: f64,
    /// Share of the surface over holes of the scan, 0 to 1.
    pub unseen: f64,
}

/// Distances of the samples of a scan from a surface.
pub(crate) fn distance(
    target: &ScanTarget<'_>,
    vertices: &[DVec3],
    faces: &[[u32; 3]],
) -> ScanDistance {
    let tree = SurfaceTree::from_faces(vertices, faces);
    let off = |sample: &SurfaceSample| {
        let nearest = tree.nearest(sample.at, sample.normal, f64::MAX);
        nearest.map_or(f64::INFINITY, |(_, nearest)| 1000.0 * nearest.at.distance(sample.at))
    };
    let mut all: Vec<f64> = target.samples.par_iter().map(off).collect();
    all.sort_unstable_by(f64::total_cmp);
    let at = |share: f64| all.get((share * all.len() as f64) as usize).copied().unwrap_or(0.0);
    let seen = ScanEnergy::new(target, vertices, faces, 0, 0.02, 1.0).shares;
    ScanDistance {
        median: at(0.5),
        mean: all.iter().sum::<f64>() / all.len().max(1) as f64,
        most: at(0.95),
        unseen: (1.0 - seen.iter().sum::<f64>()).clamp(0.0, 1.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        scan::Unit,
        testing::{BODY, assert_gradient},
    };

    fn body(width: f64) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let rows = BODY.v_template.rows().into_iter();
        (rows.map(|v| DVec3::new(width * v[0], v[1], width * v[2])).collect(), BODY.faces.clone())
    }

    fn scan(width: f64, with_faces: bool) -> Scan {
        let (vertices, faces) = body(width);
        let faces = if with_faces { faces } else { Vec::new() };
        Scan::new(vertices, None, faces, Unit::M).unwrap()
    }

    /// Along a few directions, of a surface at some distance from the scan.
    #[test]
    fn the_gradient_agrees_with_finite_differences() {
        for with_faces in [true, false] {
            let scan = scan(1.06, with_faces);
            let target = ScanTarget::new(&scan, 1500, 3);
            let (vertices, faces) = body(1.0);
            let distances = ScanEnergy::new(&target, &vertices, &faces, 1500, 0.03, 0.7);
            let mode = |which: usize, vertex: usize| {
                let phase = vertices[vertex].dot(DVec3::new(3.1, 4.7, 2.3)) + which as f64;
                DVec3::new(phase.sin(), (1.3 * phase).cos(), (0.7 * phase).sin())
            };
            let moved = |x: &[f64]| -> Vec<DVec3> {
                let change = |v| (0..x.len()).map(|w| mode(w, v) * x[w]).sum::<DVec3>();
                vertices.iter().enumerate().map(|(v, &at)| at + change(v)).collect()
            };
            let value = |x: &[f64]| {
                let none = &mut vec![DVec3::ZERO; vertices.len()];
                500.0 * distances.total(&distances.evaluate(&moved(x), 500.0, none))
            };
            let x = [0.004, -0.002, 0.003];
            let mut forces = vec![DVec3::ZERO; vertices.len()];
            distances.evaluate(&moved(&x), 500.0, &mut forces);
            let gradient: Vec<f64> = (0..x.len())
                .map(|w| forces.iter().enumerate().map(|(v, f)| f.dot(mode(w, v))).sum())
                .collect();
            assert_gradient(&x, &gradient, 5e-3, value);
        }
    }

    #[test]
    fn the_same_surface_is_at_no_distance() {
        let scan = scan(1.0, true);
        let mut target = ScanTarget::new(&scan, 2000, 1);
        let (vertices, faces) = body(1.0);
        assert!(target.orient(&vertices, &faces));
        let found = distance(&target, &vertices, &faces);
        assert!(found.mean < 1e-6 && found.unseen < 0.01, "{found:?}");
        let wider = distance(&target, &body(1.1).0, &faces);
        assert!(wider.median > 3.0 && wider.most > wider.median, "{wider:?}");
    }

    #[test]
    fn scans_that_are_inside_out_are_turned() {
        let (vertices, mut faces) = body(1.0);
        for face in &mut faces {
            face.swap(0, 1);
        }
        let scan = Scan::new(vertices.clone(), None, faces, Unit::M).unwrap();
        let mut target = ScanTarget::new(&scan, 1000, 1);
        assert!(!target.orient(&vertices, &BODY.faces));
        assert!(distance(&target, &vertices, &BODY.faces).mean < 1e-6);
    }

    #[test]
    fn surface_over_a_hole_is_not_drawn_to_its_edge() {
        let (vertices, faces) = body(1.0);
        let front = |&v: &u32| vertices[v as usize].distance(DVec3::new(0.0, 0.0, 0.15)) < 0.1;
        let holed = faces.iter().filter(|face| !face.iter().any(front)).copied().collect();
        let scan = Scan::new(vertices.clone(), None, holed, Unit::M).unwrap();
        let target = ScanTarget::new(&scan, 1000, 1);
        let distances = ScanEnergy::new(&target, &vertices, &faces, 1000, 0.05, 1.0);
        let mut forces = vec![DVec3::ZERO; vertices.len()];
        let terms = distances.evaluate(&vertices, 1.0, &mut forces);
        assert!(terms.to_scan < 1e-12, "{terms:?}");
        let unseen = distance(&target, &vertices, &faces).unseen;
        assert!((0.002..0.1).contains(&unseen), "{unseen}");
    }
}
