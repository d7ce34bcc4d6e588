//! Animated clothed bodies as glTF and USD: SMPL's skeleton and skin, and keyframes of the vertices.

use std::path::Path;

use cape_core::{
    BodyMotion, KeyframeRule, KeyframeSelector, Outfit,
    gltf::{self, GltfTexture, Keyframe, SkinnedMesh},
    usd,
};
use ndarray::{Array2, ArrayView3, Axis};

use crate::{BodySpec, ClothedModel, Error, Result, batches};

/// Most bytes of a glTF file.
const MOST_BYTES: usize = u32::MAX as usize;

/// A clothed body in motion: one latent code and outfit over a motion.
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
    /// Poses of 24 joints, translations and frame rate; at least one frame.
    pub motion: BodyMotion,
    /// Choice of the frames whose vertex offsets are stored.
    pub keyframes: KeyframeRule,
    /// Displacements of every frame, metres, `[frames, V, 3]`; decoded if there are none.
    pub displacements: Option<ArrayView3<'a, f32>>,
    /// Number of shape directions added as morph targets.
    pub shape_targets: usize,
    /// Vertex colours, sRGB from 0 to 1, `[V, 3]`.
    pub colours: Option<&'a [[f32; 3]]>,
    /// Texture coordinates and image, of glTF.
    pub texture: Option<GltfTexture<'a>>,
}

/// Keyframes of a written animation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AnimationReport {
    /// Number of frames whose vertex offsets are stored.
    pub keyframes: usize,
    /// Largest distance of a vertex of any frame from where the file puts it, metres.
    pub error: f64,
}

impl<'a> AnimatedBody<'a> {
    /// A single frame of `body` clothed by `code` `[1, latent]`.
    pub fn from_body(name: &'a str, code: &Array2<f32>, body: &'a BodySpec) -> Self {
        let poses = Array2::from_shape_fn((1, body.pose.len()), |(_, at)| body.pose[at].into());
        Self {
            name,
            code: code.clone(),
            betas: &body.betas,
            outfit: body.outfit,
            motion: BodyMotion { frame_rate: 30.0, poses, translations: Array2::zeros((1, 3)) },
            keyframes: KeyframeRule::default(),
            displacements: None,
            shape_targets: 0,
            colours: None,
            texture: None,
        }
    }

    /// Writes a file: USD if its name ends in `.usda`, else glTF (`.glb`).
    ///
    /// # Errors
    /// If there is no frame or a glTF file would be too large, sizes do not suit the run, or the file
    /// cannot be written.
    pub fn save(&self, model: &ClothedModel, path: impl AsRef<Path>) -> Result<AnimationReport> {
        self.check(model)?;
        let (figure, keyframes, report) = self.figure(model)?;
        if path.as_ref().extension().is_some_and(|found| found.eq_ignore_ascii_case("usda")) {
            usd::write(path, &figure, &keyframes)?;
        } else {
            gltf::write(path, &figure, &keyframes)?;
        }
        Ok(report)
    }

    /// The bytes of a glTF file.
    ///
    /// # Errors
    /// As of [`save`](Self::save).
    pub fn encode(&self, model: &ClothedModel) -> Result<Vec<u8>> {
        self.check(model)?;
        let (figure, keyframes, _) = self.figure(model)?;
        Ok(gltf::encode(&figure, &keyframes)?)
    }

    /// Checks, before any work, that the animation fits into a glTF file.
    ///
    /// # Errors
    /// If there is no frame, or every frame that may become a keyframe would make the file larger than
    /// 4 GiB.
    pub fn check(&self, model: &ClothedModel) -> Result<()> {
        let frames = self.motion.frames();
        let most = match self.keyframes {
            KeyframeRule::Tolerance(_) => frames,
            KeyframeRule::Every(step) => frames.div_ceil(step.max(1)) + 1,
        };
        // Offsets of a vertex, and a weight of each morph target in each keyframe.
        let bytes = most
            .checked_mul(12 * model.body().vertices())
            .and_then(|offsets| offsets.checked_add(most.checked_mul(4 * most)?));
        if frames > 0 && bytes.is_some_and(|bytes| bytes < MOST_BYTES) {
            return Ok(());
        }
        Err(Error::argument(format!(
            "{frames} frames with up to {most} keyframes: a file takes 1 frame to 4 GiB; lower the frame \
             rate (--fps), or store fewer keyframes (--every)"
        )))
    }

    fn figure<'s>(
        &'s self,
        model: &'s ClothedModel,
    ) -> Result<(SkinnedMesh<'s>, Vec<Keyframe>, AnimationReport)> {
        let body = model.body();
        let mut betas: Vec<f64> = self.betas.iter().map(|&beta| beta.into()).collect();
        betas.resize(body.betas().max(betas.len()), 0.0);
        let shape = body.rest_shape(&betas)?;
        let mut selector = KeyframeSelector::new(self.keyframes)?;
        let mut first: Option<Array2<f64>> = None;
        for rows in batches(self.motion.frames()) {
            for (frame, worn) in rows.clone().zip(self.worn(model, rows)?) {
                let first = first.get_or_insert_with(|| worn.clone());
                let pose = self.motion.poses.row(frame).to_vec();
                selector.push(body.pose_offsets(&pose)? + worn - &*first)?;
            }
        }
        let first = first.ok_or_else(|| Error::argument("animation: no frames"))?;
        let chosen = selector.finish();
        let report = AnimationReport { keyframes: chosen.keyframes.len(), error: chosen.error };
        let mut keyframes: Vec<Keyframe> = (0..self.motion.frames())
            .map(|frame| Keyframe {
                time: (frame as f64 / self.motion.frame_rate) as f32,
                pose: self.motion.poses.row(frame).to_vec(),
                transl: self.motion.translation(frame),
                offset: None,
            })
            .collect();
        for (frame, offset) in chosen.keyframes {
            keyframes[frame].offset = Some(offset);
        }
        let targets = (0..self.shape_targets.min(body.betas()))
            .map(|k| (format!("beta {k}"), body.shapedirs.index_axis(Axis(2), k).to_owned()))
            .collect();
        let figure = SkinnedMesh {
            name: self.name,
            body,
            rest: &shape + &first,
            joints: body.rest_joints(&shape)?,
            colours: self.colours,
            texture: self.texture,
            targets,
        };
        Ok((figure, keyframes, report))
    }

    /// Displacements at clothing vertices in some frames, metres, `[V, 3]` each.
    fn worn(
        &self,
        model: &ClothedModel,
        frames: std::ops::Range<usize>,
    ) -> Result<Vec<Array2<f64>>> {
        let decoded = if let Some(given) = &self.displacements {
            given.slice(ndarray::s![frames, .., ..]).to_owned()
        } else {
            let bodies: Vec<BodySpec> = frames
                .map(|frame| BodySpec {
                    betas: Vec::new(),
                    pose: self.motion.pose(frame),
                    outfit: self.outfit,
                })
                .collect();
            let codes = self.code.select(Axis(0), &vec![0; bodies.len()]);
            model.decode_displacements(&codes, &bodies)?
        };
        let at_clothing = |displacement: ndarray::ArrayView2<f32>| {
            let mut displacement = displacement.mapv(f64::from);
            let covered = model.mask().covered();
            for (mut row, &covered) in displacement.rows_mut().into_iter().zip(covered) {
                if !covered {
                    row.fill(0.0);
                }
            }
            displacement
        };
        Ok(decoded.outer_iter().map(at_clothing).collect())
    }
}
