use std::path::PathBuf;

use cape_core::{BodyPose, Outfit, obj, parse_device, ply};
use cape_infer::{AnimatedBody, BodySpec, Run, batches, write_json};
use cape_render::{Bounds, Camera, Image, Object, Projection, Style, View, render, save_animation};
use cape_synth::poses::motion_poses;
use clap::{Args, ValueEnum};
use ndarray::{Array1, Array2, Array3, ArrayView2, Axis, concatenate, s};
use serde::Serialize;

use crate::{
    arguments::{GlobalArgs, outfit},
    console::Console,
    dressed_mesh::{DressedMesh, DressedRenderer},
    error::{Error, Result},
    files,
    latent_sampler::LatentSampler,
    priors::PriorArgs,
};

/// Move a dressed body through a movement, the code being fixed.
///
/// As one animated glTF file, as meshes frame by frame, or as pictures and an animated PNG.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  cape animate run --motion squats --format png --out squats\n  \
                        cape animate run --motion amass.npz --outfit shortlong --format glb --out walk"
)]
pub(crate) struct AnimateArgs {
    /// A training run.
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// Directory to write; it must be empty or missing.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// A movement (walk, squats, punching, …), or a file of poses: .npz with `poses`, as AMASS has
    /// them, .npy or .csv.
    #[arg(long, default_value = "walk", value_name = "MOTION")]
    motion: String,
    /// Length of a movement, seconds; files are taken whole.
    #[arg(long, default_value_t = 2.0, value_name = "S")]
    seconds: f64,
    /// Frames a second.
    #[arg(long, default_value_t = 15, value_name = "FPS", value_parser = clap::value_parser!(u16).range(1..=240))]
    fps: u16,
    /// What is worn.
    #[arg(long, default_value = "longlong", value_name = "OUTFIT", value_parser = outfit)]
    outfit: Outfit,
    /// Shape coefficients of the body; missing ones are zero.
    #[arg(long, value_delimiter = ',', allow_hyphen_values = true, value_name = "B,B,…")]
    betas: Vec<f32>,
    /// The clothes' code: mean, seed:N, frame:K of the run's held-out data, FILE.npy:ROW or
    /// samples.jsonl:ROW; by default one is drawn.
    #[arg(long, value_name = "CODE")]
    code: Option<String>,
    #[command(flatten)]
    drawn: PriorArgs,
    /// What is written: pictures with an animated PNG, meshes, or one glTF file.
    #[arg(long, value_enum, default_value_t = Format::Png)]
    format: Format,
    /// Side of the pictures, pixels.
    #[arg(long, default_value_t = 512, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(16..=4096))]
    size: u32,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
    Png,
    Glb,
    Obj,
    Ply,
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    frames: usize,
    outfit: Outfit,
    code: Vec<f32>,
    seed: u64,
    /// Mean speed of clothing vertices in canonical space, millimetres a second.
    speed: f64,
    /// Mean acceleration of them, metres a second squared: what flickers is large.
    acceleration: f64,
}

