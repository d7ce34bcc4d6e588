//! Clothed bodies as glTF: skeleton, skin, and a keyframe for each pose.

use std::path::Path;

use cape_core::{
    ClothingMask, Outfit,
    gltf::{self, Figure, Keyframe, Texture},
};
use cape_train::Run;
use ndarray::{Array2, Axis};

use crate::{
    error::{Error, Result},
    pose::Pose,
};

/// Poses of one file at most: each takes a morph target of 82 kB.
const MOST_FRAMES: usize = 2000;
/// Poses decoded at a time.
const BATCH: usize = 64;

/// One sample in one outfit, moving through poses.
pub(crate) struct Animated<'a> {
    pub(crate) run: &'a Run,
    pub(crate) name: &'a str,
    /// Latent code, `[1, latent]`.
    pub(crate) code: Array2<f32>,
    pub(crate) betas: &'a [f32],
    pub(crate) outfit: Outfit,
    pub(crate) poses: Vec<Pose>,
    pub(crate) frames_per_second: f32,
    /// Shape directions added as morph targets.
    pub(crate) shape_targets: usize,
    pub(crate) colours: Option<&'a [[f32; 3]]>,
    pub(crate) texture: Option<Texture<'a>>,
}

impl Animated<'_> {
    /// Decodes every pose and writes a `.glb` file.
    pub(crate) fn write(self, path: &Path) -> Result {
        if self.poses.len() > MOST_FRAMES {
            return Err(Error::message(format!(
                "{} poses, but a glTF file takes at most {MOST_FRAMES}: give fewer, or write .obj \
                 or .ply",
                self.poses.len()
            )));
        }
        let body = self.run.body();
        let mut betas: Vec<f64> = self.betas.iter().map(|&beta| beta.into()).collect();
        betas.resize(body.betas(), 0.0);
        let shape = body.shaped(&betas)?;
        let displacements = self.displacements()?;
        let first = &displacements[0];
        let mut keyframes = Vec::with_capacity(self.poses.len());
        for (index, (pose, worn)) in self.poses.iter().zip(&displacements).enumerate() {
            let pose: Vec<f64> = pose.iter().map(|&angle| angle.into()).collect();
            keyframes.push(Keyframe {
                time: index as f32 / self.frames_per_second,
                offset: body.pose_offsets(&pose)? + worn - first,
                transl: [0.0; 3],
                pose,
            });
        }
        let targets = (0..self.shape_targets.min(body.betas()))
            .map(|k| (format!("beta {k}"), body.shapedirs.index_axis(Axis(2), k).to_owned()))
            .collect();
        let figure = Figure {
            name: self.name,
            body,
            rest: &shape + first,
            joints: body.rest_joints(&shape)?,
            colours: self.colours,
            texture: self.texture,
            targets,
        };
        Ok(gltf::write(path, &figure, &keyframes)?)
    }

    /// Displacements at clothing vertices under every pose, metres.
    fn displacements(&self) -> Result<Vec<Array2<f64>>> {
        let mask = ClothingMask::from_indices(self.run.body().vertices(), self.run.clothing())?;
        let mut found = Vec::with_capacity(self.poses.len());
        for poses in self.poses.chunks(BATCH) {
            let codes = self.code.select(Axis(0), &vec![0; poses.len()]);
            let decoded = self.run.decode(&codes, poses, &vec![self.outfit; poses.len()])?;
            for worn in decoded.outer_iter() {
                let mut worn = worn.mapv(f64::from);
                for (mut row, &covered) in worn.rows_mut().into_iter().zip(mask.covered()) {
                    if !covered {
                        row.fill(0.0);
                    }
                }
                found.push(worn);
            }
        }
        Ok(found)
    }
}
