//! Registration of garments: a template laid onto the scans of a sequence, frame by frame.
//!
//! [`GarmentTracker`] deforms a template mesh to each scan of a sequence, whose meshes have neither the same
//! vertices nor the same triangles. It starts from the frame before and minimises
//!
//! `Σ_i w_i E_i(s_i − nearest on the template) / n + Σ_v a_v w_v E_v(x_v − nearest on the scan) + λ E_R`
//!
//! by turns over rotations, nearest points and positions, from rigid and far-reaching to soft and near: `E` is
//! the squared distance along the normal and a share of the one along the surface, `w` the Geman–McClure
//! weight, `a_v` the vertex's share of the surface, and `E_R` what keeps the mesh as rigid as possible
//! (Sorkine and Alexa 2007). A point of the scan that lies sideways from a vertex is across a hole and does
//! not count; neither do points beyond the template's edge in scans of dressed people.

mod rigidity;
#[cfg(test)]
mod tests;

use cape_core::geometry::SurfaceMesh;
use glam::{DMat3, DVec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use self::rigidity::RigidMesh;
use crate::{
    Error, Result,
    body_energy::geman_mcclure,
    scan::{
        Scan, ScanDistance,
        energy::{ScanTarget, distance},
        nearest::SurfaceTree,
        rigid::RigidTransform,
        sample::vertex_frames,
    },
};

/// A stage of the registration of a garment.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct GarmentStage {
    /// Weight λ of rigidity, m²: deformations over shorter lengths than about its root are resisted.
    pub rigidity: f64,
    /// Geman–McClure scale σ (outlier threshold), metres.
    pub robust_scale: f64,
    /// Number of iterations.
    pub iterations: usize,
}

/// Configuration of the registration of garments.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GarmentConfig {
    /// Stages of a frame.
    pub stages: Vec<GarmentStage>,
    /// Number of samples of the scan.
    pub samples: usize,
    /// Weight of distances along the surface, relative to those along the normal.
    pub sliding: f64,
    /// True if the scans are of a dressed person: what lies beyond the edges of the template is skin, or
    /// another garment, and does not draw it there.
    pub dressed: bool,
    /// Random seed of the samples.
    pub seed: u64,
}

impl Default for GarmentConfig {
    fn default() -> Self {
        let stage = |rigidity, robust_scale, iterations| GarmentStage {
            rigidity,
            robust_scale,
            iterations,
        };
        Self {
            stages: vec![stage(1e-2, 0.08, 6), stage(1e-3, 0.04, 6), stage(1e-4, 0.02, 8)],
            samples: 10_000,
            sliding: 0.1,
            dressed: false,
            seed: 1,
        }
    }
}

/// A template laid onto a scan.
#[derive(Debug, Clone, PartialEq)]
pub struct GarmentFit {
    /// Vertices of the template, metres, `[V]`.
    pub vertices: Vec<DVec3>,
    /// Distances of the scan from the surface; those of a dressed person include the skin.
    pub distance: ScanDistance,
}

/// Registration of a sequence of scans with a template.
///
/// ```
/// use cape_core::geometry::{SurfaceMesh, primitives::grid};
/// use cape_fit::{GarmentConfig, GarmentTracker, scan::{Scan, ScanUnit, Unit}};
/// use glam::DVec3;
///
/// // A sheet that is bent, and scanned as a cloud of points of its own.
/// let template = grid(9, 9, |u, v| DVec3::new(0.4 * u, 0.4 * v, 0.0));
/// let bend = |u: f64, v: f64| DVec3::new(0.3 * (1.3 * u).sin(), 0.4 * v, 0.3 - 0.3 * (1.3 * u).cos());
/// let points = grid(40, 41, bend).vertices;
/// let scan = Scan::new(points, None, Vec::new(), ScanUnit::OfAnySize(Unit::M))?;
/// let mut tracker = GarmentTracker::new(&template, GarmentConfig::default())?;
/// let fit = tracker.register(&scan)?;
/// assert!(fit.distance.median < 4.0);
/// # Ok::<(), cape_fit::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct GarmentTracker {
    faces: Vec<[u32; 3]>,
    mesh: RigidMesh,
    boundary: Vec<bool>,
    config: GarmentConfig,
    /// Positions in the last frame, and in the one before if there was one, metres.
    last: Vec<DVec3>,
    before: Option<Vec<DVec3>>,
}