impl AnimateArgs {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        let device = parse_device(&global.device)?;
        if !(self.seconds.is_finite() && self.seconds > 0.0) {
            return Err(Error::message(format!(
                "--seconds {}: expected more than 0",
                self.seconds
            )));
        }
        let poses = motion_poses(&self.motion, self.seconds, f64::from(self.fps))?;
        files::require_empty(&self.out)?;
        let run = Run::open(&self.run, &device)?;
        if self.betas.len() > run.body().betas() || self.betas.iter().any(|b| !b.is_finite()) {
            let most = run.body().betas();
            return Err(Error::message(format!("--betas: expected at most {most} finite numbers")));
        }
        let seed = global.seed.unwrap_or(1);
        let code = match &self.code {
            Some(name) => {
                let draw =
                    LatentSampler { run: &run, drawn: self.drawn, outfit: self.outfit, console };
                Array1::from(draw.code(name)?).insert_axis(Axis(0))
            }
            None => self.drawn.codes(&run, &[self.outfit], 1, seed, console)?,
        };
        files::create_dir(&self.out)?;
        let displacement = self.frames(&run, &code, &poses, console)?;
        match self.format {
            Format::Glb => self.write_glb(&run, &code, &poses)?,
            _ => self.write_frames(&run, &poses, &displacement, console)?,
        }
        let [speed, acceleration] = smoothness(&displacement, run.clothing(), f64::from(self.fps));
        let report = Report {
            frames: poses.len(),
            outfit: self.outfit,
            code: code.row(0).to_vec(),
            seed,
            speed,
            acceleration,
            out: self.out,
        };
        write_json(&report.out.join("animation.json"), &report)?;
        console.result(&report, || report.text())
    }

    /// Canonical displacements, `[frames, vertices, 3]`.
    fn frames(
        &self,
        run: &Run,
        code: &Array2<f32>,
        poses: &[BodyPose],
        console: Console,
    ) -> Result<Array3<f32>> {
        let mut parts = Vec::new();
        console.while_showing("decode", "frames", |progress| {
            for rows in batches(poses.len()) {
                let done = rows.end;
                let bodies = self.body_specs(&poses[rows]);
                let codes = code.select(Axis(0), &vec![0; bodies.len()]);
                parts.push(run.decode_displacements(&codes, &bodies)?);
                progress(done, poses.len());
            }
            Ok::<_, Error>(())
        })?;
        let views: Vec<_> = parts.iter().map(|part| part.view()).collect();
        concatenate(Axis(0), &views).map_err(|error| Error::message(error.to_string()))
    }

    fn write_glb(&self, run: &Run, code: &Array2<f32>, poses: &[BodyPose]) -> Result {
        let first = self.body_specs(&poses[..1]);
        let dressed = DressedRenderer::new(run)
            .pose_clothed(&run.decode_displacements(code, &first)?, &first)?;
        let performance = AnimatedBody {
            name: "animation",
            code: code.clone(),
            betas: &self.betas,
            outfit: self.outfit,
            poses: poses.to_vec(),
            frames_per_second: f32::from(self.fps),
            shape_targets: 0,
            colours: dressed.first().map(|dressed| &dressed.colours[..]),
            texture: None,
        };
        Ok(performance.save(run, self.out.join("animation.glb"))?)
    }

    fn body_specs(&self, poses: &[BodyPose]) -> Vec<BodySpec> {
        let outfit = self.outfit;
        poses.iter().map(|&pose| BodySpec { betas: self.betas.clone(), pose, outfit }).collect()
    }

    fn write_frames(
        &self,
        run: &Run,
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
                let bodies = painter.pose_clothed(&worn, &self.body_specs(&poses[rows]))?;
                if camera.is_none() {
                    camera = view_of(&bodies);
                }
                for (offset, body) in bodies.iter().enumerate() {
                    let name = format!("frame-{:05}", first + offset);
                    let path = |extension: &str| self.out.join(format!("{name}.{extension}"));
                    match (self.format, &camera) {
                        (Format::Obj, _) => obj::write(path("obj"), &body.mesh, None)?,
                        (Format::Ply, _) => {
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
            save_animation(self.out.join("animation.png"), &pictures, self.fps)?;
        }
        Ok(())
    }

    fn picture(&self, body: &DressedMesh, camera: &Camera) -> Result<Image> {
        let style = Style { width: self.size, height: self.size, ..Style::default() };
        Ok(render(&[Object::new(&body.mesh).with_colours(&body.colours)], camera, &style)?)
    }
}

/// One camera for all frames: around the first ones, with room to move.
fn view_of(bodies: &[DressedMesh]) -> Option<Camera> {
    let bounds = Bounds::from_meshes(bodies.iter().map(|body| &body.mesh))?;
    Some(Camera::framing(&bounds, View::ThreeQuarter, Projection::Perspective(0.42), 1.0))
}

/// Mean speed, mm/s, and mean acceleration, m/s², of clothing vertices in canonical space.
fn smoothness(displacement: &Array3<f32>, clothing: &[usize], rate: f64) -> [f64; 2] {
    let frames = displacement.dim().0;
    let frame = |index: usize| displacement.index_axis(Axis(0), index);
    let mean = |order: usize, of: &dyn Fn(usize, usize, usize) -> f64| {
        let mut sum = 0.0;
        for index in order..frames {
            for &vertex in clothing {
                sum += (0..3).map(|axis| of(index, vertex, axis).powi(2)).sum::<f64>().sqrt();
            }
        }
        sum / (frames.saturating_sub(order) * clothing.len()).max(1) as f64
    };
    let at = |frame: ArrayView2<f32>, vertex: usize, axis: usize| f64::from(frame[[vertex, axis]]);
    let speed = mean(1, &|i, v, a| at(frame(i), v, a) - at(frame(i - 1), v, a));
    let change = mean(2, &|i, v, a| {
        at(frame(i), v, a) - 2.0 * at(frame(i - 1), v, a) + at(frame(i - 2), v, a)
    });
    [1000.0 * speed * rate, change * rate * rate]
}

impl Report {
    fn text(&self) -> String {
        format!(
            "{} frames of {} in {}\nclothes move over the body by {:.0} mm/s, changing by {:.2} m/s²",
            self.frames,
            self.outfit,
            self.out.display(),
            self.speed,
            self.acceleration
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smoothness_is_that_of_a_parabola() {
        // x = 0.5 · 2 m/s² · t² at 10 frames a second.
        let x = |frame: usize| (0.1 * frame as f64).powi(2) as f32;
        let moved =
            Array3::from_shape_fn(
                (5, 2, 3),
                |(frame, vertex, axis)| {
                    if vertex == 1 && axis == 0 { x(frame) } else { 0.0 }
                },
            );
        let [speed, acceleration] = smoothness(&moved, &[1], 10.0);
        assert!((acceleration - 2.0).abs() < 1e-4, "{acceleration}");
        assert!((speed - 400.0).abs() < 0.1, "{speed}");
        assert_eq!(smoothness(&moved, &[0], 10.0), [0.0, 0.0]);
        assert_eq!(smoothness(&moved.slice(s![..1, .., ..]).to_owned(), &[1], 10.0), [0.0, 0.0]);
    }
}
