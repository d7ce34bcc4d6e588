//! Files of an animation.

use std::path::Path;

use cape_core::{
    BodyMotion, KeyframeRule, Mesh, Outfit, PointCacheFormat, PointCacheWriter, motion::SmplFile,
    obj, ply,
};
use cape_eval::clothing::at_clothing;
use cape_infer::{AnimatedBody, BodySpec, Run, batches};
use cape_render::{Bounds, Camera, Image, Object, Projection, Style, View, render, save_animation};
use ndarray::{Array2, Array3, Axis, s};

use crate::{
    console::Console,
    dressed_mesh::{DressedMesh, DressedRenderer},
    error::{Error, Result},
    options::FileKind,
};

/// Number of morph targets above which some programs do not show a glTF file.
const MANY_TARGETS: usize = 256;

/// An animation to be written.
pub(super) struct AnimationOutput<'a> {
    pub(super) run: &'a Run,
    /// Latent code, `[1, latent]`.
    pub(super) code: &'a Array2<f32>,
    pub(super) betas: &'a [f32],
    pub(super) outfit: &'a Outfit,
    pub(super) motion: &'a BodyMotion,
    pub(super) keyframes: KeyframeRule,
    pub(super) format: FileKind,
    /// Side of the pictures, pixels.
    pub(super) size: u32,
    pub(super) gender: Option<&'a str>,
    pub(super) out: &'a Path,
    pub(super) console: Console,
}

/// Keyframes and error of a written animation, metres, where the format has them.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Written {
    pub(super) keyframes: Option<usize>,
    pub(super) error: Option<f64>,
}

