//! Source of the viewer's pictures: a run, a clothing layer, or meshes.

use std::path::{Path, PathBuf};

use cape_core::{
    BodyPose, Mesh,
    joints::JOINT_NAMES,
    list_files,
    motion::{MotionFile, MotionOptions},
    obj, ply,
};
use cape_data::{PackedSet, Split, raw::name_of};
use cape_infer::{AnimatedBody, BodySpec, Run, directions_by_effect};
use cape_stats::errors::distance_mm;
use cape_synth::{Motion, poses};
use ndarray::{Array2, Array3};
use serde_json::{Value, json};

use super::{
    layer_source::LayerSource,
    wire::{Answer, Download, FileFormat, MotionRequest, Person, Question, ShowRequest, ViewLayer},
};
use crate::{
    console::Console,
    dressed_mesh::{DressedMesh, DressedRenderer, unclothed_meshes},
    error::{Error, Result},
    mesh_file::{is_mesh, read_mesh},
    priors::{PriorArgs, PriorName},
};

/// Largest number of shape coefficients with sliders.
const SHAPES: usize = 10;
const CLAY: [f32; 3] = [0.72, 0.71, 0.70];

/// Source of pictures and files.
pub(super) enum Source<'a> {
    Model(Box<RunSource<'a>>),
    Layer(Box<LayerSource>),
    Meshes(MeshSource),
}

/// A trained run.
pub(super) struct RunSource<'a> {
    run: &'a Run,
    painter: DressedRenderer<'a>,
    truth: Option<PackedSet>,
    console: Console,
    /// Motion of a file, and its name in the page.
    motion: Option<(String, MotionFile)>,
}

/// A mesh, or the frames of a sequence.
pub(super) struct MeshSource {
    paths: Vec<PathBuf>,
    first: Mesh,
    fps: f64,
}

impl Source<'_> {
    /// Faces of every mesh.
    pub(super) fn faces(&self) -> &[[u32; 3]] {
        match self {
            Self::Model(model) => &model.run.body().faces,
            Self::Layer(layer) => layer.faces(),
            Self::Meshes(meshes) => &meshes.first.faces,
        }
    }

    /// Description of the source for the page.
    pub(super) fn scene(&self) -> Result<Value> {
        match self {
            Self::Model(model) => model.scene(),
            Self::Layer(layer) => layer.scene(),
            Self::Meshes(meshes) => Ok(meshes.scene()),
        }
    }

    pub(super) fn answer(&self, question: &Question) -> Result<Answer> {
        match (self, question) {
            (Self::Model(model), Question::Show(show)) => Ok(Answer::People(model.people(show)?)),
            (Self::Model(model), Question::Sample(sample)) => {
                let &RunSource { run, console, .. } = &**model;
                let (outfit, seed) = (sample.outfit, sample.seed);
                let drawn =
                    PriorArgs { prior: Some(sample.prior()?), temperature: sample.temperature };
                let z = drawn.codes(run, &[outfit], 1, seed, console)?;
                Ok(Answer::Code { z: z.row(0).to_vec() })
            }
            (Self::Model(model), Question::Carry(carry)) => {
                let code = model.code(&carry.z)?;
                let code = match model.run.prior()? {
                    Some(prior) => prior.transport_codes(&code, carry.from, carry.to)?,
                    None => code,
                };
                Ok(Answer::Code { z: code.row(0).to_vec() })
            }
            (Self::Model(model), &Question::Encode(frame)) => {
                let (_, wearer) = model.registration(frame)?;
                let z = model.code_of(frame)?.row(0).to_vec();
                Ok(Answer::Registration { z, wearer: Box::new(wearer) })
            }
            (Self::Model(model), Question::Motion(movement)) => {
                movement.check()?;
                let poses = model.poses(movement)?;
                Ok(Answer::Poses { poses, fps: movement.fps })
            }
            (Self::Layer(layer), Question::Worn(request)) => {
                Ok(Answer::People(vec![layer.person(request)?]))
            }
            (Self::Meshes(meshes), &Question::Frame(frame)) => {
                Ok(Answer::People(vec![meshes.person(frame)?]))
            }
            _ => Err(Error::message("not available for this source")),
        }
    }

    /// The file of a picture, of the clothed body if it is shown.
    pub(super) fn file(&self, download: &Download) -> Result<Vec<u8>> {
        if download.format == FileFormat::Glb {
            return match (self, &download.question) {
                (Self::Model(model), Question::Show(show)) => model.glb(show),
                _ => Err(Error::message("glTF is available only for runs: choose .obj or .ply")),
            };
        }
        let Answer::People(people) = self.answer(&download.question)? else {
            return Err(Error::message("unsupported download: expected a picture"));
        };
        let person = people
            .iter()
            .find(|person| person.layer == ViewLayer::Clothed)
            .or(people.first())
            .ok_or_else(|| Error::message("nothing is shown"))?;
        let mut bytes = Vec::new();
        if download.format == FileFormat::Ply {
            let colours: Vec<[u8; 3]> =
                person.colours.iter().copied().map(crate::dressed_mesh::eight_bit).collect();
            ply::write_to(&mut bytes, &person.mesh, Some(&colours))
        } else {
            obj::write_to(&mut bytes, &person.mesh, None, None)
        }
        .map_err(|error| Error::io("download", error))?;
        Ok(bytes)
    }
}

