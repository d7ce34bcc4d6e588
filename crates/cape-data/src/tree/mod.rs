//! Raw data sets as they lie on people's disks.
//!
//! ```text
//! <root>/sequences/<subject>/<outfit>_<sequence>/<frame>.npz
//! <root>/cape_release/sequences/<subject>/<outfit>_<sequence>/<frame>.npz
//! <root>/<subject>/<outfit>_<sequence>/<frame>.npz     beside <root>/cape_release
//! <root>/<subject>.zip                                 the same in an archive, which is not unpacked
//!
//! minimal_body_shape/<subject>/<subject>_minimal.npy   or .ply
//! minimal_body_params/minimal_body_shape/<subject>/<subject>_param.pkl    betas, optional
//! seq_lists/seq_list_<subject>.txt                     valid frames, optional
//! misc/subj_genders.pkl                                optional
//! ```
//!
//! Data of other sources have `body.npz`, the body of all subjects, or `body_male.npz` and
//! `body_female.npz` at the root.
//!
//! The last four of the list are in `<root>` or in `<root>/cape_release`, and `<root>/cape_release` may be given
//! in place of `<root>`.

mod archive;
mod lists;

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use cape_core::{
    Mesh, Outfit,
    npy::{Npz, read_f64},
    pickle::Pickle,
    smpl::{GENDERS_FILE, Gender},
};
use ndarray::Array2;

pub use lists::{KNOWN_BROKEN, ListedSequence};

use self::archive::SubjectArchive;
use crate::{
    Error, ForeignData, Result,
    raw::{self, BODY_FILE, CanonicalFrame, PosedVertices, RawFrame},
};

/// Directory of the release inside a download.
const RELEASE: &str = "cape_release";
/// Directory of the captures by subject.
const SEQUENCES: &str = "sequences";
/// Directory of the minimal shapes by subject.
const MINIMAL: &str = "minimal_body_shape";
/// Directory of the subjects' shape coefficients.
const PARAMETERS: &str = "minimal_body_params";

/// Raw data set: subjects with their captures, minimal shapes and what else the release has of them.
///
/// ```
/// use cape_core::Outfit;
/// use cape_data::{RawTree, raw};
/// use ndarray::Array2;
///
/// let directory = tempfile::tempdir()?;
/// raw::write_minimal(directory.path(), "anna", &Array2::zeros((3, 3)))?;
/// let v_cano = Array2::from_elem((3, 3), 0.01);
/// let v_posed = v_cano.clone();
/// let frame = raw::RawFrame { v_cano, v_posed, pose: [0.0; 72], transl: [0.0; 3] };
/// raw::write_frame(directory.path(), "anna", Outfit::LONG_LONG, "hips", 1, &frame)?;
///
/// let tree = RawTree::open(directory.path())?;
/// assert_eq!(tree.subjects().collect::<Vec<_>>(), ["anna"]);
/// let capture = tree.capture("anna", Outfit::LONG_LONG, "hips").ok_or("no such capture")?;
/// assert_eq!(capture.frames()[0].read(Some(3))?, frame);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct RawTree {
    root: PathBuf,
    /// The directory itself and those beside it that belong to the same download.
    bases: Vec<PathBuf>,
    subjects: BTreeMap<String, Subject>,
    /// Archives and directories that are not read, with the reason.
    notes: Vec<String>,
}

#[derive(Debug)]
struct Subject {
    /// Directory or archive of the captures.
    path: PathBuf,
    captures: Vec<RawCapture>,
    /// Entries that are no captures.
    others: Vec<String>,
}

/// Capture: the frames of a subject performing a sequence in an outfit.
#[derive(Debug, Clone)]
pub struct RawCapture {
    name: String,
    frames: Vec<FrameSource>,
    misnamed: Vec<String>,
}

/// File of a frame, on disk or in a subject's archive.
#[derive(Debug, Clone)]
pub struct FrameSource {
    path: PathBuf,
    relative: PathBuf,
    place: Place,
}

#[derive(Debug, Clone)]
enum Place {
    File { base: PathBuf },
    Member { archive: Arc<SubjectArchive>, index: usize },
}

/// Shape coefficients of a subject from the release's `<subject>_param.pkl`.
#[derive(Debug, Clone, PartialEq)]
pub struct SubjectParameters {
    /// Shape coefficients, `[10]` as a rule.
    pub betas: Vec<f64>,
}

