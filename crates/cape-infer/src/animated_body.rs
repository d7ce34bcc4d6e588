//! Animated clothed bodies as glTF: SMPL's skeleton and skin, a keyframe for each pose.

use std::path::Path;

use cape_core::{
    BodyPose, Outfit,
    gltf::{self, GltfTexture, Keyframe, SkinnedMesh},
};
use ndarray::{Array2, Axis};

use crate::{BodySpec, ClothedModel, Error, Result, batches};

/// Most poses of a file: each takes a morph target of 82 kB.
const MOST_FRAMES: usize = 2000;

/// A clothed body in motion: one latent code and outfit under a sequence of poses.
#[derive(Debug, Clone)]
pub struct AnimatedBody<'a> {
    /// Name of the mesh, shown by programs that open the file.
    pub name: &'a str,
    /// Latent code, `[1, latent]`.
    pub code: Array2<f32>,
    /// Shape coefficients β; missing ones are zero.
    pub betas: &'a [f32],
    /// Outfit, the paper's clothing type `c`.
    pub outfit: Outfit,
    /// Poses in axis-angle, `[frames][72]`, radians; at least one.
    pub poses: Vec<BodyPose>,
    /// Frame rate, poses per second.
    pub frames_per_second: f32,
    /// Number of shape directions added as morph targets.
    pub shape_targets: usize,
    /// Vertex colours, sRGB from 0 to 1, `[V, 3]`.
    pub colours: Option<&'a [[f32; 3]]>,
    /// Texture coordinates and image.
    pub texture: Option<GltfTexture<'a>>,
}

impl<'a> AnimatedBody<'a> {
    /// A single frame of `body` clothed by `code` `[1, latent]`.
    pub fn from_body(name: &'a str, code: &Array2<f32>, body: &'a BodySpec) -> Self {
        Self {
            name,
            code: code.clone(),
            betas: &body.betas,
            outfit: body.outfit,
            poses: vec![body.pose],
            frames_per_second: 30.0,
            shape_targets: 0,
            colours: None,
            texture: None,
        }
    }

    /// Decodes every pose and writes a `.glb` file.
    ///
    /// # Errors
    /// If there is no pose or there are too many, sizes do not suit the run, or the file cannot be
    /// written.
    pub fn save(&self, model: &ClothedModel, path: impl AsRef<Path>) -> Result<()> {
        let (figure, keyframes) = self.figure(model)?;
        Ok(gltf::write(path, &figure, &keyframes)?)
    }

    /// The bytes of [`save`](Self::save)'s file.
    ///
    /// # Errors
    /// As of [`save`](Self::save).
    pub fn encode(&self, model: &ClothedModel) -> Result<Vec<u8>> {
        let (figure, keyframes) = self.figure(model)?;
        Ok(gltf::encode(&figure, &keyframes)?)
    }

    fn figure<'s>(&'s self, model: &'s ClothedModel) -> Result<(SkinnedMesh<'s>, Vec<Keyframe>)> {
        if self.poses.is_empty() || self.poses.len() > MOST_FRAMES {
            return Err(Error::argument(format!(
                "{} poses, but a glTF file takes 1 to {MOST_FRAMES}: give fewer, or write .obj or \
                 .ply",
                self.poses.len()
            )));
        }
        let body = model.body();
        let mut betas: Vec<f64> = self.betas.iter().map(|&beta| beta.into()).collect();
        betas.resize(body.betas().max(betas.len()), 0.0);
        let shape = body.rest_shape(&betas)?;
        let displacements = self.displacements(model)?;
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
        let figure = SkinnedMesh {
            name: self.name,
            body,
            rest: &shape + first,
            joints: body.rest_joints(&shape)?,
            colours: self.colours,
            texture: self.texture,
            targets,
        };
        Ok((figure, keyframes))
    }

    /// Displacements at clothing vertices under every pose, metres, `[V, 3]` each.
    fn displacements(&self, model: &ClothedModel) -> Result<Vec<Array2<f64>>> {
        let mut found = Vec::with_capacity(self.poses.len());
        for rows in batches(self.poses.len()) {
            let bodies: Vec<BodySpec> = self.poses[rows]
                .iter()
                .map(|&pose| BodySpec { betas: Vec::new(), pose, outfit: self.outfit })
                .collect();
            let codes = self.code.select(Axis(0), &vec![0; bodies.len()]);
            for displacement in model.decode_displacements(&codes, &bodies)?.outer_iter() {
                let mut displacement = displacement.mapv(f64::from);
                for (mut row, &covered) in
                    displacement.rows_mut().into_iter().zip(model.mask().covered())
                {
                    if !covered {
                        row.fill(0.0);
                    }
                }
                found.push(displacement);
            }
        }
        Ok(found)
    }
}
