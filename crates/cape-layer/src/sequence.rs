//! Sequences of clothing on a moving body, and sets of sequences that share a topology.

use std::path::{Path, PathBuf};

use cape_core::{
    SmplModel,
    npy::{Npz, NpzWriter},
    write_atomically,
};
use ndarray::{Array1, Array2, Array3, Axis};
use serde::{Deserialize, Serialize};

use crate::{BodyFrame, BodyIdentity, Error, Result};
use cape_core::{
    BodyMotion, expect_finite,
    geometry::{SurfaceMesh, points},
    smpl::StandardPose,
};

/// Clothing on one body in motion.
#[derive(Debug, Clone, PartialEq)]
pub struct Sequence {
    /// Name, also of its file.
    pub name: String,
    /// Clothing vertices, metres, `[frames, n_v, 3]`.
    pub clothing: Array3<f64>,
    /// Shape coefficients β of the body.
    pub betas: Vec<f64>,
    /// Motion of the body, of as many frames as the clothing.
    pub motion: BodyMotion,
    /// Semantic parameters by name: garment sizes and materials, constant over the sequence.
    pub parameters: Vec<(String, f64)>,
}

impl Sequence {
    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.clothing.len_of(Axis(0))
    }

    /// Unclothed rest shape of the body, metres, `[V, 3]`.
    ///
    /// # Errors
    /// If the body has fewer shape coefficients.
    pub fn shape(&self, model: &SmplModel) -> Result<Array2<f64>> {
        Ok(model.rest_shape(&self.betas)?)
    }

    /// Body of a frame.
    ///
    /// # Errors
    /// If the motion does not fit the body.
    pub fn body(
        &self,
        model: &SmplModel,
        frame: usize,
        standard: &StandardPose,
    ) -> Result<BodyFrame> {
        let pose = self.motion.poses.row(frame).to_vec();
        let transl = [0, 1, 2].map(|axis| self.motion.translations[(frame, axis)]);
        BodyFrame::new(model, &self.shape(model)?, &pose, transl, standard)
    }

    pub(crate) fn check(&self, vertices: usize) -> Result<()> {
        let (frames, found, axes) = self.clothing.dim();
        let fault = |message: String| Err(Error::sequence(&self.name, message));
        if frames == 0 {
            return fault("no frames".into());
        }
        if found != vertices || axes != 3 {
            return fault(format!(
                "clothing of {found} vertices, expected {vertices}: all sequences of a set must have the \
                 same topology"
            ));
        }
        if self.motion.frames() != frames {
            return fault(format!(
                "{frames} frames of clothing but {} of the body: clothing and body are out of step",
                self.motion.frames()
            ));
        }
        for (frame, clothing) in self.clothing.outer_iter().enumerate() {
            expect_finite(format!("sequence `{}`, frame {frame}", self.name), clothing)?;
        }
        Ok(expect_finite(
            format!("sequence `{}`, parameters", self.name),
            self.parameters.iter().map(|p| &p.1),
        )?)
    }
}

/// Sequences of one clothing topology.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use cape_synth::synthetic_body;
/// use cape_layer::LayerSet;
///
/// // A patch of three vertices on a marching body.
/// let set = patch(&synthetic_body())?.0;
/// assert_eq!((set.vertices(), set.frames()), (3, 30));
/// assert_eq!(set.clothing(0, 0)?.faces, [[0, 1, 2]]);
/// // A set is saved as a directory.
/// let directory = tempfile::tempdir()?;
/// set.save(directory.path())?;
/// let again = LayerSet::load(directory.path())?;
/// assert_eq!(again.sequences[0].motion.frames(), set.sequences[0].frames());
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct LayerSet {
    /// Triangles of the clothing, `[faces, 3]`.
    pub faces: Vec<[u32; 3]>,
    /// Sequences.
    pub sequences: Vec<Sequence>,
    /// Body that wears the clothing, if it is recorded.
    pub body: Option<BodyIdentity>,
}

