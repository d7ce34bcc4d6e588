//! Simulation of one take.

use cape_cloth::{SimulatedGarment, SimulationOptions, SimulationQuality};
use cape_core::{
    BodyMotion, SmplModel,
    geometry::{SurfaceIndex, SurfaceMesh, points},
    smpl::StandardPose,
};
use cape_synth::SynthFrame;
use glam::DVec3;
use ndarray::{Array1, Array2, Axis};
use rand::{RngExt, rngs::ChaCha8Rng};
use rand_distr::StandardNormal;
use serde::{Deserialize, Serialize};

use crate::{
    OutfitCut, Result, SewnOutfit, SurfaceTransfer, WardrobeOptions, canonical::CanonicalBody,
    mesh_graph::MeshGraph, transfer::PosedBody,
};

/// Quality of the frames of a take.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct TakeQuality {
    /// Quality of the simulation.
    pub simulation: SimulationQuality,
    /// Largest share of triangles that were turned against the body's in one frame.
    pub turned_before: f64,
    /// Largest share of triangles that are turned against the body's in one frame.
    pub turned: f64,
    /// Mean share of triangles that intersect others and do not on the unclothed body.
    pub intersecting: f64,
    /// Largest depth of a covered vertex inside the unclothed body, metres.
    pub depth: f64,
    /// Mean share of covered vertices more than 1 mm inside the unclothed body.
    pub inside: f64,
    /// Mean length of the displacements of covered vertices, metres.
    pub displacement: f64,
}

/// Error of registrations: a smooth displacement of the covered vertices.
#[derive(Debug)]
pub(crate) struct RegistrationNoise {
    /// Standard deviation of a coordinate, metres.
    pub(crate) deviation: f64,
    pub(crate) rng: ChaCha8Rng,
}

impl RegistrationNoise {
    fn add(&mut self, graph: &MeshGraph, covered: &[bool], displacement: &mut [DVec3]) {
        if self.deviation <= 0.0 {
            return;
        }
        let mut draw = || self.rng.sample::<f64, _>(StandardNormal);
        let mut noise: Vec<DVec3> =
            covered.iter().map(|_| DVec3::new(draw(), draw(), draw())).collect();
        for _ in 0..2 {
            noise = (0..noise.len())
                .map(|v| noise[v].lerp(graph.mean(v as u32, |n| noise[n as usize]), 0.5))
                .collect();
        }
        let squares: f64 = noise.iter().map(|x| x.length_squared()).sum();
        let scale = self.deviation / (squares / (3 * noise.len()) as f64).sqrt();
        for ((d, x), _) in displacement.iter_mut().zip(noise).zip(covered).filter(|all| *all.1) {
            *d += x * scale;
        }
    }
}

/// A subject in garments.
#[derive(Debug, Clone)]
pub struct DressedSubject<'a> {
    model: &'a SmplModel,
    minimal: Array2<f64>,
    cut: OutfitCut,
    sewn: SewnOutfit,
    transfer: SurfaceTransfer,
}

impl<'a> DressedSubject<'a> {
    /// Sews the garments and finds the points of the body's vertices on them.
    ///
    /// # Errors
    /// If the garments do not fit the body's layout.
    pub fn new(model: &'a SmplModel, minimal: Array2<f64>, cut: OutfitCut) -> Result<Self> {
        let sewn = cut.sew(model)?;
        let standing = StandardPose::A.angles(model.joints());
        let body = model.pose_shape(&sewn.upper.body, &standing, [0.0; 3], None)?;
        let body = SurfaceMesh::from_rows("body", body.vertices.view(), &model.faces)?;
        let transfer = SurfaceTransfer::fit(&body, &sewn.layers());
        Ok(Self { model, minimal, cut, sewn, transfer })
    }

    /// Correspondence of body and garments.
    pub fn transfer(&self) -> &SurfaceTransfer {
        &self.transfer
    }

    /// Garments.
    pub fn sewn(&self) -> &SewnOutfit {
        &self.sewn
    }

