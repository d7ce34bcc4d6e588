//! Sequences of meshes of one topology: directories of meshes, point caches, arrays, animated glTF.

#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};

use glam::{DAffine3, DVec3};
use ndarray::{Array2, Array3, ArrayD, ArrayView2, Axis, Ix3, s};

use crate::{
    Error, MESH_EXTENSIONS, Mesh, PointCache, Result, expect_finite,
    gltf::GltfFile,
    list_files,
    mesh::{places, read_bytes},
    npy::{Npz, read_f64},
    pickle::Pickle,
};

/// Names of the array of vertices in archives and pickles, and of that of triangles.
const VERTEX_ARRAYS: [&str; 6] =
    ["vertices", "clothing", "verts", "positions", "garment", "points"];
const FACE_ARRAYS: [&str; 3] = ["faces", "f", "triangles"];
/// Largest number of frames that an animation is sampled at or a sequence is resampled to.
const MOST_FRAMES: f64 = 1e6;

/// Choices in reading a [`MeshSequence`].
#[derive(Debug, Clone, Default, PartialEq)]
pub struct MeshSequenceOptions {
    /// Mesh with the triangles of a file that has none (point caches, `.npy`); without it, the
    /// mesh with the name of the file and an extension of a mesh is taken.
    pub topology: Option<PathBuf>,
    /// Pattern of the file names of a directory, with `*` for any characters and `?` for one;
    /// without it, all meshes are read.
    pub files: Option<String>,
    /// Frames per second at which an animated `.glb` is sampled, if not at that of its keys.
    pub frame_rate: Option<f64>,
}

/// Meshes of one topology over time.
///
/// ```
/// use cape_core::{Mesh, MeshSequence, MeshSequenceOptions};
///
/// let directory = tempfile::tempdir()?;
/// for frame in 1..=10u8 {
///     let vertices = vec![[f32::from(frame), 0., 0.], [1., 0., 0.], [0., 1., 0.]];
///     let mesh = Mesh { vertices, faces: vec![[0, 1, 2]] };
///     mesh.save(directory.path().join(format!("frame{frame}.obj")))?;
/// }
/// // In natural order: frame2 comes before frame10.
/// let sequence = MeshSequence::read(directory.path(), &MeshSequenceOptions::default())?;
/// assert_eq!(sequence.positions.dim(), (10, 3, 3));
/// assert_eq!(sequence.positions[(9, 0, 0)], 10.0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct MeshSequence {
    /// Triangles, `[faces, 3]`.
    pub faces: Vec<[u32; 3]>,
    /// Positions of the vertices in the unit of the files, `[frames, vertices, 3]`.
    pub positions: Array3<f64>,
    /// Frames per second, if the file says it.
    pub frame_rate: Option<f64>,
}

impl MeshSequence {
    /// Reads a directory of meshes in natural order of their names; a point cache (`.pc2`, `.pc16`,
    /// `.mdd`) or `.npy` array `[frames, vertices, 3]` with its mesh; an `.npz` archive or pickle with
    /// `vertices` and `faces`; or an animated `.glb`.
    ///
    /// # Errors
    /// If a file cannot be read, the topology changes, or a number is not finite.
    pub fn read(path: impl AsRef<Path>, options: &MeshSequenceOptions) -> Result<Self> {
        let path = path.as_ref();
        let is =
            |name: &str| path.extension().is_some_and(|found| found.eq_ignore_ascii_case(name));
        let sequence = if path.is_dir() {
            from_directory(path, options)?
        } else if ["pc2", "pc16", "mdd"].into_iter().any(is) {
            let PointCache { positions, frame_rate } = PointCache::read(path)?;
            let positions = positions.mapv(f64::from);
            Self { faces: topology(path, options, positions.dim().1)?, positions, frame_rate }
        } else if is("npy") {
            let positions = three_axes(path, "array", read_f64(path)?)?;
            let faces = topology(path, options, positions.dim().1)?;
            Self { faces, positions, frame_rate: None }
        } else if is("npz") {
            from_archive(path, options)?
        } else if is("pkl") || is("pickle") {
            from_pickle(path, options)?
        } else if is("glb") {
            from_gltf(path, options)?
        } else {
            return Err(Error::format(
                path,
                "expected a directory of meshes, or a .pc2, .pc16, .mdd, .npz, .npy, .pkl or .glb file",
            ));
        };
        sequence.check(path)?;
        Ok(sequence)
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.positions.len_of(Axis(0))
    }

