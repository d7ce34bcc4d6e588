use std::ops::Range;

use cape_core::SmplModel;
use glam::DVec3;
use ndarray::{Array1, Array2, Array3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{
    Cloth, ClothMaterial, Contact, GarmentMesh, Penetration,
    contact::displacements,
    garment::{sewing_body, sewing_pose},
    outfit::{attached_waistbands, part, reinforcements},
};
use crate::{Error, Result};
use cape_core::{
    BodyMotion,
    geometry::{SurfaceIndex, SurfaceMesh, points},
};

/// Options of the simulation of a garment.
///
/// ```
/// use cape_synth::synthetic_body;
/// use cape_cloth::{Garment, GarmentKind, ClothMaterial, SimulationOptions};
/// use cape_core::BodyMotion;
/// use ndarray::Array2;
///
/// // A coarse skirt settles on the hips of a standing body.
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
    /// Least number of steps per frame; frames in which body or cloth moves by more than 10 mm in such
    /// a step, against the body's mean motion, have more.
    pub substeps: usize,
    /// Duration of the transition from the sewing pose to the first pose, seconds, followed by half
    /// as long an acceleration to the initial velocity.
    pub settle: f64,
    /// Gravitational acceleration, m/s².
    pub gravity: DVec3,
    /// Density of the air, kg/m³.
    pub air: f64,
    /// Resolve self-collisions at the thickness of the material.
    pub self_collision: bool,
    /// Largest relative elongation of an edge.
    pub strain_limit: f64,
    /// Compliance of the attachment of the waistband to the body, m/N.
    pub waistband: f64,
    /// First frame of the motion whose quality is measured.
    pub measure_from: usize,
    /// Number of frames from one whose quality is measured to the next, at least 1.
    pub measure_every: usize,
}

impl Default for SimulationOptions {
    fn default() -> Self {
        Self {
            substeps: 20,
            settle: 1.0,
            gravity: DVec3::NEG_Y * 9.81,
            air: 1.2,
            self_collision: true,
            strain_limit: 0.3,
            waistband: 0.01,
            measure_from: 0,
            measure_every: 1,
        }
    }
}

/// Quality of the simulation after one frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct StepReport {
    /// Largest depth of a point of the cloth inside the body, metres ([`Penetration`]).
    pub penetration: f64,
    /// Mean depth of vertices inside the body, 0 for those outside, metres.
    pub mean_depth: f64,
    /// Number of vertices inside the body.
    pub inside: usize,
    /// Number of intersections of cloth and body, edges with faces.
    pub intersections: usize,
    /// Number of vertices and intersections between parts of the body that overlap.
    pub hidden: usize,
    /// Number of intersections of edges with faces of the cloth, of all garments.
    pub crossings: usize,
    /// Mean absolute strain of the edges, and largest elongation.
    pub strain: [f64; 2],
    /// Largest speed of a vertex, m/s.
    pub speed: f64,
}

impl StepReport {
    /// Quality of one garment, the vertices in the range of the cloth, apart from crossings.
    fn measure(
        cloth: &Cloth,
        (worn, range): (&SurfaceMesh, Range<usize>),
        body: &SurfaceMesh,
    ) -> Self {
        let found = Penetration::measure(worn, body);
        let speeds = cloth.velocities[range.clone()].iter().map(|v| v.length());
        Self {
            penetration: found.depth,
            mean_depth: found.mean_depth,
            inside: found.inside,
            intersections: found.intersections,
            hidden: found.hidden,
            crossings: 0,
            strain: cloth.strain_within(range),
            speed: speeds.fold(0.0, f64::max),
        }
    }
}

/// Quality of a simulation over the measured frames.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct SimulationQuality {
    /// Largest depth of a point of the cloth inside the body, metres.
    pub penetration: f64,
    /// Mean depth of vertices inside the body, 0 for those outside, metres.
    pub mean_depth: f64,
    /// Largest number of intersections of cloth and body, edges with faces, in one frame.
    #[serde(default)]
    pub intersections: usize,
    /// Largest number of intersections of edges with faces of the cloth in one frame.
    pub crossings: usize,
    /// Mean absolute strain of the edges.
    pub mean_strain: f64,
    /// Largest relative elongation of an edge.
    pub strain: f64,
    /// Largest speed of a vertex, m/s.
    pub speed: f64,
}

impl SimulationQuality {
    /// Quality of two garments of one simulation: largest values, the sum of intersections, and the
    /// means of mean values.
    #[must_use]
    pub fn with(self, other: Self) -> Self {
        Self {
            penetration: self.penetration.max(other.penetration),
            mean_depth: self.mean_depth.midpoint(other.mean_depth),
            intersections: self.intersections + other.intersections,
            crossings: self.crossings.max(other.crossings),
            mean_strain: self.mean_strain.midpoint(other.mean_strain),
            strain: self.strain.max(other.strain),
            speed: self.speed.max(other.speed),
        }
    }
}

