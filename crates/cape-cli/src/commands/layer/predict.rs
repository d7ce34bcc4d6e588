use std::path::{Path, PathBuf};

use cape_core::{Mesh, SmplModel, motion::DEFAULT_FRAME_RATE};
use cape_infer::write_json;
use cape_layer::{InsideShares, Layer, LayerStream, PredictedFrame};
use cape_render::{Tile, View, contact_sheet};
use clap::Args;
use rand::{SeedableRng, rngs::ChaCha8Rng};
use serde::Serialize;

use super::{
    clearance::{ClearanceArgs, InsideSum, inside_text},
    motions::{MotionFrame, MotionFrames},
    named,
    pictures::{PictureCamera, mesh_of},
};
use crate::{
    body_source::BodyModelArgs,
    console::Console,
    error::{Error, Result},
    files,
    motion_source::{MotionFileArgs, shape_of},
    options::{FileKind, GlobalArgs, OutputArgs, ShapeArgs, at_least_one, kinds, positive},
    table::Table,
};

/// Largest number of frames in the picture.
const SHOWN: usize = 6;
/// Height of a frame in the picture, pixels.
const HEIGHT: u32 = 360;
/// Columns of the picture of random parameters.
const COLUMNS: usize = 4;

/// Predict clothing over a body in motion.
///
/// Writes a mesh per frame and predicted.png with some of them. --betas changes the body, --motion its
/// motion, --parameters material and size. With --motion - poses are read from standard input and each
/// mesh is written one frame later. With --random every draw of material and size has a directory of its
/// own, random.json has their parameters, and random.png shows them in the same frame.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  cape layer predict learned/layer.npz --motion squats --out predicted\n  \
                  cape layer predict learned/layer.npz --betas 2,-1 --out other-body\n  \
                  cape layer predict learned/layer.npz --parameters length=1.1,log_rigidity=-4 --out longer\n  \
                  cape layer predict learned/layer.npz --random 8 --seed 2 --out random\n  \
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
    /// Number of draws of random semantic parameters, distributed as in the training sequences (figure 8 of
    /// the paper); those of --parameters are the same in all.
    #[arg(long, value_name = "N", value_parser = at_least_one)]
    random: Option<usize>,
    #[command(flatten)]
    clearance: ClearanceArgs,
    /// File format.
    #[arg(long, default_value = "ply", value_name = "FORMAT", value_parser = kinds([FileKind::Ply, FileKind::Obj]))]
    format: FileKind,
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    /// Number of frames, of each draw if parameters are random.
    frames: usize,
    /// Semantic parameters, if they are not random.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    parameters: Vec<(String, f64)>,
    /// Draws of random parameters.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    random: Vec<RandomDraw>,
    /// Shares of the clothing's surface inside the body before and after it is pushed out, means over the
    /// frames, if it is.
    inside: Option<InsideShares>,
}

/// Clothing of random semantic parameters.
#[derive(Debug, Serialize)]
struct RandomDraw {
    /// Directory of the meshes.
    directory: PathBuf,
    /// Semantic parameters.
    parameters: Vec<(String, f64)>,
}

/// Layer and body of predictions.
struct Predictor<'a> {
    args: &'a PredictArgs,
    layer: &'a Layer,
    model: &'a SmplModel,
    console: Console,
}

impl PredictArgs {
    pub(super) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        self.output.require_empty()?;
        let out = &self.output.out;
        let model = self.body.load()?;
        let layer = Layer::load_for(&self.layer, &model)?;
        let (frames, betas) = if self.motion == "-" {
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
        let names = || layer.semantics.names().iter().cloned();
        let stream = |parameters: &[f64]| {
            let stream = layer.stream(&model, &shape, frames.rate, parameters)?;
            Ok::<_, Error>(stream.with_clearance(self.clearance.distance()))
        };
        let predictor = Predictor { args: &self, layer: &layer, model: &model, console };
        let mut inside = InsideSum::default();
        if let Some(count) = self.random {
            let rng = &mut ChaCha8Rng::seed_from_u64(global.seed());
            let draw = |_| layer.semantics.random_with_wearer(&self.parameters, &betas, rng);
            let draws = (0..count).map(draw).collect::<Result<Vec<_>, _>>()?;
            let streams = draws.iter().map(|draw| stream(draw)).collect::<Result<Vec<_>>>()?;
            let frames = frames.collect::<Result<Vec<_>>>()?;
            let (mut random, mut galleries) = (Vec::new(), Vec::new());
            let digits = count.to_string().len();
            for (number, (parameters, stream)) in draws.into_iter().zip(streams).enumerate() {
                let directory = out.join(format!("random-{:0digits$}", number + 1));
                let (known, total) = (frames.iter().cloned().map(Ok), Some(frames.len()));
                galleries.push(predictor.predict(
                    (known, total),
                    stream,
                    &directory,
                    &mut inside,
                )?);
                random
                    .push(RandomDraw { directory, parameters: names().zip(parameters).collect() });
            }
            write_json(&out.join("random.json"), &random)?;
            save_random(&galleries, &random, &out.join("random.png"))?;
            let inside = inside.means();
            let report = Report {
                out: out.clone(),
                frames: frames.len(),
                parameters: vec![],
                random,
                inside,
            };
            return console.result(&report, || report.text());
        }
        let parameters = layer.semantics.with_wearer(&self.parameters, &betas)?;
        let stream = stream(&parameters)?;
        let total = frames.count;
        let gallery = predictor.predict((frames, total), stream, out, &mut inside)?;
        gallery.save(&out.join("predicted.png"))?;
        let parameters = names().zip(parameters).collect();
        let (frames, inside) = (gallery.seen, inside.means());
        let report = Report { out: out.clone(), frames, parameters, random: vec![], inside };
        console.result(&report, || report.text())
    }
}

