use std::path::PathBuf;

use cape_core::{Mesh, motion::DEFAULT_FRAME_RATE};
use cape_layer::{InsideShares, Layer, PredictedFrame};
use cape_render::{Tile, View, contact_sheet};
use clap::Args;
use serde::Serialize;

use super::{
    clearance::{ClearanceArgs, InsideSum, inside_text},
    motions::MotionFrames,
    named,
    pictures::{PictureCamera, mesh_of},
};
use crate::{
    body_source::BodyModelArgs,
    console::Console,
    error::{Error, Result},
    files,
    motion_source::{MotionFileArgs, shape_of},
    options::{FileKind, OutputArgs, ShapeArgs, kinds, positive},
};

/// Largest number of frames in the picture.
const SHOWN: usize = 6;
/// Height of a frame in the picture, pixels.
const HEIGHT: u32 = 360;

/// Predict clothing over a body in motion.
///
/// Writes a mesh per frame and predicted.png with some of them. --betas changes the body, --motion its
/// motion, --parameters material and size. With --motion - poses are read from standard input and each
/// mesh is written one frame later.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  cape layer predict learned/layer.npz --motion squats --out predicted\n  \
                  cape layer predict learned/layer.npz --betas 2,-1 --out other-body\n  \
                  cape layer predict learned/layer.npz --parameters length=1.1,log_rigidity=-4 --out longer\n  \
                  tracker | cape layer predict learned/layer.npz --motion - --out live"
)]
pub(crate) struct PredictArgs {
    /// Layer written by `cape layer learn`.
    #[arg(value_name = "LAYER.npz")]
    layer: PathBuf,
    #[command(flatten)]
    output: OutputArgs,
    #[command(flatten)]
    body: BodyModelArgs,
    /// Synthetic motion (walk, squats, …), file of poses and translations, or - for rows of 72 or 75
    /// numbers on standard input.
    #[arg(long, default_value = "walk", value_name = "MOTION")]
    motion: String,
    /// Duration of a synthetic motion in seconds.
    #[arg(long, default_value_t = 2.0, value_name = "S", value_parser = positive)]
    seconds: f64,
    /// Frames per second; a file of another rate is resampled [default: those of the file, else 30].
    #[arg(long, value_name = "FPS", value_parser = positive)]
    fps: Option<f64>,
    #[command(flatten)]
    reading: MotionFileArgs,
    #[command(flatten)]
    shape: ShapeArgs,
    /// Semantic parameters by name; the others have the mean of the training sequences.
    #[arg(long, value_delimiter = ',', value_name = "NAME=X,…", value_parser = named)]
    parameters: Vec<(String, f64)>,
    #[command(flatten)]
    clearance: ClearanceArgs,
    /// File format.
    #[arg(long, default_value = "ply", value_name = "FORMAT", value_parser = kinds([FileKind::Ply, FileKind::Obj]))]
    format: FileKind,
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    frames: usize,
    /// Semantic parameters.
    parameters: Vec<(String, f64)>,
    /// Shares of the clothing vertices inside the body before and after they are pushed out, means over
    /// the frames, if they are.
    inside: Option<InsideShares>,
}

impl PredictArgs {
    pub(super) fn run(self, console: Console) -> Result {
        self.output.require_empty()?;
        let out = self.output.out;
        let model = self.body.load()?;
        let layer = Layer::load_for(&self.layer, &model)?;
        let (mut frames, betas) = if self.motion == "-" {
            let betas = self.shape.betas(&model)?;
            (MotionFrames::from_standard_input(self.fps.unwrap_or(DEFAULT_FRAME_RATE)), betas)
        } else {
            let rates = [self.fps, None];
            let file = self.reading.motion(&self.motion, self.seconds, rates, console)?;
            let betas = shape_of(&file, &self.shape, &model, console)?;
            let double: Vec<f64> = betas.iter().map(|&beta| beta.into()).collect();
            let motion = file.motion_of(&model, &double, self.fps)?;
            (MotionFrames::from_motion(&motion), betas)
        };
        let betas: Vec<f64> = betas.into_iter().map(f64::from).collect();
        let shape = model.rest_shape(&betas)?;
        let parameters = layer.semantics.with_wearer(&self.parameters, &betas)?;
        let total = frames.count;
        let mut stream = layer.stream(&model, &shape, frames.rate, &parameters)?;
        stream = stream.with_clearance(self.clearance.distance());
        let mut gallery = FrameSampler::default();
        let mut inside = InsideSum::default();
        files::create_dir(&out)?;
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
                let extension = self.format.name();
                let frame = predicted.frame;
                mesh.save(out.join(format!("frame-{frame:05}.{extension}")))?;
                if let Some(shares) = predicted.inside {
                    inside.push(shares);
                }
                gallery.push(&predicted, mesh, &model.faces);
                progress(frame + 1, total.unwrap_or(frame + 1));
            }
        })?;
        gallery.save(&out.join("predicted.png"))?;
        let names = layer.semantics.names().iter().cloned();
        let parameters = names.zip(parameters).collect();
        let inside = inside.means();
        let report = Report { frames: gallery.seen, parameters, inside, out };
        console.result(&report, || {
            let pushed = inside_text(inside);
            let picture = report.out.join("predicted.png");
            format!("{} frames\n{pushed}{}", report.frames, picture.display())
        })
    }
}

/// Evenly spaced frames of a motion of unknown length: with too many, every second one is dropped.
#[derive(Default)]
pub(super) struct FrameSampler {
    kept: Vec<(usize, Mesh, Mesh)>,
    stride: usize,
    seen: usize,
}

impl FrameSampler {
    pub(super) fn push(
        &mut self,
        predicted: &PredictedFrame,
        clothing: Mesh,
        body_faces: &[[u32; 3]],
    ) {
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

    pub(super) fn save(&self, picture: &std::path::Path) -> Result {
        let mut tiles = Vec::new();
        for (frame, body, clothing) in &self.kept {
            let stage = PictureCamera::around([body, clothing], View::ThreeQuarter, HEIGHT)?;
            let image = stage.show(Some(body), clothing, None)?;
            tiles.push(Tile { image, label: format!("frame {frame}") });
        }
        if tiles.is_empty() {
            return Err(Error::message("no frames"));
        }
        Ok(contact_sheet(&tiles, SHOWN, None)?.save(picture)?)
    }
}
