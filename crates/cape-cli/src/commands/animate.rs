use std::path::PathBuf;

use cape_core::{BodyPose, Outfit, obj, ply};
use cape_infer::{AnimatedBody, BodySpec, Run, batches, write_json};
use cape_render::{Bounds, Camera, Image, Object, Projection, Style, View, render, save_animation};
use cape_synth::poses::motion_poses;
use clap::Args;
use ndarray::{Array1, Array2, Array3, Axis, concatenate, s};
use serde::Serialize;

use crate::{
    console::Console,
    dressed_mesh::{DressedMesh, DressedRenderer},
    error::{Error, Result},
    files,
    latent_sampler::LatentSampler,
    options::{FileKind, GlobalArgs, OutfitArgs, OutputArgs, RunArgs, ShapeArgs, kinds, positive},
    priors::PriorArgs,
};

/// Animate a dressed body by a motion with a fixed latent code.
///
/// Writes pictures and an animated PNG, a mesh per frame, or one animated glTF file, and animation.json
/// with measures of smoothness.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  cape animate runs/cape --motion squats --format png --out squats\n  cape \
                  animate runs/cape --motion amass.npz --outfit shortlong --format glb --out walking"
)]
pub(crate) struct AnimateArgs {
    #[command(flatten)]
    run: RunArgs,
    #[command(flatten)]
    output: OutputArgs,
    /// Synthetic motion (walk, squats, …) or file of poses, .npz (AMASS), .npy or .csv.
    #[arg(long, default_value = "walk", value_name = "MOTION")]
    motion: String,
    /// Duration of a synthetic motion in seconds.
    #[arg(long, default_value_t = 2.0, value_name = "S", value_parser = positive)]
    seconds: f64,
    /// Frames per second.
    #[arg(long, default_value_t = 15, value_name = "FPS", value_parser = clap::value_parser!(u16).range(1..=240))]
    fps: u16,
    #[command(flatten)]
    outfit: OutfitArgs,
    #[command(flatten)]
    shape: ShapeArgs,
    /// Latent code: mean, seed:N, frame:K, FILE.npy:ROW or samples.jsonl:ROW [default: sampled].
    #[arg(long, value_name = "CODE")]
    code: Option<String>,
    #[command(flatten)]
    drawn: PriorArgs,
    /// File format: png writes pictures and an animation, glb one animated file.
    #[arg(long, default_value = "png", value_name = "FORMAT", value_parser = kinds([FileKind::Png, FileKind::Glb, FileKind::Obj, FileKind::Ply]))]
    format: FileKind,
    /// Side of the pictures in pixels.
    #[arg(long, default_value_t = 512, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(16..=4096))]
    size: u32,
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    frames: usize,
    outfit: Outfit,
    code: Vec<f32>,
    seed: u64,
    /// Mean speed of clothing vertices in canonical space, millimetres per second.
    speed: f64,
    /// Mean acceleration of them, metres per second squared; large if clothing flickers.
    acceleration: f64,
}