impl RawTree {
    /// True if a directory has raw data in one of the layouts.
    pub fn is_raw(root: impl AsRef<Path>) -> bool {
        let root = root.as_ref();
        root.join(SEQUENCES).is_dir()
            || root.join(RELEASE).is_dir()
            || root.join(MINIMAL).is_dir() && !root.join("train").is_dir()
    }

    /// Opens a raw data set and lists its captures; frames are not read yet.
    ///
    /// # Errors
    /// If the directory is in none of the layouts, or a directory or archive in it cannot be read.
    pub fn open(root: impl AsRef<Path>) -> Result<Self> {
        let root = root.as_ref();
        if !root.is_dir() {
            let source = fs::read_dir(root).err();
            return Err(match source {
                Some(source) => Error::io(root, source),
                None => Error::format(root, "is no directory"),
            });
        }
        if !Self::is_raw(root) {
            if let Some(data) = ForeignData::recognise(root) {
                return Err(Error::Data(format!("{}: {data}", root.display())));
            }
            return Err(Error::Data(format!(
                "{}: not raw data: expected sequences/<subject>/<outfit>_<sequence>/, or \
                 cape_release/ with <subject>/ or <subject>.zip beside it",
                root.display()
            )));
        }
        let mut bases = vec![root.to_owned()];
        bases.extend(Some(root.join(RELEASE)).filter(|path| path.is_dir()));
        if root.file_name().is_some_and(|name| name == RELEASE) && !root.join(SEQUENCES).is_dir() {
            let above =
                fs::canonicalize(root).ok().and_then(|path| path.parent().map(Path::to_owned));
            bases.extend(above);
        }
        let mut tree =
            Self { root: root.to_owned(), bases, subjects: BTreeMap::new(), notes: vec![] };
        tree.find_subjects()?;
        Ok(tree)
    }

    /// The directory that was opened.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Subjects that have captures, by name.
    pub fn subjects(&self) -> impl Iterator<Item = &str> {
        self.subjects.keys().map(String::as_str)
    }

    /// Captures of a subject, by name; none for an unknown subject.
    pub fn captures(&self, subject: &str) -> &[RawCapture] {
        self.subjects.get(subject).map_or(&[], |subject| &subject.captures)
    }

    /// Capture of a subject in an outfit.
    pub fn capture(&self, subject: &str, outfit: Outfit, sequence: &str) -> Option<&RawCapture> {
        let name = format!("{outfit}_{sequence}");
        self.captures(subject).iter().find(|capture| capture.name == name)
    }

    /// Directory or archive of a subject.
    pub fn subject_path(&self, subject: &str) -> Option<&Path> {
        self.subjects.get(subject).map(|subject| subject.path.as_path())
    }

    /// Names of a subject's directories that are no captures.
    pub fn other_entries(&self, subject: &str) -> &[String] {
        self.subjects.get(subject).map_or(&[], |subject| &subject.others)
    }

    /// Archives and directories of subjects that are not read, with the reason.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Reads the minimal shape of a subject, `[V, 3]`, metres.
    ///
    /// # Errors
    /// If there is none, or it is invalid.
    pub fn minimal(&self, subject: &str, follow_links: bool) -> Result<Array2<f64>> {
        let path = self.minimal_path(subject);
        if !follow_links && path.exists() {
            self.require_inside(&path)?;
        }
        if path.extension().is_some_and(|extension| extension == "ply") {
            let mesh = Mesh::load(&path)?;
            let rows = mesh.vertices.iter().flatten().map(|&x| f64::from(x)).collect();
            return Array2::from_shape_vec((mesh.vertices.len(), 3), rows)
                .map_err(|error| Error::format(&path, error.to_string()));
        }
        raw::minimal_vertices(&path, read_f64(&path)?)
    }

    /// File of the minimal shape of a subject; if there is none, where it is expected.
    pub fn minimal_path(&self, subject: &str) -> PathBuf {
        let named = |extension: &str| {
            Path::new(MINIMAL).join(subject).join(format!("{subject}_minimal.{extension}"))
        };
        let found = ["npy", "ply"].iter().find_map(|extension| self.find(named(extension)));
        found.unwrap_or_else(|| self.bases[self.bases.len() - 1].join(named("npy")))
    }

