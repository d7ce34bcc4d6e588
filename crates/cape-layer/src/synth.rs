//! Simulated sequences: exercises of several subjects, in several garment sizes and materials.

use cape_core::SmplModel;
use cape_synth::{Motion, MotionStyle};
use ndarray::{Array2, Axis};
use rand::{SeedableRng, rngs::ChaCha8Rng};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::{Error, LayerSet, Result, Sequence};
use cape_cloth::{ClothMaterial, Garment, GarmentMesh, SimulationOptions, SimulationQuality};
use cape_core::BodyMotion;

/// A motion of simulated sequences.
///
/// ```
/// use cape_synth::synthetic_body;
/// use cape_layer::synth::Exercise;
///
/// // Half a second of a walk at 1.2 m/s.
/// let body = synthetic_body();
/// let motion = Exercise::Walk.motion(&body, &body.rest_shape(&[])?, 16, 30.0)?;
/// assert_eq!(motion.poses.dim(), (16, 72));
/// let way = motion.translations[(15, 2)] - motion.translations[(0, 2)];
/// assert!((way - 0.6).abs() < 0.05);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Exercise {
    /// Walking forward, 1.2 m/s.
    Walk,
    /// Deep knee bends.
    Squat,
    /// Marching on the spot.
    March,
    /// Swinging the trunk from side to side.
    Swing,
    /// Jumping jacks, feet off the floor.
    Jump,
    /// A synthetic motion on the spot in a random style of a seed.
    #[serde(skip)]
    Styled(Motion, u64),
}

impl Exercise {
    /// The exercises of one style.
    pub const ALL: [Self; 5] = [Self::Walk, Self::Squat, Self::March, Self::Swing, Self::Jump];

    /// Name of the motion.
    pub const fn motion_name(self) -> &'static str {
        match self {
            Self::Walk => "walk",
            Self::Squat => "squat",
            Self::March => "march",
            Self::Swing => "swing",
            Self::Jump => "jump",
            Self::Styled(motion, _) => motion.name(),
        }
    }

    /// Name in files: the number of a style, and last the motion, without underscores.
    pub fn name(self) -> String {
        let motion = self.motion_name().replace('_', "-");
        match self {
            Self::Styled(_, style) => format!("v{style}_{motion}"),
            _ => motion,
        }
    }

    /// Every synthetic motion in styles of the seeds from 1 to `styles`.
    pub fn styled(styles: u64) -> Vec<Self> {
        let each = |motion| (1..=styles).map(move |style| Self::Styled(motion, style));
        Motion::CAPTURED.into_iter().flat_map(each).collect()
    }

    /// Motion of a body of 24 joints with the unclothed rest shape `[V, 3]`, metres, whose lowest
    /// point is on the floor `y = 0` except in jumps of 15 cm.
    pub fn motion(
        self,
        model: &SmplModel,
        shape: &Array2<f64>,
        frames: usize,
        frame_rate: f64,
    ) -> Result<BodyMotion> {
        const JUMP: f64 = 0.15;
        const JACK: f64 = 1.8;
        let style = match self {
            Self::Walk => MotionStyle { amplitude: 0.55, ..MotionStyle::default() },
            Self::Styled(_, seed) => MotionStyle::random(&mut ChaCha8Rng::seed_from_u64(seed)),
            _ => MotionStyle::default(),
        };
        let movement = match self {
            Self::Walk | Self::March => Motion::WalkMarch,
            Self::Squat => Motion::Squats,
            Self::Swing => Motion::TwistTilt,
            Self::Jump => Motion::JumpingJacks,
            Self::Styled(motion, _) => motion,
        };
        let rows: Vec<([f64; 72], [f64; 3])> = (0..frames)
            .into_par_iter()
            .map(|frame| {
                let time = frame as f64 / frame_rate;
                let pose = movement.pose(&style, time);
                let posed = model.pose_shape(shape, &pose, [0.0; 3], None)?.vertices;
                let floor = posed.column(1).iter().copied().fold(f64::INFINITY, f64::min);
                let from_top = (time / JACK).rem_euclid(1.0) * JACK - 0.5 * JACK;
                let (up, forward) = match self {
                    Self::Jump => ((JUMP - 0.5 * 9.81 * from_top.powi(2)).max(0.0), 0.0),
                    Self::Walk => (0.0, 1.2 * time),
                    _ => (0.0, 0.0),
                };
                Ok((pose, [0.0, up - floor, forward]))
            })
            .collect::<Result<_>>()?;
        let poses = Array2::from_shape_fn((frames, 72), |(f, k)| rows[f].0[k]);
        let translations = Array2::from_shape_fn((frames, 3), |(f, k)| rows[f].1[k]);
        Ok(BodyMotion::new(frame_rate, poses, translations)?)
    }
}