    /// Simulates the garments over a motion, and lays every `stride`-th frame after the first `skip`
    /// onto the body's topology.
    ///
    /// # Errors
    /// If the motion does not fit the body, or the simulation diverges.
    pub(crate) fn simulate(
        &self,
        options: &WardrobeOptions,
        motion: &BodyMotion,
        (skip, stride): (usize, usize),
        noise: &mut RegistrationNoise,
    ) -> Result<(Vec<SynthFrame>, TakeQuality)> {
        let worn = [
            (&self.sewn.lower, &self.cut.lower_material),
            (&self.sewn.upper, &self.cut.upper_material),
        ];
        let simulation =
            SimulationOptions { measure_from: skip, measure_every: stride, ..options.simulation };
        let simulated =
            simulation.run_outfit(self.model, &self.minimal, &worn, motion, &mut |_, _| {})?;
        let qualities = simulated.iter().map(SimulatedGarment::quality);
        let simulation = qualities.reduce(SimulationQuality::with).unwrap_or_default();
        let canonical = CanonicalBody::new(self.model, &self.minimal)?;
        let covered: Vec<bool> = self.transfer.points().iter().map(Option::is_some).collect();
        let mut quality = TakeQuality { simulation, ..TakeQuality::default() };
        let mut frames = Vec::new();
        for frame in (skip..motion.frames()).step_by(stride) {
            let pose = motion.poses.row(frame).to_vec();
            let transl = motion.translation(frame);
            let body = self.model.pose_shape(&self.minimal, &pose, transl, None)?.vertices;
            let skin = points(body.view());
            let vertices = |worn: &SimulatedGarment| points(worn.frames.index_axis(Axis(0), frame));
            let garment = simulated.iter().flat_map(vertices).collect::<Vec<_>>();
            let surface = SurfaceMesh { vertices: skin.clone(), faces: self.model.faces.clone() };
            let layers =
                self.sewn.layers().map(|layer| SurfaceMesh { vertices: garment.clone(), ..layer });
            let body = PosedBody { surface: &surface, graph: &canonical.graph };
            let laid = self.transfer.lay_sliding(&body, &layers, options.sliding);
            let at = canonical.frame(&pose, transl)?;
            let mut displacement = canonical.displacement(&at, &laid, &covered);
            noise.add(&canonical.graph, &covered, &mut displacement);
            let [before, _] = canonical.relax(&mut displacement, &covered);
            let bare = canonical.graph.intersecting(&skin);
            canonical.separate(&at, &bare, &mut displacement, &covered);
            let [turned, _] = canonical.relax(&mut displacement, &covered);
            let share = |count: usize| count as f64 / bare.len() as f64;
            quality.turned_before = quality.turned_before.max(share(before));
            quality.turned = quality.turned.max(share(turned));
            let displacement = rows(&displacement);
            let posed =
                self.model.pose_shape(&self.minimal, &pose, transl, Some(&displacement))?.vertices;
            let crossing = canonical.graph.intersecting(&points(posed.view()));
            let new = crossing.iter().zip(&bare).filter(|(now, bare)| **now && !**bare).count();
            quality.intersecting += share(new);
            quality.add_depths(self, (&skin, &posed), &covered);
            let lengths = displacement.rows().into_iter().map(|d| d.dot(&d).sqrt()).sum::<f64>();
            quality.displacement += lengths / covered.iter().filter(|&&c| c).count().max(1) as f64;
            frames.push(SynthFrame {
                v_cano: (&self.minimal + &displacement).mapv(|x| x as f32),
                v_posed: posed.mapv(|x| x as f32),
                pose: Array1::from_vec(pose),
                transl: Array1::from_vec(transl.to_vec()),
            });
        }
        quality.displacement /= frames.len().max(1) as f64;
        quality.intersecting /= frames.len().max(1) as f64;
        quality.inside /= frames.len().max(1) as f64;
        Ok((frames, quality))
    }
}

impl TakeQuality {
    fn add_depths(
        &mut self,
        subject: &DressedSubject,
        (skin, posed): (&[DVec3], &Array2<f64>),
        covered: &[bool],
    ) {
        let posed = points(posed.view());
        let faces = &subject.model.faces;
        let body = SurfaceMesh { vertices: skin.to_vec(), faces: faces.clone() };
        let index = SurfaceIndex::new(&body);
        let (mut inside, mut all) = (0.0, 0.0f64);
        for (p, _) in posed.iter().zip(covered).filter(|&(_, &covered)| covered) {
            let depth = index.closest(*p, 0.1).map_or(0.0, |near| -near.signed_distance);
            self.depth = self.depth.max(depth);
            (inside, all) = (inside + f64::from(u8::from(depth > 1e-3)), all + 1.0);
        }
        self.inside += inside / all.max(1.0);
    }
}

fn rows(vectors: &[DVec3]) -> Array2<f64> {
    Array2::from_shape_fn((vectors.len(), 3), |(v, axis)| vectors[v][axis])
}