impl<'a> RunSource<'a> {
    pub(super) fn new(run: &'a Run, motion: Option<MotionFile>, console: Console) -> Self {
        let truth = run.data().ok().and_then(|data| run.open_set(data, Split::Test).ok());
        let motion = motion.map(|file| (name_of(&file.path), file));
        Self { run, painter: DressedRenderer::new(run), truth, console, motion }
    }

    pub(super) fn run(&self) -> &'a Run {
        self.run
    }

    /// Poses of a motion by name: the file's, or a synthetic one's. Paths are not names.
    pub(super) fn poses(&self, movement: &MotionRequest) -> Result<Vec<BodyPose>> {
        if let Some((name, file)) = &self.motion
            && *name == movement.name
        {
            let motion = file.motion_of(self.run.body(), &[], Some(movement.fps))?;
            return Ok((0..motion.frames()).map(|frame| motion.pose(frame)).collect());
        }
        if poses::preset(&movement.name).is_none() {
            return Err(Error::message(format!("unknown motion `{}`", movement.name)));
        }
        let options = MotionOptions::default();
        let file = poses::load_motion(&movement.name, movement.seconds, movement.fps, &options)?;
        Ok(file.upright_poses()?)
    }

    /// Description of the run for the page.
    pub(super) fn scene(&self) -> Result<Value> {
        let run = self.run;
        let at = |name: &str| poses::preset(name).unwrap_or([0.0; 72]);
        let wearer =
            BodySpec { betas: Vec::new(), pose: at("a-pose"), outfit: run.default_outfit() };
        let (order, effect) = directions_by_effect(run, &wearer)?;
        let synthetic: Vec<&str> = Motion::ALL.iter().map(|motion| motion.name()).collect();
        let named = ["a-pose", "t-pose"].into_iter().chain(synthetic.iter().copied());
        let given = self.motion.iter().map(|(name, _)| name.as_str());
        let motions: Vec<&str> = given.chain(synthetic.iter().copied()).collect();
        let poses: Vec<Value> =
            named.map(|name| json!({"name": name, "pose": at(name).to_vec()})).collect();
        let priors: Vec<&str> = [PriorName::Gmm, PriorName::Normal, PriorName::Kde]
            .into_iter()
            .filter(|&prior| prior == PriorName::Normal || run.has_prior(prior.name()))
            .map(PriorName::name)
            .collect();
        Ok(json!({
            "title": name_of(run.name()),
            "kind": "run",
            "vertices": run.body().vertices(),
            "faces": run.body().faces.len(),
            "model": {
                "latent": order.len(),
                "order": order,
                "effect": effect,
                "betas": self.shapes(),
                "outfits": run.outfits(),
                "outfit": run.default_outfit(),
                "poses": poses,
                "motions": motions,
                "joints": JOINT_NAMES,
                "priors": priors,
                "truth": self.truth.as_ref().map_or(0, PackedSet::frames),
            },
            "sequence": null,
        }))
    }

    fn people(&self, show: &ShowRequest) -> Result<Vec<Person>> {
        let (wearer, code, truth) = if show.layers.contains(&ViewLayer::Truth) {
            let (displacement, wearer) = self.registration(show.truth)?;
            let worn = self.painter.pose_clothed(&displacement, std::slice::from_ref(&wearer))?;
            (wearer, self.code_of(show.truth)?, worn.into_iter().next())
        } else {
            (show.body_spec()?, self.code(&show.z)?, None)
        };
        let wearers = std::slice::from_ref(&wearer);
        let vertices = self.run.body().vertices();
        let mut people = Vec::with_capacity(show.layers.len());
        for &layer in &show.layers {
            if people.iter().any(|person: &Person| person.layer == layer) {
                continue;
            }
            let dressed = match layer {
                ViewLayer::Truth => truth.clone(),
                ViewLayer::Body => unclothed_meshes(self.run, wearers)?.into_iter().next(),
                ViewLayer::Clothed => {
                    let worn = self.run.decode_displacements(&code, wearers)?;
                    self.painter.pose_clothed(&worn, wearers)?.into_iter().next()
                }
            };
            let Some(DressedMesh { mesh, colours, distances }) = dressed else { continue };
            let mut errors = vec![0.0; vertices];
            if let (Some(truth), ViewLayer::Clothed) = (&truth, layer) {
                for &vertex in self.run.clothing() {
                    let (a, b) = (mesh.vertices[vertex], truth.mesh.vertices[vertex]);
                    errors[vertex] = (1e-3 * distance_mm(a, b)) as f32;
                }
            }
            people.push(Person { layer, mesh, colours, distances, errors });
        }
        Ok(people)
    }

    fn code(&self, z: &[f32]) -> Result<Array2<f32>> {
        let latent = self.run.config().model.latent;
        Array2::from_shape_vec((1, z.len()), z.to_vec())
            .ok()
            .filter(|code| code.ncols() == latent)
            .ok_or_else(|| Error::message(format!("z has {} values, expected {latent}", z.len())))
    }

    fn set(&self) -> Result<&PackedSet> {
        self.truth.as_ref().ok_or_else(|| {
            Error::message("no registrations: the packed set of the run was not found")
        })
    }

    fn code_of(&self, frame: usize) -> Result<Array2<f32>> {
        Ok(self.run.encode_frames(self.set()?, &[frame])?)
    }

    /// Displacements `[1, vertices, 3]` of a held-out frame, and its pose and outfit.
    fn registration(&self, frame: usize) -> Result<(Array3<f32>, BodySpec)> {
        let (displacement, wearer) = cape_infer::registration(self.set()?, frame)?;
        Ok((displacement, BodySpec { betas: vec![0.0; self.shapes()], ..wearer }))
    }

    /// Up to `count` held-out frames, evenly spaced: code, shape, pose and outfit of each, and all their
    /// displacements, metres, `[frames, vertices, 3]`.
    pub(super) fn registrations(&self, count: usize) -> Result<(Vec<Value>, Vec<f32>)> {
        if count == 0 {
            return Ok((Vec::new(), Vec::new()));
        }
        let frames = self.set()?.frames();
        let count = count.min(frames);
        let (mut described, mut displacements) = (Vec::new(), Vec::new());
        for frame in (0..count).map(|index| index * frames / count) {
            let (displacement, BodySpec { betas, pose, outfit }) = self.registration(frame)?;
            let z = self.code_of(frame)?.row(0).to_vec();
            described
                .push(json!({"z": z, "betas": betas, "pose": pose.to_vec(), "outfit": outfit}));
            displacements.extend(displacement);
        }
        Ok((described, displacements))
    }

    /// Number of shape coefficients with sliders.
    fn shapes(&self) -> usize {
        self.run.body().betas().min(SHAPES)
    }

    fn glb(&self, show: &ShowRequest) -> Result<Vec<u8>> {
        let (code, wearer) = if show.layers.contains(&ViewLayer::Truth) {
            (self.code_of(show.truth)?, self.registration(show.truth)?.1)
        } else {
            (self.code(&show.z)?, show.body_spec()?)
        };
        let worn = self.run.decode_displacements(&code, std::slice::from_ref(&wearer))?;
        let dressed = self.painter.pose_clothed(&worn, std::slice::from_ref(&wearer))?;
        let performance = AnimatedBody {
            colours: dressed.first().map(|dressed| &dressed.colours[..]),
            ..AnimatedBody::from_body("clothed", &code, &wearer)
        };
        Ok(performance.encode(self.run)?)
    }
}

