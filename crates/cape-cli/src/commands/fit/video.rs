//! Fits to the frames of a video.

use std::{path::PathBuf, time::Instant};

use cape_core::{
    BodyMotion, KeyframeRule,
    npy::{NpzWriter, write_npy},
};
use cape_fit::{ImageObservation, SequenceConfig, SequenceFit, TemporalConfig};
use cape_infer::{AnimatedBody, BodySpec, write_json};
use cape_render::Tile;
use clap::Args;
use ndarray::{Array1, Array2, arr0};
use serde::Serialize;

use super::{
    drawing, folder,
    folder::ImageItem,
    image::{FitArgs, FitInput, ImageFitter, dressed, fit_workers},
};
use crate::{
    console::{Console, seconds},
    error::{Error, Result, in_one_line},
    files,
    options::{GlobalArgs, positive},
};

/// Frames of a video.
#[derive(Debug, Clone, Args)]
pub(crate) struct VideoArgs {
    /// Take the images of the directories, in natural order of their names, as the frames of a video: one
    /// shape, one outfit, one code and a smooth motion. Frames without keypoints are interpolated.
    #[arg(long, conflicts_with_all = ["compare_outfits", "image_id"])]
    sequence: bool,
    /// Frames per second of the video [default: 30].
    #[arg(long, value_name = "FPS", value_parser = positive, requires = "sequence")]
    fps: Option<f64>,
}

impl VideoArgs {
    pub(super) fn sequence(&self) -> bool {
        self.sequence
    }
}

#[derive(Debug, Serialize)]
struct VideoReport<'a> {
    out: PathBuf,
    frames: usize,
    frames_per_second: f64,
    /// Frames that could not be read, with the reason.
    left_out: Vec<[String; 2]>,
    unreliable: usize,
    fit: &'a SequenceFit,
    seconds: f64,
}

/// Result of one frame, a line of fits.jsonl.
#[derive(Debug, Serialize)]
struct FrameLine<'a> {
    image: &'a str,
    #[serde(flatten)]
    frame: &'a cape_fit::SequenceFrame,
}

pub(super) fn run(args: &FitArgs, global: &GlobalArgs, console: Console) -> Result {
    args.output.require_empty()?;
    let items = args.sources().items()?;
    let config = args.config()?;
    let temporal = TemporalConfig {
        frame_rate: args.video.fps.unwrap_or(TemporalConfig::default().frame_rate),
        ..TemporalConfig::default()
    };
    let run = args.run.open(global)?;
    let fitter = ImageFitter::new(args, &run, config)?;
    let workers = fit_workers(&run)?;
    let start = Instant::now();
    let inputs = workers.map(&items, |_, item| read(args, item), &mut || {});
    let left_out: Vec<[String; 2]> = items
        .iter()
        .zip(&inputs)
        .filter_map(|(item, input)| Some([item.name.clone(), in_one_line(input.as_ref().err()?)]))
        .collect();
    for [name, reason] in &left_out {
        console.note(&format!("{name}: left out: {reason}"));
    }
    let images: Vec<Option<ImageObservation<'_>>> =
        inputs.iter().map(|input| input.as_ref().ok().map(FitInput::observation)).collect();
    let silhouettes = images.iter().flatten().any(|image| image.mask.is_some());
    let fit = console.while_showing("fit", "%", |progress| {
        let config = SequenceConfig { clothed: &fitter.config.clothed, temporal };
        let bodies = fitter.distinct(silhouettes);
        fitter.smplify.fit_sequence(bodies, &images, config, &workers, &mut |share| {
            progress((100.0 * share).round() as usize, 100);
        })
    })?;
    let report = VideoReport {
        out: args.output.out.clone(),
        frames: fit.frames.len(),
        frames_per_second: temporal.frame_rate,
        unreliable: fit.frames.iter().filter(|frame| frame.problem.is_some()).count(),
        left_out,
        fit: &fit,
        seconds: start.elapsed().as_secs_f64(),
    };
    report.write(args, &fitter, &items)?;
    if report.unreliable == report.frames - report.left_out.len() {
        return Err(Error::message(format!(
            "the fit in {} is unreliable in all frames",
            report.out.display()
        )));
    }
    console.result(&report, || report.text())
}