    /// The sequence with every position moved by `place`, a change of axes and unit for example.
    #[must_use]
    pub fn moved(mut self, place: DAffine3) -> Self {
        for mut row in self.positions.rows_mut() {
            let moved = place.transform_point3(DVec3::new(row[0], row[1], row[2]));
            row.assign(&ndarray::aview1(&moved.to_array()));
        }
        self
    }

    /// The sequence with each frame moved by its row of `translations`, in the unit of the files,
    /// `[frames, 3]`.
    ///
    /// # Errors
    /// If the number of frames differs.
    pub fn translated(mut self, translations: ArrayView2<f64>) -> Result<Self> {
        if translations.dim() != (self.frames(), 3) {
            return Err(Error::argument(format!(
                "translations {:?} for meshes of {} frames, expected one for each",
                translations.shape(),
                self.frames()
            )));
        }
        for (mut frame, place) in self.positions.outer_iter_mut().zip(translations.rows()) {
            frame += &place;
        }
        Ok(self)
    }

    /// The sequence, of frames at `from` per second, at `to` frames per second, with positions
    /// interpolated linearly. The first frame is kept; the last is kept if it falls on a new frame.
    ///
    /// # Errors
    /// If a rate is not positive, or there would be more than a million frames.
    pub fn resampled(&self, from: f64, to: f64) -> Result<Self> {
        for rate in [from, to] {
            if !(rate.is_finite() && rate > 0.0) {
                return Err(Error::argument(format!(
                    "frame rate {rate}: expected a positive number"
                )));
            }
        }
        if (from - to).abs() < 1e-9 * to || self.frames() < 2 {
            return Ok(Self { frame_rate: Some(to), ..self.clone() });
        }
        let last = self.frames() - 1;
        // Rounding must not lose the last frame.
        let count = (last as f64 * to / from + 1e-6).floor();
        if count >= MOST_FRAMES {
            return Err(Error::argument(format!(
                "{to} frames per second of {} s: more than a million frames",
                last as f64 / from
            )));
        }
        let (_, vertices, _) = self.positions.dim();
        let mut positions = Array3::zeros((count as usize + 1, vertices, 3));
        for (frame, mut new) in positions.outer_iter_mut().enumerate() {
            let at = frame as f64 * from / to;
            let before = (at.floor() as usize).min(last - 1);
            let share = (at - before as f64).min(1.0);
            new.assign(&self.positions.index_axis(Axis(0), before));
            new *= 1.0 - share;
            new.scaled_add(share, &self.positions.index_axis(Axis(0), before + 1));
        }
        Ok(Self { faces: self.faces.clone(), positions, frame_rate: Some(to) })
    }

    fn check(&self, path: &Path) -> Result<()> {
        let (frames, vertices, axes) = self.positions.dim();
        if frames == 0 || vertices == 0 || axes != 3 {
            let shape = self.positions.shape();
            let message = format!("vertices of shape {shape:?}, expected [frames, vertices, 3]");
            return Err(Error::format(path, message));
        }
        if let Some(face) = self.faces.iter().find(|f| f.iter().any(|&v| v as usize >= vertices)) {
            let message = format!("face {face:?} is out of range for {vertices} vertices");
            return Err(Error::format(path, message));
        }
        for (frame, positions) in self.positions.outer_iter().enumerate() {
            expect_finite(format!("{}: frame {frame}", path.display()), positions)?;
        }
        Ok(())
    }
}