impl MeshSource {
    /// Opens a mesh, or all meshes of a directory in natural order of their names.
    pub(super) fn open(path: &Path, fps: f64) -> Result<Self> {
        let paths = if path.is_dir() { list_files(path, is_mesh)? } else { vec![path.to_owned()] };
        let Some(first) = paths.first() else {
            return Err(Error::message(format!(
                "{}: no meshes: expected a run, a mesh (.obj, .ply, .stl, .off, .glb), a body (.npz, \
                 .pkl), or a directory of meshes",
                path.display()
            )));
        };
        let first = checked(first)?;
        Ok(Self { paths, first, fps })
    }

    fn scene(&self) -> Value {
        let sequence = self.paths.len() > 1;
        let title = match self.paths.first() {
            Some(path) if sequence => name_of(path.parent().unwrap_or(path)),
            Some(path) => name_of(path),
            None => String::new(),
        };
        json!({
            "title": title,
            "kind": if sequence { "sequence" } else { "mesh" },
            "vertices": self.first.vertices.len(),
            "faces": self.first.faces.len(),
            "model": null,
            "sequence": sequence.then(|| json!({"frames": self.paths.len(), "fps": self.fps})),
        })
    }

    fn person(&self, frame: usize) -> Result<Person> {
        let mesh = match self.paths.get(frame) {
            Some(_) if frame == 0 => self.first.clone(),
            Some(path) => checked(path)?,
            None => {
                return Err(Error::message(format!(
                    "frame {frame}: the sequence has {} frames",
                    self.paths.len()
                )));
            }
        };
        if mesh.faces != self.first.faces {
            return Err(Error::message(format!(
                "{}: its faces differ from those of the first frame",
                self.paths[frame].display()
            )));
        }
        let count = mesh.vertices.len();
        Ok(Person {
            layer: ViewLayer::Clothed,
            colours: vec![CLAY; count],
            distances: vec![0.0; count],
            errors: vec![0.0; count],
            mesh,
        })
    }
}

/// Reads a mesh and checks that it can be drawn.
fn checked(path: &Path) -> Result<Mesh> {
    let mesh = read_mesh(path)?;
    let count = mesh.vertices.len();
    let drawable = count > 0
        && mesh.faces.iter().flatten().all(|&i| (i as usize) < count)
        && mesh.vertices.iter().flatten().all(|x| x.is_finite());
    if drawable {
        return Ok(mesh);
    }
    Err(cape_core::Error::format(path, "expected finite vertices and faces between them").into())
}