/// Entry of `set.json` for one sequence.
#[derive(Debug, Serialize, Deserialize)]
struct Entry {
    name: String,
    frame_rate: f64,
    parameters: Vec<(String, f64)>,
}

/// Content of `set.json`.
#[derive(Debug, Default, Serialize, Deserialize)]
struct Index {
    /// Body of all sequences, if it is recorded.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    body: Option<BodyIdentity>,
    sequences: Vec<Entry>,
}

/// Forms of `set.json`; the second one has no body.
#[derive(Deserialize)]
#[serde(untagged)]
enum AnyIndex {
    Present(Index),
    Earlier(Vec<Entry>),
}

const INDEX: &str = "set.json";

impl LayerSet {
    /// A set of sequences.
    ///
    /// # Errors
    /// If there is no sequence, or sequences differ in topology or names of parameters, have
    /// different numbers of frames of clothing and body, or numbers that are not finite.
    pub fn new(faces: Vec<[u32; 3]>, sequences: Vec<Sequence>) -> Result<Self> {
        let Some(first) = sequences.first() else {
            return Err(Error::argument("layer set: no sequences, expected at least one"));
        };
        let vertices = first.clothing.len_of(Axis(1));
        let names: Vec<&String> = first.parameters.iter().map(|p| &p.0).collect();
        for sequence in &sequences {
            sequence.check(vertices)?;
            if !sequence.parameters.iter().map(|p| &p.0).eq(names.iter().copied()) {
                let message = format!(
                    "semantic parameters differ from {names:?}: all sequences of a set need the same"
                );
                return Err(Error::sequence(&sequence.name, message));
            }
        }
        let set = Self { faces, sequences, body: None };
        set.clothing(0, 0)?;
        Ok(set)
    }

    /// Number of clothing vertices.
    pub fn vertices(&self) -> usize {
        self.sequences.first().map_or(0, |sequence| sequence.clothing.len_of(Axis(1)))
    }

    /// Total number of frames.
    pub fn frames(&self) -> usize {
        self.sequences.iter().map(Sequence::frames).sum()
    }

    /// Names and values of the semantic parameters of all sequences, `[sequences, names]`: those of garment
    /// and material, and as `beta_1`, `beta_2` and so on the shape coefficients in which the sequences
    /// differ.
    pub fn semantic_parameters(&self) -> (Vec<String>, Array2<f64>) {
        let names = self.sequences.first().map_or(&[][..], |first| &first.parameters);
        let mut names: Vec<String> = names.iter().map(|(name, _)| name.clone()).collect();
        let given = names.len();
        let beta = |sequence: &Sequence, k: usize| sequence.betas.get(k).copied().unwrap_or(0.0);
        let most = self.sequences.iter().map(|sequence| sequence.betas.len()).max().unwrap_or(0);
        let differ = |&k: &usize| {
            self.sequences.iter().any(|other| beta(other, k) != beta(&self.sequences[0], k))
        };
        let betas: Vec<usize> = (0..most).filter(differ).collect();
        names.extend(betas.iter().map(|k| beta_name(*k)));
        let values = Array2::from_shape_fn((self.sequences.len(), names.len()), |(row, column)| {
            let sequence = &self.sequences[row];
            match column.checked_sub(given) {
                None => sequence.parameters[column].1,
                Some(k) => beta(sequence, betas[k]),
            }
        });
        (names, values)
    }

    /// Index of the sequence and of the frame in it for each frame of the set, in order, `[frames]`.
    pub fn each_frame(&self) -> Vec<(usize, usize)> {
        let frames = |(index, sequence): (usize, &Sequence)| {
            (0..sequence.frames()).map(move |frame| (index, frame)).collect::<Vec<_>>()
        };
        self.sequences.iter().enumerate().flat_map(frames).collect()
    }