/// Simulated motion of a garment.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulatedGarment {
    /// Clothing vertices, metres, `[frames, vertices, 3]`.
    pub frames: Array3<f64>,
    /// Quality after each measured frame ([`SimulationOptions::measure_from`]).
    pub reports: Vec<StepReport>,
}

impl SimulatedGarment {
    /// Largest and mean values over the measured frames.
    pub fn quality(&self) -> SimulationQuality {
        let frames = self.reports.len().max(1) as f64;
        let mut whole = SimulationQuality::default();
        for report in &self.reports {
            whole.penetration = whole.penetration.max(report.penetration);
            whole.mean_depth += report.mean_depth / frames;
            whole.intersections = whole.intersections.max(report.intersections);
            whole.crossings = whole.crossings.max(report.crossings);
            whole.mean_strain += report.strain[0] / frames;
            whole.strain = whole.strain.max(report.strain[1]);
            whole.speed = whole.speed.max(report.speed);
        }
        whole
    }
}

impl SimulationOptions {
    /// Simulates a garment of a material on a body with the unclothed rest shape `shape`, metres,
    /// `[V, 3]`, in motion. Before the first recorded frame the body changes from the shape and the
    /// pose in which the garment was sewn to `shape` and the first pose. `watch` is called with the
    /// number of finished frames and of all.
    ///
    /// # Errors
    /// If an option is out of range, the motion does not fit the body, or the simulation diverges.
    pub fn run(
        &self,
        model: &SmplModel,
        shape: &Array2<f64>,
        worn: (&GarmentMesh, &ClothMaterial),
        motion: &BodyMotion,
        watch: &mut dyn FnMut(usize, usize),
    ) -> Result<SimulatedGarment> {
        let mut all = self.run_outfit(model, shape, &[worn], motion, watch)?;
        all.pop().ok_or_else(|| Error::argument("simulation: no garment, expected at least one"))
    }

