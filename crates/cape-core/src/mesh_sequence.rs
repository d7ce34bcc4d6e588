//! Sequences of meshes of one topology: directories of meshes, point caches, arrays, animated glTF.

use std::path::{Path, PathBuf};

use glam::{DAffine3, DVec3};
use ndarray::{Array2, Array3, ArrayD, Axis, Ix3, s};

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        PointCacheFormat, PointCacheWriter,
        gltf::{self, Keyframe, SkinnedMesh},
        npy::{NpzWriter, write_npy},
        smpl::test_model::random_model,
    };

    const FACES: [[u32; 3]; 2] = [[0, 1, 2], [0, 2, 3]];

    fn mesh(frame: usize) -> Mesh {
        let square = [[0.0f32, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        let vertices = square.iter().map(|&[x, y]| [x, y, frame as f32 / 4.0]).collect();
        Mesh { vertices, faces: FACES.to_vec() }
    }

    fn read(path: &Path) -> Result<MeshSequence> {
        MeshSequence::read(path, &MeshSequenceOptions::default())
    }

    #[test]
    fn directories_are_read_in_natural_order_without_hidden_files() {
        let place = tempfile::tempdir().unwrap();
        // Without leading zeros, among the files of a second sequence and of a file manager.
        for frame in 0..12 {
            mesh(frame).save(place.path().join(format!("f{frame}_cloth.obj"))).unwrap();
            let body = Mesh { vertices: vec![[0.0; 3]; 3], faces: vec![[0, 1, 2]] };
            body.save(place.path().join(format!("f{frame}_body.obj"))).unwrap();
        }
        std::fs::write(place.path().join("._f3_cloth.obj"), b"\0\x05\x16\x07").unwrap();
        let options =
            MeshSequenceOptions { files: Some("*_cloth.obj".into()), ..Default::default() };
        let found = MeshSequence::read(place.path(), &options).unwrap();
        assert_eq!((found.faces.as_slice(), found.positions.dim()), (&FACES[..], (12, 4, 3)));
        for frame in 0..12 {
            assert_eq!(found.positions[(frame, 2, 2)], frame as f64 / 4.0);
        }
        let both = read(place.path()).unwrap_err().to_string();
        assert!(both.contains("pattern of its file names"), "{both}");
        let none = MeshSequenceOptions { files: Some("x*".into()), ..Default::default() };
        let none = MeshSequence::read(place.path(), &none).unwrap_err().to_string();
        assert!(none.contains("no meshes named `x*`"), "{none}");
    }

    #[test]
    fn caches_and_arrays_take_the_triangles_of_a_mesh() {
        let place = tempfile::tempdir().unwrap();
        let at = |name: &str| place.path().join(name);
        let expected = Array3::from_shape_fn((3, 4, 3), |(frame, vertex, axis)| {
            f64::from(mesh(frame).vertices[vertex][axis])
        });
        for (name, format) in [("a.pc2", PointCacheFormat::Pc2), ("a.mdd", PointCacheFormat::Mdd)] {
            let mut cache = PointCacheWriter::create(at(name), format, [3, 4], 25.0).unwrap();
            for frame in 0..3 {
                cache.push(&mesh(frame).vertices).unwrap();
            }
            cache.finish().unwrap();
        }
        write_npy(at("a.npy"), &expected).unwrap();
        let alone = read(&at("a.pc2")).unwrap_err().to_string();
        assert!(alone.contains("has no triangles"), "{alone}");
        mesh(0).save(at("a.obj")).unwrap();
        for (name, rate) in [("a.pc2", None), ("a.mdd", Some(25.0)), ("a.npy", None)] {
            let found = read(&at(name)).unwrap();
            assert_eq!(
                (found.faces.as_slice(), &found.positions),
                (&FACES[..], &expected),
                "{name}"
            );
            assert_eq!(found.frame_rate.map(|rate| (1e3 * rate).round() / 1e3), rate, "{name}");
        }
        let mut few = mesh(0);
        few.vertices.pop();
        few.faces.pop();
        few.save(at("few.ply")).unwrap();
        let options = MeshSequenceOptions { topology: Some(at("few.ply")), ..Default::default() };
        let other = MeshSequence::read(at("a.pc2"), &options).unwrap_err().to_string();
        assert!(other.contains("4 points, but") && other.contains("has 3 vertices"), "{other}");
    }

    #[test]
    fn archives_hold_vertices_and_faces() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("a.npz");
        let positions = Array3::from_shape_fn((2, 4, 3), |(f, v, k)| (f + v + k) as f64);
        let mut archive = NpzWriter::create(&path).unwrap();
        archive.add("vertices", &positions).unwrap();
        archive.add("faces", &Array2::from(vec![[0i64, 1, 2], [0, 2, 3]])).unwrap();
        archive.add("fps", &ndarray::arr1(&[50.0])).unwrap();
        archive.finish().unwrap();
        let found = read(&path).unwrap();
        assert_eq!((found.faces.as_slice(), found.frame_rate), (&FACES[..], Some(50.0)));
        assert_eq!(found.positions, positions);
        let mut archive = NpzWriter::create(&path).unwrap();
        archive.add("poses", &Array2::<f64>::zeros((2, 72))).unwrap();
        archive.finish().unwrap();
        let message = read(&path).unwrap_err().to_string();
        assert!(
            message.contains("expected vertices, clothing") && message.contains("it has poses")
        );
    }

    #[test]
    fn animated_gltf_is_sampled() {
        let body = random_model();
        let skinned = SkinnedMesh {
            name: "moving",
            body: &body,
            rest: body.v_template.clone(),
            joints: body.rest_joints(&body.v_template).unwrap(),
            colours: None,
            texture: None,
            targets: Vec::new(),
        };
        let size = 3 * body.joints();
        let pose = |step: usize| -> Vec<f64> {
            (0..size).map(|k| 0.3 * ((k + step) as f64).sin()).collect()
        };
        let clothing = |step: usize| {
            Array2::from_shape_fn(body.v_template.dim(), |(v, k)| 0.01 * (v * k * step) as f64)
        };
        let transl = |step: usize| [0.5 * step as f64, 0.0, 1.0];
        let keyframe = |step: usize| Keyframe {
            time: step as f32 / 10.0,
            pose: pose(step),
            transl: transl(step),
            offset: Some(body.pose_offsets(&pose(step)).unwrap() + clothing(step)),
        };
        let keyframes: Vec<Keyframe> = (0..3).map(keyframe).collect();
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("a.glb");
        gltf::write(&path, &skinned, &keyframes).unwrap();
        let found = read(&path).unwrap();
        assert_eq!((found.frames(), found.faces.clone()), (3, body.faces.clone()));
        assert!((found.frame_rate.unwrap() - 10.0).abs() < 1e-4);
        for step in 0..3 {
            let clothing = clothing(step);
            let posed = body
                .pose_shape(&body.v_template, &pose(step), transl(step), Some(&clothing))
                .unwrap();
            let frame = found.positions.index_axis(Axis(0), step);
            for (a, b) in frame.iter().zip(&posed.vertices) {
                assert!((a - b).abs() < 1e-4, "frame {step}: {a} {b}");
            }
        }
        let options = MeshSequenceOptions { frame_rate: Some(20.0), ..Default::default() };
        assert_eq!(MeshSequence::read(&path, &options).unwrap().frames(), 5);
        gltf::write(&path, &skinned, &keyframes[..1]).unwrap();
        assert!(read(&path).unwrap_err().to_string().contains("no animation"));
    }

    #[test]
    fn sequences_are_resampled_and_moved() {
        let positions = Array3::from_shape_fn((5, 2, 3), |(f, v, k)| (f * f + v + k) as f64);
        let sequence = MeshSequence { faces: Vec::new(), positions, frame_rate: None };
        let half = sequence.resampled(20.0, 10.0).unwrap();
        assert_eq!((half.frames(), half.positions[(1, 0, 0)]), (3, 4.0));
        let double = sequence.resampled(20.0, 40.0).unwrap();
        assert_eq!((double.frames(), double.positions[(3, 0, 0)]), (9, 2.5));
        assert!(sequence.resampled(0.0, 30.0).is_err());
        assert!(sequence.resampled(1e-6, 1e6).is_err());
        let place = DAffine3::from_scale(DVec3::splat(0.01));
        assert_eq!(sequence.moved(place).positions[(4, 1, 2)], 0.19);
    }

    #[test]
    fn patterns_of_file_names() {
        for (pattern, name, fits) in [
            ("*", "", true),
            ("a*.obj", "a.obj", true),
            ("a*.obj", "ab.c.obj", true),
            ("a?.obj", "a.obj", false),
            ("*_cloth*", "f1_cloth.ply", true),
            ("*a*b", "aab", true),
            ("*a*b", "aabc", false),
            ("", "a", false),
        ] {
            assert_eq!(matches(pattern, name), fits, "{pattern} {name}");
        }
    }
}