    /// Shape coefficients of a subject, if the release's file of them is there.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn parameters(&self, subject: &str) -> Result<Option<SubjectParameters>> {
        let name = format!("{subject}_param.pkl");
        let places = [
            Path::new(PARAMETERS).join(MINIMAL).join(subject).join(&name),
            Path::new(PARAMETERS).join(subject).join(&name),
            Path::new(MINIMAL).join(subject).join(&name),
        ];
        let Some(path) = places.into_iter().find_map(|place| self.find(place)) else {
            return Ok(None);
        };
        let pickle = Pickle::open(&path)?;
        let betas = pickle.root().require("betas")?.array::<f64>()?;
        if let Some(at) = betas.iter().position(|x| !x.is_finite()) {
            return Err(Error::field(&path, "betas", format!("number {at} is not finite")));
        }
        Ok(Some(SubjectParameters { betas: betas.into_iter().collect() }))
    }

    /// Genders of the subjects by the release's `misc/subj_genders.pkl`; empty without it.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn genders(&self) -> Result<BTreeMap<String, String>> {
        let Some(path) = self.find(GENDERS_FILE) else { return Ok(BTreeMap::new()) };
        lists::genders(&path)
    }

    /// File of the body of the subjects of a gender, `body_male.npz` for example, or that of all
    /// subjects, `body.npz`; `None` if there is none.
    pub fn body_path(&self, gender: Option<Gender>) -> Option<PathBuf> {
        let names = gender.map(Gender::body_file).into_iter().chain([BODY_FILE]);
        names.map(|name| self.root.join(name)).find(|path| path.is_file())
    }

    /// Sequences of a subject by the release's `seq_lists`; `None` without a list.
    ///
    /// # Errors
    /// If the list cannot be read.
    pub fn sequence_list(&self, subject: &str) -> Result<Option<Vec<ListedSequence>>> {
        let place = format!("seq_lists/seq_list_{subject}.txt");
        self.find(place).map(|path| lists::sequences(&path)).transpose()
    }

    /// A file of the data set, in whichever directory of it; `None` if there is none.
    pub fn find(&self, place: impl AsRef<Path>) -> Option<PathBuf> {
        let place = place.as_ref();
        self.bases.iter().map(|base| base.join(place)).find(|path| path.exists())
    }

    fn require_inside(&self, path: &Path) -> Result<()> {
        let base = self.bases.iter().find(|base| path.starts_with(base)).unwrap_or(&self.root);
        raw::require_inside(base, path)
    }

    /// True if the release knows a subject of this name.
    fn is_known(&self, subject: &str) -> bool {
        self.find(Path::new(MINIMAL).join(subject)).is_some()
            || self.find(format!("seq_lists/seq_list_{subject}.txt")).is_some()
    }

    fn find_subjects(&mut self) -> Result<()> {
        // Where subjects lie, and whether everything there is one.
        let both = |base: &PathBuf| [(base.join(SEQUENCES), true), (base.clone(), false)];
        let mut places: Vec<(PathBuf, bool)> = self.bases.iter().flat_map(both).collect();
        places.retain(|(place, _)| place.is_dir());
        for (place, all) in &places {
            for path in raw::directories(place)? {
                let subject = raw::name_of(&path);
                if *all || self.is_known(&subject) {
                    self.add_directory(subject, path, place)?;
                }
            }
        }
        // What is unpacked is preferred.
        for (place, all) in &places {
            self.add_archives(place, *all)?;
        }
        Ok(())
    }

    fn add_directory(&mut self, name: String, path: PathBuf, place: &Path) -> Result<()> {
        if let Some(known) = self.subjects.get(&name) {
            let text = format!("{}: not read: {} is", path.display(), known.path.display());
            self.notes.push(text);
            return Ok(());
        }
        let base = self.bases.iter().find(|base| path.starts_with(base)).cloned();
        let base = base.unwrap_or_else(|| place.to_owned());
        let mut subject = Subject { path: path.clone(), captures: vec![], others: vec![] };
        for directory in raw::directories(&path)? {
            let title = raw::name_of(&directory);
            if split_title(&title).is_none() {
                subject.others.push(title);
                continue;
            }
            let (paths, misnamed) = raw::frame_files(&directory)?;
            let frames = paths
                .into_iter()
                .map(|path| FrameSource {
                    relative: Path::new(&name).join(&title).join(raw::name_of(&path)),
                    place: Place::File { base: base.clone() },
                    path,
                })
                .collect();
            subject.captures.push(RawCapture { name: title, frames, misnamed });
        }
        if subject.captures.is_empty() && !place.ends_with(SEQUENCES) {
            // A directory that only has the name of a subject.
            return Ok(());
        }
        self.subjects.insert(name, subject);
        Ok(())
    }

    fn add_archives(&mut self, place: &Path, all: bool) -> Result<()> {
        let fail = |error| Error::io(place, error);
        let mut paths = Vec::new();
        for entry in fs::read_dir(place).map_err(fail)? {
            let path = entry.map_err(fail)?.path();
            let zip =
                path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("zip"));
            if zip && path.is_file() && !raw::name_of(&path).starts_with('.') {
                paths.push(path);
            }
        }
        paths.sort_unstable();
        for path in paths {
            let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            if !all && !self.is_known(&name) {
                continue;
            }
            if let Some(known) = self.subjects.get(&name) {
                let text = format!("{}: not read: {} is", path.display(), known.path.display());
                self.notes.push(text);
                continue;
            }
            let (archive, captures) = SubjectArchive::open(&path, &name)?;
            let archive = Arc::new(archive);
            let captures = captures.into_iter().map(|(title, members)| RawCapture {
                frames: members
                    .frames
                    .into_iter()
                    .map(|(file, index)| FrameSource {
                        path: path.join(&name).join(&title).join(&file),
                        relative: Path::new(&name).join(&title).join(&file),
                        place: Place::Member { archive: archive.clone(), index },
                    })
                    .collect(),
                misnamed: members.misnamed,
                name: title,
            });
            let captures = captures.collect();
            self.subjects.insert(name, Subject { path, captures, others: vec![] });
        }
        Ok(())
    }
}