impl AnimateArgs {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        let poses = motion_poses(&self.motion, self.seconds, f64::from(self.fps))?;
        self.output.require_empty()?;
        let run = self.run.open(global)?;
        let betas = self.shape.betas(run.body())?;
        let (seed, outfit) = (global.seed(), self.outfit.of(&run)?);
        let code = match &self.code {
            Some(name) => {
                let draw = LatentSampler { run: &run, drawn: self.drawn, outfit, console };
                Array1::from(draw.code(name)?).insert_axis(Axis(0))
            }
            None => self.drawn.codes(&run, &[outfit], 1, seed, console)?,
        };
        files::create_dir(&self.output.out)?;
        let wearer = BodySpec { betas, pose: poses[0], outfit };
        let displacement = frames(&run, &code, &wearer, &poses, console)?;
        match self.format {
            FileKind::Glb => self.write_glb(&run, &code, &wearer, &poses)?,
            _ => self.write_frames(&run, &wearer, &poses, &displacement, console)?,
        }
        let [speed, acceleration] =
            cape_eval::clothing::smoothness(&displacement, run.clothing(), f64::from(self.fps));
        let report = Report {
            frames: poses.len(),
            outfit,
            code: code.row(0).to_vec(),
            seed,
            speed,
            acceleration,
            out: self.output.out,
        };
        write_json(&report.out.join("animation.json"), &report)?;
        console.result(&report, || report.text())
    }

    fn write_glb(
        &self,
        run: &Run,
        code: &Array2<f32>,
        wearer: &BodySpec,
        poses: &[BodyPose],
    ) -> Result {
        let first = body_specs(wearer, &poses[..1]);
        let dressed = DressedRenderer::new(run)
            .pose_clothed(&run.decode_displacements(code, &first)?, &first)?;
        let performance = AnimatedBody {
            name: "animation",
            code: code.clone(),
            betas: &wearer.betas,
            outfit: wearer.outfit,
            poses: poses.to_vec(),
            frames_per_second: f32::from(self.fps),
            shape_targets: 0,
            colours: dressed.first().map(|dressed| &dressed.colours[..]),
            texture: None,
        };
        Ok(performance.save(run, self.output.out.join("animation.glb"))?)
    }

    fn write_frames(
        &self,
        run: &Run,
        wearer: &BodySpec,
        poses: &[BodyPose],
        displacement: &Array3<f32>,
        console: Console,
    ) -> Result {
        let painter = DressedRenderer::new(run);
        let mut camera = None;
        let mut pictures = Vec::new();
        console.while_showing("write", "frames", |progress| {
            for rows in batches(poses.len()) {
                let first = rows.start;
                let worn = displacement.slice(s![rows.clone(), .., ..]).to_owned();
                let bodies = painter.pose_clothed(&worn, &body_specs(wearer, &poses[rows]))?;
                if camera.is_none() {
                    camera = view_of(&bodies);
                }
                for (offset, body) in bodies.iter().enumerate() {
                    let name = format!("frame-{:05}", first + offset);
                    let path =
                        |extension: &str| self.output.out.join(format!("{name}.{extension}"));
                    match (self.format, &camera) {
                        (FileKind::Obj, _) => obj::write(path("obj"), &body.mesh, None)?,
                        (FileKind::Ply, _) => {
                            ply::write(path("ply"), &body.mesh, Some(&body.colours_8_bit()))?;
                        }
                        (_, Some(camera)) => {
                            let picture = self.picture(body, camera)?;
                            picture.save(path("png"))?;
                            pictures.push(picture);
                        }
                        _ => {}
                    }
                    progress(first + offset + 1, poses.len());
                }
            }
            Ok::<_, Error>(())
        })?;
        if !pictures.is_empty() {
            save_animation(self.output.out.join("animation.png"), &pictures, self.fps)?;
        }
        Ok(())
    }

    fn picture(&self, body: &DressedMesh, camera: &Camera) -> Result<Image> {
        let style = Style { width: self.size, height: self.size, ..Style::default() };
        Ok(render(&[Object::new(&body.mesh).with_colours(&body.colours)], camera, &style)?)
    }
}

/// Canonical displacements, `[frames, vertices, 3]`.
fn frames(
    run: &Run,
    code: &Array2<f32>,
    wearer: &BodySpec,
    poses: &[BodyPose],
    console: Console,
) -> Result<Array3<f32>> {
    let mut parts = Vec::new();
    console.while_showing("decode", "frames", |progress| {
        for rows in batches(poses.len()) {
            let done = rows.end;
            let bodies = body_specs(wearer, &poses[rows]);
            let codes = code.select(Axis(0), &vec![0; bodies.len()]);
            parts.push(run.decode_displacements(&codes, &bodies)?);
            progress(done, poses.len());
        }
        Ok::<_, Error>(())
    })?;
    let views: Vec<_> = parts.iter().map(|part| part.view()).collect();
    concatenate(Axis(0), &views).map_err(|error| Error::message(error.to_string()))
}

fn body_specs(wearer: &BodySpec, poses: &[BodyPose]) -> Vec<BodySpec> {
    poses.iter().map(|&pose| BodySpec { pose, ..wearer.clone() }).collect()
}

/// Camera for all frames, around the first ones with a margin for the motion.
fn view_of(bodies: &[DressedMesh]) -> Option<Camera> {
    let bounds = Bounds::from_meshes(bodies.iter().map(|body| &body.mesh))?;
    Some(Camera::framing(&bounds, View::ThreeQuarter, Projection::Perspective(0.42), 1.0))
}

impl Report {
    fn text(&self) -> String {
        format!(
            "{} frames of {} in {}\ncanonical clothing: mean speed {:.0} mm/s, mean acceleration {:.2} m/s²",
            self.frames,
            self.outfit,
            self.out.display(),
            self.speed,
            self.acceleration
        )
    }
}