    /// Clothing mesh of a frame.
    ///
    /// # Errors
    /// If there is no such frame, or the faces do not fit the vertices.
    pub fn clothing(&self, sequence: usize, frame: usize) -> Result<SurfaceMesh> {
        let clothing = self.sequences.get(sequence).filter(|s| frame < s.frames());
        let Some(clothing) = clothing else {
            return Err(Error::argument(format!(
                "layer set: no frame {frame} of sequence {sequence}"
            )));
        };
        let clothing = clothing.clothing.index_axis(Axis(0), frame);
        Ok(SurfaceMesh::new("clothing", points(clothing), self.faces.clone())?)
    }

    /// Writes `set.json` and one `<name>.npz` for each sequence, clothing in float32, into
    /// `directory`, which is created if it is missing. Each file is replaced atomically.
    ///
    /// # Errors
    /// If the directory or a file cannot be written.
    pub fn save(&self, directory: impl AsRef<Path>) -> Result<()> {
        let directory = directory.as_ref();
        std::fs::create_dir_all(directory)
            .map_err(|source| cape_core::Error::io(directory, source))?;
        for sequence in &self.sequences {
            write(directory, &self.faces, sequence)?;
        }
        let sequences = self.sequences.iter().map(Entry::from_sequence).collect();
        write_index(directory, &Index { body: self.body.clone(), sequences })
    }

    /// The set with the body that wears its clothing.
    #[must_use]
    pub fn with_body(self, body: BodyIdentity) -> Self {
        Self { body: Some(body), ..self }
    }

    /// Adds a sequence of clothing on `body` to the set in `directory`, in place of one with the same
    /// name; an empty or missing set is begun.
    ///
    /// # Errors
    /// If a file cannot be read or written, or the set is of another body.
    pub fn add(
        directory: impl AsRef<Path>,
        body: &BodyIdentity,
        faces: &[[u32; 3]],
        sequence: &Sequence,
    ) -> Result<()> {
        let directory = directory.as_ref();
        let mut index = if directory.join(INDEX).exists() {
            read_index(directory)?
        } else {
            Index { body: Some(body.clone()), sequences: Vec::new() }
        };
        if let Some(known) = &index.body
            && known.sha256 != body.sha256
        {
            return Err(Error::sequence(
                &sequence.name,
                format!(
                    "is of the body `{}`, but the set {} of `{}`: all sequences of a set need the same \
                     body",
                    body.name,
                    directory.display(),
                    known.name
                ),
            ));
        }
        write(directory, faces, sequence)?;
        index.sequences.retain(|entry| entry.name != sequence.name);
        index.sequences.push(Entry::from_sequence(sequence));
        write_index(directory, &index)
    }

    /// Reads a set that [`save`](Self::save) or [`add`](Self::add) wrote.
    ///
    /// # Errors
    /// If a file is missing or malformed, or as of [`new`](Self::new).
    pub fn load(directory: impl AsRef<Path>) -> Result<Self> {
        let directory = directory.as_ref();
        let index = read_index(directory)?;
        let mut all_faces: Option<Vec<[u32; 3]>> = None;
        let mut sequences = Vec::new();
        for entry in index.sequences {
            let (faces, sequence) = read(directory, entry)?;
            if all_faces.as_ref().is_some_and(|known| *known != faces) {
                let message = "faces differ from those of the sequences before: all sequences of a set \
                               must have the same topology";
                return Err(Error::sequence(&sequence.name, message));
            }
            all_faces = Some(faces);
            sequences.push(sequence);
        }
        let set = Self::new(all_faces.unwrap_or_default(), sequences)?;
        Ok(Self { body: index.body, ..set })
    }

    /// [`load`](Self::load) for sequences worn by `model`.
    ///
    /// # Errors
    /// As of `load`, or if the set is of another body.
    pub fn load_for(directory: impl AsRef<Path>, model: &SmplModel) -> Result<Self> {
        let directory = directory.as_ref();
        let set = Self::load(directory)?;
        if let Some(body) = &set.body {
            body.check(&directory.display().to_string(), model)?;
        }
        Ok(set)
    }
}

/// Name of the shape coefficient with index `k`, from 0, among semantic parameters.
pub(crate) fn beta_name(k: usize) -> String {
    format!("beta_{}", k + 1)
}