impl GarmentTracker {
    /// Tracker that starts from the `template`, metres, which is near the garment in the first scan and has
    /// its size.
    ///
    /// # Errors
    /// If the template has no faces, or the configuration is out of range.
    pub fn new(template: &SurfaceMesh, config: GarmentConfig) -> Result<Self> {
        if template.faces.is_empty() {
            return Err(Error::argument("template: no triangles, expected a mesh of a garment"));
        }
        let positive = |x: f64| x.is_finite() && x > 0.0;
        let fair = |stage: &GarmentStage| positive(stage.rigidity) && positive(stage.robust_scale);
        if !config.stages.iter().all(fair) || !positive(config.sliding) {
            return Err(Error::argument(
                "garment: rigidity, robust scale and sliding, expected numbers above 0",
            ));
        }
        Ok(Self {
            faces: template.faces.clone(),
            mesh: RigidMesh::new(template),
            boundary: template.boundary(),
            config,
            last: template.vertices.clone(),
            before: None,
        })
    }

    /// Lays the template onto the next scan.
    ///
    /// # Errors
    /// If no part of the scan is near the template.
    pub fn register(&mut self, scan: &Scan) -> Result<GarmentFit> {
        let mut target = ScanTarget::new(scan, self.config.samples, self.config.seed);
        target.orient(&self.last, &self.faces);
        let mut at = self.start(&target);
        for stage in &self.config.stages {
            for _ in 0..stage.iterations {
                let rotations = self.mesh.rotations(&at);
                let mut system = self.mesh.system(&rotations, stage.rigidity);
                let pulls = self.pulls(&target, &at, stage.robust_scale);
                if pulls.is_empty() {
                    let reach = 1e3 * REACH * stage.robust_scale;
                    let message =
                        format!("garment: no point of the scan within {reach:.0} mm of it");
                    return Err(Error::Observation(message));
                }
                for pull in &pulls {
                    let sides = pull.face.map(|face| self.mesh.sides(face));
                    let on = (pull.corners, sides);
                    system.pull(on, pull.barycentric, (pull.to, pull.metric));
                }
                self.mesh.solve(&system, &mut at);
            }
        }
        self.before = Some(std::mem::replace(&mut self.last, at.clone()));
        Ok(GarmentFit { distance: distance(&target, &at, &self.faces), vertices: at })
    }

    /// Positions from which the registration begins: those of the last frame, or continued at the last
    /// velocity, if that is nearer to the scan; moved rigidly towards it.
    fn start(&self, target: &ScanTarget<'_>) -> Vec<DVec3> {
        let scale = self.config.stages.first().map_or(0.0, |stage| stage.robust_scale);
        let continued = self.before.as_ref().map(|before| {
            self.last.iter().zip(before).map(|(last, before)| *last * 2.0 - *before).collect()
        });
        let starts: Vec<Vec<DVec3>> =
            [Some(self.last.clone()), continued].into_iter().flatten().collect();
        let placed = starts.into_iter().map(|mut at| {
            for _ in 0..RIGID_STEPS {
                let pairs: Vec<(DVec3, DVec3, f64)> = self
                    .pulls(target, &at, scale)
                    .iter()
                    .map(|pull| (pull.on(&at), pull.to, pull.weight))
                    .collect();
                let Some(rigid) = RigidTransform::between(&pairs) else { break };
                for x in &mut at {
                    *x = rigid.apply(*x);
                }
            }
            let off: f64 = self.pulls(target, &at, scale).iter().map(|pull| pull.penalty).sum();
            (at, off)
        });
        // Sliding along the surface, which the scan does not show, must not go on by its own momentum.
        let weighted = placed.zip([1.0, MOMENTUM]).map(|((at, off), weight)| (at, off * weight));
        let least = weighted.min_by(|a, b| a.1.total_cmp(&b.1));
        least.map_or_else(|| self.last.clone(), |(at, _)| at)
    }

