use std::path::PathBuf;

use cape_layer::{LayerSet, import};
use clap::Args;
use serde::Serialize;

use super::{association::AssociationArgs, body, named};
use crate::{
    console::Console,
    error::{Error, Result},
    files,
};

/// Add a captured or simulated sequence of one's own to a set.
///
/// Takes a directory of OBJ or PLY meshes, whose names sort by frame, and SMPL's parameters of the
/// same frames. All sequences of a set have one topology and the same semantic parameters.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  cape layer import scans/skirt_01 scans/skirt_01.npz --set skirts --name \
                  walk --parameters length=0.85,width=1.1"
)]
pub(super) struct ImportArgs {
    /// Directory of clothing meshes, .obj or .ply, metres.
    #[arg(value_name = "MESHES")]
    meshes: PathBuf,
    /// The body in the same frames: poses, trans or transl, betas and mocap_framerate, as AMASS has
    /// them.
    #[arg(value_name = "SMPL.npz")]
    motion: PathBuf,
    /// Directory of the set; it is made if it is missing.
    #[arg(long, value_name = "SET")]
    set: PathBuf,
    /// The sequence's name; what follows its last underscore is the movement's.
    #[arg(long, value_name = "NAME")]
    name: String,
    /// Semantic parameters: sizes (length, width, sleeve, size) and others, which are the material's.
    #[arg(long, value_delimiter = ',', value_name = "NAME=X,…", value_parser = named)]
    parameters: Vec<(String, f64)>,
    /// Frames a second, if the archive does not say.
    #[arg(long, value_name = "FPS")]
    fps: Option<f64>,
    /// The body, .pkl or .npz; by default the synthetic one.
    #[arg(long, value_name = "SMPL")]
    body: Option<PathBuf>,
}

#[derive(Debug, Serialize)]
struct Report {
    set: PathBuf,
    name: String,
    frames: usize,
    vertices: usize,
    /// Sequences of the set with this one.
    sequences: usize,
}

impl ImportArgs {
    pub(super) fn run(self, console: Console) -> Result {
        let model = body(self.body.as_deref())?;
        let (faces, mut sequence) = import(&self.name, &self.meshes, &self.motion, self.fps)?;
        sequence.parameters.clone_from(&self.parameters);
        let own = LayerSet::new(faces, vec![sequence])?;
        // What cannot be tied to the body cannot be learned.
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

    /// The set that is there already with the new sequence.
    fn joined(&self, own: LayerSet) -> Result<LayerSet> {
        if files::require_empty(&self.set).is_ok() {
            return Ok(own);
        }
        let LayerSet { faces, mut sequences } = LayerSet::load(&self.set)?;
        if sequences.iter().any(|sequence| sequence.name == self.name) {
            let (name, set) = (&self.name, self.set.display());
            return Err(Error::message(format!("--name {name}: {set} has such a sequence")));
        }
        if faces != own.faces {
            return Err(Error::message(format!(
                "sequence `{}`: other faces than those of {}: every sequence of a set must have the \
                 same topology",
                self.name,
                self.set.display()
            )));
        }
        sequences.extend(own.sequences);
        Ok(LayerSet::new(faces, sequences)?)
    }
}
