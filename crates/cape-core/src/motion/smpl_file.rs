//! `.smpl` files, version 2: poses, shape and displacements of a body in an `.npz` archive.

use std::path::Path;

use ndarray::{Array1, Array2, Array3, arr0};

use super::BodyMotion;
use crate::{Error, Result, npy::NpzWriter};

/// Version of the format.
const CODEC_VERSION: i32 = 2;
/// Number of the SMPL body among the format's bodies.
const SMPL: i32 = 0;
/// Number of shape coefficients.
const BETAS: usize = 10;

/// Content of a `.smpl` file of an SMPL body.
///
/// ```
/// use cape_core::{BodyMotion, motion::{MotionOptions, SmplFile, read_motion}};
/// use ndarray::Array2;
///
/// let motion = BodyMotion::new(30.0, Array2::zeros((2, 72)), Array2::ones((2, 3)))?;
/// let directory = tempfile::tempdir()?;
/// let path = directory.path().join("standing.smpl");
/// let file = SmplFile { motion: &motion, betas: &[0.5], gender: Some("female"), offsets: None };
/// file.save(&path)?;
/// let found = read_motion(&path, &MotionOptions::default())?;
/// assert_eq!((found.betas[0], found.gender.as_deref()), (0.5, Some("female")));
/// assert_eq!(found.motion(None, [0.0; 3])?, motion);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy)]
pub struct SmplFile<'a> {
    /// Poses of 24 joints, and translations; y points up.
    pub motion: &'a BodyMotion,
    /// Shape coefficients, of which the format has ten.
    pub betas: &'a [f64],
    /// `male` or `female`; any other is neutral.
    pub gender: Option<&'a str>,
    /// Displacements of the rest vertices, such as clothing, metres, `[V, 3]`.
    pub offsets: Option<&'a Array2<f64>>,
}

impl SmplFile<'_> {
    /// Writes the file, atomically.
    ///
    /// # Errors
    /// If the poses are not of 24 joints, there are more than ten shape coefficients, or the file
    /// cannot be written.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<()> {
        let frames = self.motion.frames();
        if self.motion.poses.ncols() != 72 || self.betas.len() > BETAS {
            return Err(Error::argument(format!(
                ".smpl: poses of {} numbers and {} betas, expected 72 and at most {BETAS}",
                self.motion.poses.ncols(),
                self.betas.len()
            )));
        }
        let gender = match self.gender {
            Some("male") => 1,
            Some("female") => 2,
            _ => 0,
        };
        let mut betas = Array1::<f32>::zeros(BETAS);
        for (beta, &given) in betas.iter_mut().zip(self.betas) {
            *beta = given as f32;
        }
        let poses: Array3<f32> = Array3::from_shape_fn((frames, 24, 3), |(frame, joint, axis)| {
            self.motion.poses[(frame, 3 * joint + axis)] as f32
        });
        let mut archive = NpzWriter::create(path)?.deflate();
        let numbers = [
            ("codecVersion", CODEC_VERSION),
            ("smplVersion", SMPL),
            ("gender", gender),
            ("frameCount", frames as i32),
        ];
        for (name, number) in numbers {
            archive.add(name, &arr0(number))?;
        }
        archive.add("shapeParameters", &betas)?;
        archive.add("frameRate", &arr0(self.motion.frame_rate as f32))?;
        archive.add("bodyTranslation", &self.motion.translations.mapv(|x| x as f32))?;
        archive.add("bodyPose", &poses)?;
        if let Some(offsets) = self.offsets {
            archive.add("vertexOffsets", &offsets.mapv(|x| x as f32))?;
        }
        archive.finish()
    }
}