    /// Pulls of the scan's samples on the template at the positions `at`, and of the scan on its vertices.
    fn pulls(&self, target: &ScanTarget<'_>, at: &[DVec3], scale: f64) -> Vec<Pull> {
        let reach = REACH * scale;
        let (normals, shares) = vertex_frames(at, &self.faces);
        let tree = SurfaceTree::from_faces(at, &self.faces);
        let samples = target.samples();
        let each = 1.0 / samples.len().max(1) as f64;
        let from_scan = samples.par_iter().filter_map(|sample| {
            let (face, near) = tree.nearest(sample.at, sample.normal, reach)?;
            let corners = self.faces[face];
            let normal =
                if sample.normal == DVec3::ZERO { tree.normal(face) } else { sample.normal };
            let on_edge = || {
                let held = corners.iter().zip(near.on.weights).filter(|(_, weight)| *weight > 1e-9);
                held.clone().count() < 3 && held.clone().all(|(&v, _)| self.boundary[v as usize])
            };
            if self.config.dressed && on_edge() && sideways(sample.at - near.at, tree.normal(face))
            {
                return None;
            }
            let pull = self.pull(near.at, (sample.at, normal), scale, each);
            Some(Pull { corners, barycentric: near.on.weights, face: Some(face), ..pull })
        });
        let vertices = (0..at.len()).into_par_iter().filter_map(|v| {
            let (element, near) = target.tree().nearest(at[v], normals[v], reach)?;
            let off = near.at - at[v];
            if off.length() > target.spacing() && sideways(off, normals[v]) {
                return None;
            }
            let own = target.tree().normal(element);
            let normal = if own == DVec3::ZERO { normals[v] } else { own };
            let pull = self.pull(at[v], (near.at, normal), scale, shares[v]);
            Some(Pull { corners: [v as u32; 3], barycentric: [1.0, 0.0, 0.0], face: None, ..pull })
        });
        let mut all: Vec<Pull> = from_scan.collect();
        all.extend(vertices.collect::<Vec<Pull>>());
        all
    }

    /// Pull of a point of the template towards a point of the scan with its normal.
    fn pull(&self, from: DVec3, (to, normal): (DVec3, DVec3), scale: f64, share: f64) -> Pull {
        let (penalty, slope) = geman_mcclure(from.distance_squared(to), scale);
        let weight = share * slope;
        let sliding = DMat3::from_diagonal(DVec3::splat(self.config.sliding));
        let along = DMat3::from_cols(normal * normal.x, normal * normal.y, normal * normal.z);
        let metric = (along * (1.0 - self.config.sliding) + sliding) * weight;
        Pull { to, metric, weight, penalty: share * penalty, ..Pull::default() }
    }
}

/// Reach of the search for nearest points, in units of the Geman–McClure scale σ.
const REACH: f64 = 3.0;

/// Factor of the distance of a start at the last velocity when it is compared with the one at the last
/// positions.
const MOMENTUM: f64 = 1.25;

/// Rigid steps at the start of a frame.
const RIGID_STEPS: usize = 5;

/// True if an offset lies more along the surface than along its `normal`.
fn sideways(off: DVec3, normal: DVec3) -> bool {
    off.dot(normal).abs() < 0.85 * off.length()
}

/// The pull of a point of the scan on a point of the template.
#[derive(Debug, Clone, Copy, Default)]
struct Pull {
    corners: [u32; 3],
    barycentric: [f64; 3],
    /// Face of the point, unless it is a vertex.
    face: Option<usize>,
    to: DVec3,
    metric: DMat3,
    weight: f64,
    /// Robust squared distance times the share of the surface, m².
    penalty: f64,
}

impl Pull {
    /// The point of the template at the positions of its vertices.
    fn on(&self, at: &[DVec3]) -> DVec3 {
        self.corners.iter().zip(self.barycentric).map(|(&v, weight)| at[v as usize] * weight).sum()
    }
}
