use std::path::PathBuf;

use cape_core::{Mesh, ply, poses::movement};
use cape_layer::{Layer, regress::Motion};
use clap::Args;
use ndarray::Array2;
use serde::Serialize;

use super::body;
use crate::{
    console::Console,
    error::{Error, Result},
    files,
};

/// Predict clothing over a movement, frame by frame.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  cape layer predict learnt/layer.npz --motion squats --out predicted"
)]
pub(super) struct Predict {
    /// What `cape layer learn` wrote.
    #[arg(value_name = "LAYER.npz")]
    layer: PathBuf,
    /// Directory to write; it must be empty or missing.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// The body, .pkl or .npz; by default the synthetic one.
    #[arg(long, value_name = "SMPL")]
    body: Option<PathBuf>,
    /// A movement (walk, squats, …), or a file of poses, .npz, .npy or .csv.
    #[arg(long, default_value = "walk", value_name = "MOTION")]
    motion: String,
    /// Length of a movement, seconds.
    #[arg(long, default_value_t = 2.0, value_name = "S")]
    seconds: f64,
    /// Frames a second.
    #[arg(long, default_value_t = 30.0, value_name = "FPS")]
    fps: f64,
    /// Shape coefficients of the body; missing ones are zero.
    #[arg(long, value_delimiter = ',', allow_hyphen_values = true, value_name = "B,B,…")]
    betas: Vec<f64>,
    /// Semantic parameters, in the layer's order.
    #[arg(long, value_delimiter = ',', allow_hyphen_values = true, value_name = "P,P,…")]
    parameters: Vec<f64>,
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    frames: usize,
}

impl Predict {
    pub(super) fn run(self, console: Console) -> Result {
        files::require_empty(&self.out)?;
        let model = body(self.body.as_deref())?;
        let layer = Layer::load(&self.layer, model.vertices())?;
        let poses = movement(&self.motion, self.seconds, self.fps)?;
        let frames = poses.len();
        let angles = poses.iter().flatten().map(|&angle| f64::from(angle)).collect();
        let angles = Array2::from_shape_vec((frames, 72), angles)
            .map_err(|error| Error::message(error.to_string()))?;
        let motion = Motion::new(self.fps, angles, Array2::zeros((frames, 3)))?;
        let shape = model.shaped(&self.betas)?;
        files::create_dir(&self.out)?;
        console.while_showing("predict", "frames", |progress| {
            layer.predict(&model, &shape, &motion, &self.parameters, &mut |frame, vertices| {
                let vertices = vertices.rows().into_iter();
                let vertices = vertices.map(|v| [v[0], v[1], v[2]].map(|x| x as f32)).collect();
                let mesh = Mesh { vertices, faces: layer.faces.clone() };
                ply::write(self.out.join(format!("frame-{frame:05}.ply")), &mesh, None)?;
                progress(frame + 1, frames);
                Ok(())
            })
        })?;
        let report = Report { out: self.out, frames };
        console.result(&report, || format!("{frames} frames\n{}", report.out.display()))
    }
}
