use std::path::PathBuf;

use cape_core::Mesh;
use cape_layer::{Layer, PredictedFrame};
use cape_render::{Tile, View, contact_sheet};
use clap::{Args, ValueEnum};
use serde::Serialize;

use super::{
    body,
    motions::MotionFrames,
    named,
    pictures::{PictureCamera, mesh_of},
};
use crate::{
    console::Console,
    error::{Error, Result},
    files,
};

/// Frames shown in the picture, at most.
const SHOWN: usize = 6;
/// Rows of pixels of each.
const HEIGHT: u32 = 360;

/// Predict clothing over a body in motion, frame by frame.
///
/// For another body under the same clothing change --betas; for another motion --motion; for another
/// material or fit --parameters. A mesh is written as soon as its frame's speed is known: motions from
/// standard input may go on for ever. predicted.png shows some frames.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  cape layer predict learnt/layer.npz --motion squats --out predicted\n  \
                  cape layer predict learnt/layer.npz --betas 2,-1 --out other-body\n  \
                  cape layer predict learnt/layer.npz --parameters length=1.1,log_bend=-2 --out fit\n  \
                  tracker | cape layer predict learnt/layer.npz --motion - --out live"
)]
pub(super) struct PredictArgs {
    /// What `cape layer learn` wrote.
    #[arg(value_name = "LAYER.npz")]
    layer: PathBuf,
    /// Directory to write; it must be empty or missing.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// The body, .pkl or .npz; by default the synthetic one.
    #[arg(long, value_name = "SMPL")]
    body: Option<PathBuf>,
    /// A movement (walk, squats, …); a file of poses, .npz (with trans and betas, as AMASS has them)
    /// or .npy; or rows of 72 numbers, or 75 with the translation, in a .csv file or, with -, from
    /// standard input.
    #[arg(long, default_value = "walk", value_name = "MOTION")]
    motion: String,
    /// Length of a movement, seconds.
    #[arg(long, default_value_t = 2.0, value_name = "S")]
    seconds: f64,
    /// Frames a second, where the motion does not say.
    #[arg(long, default_value_t = 30.0, value_name = "FPS")]
    fps: f64,
    /// Shape coefficients of the body; missing ones are zero. By default those of the motion's file.
    #[arg(long, value_delimiter = ',', allow_hyphen_values = true, value_name = "B,B,…")]
    betas: Option<Vec<f64>>,
    /// Sizes and materials by name; those not named have the mean of what was learned from.
    #[arg(long, value_delimiter = ',', value_name = "NAME=X,…", value_parser = named)]
    parameters: Vec<(String, f64)>,
    /// What is written.
    #[arg(long, value_enum, default_value_t = Format::Ply)]
    format: Format,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
    Ply,
    Obj,
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    frames: usize,
    /// The semantic parameters that were used.
    parameters: Vec<(String, f64)>,
}

impl PredictArgs {
    pub(super) fn run(self, console: Console) -> Result {
        files::require_empty(&self.out)?;
        let model = body(self.body.as_deref())?;
        let layer = Layer::load(&self.layer, model.vertices())?;
        let parameters = layer.semantics.with(&self.parameters)?;
        let mut frames = MotionFrames::open(&self.motion, self.seconds, self.fps)?;
        let shape = model.rest_shape(self.betas.as_ref().unwrap_or(&frames.betas))?;
        let total = frames.count;
        let mut stream = layer.stream(&model, &shape, frames.rate, &parameters)?;
        let mut gallery = FrameSampler::default();
        files::create_dir(&self.out)?;
        console.while_showing("predict", "frames", |progress| {
            loop {
                let predicted = match frames.next().transpose()? {
                    Some((pose, transl)) => match stream.push(&pose, transl)? {
                        Some(predicted) => predicted,
                        None => continue,
                    },
                    None => match stream.finish()? {
                        Some(predicted) => predicted,
                        None => return Ok::<_, Error>(()),
                    },
                };
                let mesh = mesh_of(predicted.clothing.view(), &layer.faces);
                let extension = match self.format {
                    Format::Ply => "ply",
                    Format::Obj => "obj",
                };
                let frame = predicted.frame;
                mesh.save(self.out.join(format!("frame-{frame:05}.{extension}")))?;
                gallery.push(&predicted, mesh, &model.faces);
                progress(frame + 1, total.unwrap_or(frame + 1));
            }
        })?;
        gallery.save(&self.out)?;
        let names = layer.semantics.names().iter().cloned();
        let report = Report {
            frames: gallery.seen,
            parameters: names.zip(parameters).collect(),
            out: self.out,
        };
        console.result(&report, || {
            format!("{} frames\n{}", report.frames, report.out.join("predicted.png").display())
        })
    }
}

/// Some frames of a motion whose length is not known, evenly spaced: when there are too many, every
/// second one is dropped.
#[derive(Default)]
struct FrameSampler {
    kept: Vec<(usize, Mesh, Mesh)>,
    stride: usize,
    seen: usize,
}

impl FrameSampler {
    fn push(&mut self, predicted: &PredictedFrame, clothing: Mesh, body_faces: &[[u32; 3]]) {
        self.stride = self.stride.max(1);
        self.seen += 1;
        if !predicted.frame.is_multiple_of(self.stride) {
            return;
        }
        if self.kept.len() == SHOWN {
            self.stride *= 2;
            self.kept.retain(|(frame, ..)| frame.is_multiple_of(self.stride));
            if !predicted.frame.is_multiple_of(self.stride) {
                return;
            }
        }
        let body = predicted.body.posed.iter().map(|v| v.as_vec3().to_array()).collect();
        let body = Mesh { vertices: body, faces: body_faces.to_vec() };
        self.kept.push((predicted.frame, body, clothing));
    }

    fn save(&self, out: &std::path::Path) -> Result {
        let mut tiles = Vec::new();
        for (frame, body, clothing) in &self.kept {
            let stage = PictureCamera::around([body, clothing], View::ThreeQuarter, HEIGHT)?;
            let image = stage.show(Some(body), clothing, None)?;
            tiles.push(Tile { image, label: format!("frame {frame}") });
        }
        if tiles.is_empty() {
            return Err(Error::message("--motion: there is no frame"));
        }
        Ok(contact_sheet(&tiles, SHOWN, None)?.save(out.join("predicted.png"))?)
    }
}
