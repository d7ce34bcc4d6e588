use cape_core::SmplModel;
use glam::DVec3;
use ndarray::{Array1, Array2, Array3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{
    Cloth, ClothMaterial, GarmentMesh,
    garment::{sewing_body, sewing_pose},
};
use crate::{Error, Result};
use cape_core::{
    BodyMotion,
    geometry::{SurfaceIndex, SurfaceMesh, points},
};

/// How garments are simulated.
///
/// ```
/// use cape_synth::synthetic_body;
/// use cape_cloth::{Garment, GarmentKind, ClothMaterial, SimulationOptions};
/// use cape_core::BodyMotion;
/// use ndarray::Array2;
///
/// // A coarse skirt falls onto the hips of a body that stands.
/// let body = synthetic_body();
/// let shape = body.rest_shape(&[])?;
/// let skirt = Garment { resolution: 0.05, ..Garment::new(GarmentKind::Skirt) };
/// let sewn = skirt.sew(&body, &shape)?;
/// let motion = BodyMotion::new(30.0, Array2::zeros((2, 72)), Array2::zeros((2, 3)))?;
/// let simulation = SimulationOptions { settle: 0.1, ..SimulationOptions::default() };
/// let worn = (&sewn, &ClothMaterial::default());
/// let simulated = simulation.run(&body, &shape, worn, &motion, &mut |_, _| {})?;
/// assert_eq!(simulated.frames.dim(), (2, sewn.surface.vertices.len(), 3));
/// assert_eq!(simulated.reports.len(), 2);
/// assert!(simulated.quality().penetration < 0.01);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SimulationOptions {
    /// Steps of a frame.
    pub substeps: usize,
    /// Seconds from the pose of sewing to the first frame, and half as many more until it moves as in
    /// that frame.
    pub settle: f64,
    /// Acceleration, m/s².
    pub gravity: DVec3,
    /// Whether layers of the cloth keep apart, by the material's thickness.
    pub self_collision: bool,
    /// Largest relative lengthening of an edge, where the material would let it lengthen more.
    pub strain_limit: f64,
    /// Compliance of the waistband's hold on the body, metres a newton.
    pub waistband: f64,
}

impl Default for SimulationOptions {
    fn default() -> Self {
        Self {
            substeps: 20,
            settle: 1.0,
            gravity: DVec3::NEG_Y * 9.81,
            self_collision: true,
            strain_limit: 0.3,
            waistband: 0.1,
        }
    }
}

/// State of the cloth after a frame.
///
/// See [`SimulationOptions`] for an example.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct StepReport {
    /// Deepest that a vertex or the middle of a face is inside the body, metres.
    pub penetration: f64,
    /// Mean depth of vertices and middles of faces, those outside counting 0, metres.
    pub mean_depth: f64,
    /// Vertices and middles of faces inside the body.
    pub inside: usize,
    /// Edges that go through faces of the cloth.
    pub crossings: usize,
    /// Mean relative change of an edge's length, and largest lengthening.
    pub strain: [f64; 2],
    /// Speed of the fastest vertex, m/s.
    pub speed: f64,
}

/// How a whole simulation went.
///
/// See [`SimulationOptions`] for an example.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct SimulationQuality {
    /// Deepest that a vertex or the middle of a face was inside the body, metres.
    pub penetration: f64,
    /// Mean depth of vertices and middles of faces, those outside counting 0, metres.
    pub mean_depth: f64,
    /// Most edges that went through faces of the cloth in one frame.
    pub crossings: usize,
    /// Mean relative change of an edge's length.
    pub mean_strain: f64,
    /// Largest relative lengthening of an edge.
    pub strain: f64,
    /// Speed of the fastest vertex, m/s.
    pub speed: f64,
}

/// A garment's movement.
///
/// See [`SimulationOptions`] for an example.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulatedGarment {
    /// Clothing vertices, metres, `[frames, vertices, 3]`.
    pub frames: Array3<f64>,
    /// State after each frame.
    pub reports: Vec<StepReport>,
}

impl SimulatedGarment {
    /// The worst and the mean of all frames.
    pub fn quality(&self) -> SimulationQuality {
        let frames = self.reports.len().max(1) as f64;
        let mut whole = SimulationQuality::default();
        for report in &self.reports {
            whole.penetration = whole.penetration.max(report.penetration);
            whole.mean_depth += report.mean_depth / frames;
            whole.crossings = whole.crossings.max(report.crossings);
            whole.mean_strain += report.strain[0] / frames;
            whole.strain = whole.strain.max(report.strain[1]);
            whole.speed = whole.speed.max(report.speed);
        }
        whole
    }
}