/// A full factorial design of subjects, garment sizes, materials and exercises, in one topology.
///
/// ```
/// use cape_cloth::{Garment, GarmentKind};
/// use cape_layer::synth::{Design, Exercise};
///
/// let skirt = Garment::new(GarmentKind::Skirt);
/// let design = Design {
///     sizes: vec![skirt, Garment { length: 1.2 * skirt.length, ..skirt }],
///     exercises: vec![Exercise::Walk, Exercise::Squat],
///     ..Design::new(skirt)
/// };
/// // Every synthetic motion in two styles.
/// assert_eq!(Exercise::styled(2)[1].name(), "v2_walk-march");
/// let names: Vec<String> = design.cells().iter().map(|cell| cell.name()).collect();
/// assert_eq!(names.len(), 4);
/// assert_eq!(names[3], "s00_z01_m00_squat");
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Design {
    /// Shape coefficients β of the subjects.
    pub subjects: Vec<Vec<f64>>,
    /// Sizes of one garment; the first is sewn for the mean body, the others are resized from it.
    pub sizes: Vec<Garment>,
    /// Cloth materials.
    pub materials: Vec<ClothMaterial>,
    /// Exercises.
    pub exercises: Vec<Exercise>,
    /// Frames of each sequence.
    pub frames: usize,
    /// Frames per second.
    pub frame_rate: f64,
    /// Options of the cloth simulation.
    pub simulation: SimulationOptions,
}

/// One combination of a [`Design`], by index.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct DesignCell {
    /// Index of the subject.
    pub subject: usize,
    /// Index of the garment size.
    pub size: usize,
    /// Index of the material.
    pub material: usize,
    /// Exercise.
    pub exercise: Exercise,
}

impl DesignCell {
    /// Name of the sequence, such as `s00_z01_m00_squat`.
    pub fn name(&self) -> String {
        let Self { subject, size, material, exercise } = self;
        format!("s{subject:02}_z{size:02}_m{material:02}_{}", exercise.name())
    }
}

/// Names of the semantic parameters of simulated sequences: garment size, then material. Sets of the
/// first version of the simulator have other numbers under the names `log_stretch`, `log_bend` and
/// `damping`.
pub const PARAMETERS: [&str; 8] = [
    "length",
    "width",
    "sleeve",
    "log_density",
    "log_stiffness",
    "log_rigidity",
    "damping_time",
    "friction",
];

impl Design {
    /// One subject of mean shape in one garment of the default material, in all exercises.
    pub fn new(garment: Garment) -> Self {
        Self {
            subjects: vec![vec![]],
            sizes: vec![garment],
            materials: vec![ClothMaterial::default()],
            exercises: Exercise::ALL.to_vec(),
            frames: 100,
            frame_rate: 30.0,
            simulation: SimulationOptions::default(),
        }
    }

    /// All combinations, exercises fastest.
    pub fn cells(&self) -> Vec<DesignCell> {
        let mut cells = Vec::new();
        for subject in 0..self.subjects.len() {
            for size in 0..self.sizes.len() {
                for material in 0..self.materials.len() {
                    for &exercise in &self.exercises {
                        cells.push(DesignCell { subject, size, material, exercise });
                    }
                }
            }
        }
        cells
    }

    /// Sews the garment of the first size for the mean body.
    ///
    /// # Errors
    /// If there is no size or it is out of range.
    pub fn sew(&self, model: &SmplModel) -> Result<GarmentMesh> {
        let first = self
            .sizes
            .first()
            .ok_or_else(|| Error::argument("design: no garment sizes, expected at least one"))?;
        Ok(first.sew(model, &model.rest_shape(&[])?)?)
    }

    /// Simulates one combination: the sequence and the quality of its simulation.
    ///
    /// # Errors
    /// If the combination is not in the design, or the simulation diverges.
    pub fn simulate(
        &self,
        model: &SmplModel,
        sewn: &GarmentMesh,
        cell: DesignCell,
    ) -> Result<(Sequence, SimulationQuality)> {
        let missing = || Error::argument(format!("design: {cell:?} is out of range"));
        let betas = self.subjects.get(cell.subject).ok_or_else(missing)?;
        let size = self.sizes.get(cell.size).ok_or_else(missing)?;
        let material = self.materials.get(cell.material).ok_or_else(missing)?;
        let shape = model.rest_shape(betas)?;
        let motion = cell.exercise.motion(model, &shape, self.frames, self.frame_rate)?;
        let sewn = sewn.resize(model, size)?;
        let result =
            self.simulation.run(model, &shape, (&sewn, material), &motion, &mut |_, _| {})?;
        let numbers = size.numbers().into_iter().chain(material.numbers());
        let named = PARAMETERS.iter().zip(numbers).map(|(name, x)| ((*name).to_owned(), x));
        let quality = result.quality();
        let sequence = Sequence {
            name: cell.name(),
            clothing: result.frames,
            betas: betas.clone(),
            motion,
            parameters: named.collect(),
        };
        Ok((sequence, quality))
    }