/// The files of a frame; its picture is read again when it is drawn.
fn read(args: &FitArgs, item: &ImageItem) -> Result<FitInput> {
    let input = item.read(args)?;
    Ok(FitInput { image: cape_render::Image::new(1, 1, [0; 4])?, ..input })
}

impl VideoReport<'_> {
    /// Writes all files, sequence.json last.
    fn write(&self, args: &FitArgs, fitter: &ImageFitter<'_>, items: &[ImageItem]) -> Result {
        files::create_dir(&self.out)?;
        let at = |name: &str| self.out.join(name);
        let SequenceFit { outfit, betas, code, frames, .. } = self.fit;
        let poses = Array2::from_shape_fn((frames.len(), 72), |(f, k)| frames[f].body.pose[k]);
        let translations =
            Array2::from_shape_fn((frames.len(), 3), |(f, k)| frames[f].body.transl[k]);
        let mut archive = NpzWriter::create(at("motion.npz"))?;
        archive.add("poses", &poses)?;
        archive.add("trans", &translations)?;
        archive.add("betas", &Array1::from(betas.clone()))?;
        archive.add("mocap_frame_rate", &arr0(self.frames_per_second))?;
        archive.finish()?;
        let code = Array1::from_iter(code.iter().map(|&x| x as f32));
        write_npy(at("code.npy"), &code)?;

        let codes = code.insert_axis(ndarray::Axis(0));
        let motion = BodyMotion::new(self.frames_per_second, poses, translations)?;
        let betas: Vec<f32> = betas.iter().map(|&x| x as f32).collect();
        let wearer = BodySpec { betas: betas.clone(), pose: motion.pose(0), outfit: *outfit };
        let colours = dressed(fitter.run, &codes, &wearer)?.colours;
        let animated = AnimatedBody {
            betas: &betas,
            colours: Some(&colours),
            motion,
            keyframes: KeyframeRule::default(),
            ..AnimatedBody::from_body("fitted", &codes, &wearer)
        };
        animated.save(fitter.run, at("clothed.glb"))?;
        self.sheet(args, fitter, items, &colours)?.save(at("fits.png"))?;
        let lines = items.iter().zip(frames);
        let lines = lines.map(|(item, frame)| FrameLine { image: &item.name, frame });
        files::write_json_lines(&at("fits.jsonl"), &lines.collect::<Vec<_>>())?;
        Ok(write_json(&at("sequence.json"), self)?)
    }

    /// Fitted bodies over the images of the frames.
    fn sheet(
        &self,
        args: &FitArgs,
        fitter: &ImageFitter<'_>,
        items: &[ImageItem],
        colours: &[[f32; 3]],
    ) -> Result<cape_render::Image> {
        let worn = fitter.bodies.iter().find(|body| body.outfit() == self.fit.outfit);
        let worn = worn.ok_or_else(|| Error::message("internal error: another outfit"))?;
        let seen: Vec<(&ImageItem, &cape_fit::SequenceFrame)> =
            items.iter().zip(&self.fit.frames).filter(|(_, frame)| frame.observed).collect();
        let mut tiles = Vec::new();
        for &(item, frame) in folder::chosen(&seen) {
            let observed = item.read(args)?;
            let surface = worn.surface(&frame.body, &self.fit.code)?;
            let mut picture = observed.image.clone();
            let faces = worn.faces();
            drawing::body(
                &mut picture,
                surface.vertices(),
                faces,
                Some(colours),
                &observed.camera,
            )?;
            let overlap = frame.intersection_over_union;
            let overlap = overlap.map_or_else(String::new, |iou| format!(" {:.0} %", 100.0 * iou));
            let image = folder::thumbnail(&picture, &observed)?;
            tiles.push(Tile { image, label: item.name.clone() + &overlap });
        }
        folder::sheet(&tiles)
    }

    fn text(&self) -> String {
        let out = self.out.display();
        format!(
            "{} frames in {} in {}: {} left out, {} unreliable\n{out}/motion.npz\n{out}/clothed.glb\n\
             {out}/fits.png",
            self.frames,
            self.fit.outfit,
            seconds(self.seconds),
            self.left_out.len(),
            self.unreliable
        )
    }
}
