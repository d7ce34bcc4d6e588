use std::path::PathBuf;

use cape_core::motion::{MotionOptions, UpAxis, read_motion};
use cape_layer::{LayerSet, import};
use clap::Args;
use serde::Serialize;

use super::{association::AssociationArgs, named};
use crate::{
    console::Console,
    error::{Error, Result},
    files,
    options::{BodyModelArgs, positive},
};

/// Import a captured or simulated clothing sequence.
///
/// Adds a directory of OBJ or PLY meshes, whose names sort by frame, with the SMPL parameters of the same
/// frames to a set. All sequences of a set share topology and semantic parameters.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  cape layer import scans/skirt_01 scans/skirt_01.npz --set skirts --name \
                  walk --parameters length=0.85,width=1.1"
)]
pub(crate) struct ImportArgs {
    /// Directory of clothing meshes, .obj or .ply, metres.
    #[arg(value_name = "MESHES")]
    meshes: PathBuf,
    /// Motion of the body in the same frames, in the coordinates of the meshes: a file of poses and
    /// translations.
    #[arg(value_name = "MOTION")]
    motion: PathBuf,
    /// Directory of the set; it is created if missing.
    #[arg(long, value_name = "SET")]
    set: PathBuf,
    /// Name of the sequence; the part after the last underscore is that of the motion.
    #[arg(long, value_name = "NAME")]
    name: String,
    /// Semantic parameters: length, width, sleeve and size; all others are of the material.
    #[arg(long, value_delimiter = ',', value_name = "NAME=X,…", value_parser = named)]
    parameters: Vec<(String, f64)>,
    /// Frames per second [default: those of the motion's file].
    #[arg(long, value_name = "FPS", value_parser = positive)]
    fps: Option<f64>,
    /// Person of a file of poses with several.
    #[arg(long, value_name = "NAME")]
    person: Option<String>,
    #[command(flatten)]
    body: BodyModelArgs,
}

#[derive(Debug, Serialize)]
struct Report {
    set: PathBuf,
    name: String,
    frames: usize,
    vertices: usize,
    /// Number of sequences of the set, this one included.
    sequences: usize,
}

impl ImportArgs {
    pub(super) fn run(self, console: Console) -> Result {
        let model = self.body.load()?;
        let options = MotionOptions { person: self.person.clone(), up: Some(UpAxis::Y) };
        let file = read_motion(&self.motion, &options)?;
        let (faces, mut sequence) = import(&self.name, &self.meshes, &file, self.fps)?;
        let given = sequence.betas.len();
        sequence.betas.truncate(model.betas());
        let path = self.motion.display();
        if sequence.betas.len() < given {
            console.note(&format!(
                "{path}: the first {} of {given} betas are used, as the body has no more",
                model.betas()
            ));
        }
        for note in file.notes.iter().filter(|note| !note.starts_with("no frame rate")) {
            console.note(&format!("{path}: {note}"));
        }
        sequence.parameters.clone_from(&self.parameters);
        let own = LayerSet::new(faces, vec![sequence])?;
        // Sequences that cannot be associated with the body are refused now.
        AssociationArgs::default().associate(&model, &own, console)?;
        let set = self.joined(own)?;
        files::create_dir(&self.set)?;
        set.save(&self.set)?;
        let report = Report {
            frames: set.sequences[set.sequences.len() - 1].frames(),
            vertices: set.vertices(),
            sequences: set.sequences.len(),
            name: self.name,
            set: self.set,
        };
        console.result(&report, || {
            format!(
                "{} frames of {} vertices\n{}: {} sequences",
                report.frames,
                report.vertices,
                report.set.display(),
                report.sequences
            )
        })
    }

    /// The existing set with the new sequence.
    fn joined(&self, own: LayerSet) -> Result<LayerSet> {
        if files::require_empty(&self.set).is_ok() {
            return Ok(own);
        }
        let LayerSet { faces, mut sequences } = LayerSet::load(&self.set)?;
        if sequences.iter().any(|sequence| sequence.name == self.name) {
            let (name, set) = (&self.name, self.set.display());
            return Err(Error::message(format!(
                "--name {name}: {set} already has a sequence of this name"
            )));
        }
        if faces != own.faces {
            return Err(Error::message(format!(
                "sequence `{}`: its faces differ from those of {}: all sequences of a set need the \
                 same topology",
                self.name,
                self.set.display()
            )));
        }
        sequences.extend(own.sequences);
        Ok(LayerSet::new(faces, sequences)?)
    }
}