impl SimulationOptions {
    /// Simulates `garment` over the motion of a body with the unclothed rest shape `shape`, `[V, 3]`.
    /// Before anything is recorded the body goes from the shape and the pose in which the
    /// garment was made to its own and the first frame. `watch` is told the frames done and their number.
    pub fn run(
        &self,
        model: &SmplModel,
        shape: &Array2<f64>,
        (garment, material): (&GarmentMesh, &ClothMaterial),
        motion: &BodyMotion,
        watch: &mut dyn FnMut(usize, usize),
    ) -> Result<SimulatedGarment> {
        if self.substeps == 0 || !(self.settle >= 0.0 && self.settle.is_finite()) {
            return Err(Error::argument(format!(
                "{} steps a frame and {} s to settle: expected at least 1 and 0",
                self.substeps, self.settle
            )));
        }
        let track = self.track(model, (&garment.body, shape), motion)?;
        let rest = sewing_body(model, &garment.body)?.0;
        let across = rest.neighbours();
        let at_rest = SurfaceIndex::new(&rest);
        let band: Vec<_> = garment
            .waistband
            .iter()
            .filter_map(|&v| {
                let near = at_rest.closest(garment.surface.vertices[v as usize], 0.2)?;
                let off = garment.surface.vertices[v as usize] - near.point;
                Some((v, near.face, near.barycentric, at_rest.axes(near.face).transpose() * off))
            })
            .collect();
        let mut cloth =
            Cloth::new(&garment.surface, material)?.with_strain_limit(self.strain_limit);
        if self.self_collision {
            cloth = cloth.with_self_collision(&garment.surface, material.thickness);
        }
        let start = track[0][0] - rest.vertices[0];
        cloth.positions.iter_mut().for_each(|x| *x += start);
        let dt = 1.0 / (motion.frame_rate * self.substeps as f64);
        let recorded = motion.frames();
        let before = track.len() - recorded;
        let mut frames = Array3::zeros((recorded, cloth.positions.len(), 3));
        let mut reports = Vec::with_capacity(recorded);
        for (index, to) in track.iter().enumerate() {
            let from = &track[index.saturating_sub(1)];
            let surface = SurfaceMesh { vertices: from.clone(), faces: model.faces.clone() };
            let mut solid = SurfaceIndex::moving(&surface, to.clone(), across.clone());
            for substep in 0..self.substeps {
                let [was, now] = [substep, substep + 1].map(|s| s as f64 / self.substeps as f64);
                solid.set_time(now);
                let led = band.iter().map(|&(v, face, at, off)| {
                    (v, solid.position_at(face, at, now) + solid.axes(face) * off)
                });
                cloth.attach(led, self.waistband);
                cloth.step(dt, self.gravity, Some((&solid, [was, now])));
            }
            let Some(frame) = index.checked_sub(before) else { continue };
            if let Some(vertex) = cloth.positions.iter().position(|x| !x.is_finite()) {
                return Err(Error::argument(format!(
                    "the simulation failed in frame {frame} at vertex {vertex}: take more steps"
                )));
            }
            for (vertex, x) in cloth.positions.iter().enumerate() {
                for axis in 0..3 {
                    frames[(frame, vertex, axis)] = x[axis];
                }
            }
            reports.push(report(&cloth, &solid));
            watch(frame + 1, recorded);
        }
        Ok(SimulatedGarment { frames, reports })
    }

    /// Body vertices of the way to the first frame, then of the frames.
    fn track(
        &self,
        model: &SmplModel,
        (made_for, shape): (&Array2<f64>, &Array2<f64>),
        motion: &BodyMotion,
    ) -> Result<Vec<Vec<DVec3>>> {
        if motion.frames() == 0 {
            return Err(Error::argument("a motion without frames"));
        }
        let way = (self.settle * motion.frame_rate).ceil() as usize;
        let standing = way / 2;
        let transl = |frame: usize| {
            DVec3::from_array([0, 1, 2].map(|axis| motion.translations[(frame, axis)]))
        };
        // From rest to the speed at the start, evenly, metres a frame.
        let speed = transl(1.min(motion.frames() - 1)) - transl(0);
        let run_up = |to_go: usize| {
            let gone = (standing - to_go) as f64;
            let whole = standing as f64;
            transl(0) + speed * (0.5 * gone * gone / whole.max(1.0) - 0.5 * whole)
        };
        let first = motion.poses.row(0);
        let sewn = Array1::from_vec(sewing_pose(model));
        let mut stations = Vec::new();
        for step in 0..=way {
            let t = step as f64 / way.max(1) as f64;
            let share = t * t * (3.0 - 2.0 * t);
            stations.push((share, &sewn * (1.0 - share) + &first * share, run_up(standing)));
        }
        stations.extend((1..standing).map(|gone| (1.0, first.to_owned(), run_up(standing - gone))));
        let frames = 0..motion.frames();
        stations.extend(frames.map(|f| (1.0, motion.poses.row(f).to_owned(), transl(f))));
        stations
            .par_iter()
            .map(|(share, pose, transl)| {
                let shape = made_for * (1.0 - share) + shape * *share;
                let posed = model.pose_shape(&shape, &pose.to_vec(), transl.to_array(), None)?;
                Ok(points(posed.vertices.view()))
            })
            .collect()
    }
}

fn report(cloth: &Cloth, body: &SurfaceIndex) -> StepReport {
    let depths = cloth.depths(body);
    StepReport {
        penetration: depths.iter().copied().fold(0.0, f64::max),
        mean_depth: depths.iter().sum::<f64>() / depths.len().max(1) as f64,
        inside: depths.iter().filter(|&&depth| depth > 0.0).count(),
        crossings: cloth.crossings(),
        strain: cloth.strain(),
        speed: cloth.velocities.iter().map(|v| v.length()).fold(0.0, f64::max),
    }
}