    /// Simulates several garments with their materials, from the inner to the outer one, which touch
    /// each other at their thicknesses: a shirt over trousers. All are sewn for the same body, and each
    /// begins outside the one before it.
    ///
    /// # Errors
    /// As of [`run`](Self::run), or if there is no garment, or they are sewn for different bodies.
    ///
    /// ```
    /// use cape_cloth::{ClothMaterial, Garment, GarmentKind, SimulationOptions};
    /// use cape_core::BodyMotion;
    /// use cape_synth::synthetic_body;
    /// use ndarray::Array2;
    ///
    /// let body = synthetic_body();
    /// let shape = body.rest_shape(&[])?;
    /// let sew = |kind, length| {
    ///     Garment { resolution: 0.05, length, ..Garment::new(kind) }.sew(&body, &shape)
    /// };
    /// let [trousers, shirt] = [sew(GarmentKind::Shorts, 1.8)?, sew(GarmentKind::TShirt, 1.15)?];
    /// let outfit = [(&trousers, &ClothMaterial::DENIM), (&shirt, &ClothMaterial::INTERLOCK)];
    /// let motion = BodyMotion::new(30.0, Array2::zeros((1, 72)), Array2::zeros((1, 3)))?;
    /// let options = SimulationOptions { settle: 0.1, ..SimulationOptions::default() };
    /// let worn = options.run_outfit(&body, &shape, &outfit, &motion, &mut |_, _| {})?;
    /// assert_eq!(worn[1].frames.dim(), (1, shirt.surface.vertices.len(), 3));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn run_outfit(
        &self,
        model: &SmplModel,
        shape: &Array2<f64>,
        outfit: &[(&GarmentMesh, &ClothMaterial)],
        motion: &BodyMotion,
        watch: &mut dyn FnMut(usize, usize),
    ) -> Result<Vec<SimulatedGarment>> {
        self.check()?;
        let sewn_for = match outfit {
            [(first, _), others @ ..] if others.iter().all(|(g, _)| g.body == first.body) => {
                &first.body
            }
            [] => return Err(Error::argument("simulation: no garment, expected at least one")),
            _ => {
                let message = "simulation: garments sewn for different bodies: sew them for one";
                return Err(Error::argument(message));
            }
        };
        let track = self.track(model, (sewn_for, shape), motion)?;
        let rest = sewing_body(model, sewn_for)?.0;
        let across = rest.neighbours();
        let bands = attached_waistbands(outfit, &rest);
        let sheets: Vec<_> = outfit.iter().map(|(g, material)| (&g.surface, *material)).collect();
        let mut cloth =
            Cloth::layered(&sheets)?.with_strain_limit(self.strain_limit).with_air(self.air);
        let (hems, cuffs) = reinforcements(outfit);
        cloth = cloth.with_double(&hems).with_elastic(&cuffs);
        if self.self_collision {
            cloth = cloth.with_layer_collision();
        }
        let start = track[0][0] - rest.vertices[0];
        cloth.positions = super::outfit::dressed(&sheets);
        cloth.positions.iter_mut().for_each(|x| *x += start);
        let recorded = motion.frames();
        let before = track.len() - recorded;
        let mut results: Vec<SimulatedGarment> = sheets
            .iter()
            .map(|(surface, _)| SimulatedGarment {
                frames: Array3::zeros((recorded, surface.vertices.len(), 3)),
                reports: Vec::with_capacity(recorded),
            })
            .collect();
        for (index, to) in track.iter().enumerate() {
            let from = &track[index.saturating_sub(1)];
            let surface = SurfaceMesh { vertices: from.clone(), faces: model.faces.clone() };
            let mut solid = SurfaceIndex::moving(&surface, to.clone(), across.clone());
            self.advance(&mut cloth, &mut solid, 1.0 / motion.frame_rate, |cloth, solid, now| {
                let attached = bands.iter().map(|&(v, face, at, off)| {
                    (v, solid.position_at(face, at, now) + solid.axes(face) * off)
                });
                cloth.attach(attached, self.waistband);
            });
            let Some(frame) = index.checked_sub(before) else { continue };
            if let Some(vertex) = cloth.positions.iter().position(|x| !x.is_finite()) {
                return Err(Error::argument(format!(
                    "simulation: diverged in frame {frame} at vertex {vertex}: use more steps per frame"
                )));
            }
            let measured = frame >= self.measure_from
                && (frame - self.measure_from).is_multiple_of(self.measure_every);
            let crossings = if measured { cloth.crossings() } else { 0 };
            let mut first = 0;
            for (result, (surface, _)) in results.iter_mut().zip(&sheets) {
                let range = first..first + surface.vertices.len();
                first = range.end;
                for (vertex, x) in cloth.positions[range.clone()].iter().enumerate() {
                    for axis in 0..3 {
                        result.frames[(frame, vertex, axis)] = x[axis];
                    }
                }
                if measured {
                    let worn = part(&cloth.positions[range.clone()], surface);
                    let report = StepReport::measure(&cloth, (&worn, range), solid.surface());
                    result.reports.push(StepReport { crossings, ..report });
                }
            }
            watch(frame + 1, recorded);
        }
        Ok(results)
    }

    fn check(&self) -> Result<()> {
        if self.substeps == 0 || !(self.settle >= 0.0 && self.settle.is_finite()) {
            return Err(Error::argument(format!(
                "simulation: {} steps per frame and {} s to settle, expected at least 1 and 0",
                self.substeps, self.settle
            )));
        }
        if self.measure_every == 0 {
            return Err(Error::argument(
                "simulation: quality measured every 0 frames, expected at least 1",
            ));
        }
        Ok(())
    }

    /// Moves cloth and body by one frame of `duration` seconds in as many steps as their motion needs.
    /// `attach` is called before each step with the time within the frame after it, 0 to 1.
    pub(super) fn advance(
        &self,
        cloth: &mut Cloth,
        body: &mut SurfaceIndex,
        duration: f64,
        attach: impl Fn(&mut Cloth, &SurfaceIndex, f64),
    ) {
        let substeps = self.substeps(cloth, body, duration);
        let dt = duration / substeps as f64;
        for substep in 0..substeps {
            let [was, now] = [substep, substep + 1].map(|s| s as f64 / substeps as f64);
            body.set_time(now);
            attach(cloth, body, now);
            cloth.step(dt, self.gravity, Some((body, [was, now])));
        }
    }

    /// Number of steps of the next frame of `duration` seconds: in each, body and cloth move by at most
    /// 10 mm against the body's mean motion, and by at most half the reach of contact.
    fn substeps(&self, cloth: &Cloth, body: &SurfaceIndex, duration: f64) -> usize {
        const FARTHEST: f64 = 0.01;
        const MOST: f64 = 200.0;
        let (moves, mean) = displacements(body);
        let relative = moves.iter().map(|[from, to]| (*to - *from - mean).length());
        let farthest = relative.fold(0.0, f64::max);
        let along = mean / duration;
        let fastest = cloth.velocities.iter().map(|v| (*v - along).length()).fold(0.0, f64::max);
        let way = farthest.max(fastest * duration) / FARTHEST;
        let whole = (mean.length() + farthest) / (0.5 * Contact::REACH);
        self.substeps.max(way.max(whole).min(MOST).ceil() as usize)
    }

    /// Body vertices, metres, of the transition to the first frame, then of the frames.
    fn track(
        &self,
        model: &SmplModel,
        (sewn_for, shape): (&Array2<f64>, &Array2<f64>),
        motion: &BodyMotion,
    ) -> Result<Vec<Vec<DVec3>>> {
        if motion.frames() == 0 {
            return Err(Error::argument(
                "simulation: the motion has no frames, expected at least one",
            ));
        }
        let way = (self.settle * motion.frame_rate).ceil() as usize;
        let standing = way / 2;
        let transl = |frame: usize| {
            DVec3::from_array([0, 1, 2].map(|axis| motion.translations[(frame, axis)]))
        };
        // Constant acceleration from rest to the initial velocity, metres per frame.
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
                let shape = sewn_for * (1.0 - share) + shape * *share;
                let posed = model.pose_shape(&shape, &pose.to_vec(), transl.to_array(), None)?;
                Ok(points(posed.vertices.view()))
            })
            .collect()
    }
}