impl Entry {
    fn from_sequence(sequence: &Sequence) -> Self {
        Self {
            name: sequence.name.clone(),
            frame_rate: sequence.motion.frame_rate,
            parameters: sequence.parameters.clone(),
        }
    }
}

fn read_index(directory: &Path) -> Result<Index> {
    let path = directory.join(INDEX);
    let text = std::fs::read(&path).map_err(|source| cape_core::Error::io(&path, source))?;
    let index = serde_json::from_slice(&text).map_err(|error| {
        let message = format!("expected `sequences` of name, frame_rate and parameters: {error}");
        cape_core::Error::format(&path, message)
    })?;
    Ok(match index {
        AnyIndex::Present(index) => index,
        AnyIndex::Earlier(sequences) => Index { body: None, sequences },
    })
}

fn write_index(directory: &Path, index: &Index) -> Result<()> {
    let path = directory.join(INDEX);
    let text = serde_json::to_vec_pretty(index)
        .map_err(|error| cape_core::Error::format(&path, error.to_string()))?;
    Ok(write_atomically(path, |file| std::io::Write::write_all(file, &text))?)
}

fn write(directory: &Path, faces: &[[u32; 3]], sequence: &Sequence) -> Result<()> {
    let faces = Array2::from_shape_fn((faces.len(), 3), |(f, k)| i64::from(faces[f][k]));
    let mut file = NpzWriter::create(array_file(directory, &sequence.name))?;
    file.add("faces", &faces)?;
    file.add("clothing", &sequence.clothing.mapv(|x| x as f32))?;
    file.add("poses", &sequence.motion.poses)?;
    file.add("trans", &sequence.motion.translations)?;
    file.add("betas", &Array1::from_vec(sequence.betas.clone()))?;
    Ok(file.finish()?)
}

fn array_file(directory: &Path, name: &str) -> PathBuf {
    directory.join(format!("{name}.npz"))
}

fn read(directory: &Path, entry: Entry) -> Result<(Vec<[u32; 3]>, Sequence)> {
    let Entry { name, frame_rate, parameters } = entry;
    if name.contains(['/', '\\']) || name.starts_with('.') {
        return Err(Error::sequence(
            &name,
            "the name must not contain / or \\, nor begin with a dot: it is a file name",
        ));
    }
    let path = array_file(directory, &name);
    let mut file = Npz::open(&path)?;
    let faces = file.i64("faces")?;
    file.expect_shape("faces", faces.shape(), &[None, Some(3)])?;
    let corner = |&v: &i64| {
        u32::try_from(v).map_err(|error| cape_core::Error::field(&path, "faces", error.to_string()))
    };
    let corners: Vec<u32> = faces.iter().map(corner).collect::<Result<_, _>>()?;
    let faces = corners.as_chunks::<3>().0.to_vec();
    let clothing = file.f64("clothing")?;
    file.expect_shape("clothing", clothing.shape(), &[None, None, Some(3)])?;
    let clothing = clothing
        .into_dimensionality()
        .map_err(|error| cape_core::Error::field(&path, "clothing", error.to_string()))?;
    let (motion, betas) = motion_of(&mut file, frame_rate)?;
    Ok((faces, Sequence { name, clothing, betas, motion, parameters }))
}

/// Motion of the body at a frame rate, and its shape coefficients, of an archive of a set.
fn motion_of(file: &mut Npz, frame_rate: f64) -> Result<(BodyMotion, Vec<f64>)> {
    let mut table = |name: &str, columns: Option<usize>| -> Result<Array2<f64>> {
        let array = file.f64(name)?;
        file.expect_shape(name, array.shape(), &[None, columns])?;
        let path = file.path();
        Ok(array
            .into_dimensionality()
            .map_err(|error| cape_core::Error::field(path, name, error.to_string()))?)
    };
    let (poses, translations) = (table("poses", None)?, table("trans", Some(3))?);
    let betas = if file.contains("betas") {
        file.f64("betas")?.iter().copied().collect()
    } else {
        Vec::new()
    };
    expect_finite("betas", &betas)?;
    Ok((BodyMotion::new(frame_rate, poses, translations)?, betas))
}