    /// Simulates all combinations in parallel. `watch` is called with the number of finished
    /// sequences and of all.
    ///
    /// # Errors
    /// As of [`simulate`](Self::simulate).
    pub fn set(
        &self,
        model: &SmplModel,
        watch: &(dyn Fn(usize, usize) + Sync),
    ) -> Result<LayerSet> {
        let sewn = self.sew(model)?;
        let cells = self.cells();
        let done = std::sync::atomic::AtomicUsize::new(0);
        let sequences = cells
            .par_iter()
            .map(|&cell| {
                let (sequence, _) = self.simulate(model, &sewn, cell)?;
                let done = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1;
                watch(done, cells.len());
                Ok(sequence)
            })
            .collect::<Result<_>>()?;
        LayerSet::new(sewn.surface.faces, sequences)
    }
}

/// A sequence whose clothing is followed by the vertices of its body, with the faces of both: a layer
/// that includes the body, as the paper's captured sequences do.
pub fn append_body(
    model: &SmplModel,
    faces: &[[u32; 3]],
    sequence: &Sequence,
) -> Result<(Vec<[u32; 3]>, Sequence)> {
    let shape = sequence.shape(model)?;
    let own = sequence.clothing.len_of(Axis(1));
    let mut clothing = ndarray::Array3::zeros((sequence.frames(), own + model.vertices(), 3));
    for frame in 0..sequence.frames() {
        let pose = sequence.motion.poses.row(frame).to_vec();
        let transl = [0, 1, 2].map(|axis| sequence.motion.translations[(frame, axis)]);
        let body = model.pose_shape(&shape, &pose, transl, None)?.vertices;
        let mut whole = clothing.index_axis_mut(Axis(0), frame);
        let (mut first, mut second) = whole.view_mut().split_at(Axis(0), own);
        first.assign(&sequence.clothing.index_axis(Axis(0), frame));
        second.assign(&body);
    }
    let shifted = model.faces.iter().map(|face| face.map(|v| v + own as u32));
    let faces = faces.iter().copied().chain(shifted).collect();
    Ok((faces, Sequence { clothing, ..sequence.clone() }))
}

#[cfg(test)]
mod tests {
    use cape_synth::synthetic_body;

    use super::*;
    use cape_cloth::GarmentKind;

    #[test]
    fn exercises_stand_on_the_floor() {
        let model = synthetic_body();
        let shape = model.rest_shape(&[]).unwrap();
        let lowest = |exercise: Exercise| -> Vec<f64> {
            let motion = exercise.motion(&model, &shape, 54, 30.0).unwrap();
            (0..54)
                .map(|f| {
                    let transl = [0, 1, 2].map(|k| motion.translations[(f, k)]);
                    let pose = motion.poses.row(f).to_vec();
                    let posed = model.pose_shape(&shape, &pose, transl, None).unwrap().vertices;
                    posed.column(1).iter().copied().fold(f64::INFINITY, f64::min)
                })
                .collect()
        };
        assert!(lowest(Exercise::Walk).iter().all(|y| y.abs() < 1e-9));
        let jump = lowest(Exercise::Jump);
        let in_air = jump.iter().filter(|&&y| y > 1e-9).count() as f64 / 30.0;
        assert!((in_air - 2.0 * (2.0 * 0.15f64 / 9.81).sqrt()).abs() < 0.07, "{in_air}");
        let highest = jump.iter().copied().fold(0.0, f64::max);
        assert!((highest - 0.15).abs() < 0.003, "{highest}");
    }

    #[test]
    fn a_design_is_one_topology_over_all_its_cells() {
        let model = synthetic_body();
        let skirt = Garment { resolution: 0.035, ..Garment::new(GarmentKind::Skirt) };
        let design = Design {
            subjects: vec![vec![], vec![1.5, -1.0]],
            sizes: vec![skirt, Garment { length: 1.1, width: 1.25, ..skirt }],
            exercises: vec![Exercise::March],
            frames: 4,
            ..Design::new(skirt)
        };
        let set = design.set(&model, &|_, _| {}).unwrap();
        assert_eq!((set.sequences.len(), set.frames()), (4, 16));
        let hem = |sequence: usize| {
            let last = set.sequences[sequence].clothing.index_axis(Axis(0), 3).to_owned();
            last.column(1).iter().copied().fold(f64::INFINITY, f64::min)
        };
        assert!(hem(1) < hem(0) - 0.05, "the longer skirt reaches further: {} {}", hem(0), hem(1));
        let (faces, whole) = append_body(&model, &set.faces, &set.sequences[2]).unwrap();
        assert_eq!(whole.clothing.len_of(Axis(1)), set.vertices() + model.vertices());
        LayerSet::new(faces, vec![whole]).unwrap();
    }
}