/// Outfit and sequence of a capture's name.
fn split_title(title: &str) -> Option<(Outfit, &str)> {
    let (outfit, sequence) = title.split_once('_')?;
    Some((outfit.parse().ok()?, sequence))
}

impl RawCapture {
    /// Name, `<outfit>_<sequence>`.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Outfit.
    pub fn outfit(&self) -> Outfit {
        split_title(&self.name).map_or(Outfit::LONG_LONG, |(outfit, _)| outfit)
    }

    /// Motion sequence.
    pub fn sequence(&self) -> &str {
        split_title(&self.name).map_or("", |(_, sequence)| sequence)
    }

    /// Frames, by name.
    pub fn frames(&self) -> &[FrameSource] {
        &self.frames
    }

    /// Files whose names begin like those of frames but do not end with `.npz`.
    pub fn misnamed(&self) -> &[String] {
        &self.misnamed
    }
}

impl FrameSource {
    /// Path of the file; that of a member continues the path of its archive.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Path below the subjects, `<subject>/<outfit>_<sequence>/<file>`.
    pub fn relative(&self) -> &Path {
        &self.relative
    }

    /// Size and, of a file, the time of its last change in seconds, or, of a member, its checksum.
    ///
    /// # Errors
    /// If the file is missing.
    pub fn identity(&self) -> Result<[u64; 2]> {
        match &self.place {
            Place::File { .. } => raw::file_identity(&self.path),
            Place::Member { archive, index } => archive.identity(*index),
        }
    }

    /// Checks that the file does not link to one outside of the data set.
    ///
    /// # Errors
    /// If it does, or does not exist.
    pub fn require_inside(&self) -> Result<()> {
        match &self.place {
            Place::File { base } => raw::require_inside(base, &self.path),
            Place::Member { .. } => Ok(()),
        }
    }

    /// Opens the arrays of the frame.
    ///
    /// # Errors
    /// If the file is missing or no archive of arrays.
    pub fn open(&self) -> Result<Npz> {
        match &self.place {
            Place::File { .. } => Npz::open(&self.path),
            Place::Member { archive, index } => {
                Npz::from_bytes(&self.path, archive.read(*index, &self.path)?)
            }
        }
    }

    /// Reads the frame; `vertices` of `None` is any number.
    pub fn read(&self, vertices: Option<usize>) -> Result<RawFrame> {
        raw::frame_from(&self.path, &mut self.open()?, vertices)
    }

    /// Reads the canonical part of a frame of `vertices` vertices.
    pub fn canonical(&self, vertices: usize) -> Result<CanonicalFrame> {
        raw::canonical(&self.path, &mut self.open()?, Some(vertices))
    }

    /// Reads the posed part of a frame of `vertices` vertices; canonical vertices are empty, and a
    /// missing translation is zero.
    pub fn posed(&self, vertices: usize) -> Result<RawFrame> {
        raw::posed_from(&self.path, &mut self.open()?, vertices)
    }

    /// Reads the canonical part, and the posed part if it is there.
    pub fn any(&self) -> Result<(CanonicalFrame, Option<PosedVertices>)> {
        raw::any_from(&self.path, &mut self.open()?)
    }
}