fn from_directory(path: &Path, options: &MeshSequenceOptions) -> Result<MeshSequence> {
    let wanted = |file: &Path| {
        let name = file.file_name().unwrap_or_default().to_string_lossy();
        let mesh = file.extension().is_some_and(|extension| {
            MESH_EXTENSIONS.iter().any(|known| extension.eq_ignore_ascii_case(known))
        });
        mesh && options.files.as_ref().is_none_or(|pattern| matches(pattern, &name))
    };
    let paths = list_files(path, wanted)?;
    let mut found: Option<MeshSequence> = None;
    for (frame, file) in paths.iter().enumerate() {
        let mesh = Mesh::load(file)?;
        let sequence = found.get_or_insert_with(|| MeshSequence {
            faces: mesh.faces.clone(),
            positions: Array3::zeros((paths.len(), mesh.vertices.len(), 3)),
            frame_rate: None,
        });
        let vertices = sequence.positions.dim().1;
        if mesh.faces != sequence.faces || mesh.vertices.len() != vertices {
            return Err(Error::format(
                file,
                format!(
                    "{} vertices and other faces than in the frames before ({vertices} vertices): all \
                     frames must have the same topology; if the directory has several sequences, \
                     choose one by a pattern of its file names",
                    mesh.vertices.len()
                ),
            ));
        }
        let mut rows = sequence.positions.slice_mut(s![frame, .., ..]);
        for (mut row, vertex) in rows.rows_mut().into_iter().zip(&mesh.vertices) {
            row.assign(&ndarray::aview1(&vertex.map(f64::from)));
        }
    }
    found.ok_or_else(|| {
        let named = match &options.files {
            Some(pattern) => format!(" named `{pattern}`"),
            None => String::new(),
        };
        Error::format(
            path,
            format!(
                "no meshes{named} (.{}), expected one for each frame",
                MESH_EXTENSIONS.join(", .")
            ),
        )
    })
}

/// Triangles for the points of `path`.
fn topology(path: &Path, options: &MeshSequenceOptions, points: usize) -> Result<Vec<[u32; 3]>> {
    let beside =
        || MESH_EXTENSIONS.iter().map(|name| path.with_extension(name)).find(|file| file.exists());
    let Some(file) = options.topology.clone().or_else(beside) else {
        return Err(Error::format(
            path,
            "has no triangles: give a mesh of the same vertices, or put one of the same name beside it",
        ));
    };
    let mesh = Mesh::load(&file)?;
    if mesh.vertices.len() != points {
        return Err(Error::format(
            path,
            format!(
                "{points} points, but {} has {} vertices: they must be the same, in the same order",
                file.display(),
                mesh.vertices.len()
            ),
        ));
    }
    Ok(mesh.faces)
}

fn from_archive(path: &Path, options: &MeshSequenceOptions) -> Result<MeshSequence> {
    let mut archive = Npz::open(path)?;
    let first = |names: &[&'static str], archive: &Npz| {
        names.iter().copied().find(|name| archive.contains(name))
    };
    let Some(name) = first(&VERTEX_ARRAYS, &archive) else {
        return Err(lacks_vertices(path, &archive.names()));
    };
    let positions = three_axes(path, name, archive.f64(name)?)?;
    let faces = match first(&FACE_ARRAYS, &archive) {
        Some(name) => faces(path, name, archive.get::<u32>(name)?)?,
        None => topology(path, options, positions.dim().1)?,
    };
    let rate = ["mocap_frame_rate", "mocap_framerate", "fps"]
        .into_iter()
        .find(|name| archive.contains(name));
    let frame_rate = rate.map(|name| archive.f64(name)).transpose()?;
    let frame_rate = frame_rate.and_then(|array| array.first().copied());
    Ok(MeshSequence { faces, positions, frame_rate })
}