impl Predictor<'_> {
    /// Writes the clothing of a motion, whose number of frames is known or not, to a directory.
    fn predict(
        &self,
        (mut frames, total): (impl Iterator<Item = Result<MotionFrame>>, Option<usize>),
        mut stream: LayerStream<'_>,
        out: &Path,
        inside: &mut InsideSum,
    ) -> Result<FrameSampler> {
        let Self { args, layer, model, console } = self;
        let mut gallery = FrameSampler::default();
        files::create_dir(out)?;
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
                let extension = args.format.name();
                let frame = predicted.frame;
                mesh.save(out.join(format!("frame-{frame:05}.{extension}")))?;
                if let Some(shares) = predicted.inside {
                    inside.push(shares);
                }
                gallery.push(&predicted, mesh, &model.faces);
                progress(frame + 1, total.unwrap_or(frame + 1));
            }
        })?;
        Ok(gallery)
    }
}

impl Report {
    fn text(&self) -> String {
        let pushed = inside_text(self.inside);
        if self.random.is_empty() {
            let picture = self.out.join("predicted.png");
            return format!("{} frames\n{pushed}{}", self.frames, picture.display());
        }
        let differing = differing(&self.random);
        let names = differing.iter().map(|&at| self.random[0].parameters[at].0.clone());
        let mut table = Table::new(std::iter::once("meshes".to_owned()).chain(names));
        for draw in &self.random {
            let values = differing.iter().map(|&at| format!("{:.3}", draw.parameters[at].1));
            let name = draw.directory.file_name().unwrap_or_default().to_string_lossy();
            table.row(std::iter::once(name.into_owned()).chain(values));
        }
        let picture = self.out.join("random.png");
        format!("{}\n\n{} frames each\n{pushed}{}", table.text(), self.frames, picture.display())
    }
}

/// Indices of the parameters in which draws differ.
fn differing(draws: &[RandomDraw]) -> Vec<usize> {
    let Some((first, others)) = draws.split_first() else { return Vec::new() };
    let differs = |&at: &usize| others.iter().any(|o| o.parameters[at] != first.parameters[at]);
    (0..first.parameters.len()).filter(differs).collect()
}

/// A contact sheet of the same frame of each draw, by one camera.
fn save_random(galleries: &[FrameSampler], draws: &[RandomDraw], picture: &Path) -> Result {
    let shown: Vec<_> = galleries.iter().filter_map(|g| g.kept.get(g.kept.len() / 2)).collect();
    let meshes = shown.iter().flat_map(|(_, body, clothing)| [body, clothing]);
    let stage = PictureCamera::around(meshes, View::ThreeQuarter, HEIGHT)?;
    let differing = differing(draws);
    let mut tiles = Vec::new();
    for (number, ((_, body, clothing), draw)) in shown.iter().zip(draws).enumerate() {
        let named = |&at: &usize| format!("{} {:.2}", draw.parameters[at].0, draw.parameters[at].1);
        let label = match &differing[..] {
            few @ ([_] | [_, _]) => few.iter().map(named).collect::<Vec<_>>().join(", "),
            _ => format!("random {}", number + 1),
        };
        tiles.push(Tile { image: stage.show(Some(body), clothing, None)?, label });
    }
    Ok(contact_sheet(&tiles, COLUMNS, None)?.save(picture)?)
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