#[cfg(test)]
mod tests {
    use cape_synth::synthetic_body;

    use super::*;

    fn sequence(name: &str) -> Sequence {
        let clothing =
            Array3::from_shape_fn((3, 4, 3), |(f, v, k)| (f + 2 * v + k * v) as f64 / 8.0);
        let motion = BodyMotion::new(30.0, Array2::zeros((3, 72)), Array2::zeros((3, 3))).unwrap();
        let parameters = vec![("length".to_owned(), 1.5)];
        Sequence { name: name.into(), clothing, betas: vec![0.5, -1.0], motion, parameters }
    }

    const FACES: [[u32; 3]; 2] = [[0, 1, 2], [0, 2, 3]];

    #[test]
    fn a_set_is_read_back() {
        let set = LayerSet::new(FACES.to_vec(), vec![sequence("a"), sequence("b")]).unwrap();
        let directory = tempfile::tempdir().unwrap();
        set.save(directory.path()).unwrap();
        assert_eq!(LayerSet::load(directory.path()).unwrap(), set);
        assert_eq!((set.frames(), set.vertices(), set.each_frame()[4]), (6, 4, (1, 1)));
        let grown = tempfile::tempdir().unwrap();
        let body = BodyIdentity::new("body", &synthetic_body());
        for name in ["b", "a", "b"] {
            LayerSet::add(grown.path(), &body, &FACES, &sequence(name)).unwrap();
        }
        assert_eq!(LayerSet::load(grown.path()).unwrap(), set.with_body(body));
    }

    #[test]
    fn inconsistent_sequences_are_refused() {
        let text = |sequences| LayerSet::new(FACES.to_vec(), sequences).unwrap_err().to_string();
        let mut other = sequence("b");
        other.clothing = Array3::zeros((3, 5, 3));
        assert!(text(vec![sequence("a"), other]).contains("`b`: clothing of 5 vertices"));
        let mut late = sequence("b");
        late.clothing = Array3::zeros((2, 4, 3));
        assert!(text(vec![sequence("a"), late]).contains("out of step"));
        let mut broken = sequence("b");
        broken.clothing[(1, 0, 0)] = f64::NAN;
        assert!(text(vec![broken]).contains("frame 1"));
        let mut unlike = sequence("b");
        unlike.parameters.clear();
        assert!(text(vec![sequence("a"), unlike]).contains("parameters"));
        assert!(text(vec![]).contains("no sequences"));
    }

    #[test]
    fn sets_record_their_body() {
        let model = synthetic_body();
        let body = BodyIdentity::new("SMPL_MALE.pkl", &model);
        let directory = tempfile::tempdir().unwrap();
        LayerSet::add(directory.path(), &body, &FACES, &sequence("a")).unwrap();
        let set = LayerSet::load_for(directory.path(), &model).unwrap();
        assert_eq!(set.body.as_ref(), Some(&body));
        set.save(directory.path()).unwrap();
        let mut other = model.clone();
        other.v_template[(0, 0)] += 1e-3;
        let message = LayerSet::load_for(directory.path(), &other).unwrap_err().to_string();
        assert!(message.contains("another body, `SMPL_MALE.pkl`"), "{message}");
        let other = BodyIdentity::new("other.npz", &other);
        let message = LayerSet::add(directory.path(), &other, &FACES, &sequence("b"))
            .unwrap_err()
            .to_string();
        assert!(message.contains("`other.npz`") && message.contains("same body"), "{message}");
        // Sets from before bodies were recorded.
        let index = std::fs::read(directory.path().join(INDEX)).unwrap();
        let index: serde_json::Value = serde_json::from_slice(&index).unwrap();
        let earlier = serde_json::to_vec(&index["sequences"]).unwrap();
        std::fs::write(directory.path().join(INDEX), earlier).unwrap();
        let set = LayerSet::load_for(directory.path(), &model).unwrap();
        assert_eq!((set.body, set.sequences.len()), (None, 1));
    }
}