impl AnimationOutput<'_> {
    /// Returns an error if the animation cannot be written in its format.
    pub(super) fn check(&self) -> Result {
        match self.format {
            FileKind::Glb | FileKind::Usda => Ok(self.body(None, None).check(self.run)?),
            _ => Ok(()),
        }
    }

    /// Writes the animation with displacements `[frames, vertices, 3]`, metres.
    pub(super) fn write(&self, displacement: &Array3<f32>) -> Result<Written> {
        match self.format {
            FileKind::Glb | FileKind::Usda => self.write_animated(displacement),
            FileKind::Smpl => self.write_smpl(displacement),
            FileKind::Pc2 => self.write_cache(displacement, PointCacheFormat::Pc2),
            FileKind::Mdd => self.write_cache(displacement, PointCacheFormat::Mdd),
            FileKind::Obj | FileKind::Ply => {
                self.each_frame(displacement, |frame, body| self.write_mesh(frame, &body))?;
                Ok(Written::default())
            }
            _ => self.write_pictures(displacement),
        }
    }

    fn body<'s>(
        &'s self,
        displacement: Option<&'s Array3<f32>>,
        colours: Option<&'s [[f32; 3]]>,
    ) -> AnimatedBody<'s> {
        AnimatedBody {
            name: "animation",
            code: self.code.clone(),
            betas: self.betas,
            outfit: *self.outfit,
            motion: self.motion.clone(),
            keyframes: self.keyframes,
            displacements: displacement.map(|worn| worn.view()),
            shape_targets: 0,
            colours,
            texture: None,
        }
    }

    fn file(&self, extension: &str) -> std::path::PathBuf {
        self.out.join(format!("animation.{extension}"))
    }

    fn write_animated(&self, displacement: &Array3<f32>) -> Result<Written> {
        let first = displacement.slice(s![..1, .., ..]).to_owned();
        let dressed = DressedRenderer::new(self.run).pose_clothed(&first, &self.bodies(0..1))?;
        let colours = dressed.first().map(|dressed| &dressed.colours[..]);
        let body = self.body(Some(displacement), colours);
        let report = body.save(self.run, self.file(self.format.name()))?;
        if report.keyframes > MANY_TARGETS {
            self.console.note(&format!(
                "{} morph targets: some programs show no more than {MANY_TARGETS}; --tolerance or --every \
                 stores fewer",
                report.keyframes
            ));
        }
        Ok(Written { keyframes: Some(report.keyframes), error: Some(report.error) })
    }

    fn write_smpl(&self, displacement: &Array3<f32>) -> Result<Written> {
        let mean = displacement
            .mean_axis(Axis(0))
            .ok_or_else(|| Error::message("animation: no frames"))?;
        let mut worst: f64 = 0.0;
        for frame in displacement.outer_iter() {
            for &vertex in self.run.clothing() {
                let d = [0, 1, 2].map(|k| f64::from(frame[[vertex, k]] - mean[[vertex, k]]));
                worst = worst.max((d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt());
            }
        }
        let betas: Vec<f64> = self.betas.iter().map(|&beta| beta.into()).collect();
        let offsets = at_clothing(self.run, mean.view());
        let file = SmplFile {
            motion: self.motion,
            betas: &betas,
            gender: self.gender,
            offsets: Some(&offsets),
        };
        file.save(self.file("smpl"))?;
        Ok(Written { keyframes: None, error: Some(worst) })
    }

    fn write_cache(&self, displacement: &Array3<f32>, format: PointCacheFormat) -> Result<Written> {
        let sizes = [self.motion.frames(), self.run.body().vertices()];
        let path = self.file(self.format.name());
        let mut writer = PointCacheWriter::create(path, format, sizes, self.motion.frame_rate)?;
        self.each_frame(displacement, |frame, body| {
            if frame == 0 {
                obj::write(self.file("obj"), &body.mesh, None)?;
            }
            Ok(writer.push(&body.mesh.vertices)?)
        })?;
        writer.finish()?;
        Ok(Written::default())
    }

    fn write_mesh(&self, frame: usize, body: &DressedMesh) -> Result {
        let extension = self.format.name();
        let path = self.out.join(format!("frame-{frame:05}.{extension}"));
        if self.format == FileKind::Obj {
            return Ok(obj::write(path, &body.mesh, None)?);
        }
        Ok(ply::write(path, &body.mesh, Some(&body.colours_8_bit()))?)
    }

    fn write_pictures(&self, displacement: &Array3<f32>) -> Result<Written> {
        let mut camera = None;
        let mut pictures = Vec::new();
        self.each_frame(displacement, |frame, body| {
            if camera.is_none() {
                camera = self.camera(&body.mesh);
            }
            let Some(camera) = &camera else { return Ok(()) };
            let picture = self.picture(&body, camera)?;
            picture.save(self.out.join(format!("frame-{frame:05}.png")))?;
            pictures.push(picture);
            Ok(())
        })?;
        if !pictures.is_empty() {
            let rate = self.motion.frame_rate.round().clamp(1.0, f64::from(u16::MAX)) as u16;
            save_animation(self.out.join("animation.png"), &pictures, rate)?;
        }
        Ok(Written::default())
    }

    /// Bodies of some frames, not moved.
    pub(super) fn bodies(&self, frames: std::ops::Range<usize>) -> Vec<BodySpec> {
        let (betas, outfit) = (self.betas, self.outfit);
        let body = |frame| BodySpec {
            betas: betas.to_vec(),
            pose: self.motion.pose(frame),
            outfit: *outfit,
        };
        frames.map(body).collect()
    }

    /// Passes the posed and moved body of every frame to `each`.
    fn each_frame(
        &self,
        displacement: &Array3<f32>,
        mut each: impl FnMut(usize, DressedMesh) -> Result,
    ) -> Result {
        let painter = DressedRenderer::new(self.run);
        self.console.while_showing("write", "frames", |progress| {
            for rows in batches(self.motion.frames()) {
                let worn = displacement.slice(s![rows.clone(), .., ..]).to_owned();
                let bodies = painter.pose_clothed(&worn, &self.bodies(rows.clone()))?;
                for (frame, mut body) in rows.zip(bodies) {
                    let moved = self.motion.translation(frame);
                    for vertex in &mut body.mesh.vertices {
                        *vertex = [0, 1, 2].map(|k| (f64::from(vertex[k]) + moved[k]) as f32);
                    }
                    each(frame, body)?;
                    progress(frame + 1, self.motion.frames());
                }
            }
            Ok::<_, Error>(())
        })
    }

    /// Camera for all frames: around the first one with a margin, moved along the whole way.
    fn camera(&self, first: &Mesh) -> Option<Camera> {
        let [low, high] = first.bounding_box()?;
        let start = self.motion.translation(0);
        let mut corners = Vec::new();
        for frame in 0..self.motion.frames() {
            let t = self.motion.translation(frame);
            let shift = [0, 1, 2].map(|k| (t[k] - start[k]) as f32);
            corners.extend([low, high].map(|corner| [0, 1, 2].map(|k| corner[k] + shift[k])));
        }
        let way = Mesh { vertices: corners, faces: Vec::new() };
        let bounds = Bounds::from_meshes([&way])?;
        Some(Camera::framing(&bounds, View::ThreeQuarter, Projection::Perspective(0.42), 1.0))
    }

    fn picture(&self, body: &DressedMesh, camera: &Camera) -> Result<Image> {
        let style = Style { width: self.size, height: self.size, ..Style::default() };
        Ok(render(&[Object::new(&body.mesh).with_colours(&body.colours)], camera, &style)?)
    }
}
