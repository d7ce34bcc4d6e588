use std::path::PathBuf;

use cape_core::{
    MeshSequence, MeshSequenceOptions, SmplModel,
    motion::{MotionFile, MotionOptions, Pivot, UpAxis, read_motion},
};
use cape_fit::scan::Unit;
use cape_layer::{ImportRates, LayerSet, Sequence, import};
use clap::Args;
use glam::{DAffine3, DVec3};
use serde::Serialize;

use super::{association::AssociationArgs, named};
use crate::{
    body_source::BodyModelArgs,
    console::Console,
    error::{Error, Result},
    files,
    options::positive,
};

/// Import a captured or simulated clothing sequence.
///
/// Adds a sequence of meshes with the motion of the body to a set. Meshes are a directory of files whose
/// names sort by frame (--files picks some of them), a point cache with its mesh (--topology), an archive
/// of vertices and faces, or an animated .glb, in metres or in --unit. The motion is a file of poses with
/// translations: AMASS, SMPL-X's parameters, results of pose estimators, .smpl, .mat. Its up axis, that of
/// the meshes as well, is found out or given by --up; shape coefficients that the body has not are left
/// out. Garments of CLOTH3D (.pc16 with info.mat), relative to the pelvis, are moved with it.
/// --mesh-fps is the frame rate of the meshes where it differs from the motion's, --resample that of the
/// imported sequence. All sequences of a set share topology, body and semantic parameters; a set records
/// its body, and another is refused.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  cape layer import scans/skirt_01 scans/skirt_01.npz --set skirts --name \
                  walk --parameters length=0.85,width=1.1\n  cape layer import skirt.pc2 \
                  scans/skirt_01.npz --topology skirt.obj --unit cm --set skirts --name walk\n  cape \
                  layer import frames scans/skirt_01.npz --files '*_skirt.obj' --set skirts --name walk"
)]
pub(crate) struct ImportArgs {
    /// Directory of meshes (.obj, .ply, .stl, .off, .glb), point cache (.pc2, .pc16, .mdd), archive
    /// (.npz, .npy, .pkl) or animated .glb.
    #[arg(value_name = "MESHES")]
    meshes: PathBuf,
    /// Motion of the body in the coordinates of the meshes, a file of poses and translations [default:
    /// MESHES, which has them as well].
    #[arg(value_name = "MOTION")]
    motion: Option<PathBuf>,
    /// Directory of the set; it is created if missing.
    #[arg(long, value_name = "SET")]
    set: PathBuf,
    /// Name of the sequence; the part after the last underscore is that of the motion.
    #[arg(long, value_name = "NAME")]
    name: String,
    /// Semantic parameters: length, width, sleeve and size; all others are of the material.
    #[arg(long, value_delimiter = ',', value_name = "NAME=X,…", value_parser = named)]
    parameters: Vec<(String, f64)>,
    /// Mesh with the triangles of a point cache or array [default: the mesh of the same name].
    #[arg(long, value_name = "MESH")]
    topology: Option<PathBuf>,
    /// Pattern of the file names in a directory, with * and ? [default: all meshes].
    #[arg(long, value_name = "PATTERN")]
    files: Option<String>,
    /// Unit of the meshes: m, cm or mm; the motion is in metres.
    #[arg(long, default_value = "m", value_name = "UNIT")]
    unit: Unit,
    /// Axis that points up in meshes and motion: y, z or -y [default: as the motion tells].
    #[arg(long, allow_hyphen_values = true, value_name = "AXIS")]
    up: Option<UpAxis>,
    /// Frames per second of the motion, if its file says none.
    #[arg(long, value_name = "FPS", value_parser = positive)]
    fps: Option<f64>,
    /// Frames per second of the meshes, if they differ from the motion, which is then resampled.
    #[arg(long, value_name = "FPS", value_parser = positive)]
    mesh_fps: Option<f64>,
    /// Frames per second of the imported sequence [default: those of the meshes].
    #[arg(long, value_name = "FPS", value_parser = positive)]
    resample: Option<f64>,
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
        let (faces, mut sequence) = self.sequence(&model, console)?;
        sequence.parameters.clone_from(&self.parameters);
        let own =
            LayerSet::new(faces, vec![sequence])?.with_body(self.body.source()?.identity(&model));
        // Sequences that cannot be associated with the body are refused now.
        AssociationArgs::default().associate(&model, &own, console)?;
        let set = self.joined(own, &model)?;
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

    /// Faces and sequence, in metres with y up.
    fn sequence(&self, model: &SmplModel, console: Console) -> Result<(Vec<[u32; 3]>, Sequence)> {
        let motion = self.motion.as_deref().unwrap_or(&self.meshes);
        let options = MotionOptions { person: self.person.clone(), up: self.up };
        let file = read_motion(motion, &options)?;
        let note = |text: &str| console.note(&format!("{}: {text}", motion.display()));
        let said = file.notes.iter().filter(|note| !note.starts_with("no frame rate"));
        said.for_each(|text| note(text));
        let (given, known) = (file.betas.len(), model.betas());
        if given > known {
            note(&format!("the first {known} of {given} betas are used, as the body has no more"));
        }
        let betas: Vec<f64> = file.betas.iter().take(known).copied().collect();
        let file = self.complete(file)?;
        let place = DAffine3::from_scale_rotation_translation(
            DVec3::splat(self.unit.metres()),
            file.up.to_y(),
            DVec3::ZERO,
        );
        let options = MeshSequenceOptions {
            topology: self.topology.clone(),
            files: self.files.clone(),
            frame_rate: self.mesh_fps,
        };
        let meshes = MeshSequence::read(&self.meshes, &options)?;
        let relative = self.meshes.extension().is_some_and(|e| e.eq_ignore_ascii_case("pc16"))
            && file.pivot == Pivot::PelvisAtOrigin;
        let meshes = match &file.translations {
            Some(translations) if relative => {
                note("the garment's vertices are relative to the pelvis, as in CLOTH3D");
                meshes.translated((translations / self.unit.metres()).view())?
            }
            _ => meshes,
        };
        let meshes = meshes.moved(place);
        let motion = file.motion_of(model, &betas, None)?;
        let rates = ImportRates { meshes: self.mesh_fps, output: self.resample };
        let sequence = import(&self.name, &meshes, &motion, betas, rates)?;
        Ok((meshes.faces, sequence))
    }

    /// The motion with its frame rate; an error if it has none, or no translations.
    fn complete(&self, file: MotionFile) -> Result<MotionFile> {
        let missing = |message: &str| cape_core::Error::format(&file.path, message);
        let rate = self.fps.filter(|_| file.frame_rate.is_none()).or(file.frame_rate);
        let frame_rate = rate.ok_or_else(|| {
            missing(
                "no frame rate, on which the speeds of the motion depend: expected `mocap_framerate` or \
                 `fps`, or the option --fps",
            )
        })?;
        if file.translations.is_none() {
            return Err(missing(
                "no translations: expected `trans` or `transl`, [frames, 3], of the body in the meshes",
            )
            .into());
        }
        Ok(MotionFile { frame_rate: Some(frame_rate), ..file })
    }

    /// The existing set with the new sequence.
    fn joined(&self, own: LayerSet, model: &SmplModel) -> Result<LayerSet> {
        if files::require_empty(&self.set).is_ok() {
            return Ok(own);
        }
        let LayerSet { faces, mut sequences, body } = LayerSet::load_for(&self.set, model)?;
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
        Ok(LayerSet { body, ..LayerSet::new(faces, sequences)? })
    }
}