/// A simulated sequence of the VTO data set: `vertices` and `faces` beside the body's parameters.
fn from_pickle(path: &Path, options: &MeshSequenceOptions) -> Result<MeshSequence> {
    let pickle = Pickle::open(path)?;
    let root = pickle.root();
    let first =
        |names: &[&'static str]| names.iter().copied().find(|name| root.get(name).is_some());
    let Some(name) = first(&VERTEX_ARRAYS) else {
        return Err(lacks_vertices(path, &root.keys()));
    };
    let positions = three_axes(path, name, root.require(name)?.array()?)?;
    let faces = match first(&FACE_ARRAYS) {
        Some(name) => faces(path, name, root.require(name)?.array::<u32>()?)?,
        None => topology(path, options, positions.dim().1)?,
    };
    Ok(MeshSequence { faces, positions, frame_rate: None })
}

fn from_gltf(path: &Path, options: &MeshSequenceOptions) -> Result<MeshSequence> {
    let file = GltfFile::parse(path, read_bytes(path)?)?;
    let Some(([first, last], keys)) = file.time_range() else {
        return Err(Error::format(path, "no animation, expected one"));
    };
    let rate = options.frame_rate.unwrap_or(keys);
    if !(rate.is_finite() && rate > 0.0) {
        return Err(Error::format(path, "the animation has a single time: give the frame rate"));
    }
    let count = ((last - first) * rate + 1e-3).floor();
    if count >= MOST_FRAMES {
        return Err(Error::format(path, format!("{count} frames, expected at most a million")));
    }
    let times = (0..=count as usize).map(|frame| first + frame as f64 / rate);
    let frames = times.map(|time| file.vertices(Some(time))).collect::<Result<Vec<_>>>()?;
    // Vertices that glTF keeps apart for their normals and texture coordinates.
    let (kept, number) = places(&frames);
    let renamed = file.faces()?.into_iter().map(|face| face.map(|v| number[v as usize]));
    let faces = renamed.filter(|&face| crate::mesh::is_face(face)).collect();
    let positions =
        Array3::from_shape_fn((frames.len(), kept.len(), 3), |(frame, vertex, axis)| {
            f64::from(frames[frame][kept[vertex]][axis])
        });
    Ok(MeshSequence { faces, positions, frame_rate: Some(rate) })
}

fn lacks_vertices(path: &Path, names: &[String]) -> Error {
    Error::format(
        path,
        format!(
            "no array of vertices [frames, vertices, 3] (expected {}); it has {}",
            VERTEX_ARRAYS.join(", "),
            names.join(", ")
        ),
    )
}

fn three_axes(path: &Path, name: &str, array: ArrayD<f64>) -> Result<Array3<f64>> {
    let shape = array.shape().to_vec();
    array.into_dimensionality::<Ix3>().map_err(|_| {
        Error::field(path, name, format!("shape {shape:?}, expected [frames, vertices, 3]"))
    })
}

fn faces(path: &Path, name: &str, array: ArrayD<u32>) -> Result<Vec<[u32; 3]>> {
    let shape = array.shape().to_vec();
    let table: Array2<u32> = array
        .into_dimensionality()
        .ok()
        .filter(|table: &Array2<u32>| table.ncols() == 3)
        .ok_or_else(|| Error::field(path, name, format!("shape {shape:?}, expected [faces, 3]")))?;
    Ok(table.rows().into_iter().map(|row| [row[0], row[1], row[2]]).collect())
}

/// True if `name` fits `pattern`, in which `*` stands for any characters and `?` for one.
fn matches(pattern: &str, name: &str) -> bool {
    let (pattern, name): (Vec<char>, Vec<char>) =
        (pattern.chars().collect(), name.chars().collect());
    let (mut p, mut n) = (0, 0);
    // Position after the last `*` and the part of the name that it takes.
    let mut star: Option<(usize, usize)> = None;
    while n < name.len() {
        match pattern.get(p) {
            Some('*') => {
                star = Some((p + 1, n));
                p += 1;
            }
            Some(&c) if c == '?' || c == name[n] => {
                (p, n) = (p + 1, n + 1);
            }
            _ => match star {
                Some((after, taken)) => {
                    star = Some((after, taken + 1));
                    (p, n) = (after, taken + 1);
                }
                None => return false,
            },
        }
    }
    pattern[p..].iter().all(|&c| c == '*')
}
