//! Reader of the geometry of `.glb` files: meshes of the scene at any time of its first animation,
//! with morph targets and skins. Materials, cameras and lights are skipped.

use std::path::{Path, PathBuf};

use glam::{Mat4, Vec3};
use serde_json::Value;

use super::{
    BINARY_CHUNK, JSON_CHUNK, MAGIC,
    accessor::Data,
    animation::{Animation, NodeState},
};
use crate::{Error, Result, mesh::is_face};

/// Largest number of vertices of a scene, which may show a mesh many times, for each byte of the
/// file.
const MOST_COPIES: usize = 2;
const POINTS: u64 = 0;
const TRIANGLES: u64 = 4;
const TRIANGLE_STRIP: u64 = 5;
const TRIANGLE_FAN: u64 = 6;

/// Meshes of the scene of a `.glb` file, as one mesh whose vertices may move.
///
/// ```
/// use cape_core::gltf::{self, GltfFile, Keyframe, SkinnedMesh};
/// use cape_synth::synthetic_body;
///
/// let body = synthetic_body();
/// let skinned = SkinnedMesh {
///     name: "rising",
///     body: &body,
///     rest: body.v_template.clone(),
///     joints: body.rest_joints(&body.v_template)?,
///     colours: None,
///     texture: None,
///     targets: Vec::new(),
/// };
/// let at = |time: f32| Keyframe {
///     time,
///     pose: vec![0.0; 72],
///     transl: [0.0, f64::from(time), 0.0],
///     offset: Some(ndarray::Array2::zeros((6890, 3))),
/// };
/// let bytes = gltf::encode(&skinned, &[at(0.0), at(1.0)])?;
/// let file = GltfFile::parse("rising.glb", bytes)?;
/// assert_eq!(file.faces()?.len(), 13776);
/// let rise = file.vertices(Some(0.25))?[0][1] - file.vertices(Some(0.0))?[0][1];
/// assert!((rise - 0.25).abs() < 1e-5);
/// # Ok::<(), cape_core::Error>(())
/// ```
#[derive(Debug)]
pub struct GltfFile {
    path: PathBuf,
    document: Value,
    binary: Vec<u8>,
    animation: Option<Animation>,
}

/// A mesh node of the scene and its primitive.
struct Part<'a> {
    node: usize,
    primitive: &'a Value,
}

impl GltfFile {
    /// Decodes a file in memory; errors name `path`.
    ///
    /// # Errors
    /// If the bytes are no complete `.glb` file of version 2, or need an extension that is not
    /// supported, such as compressed meshes.
    pub fn parse(path: impl AsRef<Path>, bytes: Vec<u8>) -> Result<Self> {
        let path = path.as_ref();
        let fault = |message: String| Error::format(path, format!("glTF: {message}"));
        let (document, binary) = chunks(&bytes).map_err(fault)?;
        check_extensions(&document).map_err(fault)?;
        let data = Data { document: &document, binary: &binary };
        let animation = Animation::first(&data).map_err(fault)?;
        Ok(Self { path: path.to_owned(), document, binary, animation })
    }

    /// Times of the first and last key of the animation, seconds, and the rate of its most densely
    /// sampled channel, keys per second; `None` without an animation.
    pub fn time_range(&self) -> Option<([f64; 2], f64)> {
        self.animation.as_ref().and_then(Animation::time_range)
    }

    /// Vertices of all meshes at a time of the animation, seconds, or as the scene is stored with
    /// `None`, metres, `[vertices, 3]`.
    ///
    /// # Errors
    /// If the content is malformed.
    pub fn vertices(&self, time: Option<f64>) -> Result<Vec<[f32; 3]>> {
        self.try_vertices(time).map_err(|message| self.fault(message))
    }

    /// Triangles of all meshes, `[faces, 3]`; those with two equal corners are left out.
    ///
    /// # Errors
    /// If the content is malformed.
    pub fn faces(&self) -> Result<Vec<[u32; 3]>> {
        self.try_faces().map_err(|message| self.fault(message))
    }

    fn fault(&self, message: String) -> Error {
        Error::format(&self.path, format!("glTF: {message}"))
    }

    fn data(&self) -> Data<'_> {
        Data { document: &self.document, binary: &self.binary }
    }

    fn try_faces(&self) -> Result<Vec<[u32; 3]>, String> {
        let data = self.data();
        let mut faces = Vec::new();
        let mut before = 0u32;
        for Part { primitive, .. } in self.parts()? {
            let count = position_count(&self.document, primitive)?;
            let indices = match primitive["indices"].as_u64() {
                Some(accessor) => data.indices(accessor)?,
                None => (0..count).collect(),
            };
            if let Some(index) = indices.iter().find(|&&index| index >= count) {
                return Err(format!("vertex {index} is out of range: the mesh has {count}"));
            }
            let found: Vec<[u32; 3]> = match primitive["mode"].as_u64().unwrap_or(TRIANGLES) {
                TRIANGLES => indices.as_chunks::<3>().0.to_vec(),
                TRIANGLE_STRIP => crate::mesh::strip(&indices).collect(),
                TRIANGLE_FAN => crate::mesh::fan(&indices).collect(),
                // Points and lines.
                _ => Vec::new(),
            };
            faces.extend(
                found
                    .into_iter()
                    .filter(|&face| is_face(face))
                    .map(|face| face.map(|v| v + before)),
            );
            before += count;
        }
        Ok(faces)
    }

    fn try_vertices(&self, time: Option<f64>) -> Result<Vec<[f32; 3]>, String> {
        let data = self.data();
        let states = self.states(time);
        let globals = self.globals(&states);
        let mut vertices = Vec::new();
        for Part { node, primitive } in self.parts()? {
            let attributes = &primitive["attributes"];
            let read = |accessor: &Value| -> Result<Vec<[f32; 3]>, String> {
                let accessor = accessor.as_u64().ok_or("a mesh without positions")?;
                data.rows(accessor)?.fixed("positions")
            };
            let mut positions = read(&attributes["POSITION"])?;
            let targets = primitive["targets"].as_array().map_or(&[][..], Vec::as_slice);
            for (target, &weight) in targets.iter().zip(&states[node].weights) {
                if weight == 0.0 || !target["POSITION"].is_u64() {
                    continue;
                }
                for (position, offset) in positions.iter_mut().zip(read(&target["POSITION"])?) {
                    *position = (Vec3::from(*position) + weight * Vec3::from(offset)).into();
                }
            }
            match self.document["nodes"][node]["skin"].as_u64() {
                None => {
                    let place = globals[node];
                    vertices.extend(
                        positions.iter().map(|&p| place.transform_point3(p.into()).to_array()),
                    );
                }
                Some(skin) => {
                    let joints =
                        self.joint_matrices(&self.document["skins"][skin as usize], &globals)?;
                    let moved = skinned(&data, attributes, &positions, &joints)?;
                    vertices.extend(moved);
                }
            }
        }
        Ok(vertices)
    }

    fn joint_matrices(&self, skin: &Value, globals: &[Mat4]) -> Result<Vec<Mat4>, String> {
        let joints = skin["joints"].as_array().ok_or("a skin without joints")?;
        let inverse: Vec<[f32; 16]> = match skin["inverseBindMatrices"].as_u64() {
            Some(accessor) => self.data().rows(accessor)?.fixed("inverse bind matrices")?,
            None => vec![Mat4::IDENTITY.to_cols_array(); joints.len()],
        };
        if inverse.len() < joints.len() {
            return Err(format!(
                "{} inverse bind matrices, expected {}",
                inverse.len(),
                joints.len()
            ));
        }
        let node = |joint: &Value| joint.as_u64().and_then(|joint| globals.get(joint as usize));
        let global = joints.iter().map(|joint| node(joint).ok_or("a joint is no node of the file"));
        global
            .zip(&inverse)
            .map(|(global, inverse)| Ok(*global? * Mat4::from_cols_array(inverse)))
            .collect()
    }

    /// Transforms and morph weights of all nodes.
    fn states(&self, time: Option<f64>) -> Vec<NodeState> {
        let nodes = self.nodes();
        let mut states: Vec<NodeState> = nodes
            .iter()
            .map(|node| {
                let mesh = node["mesh"]
                    .as_u64()
                    .map_or(&Value::Null, |mesh| &self.document["meshes"][mesh as usize]);
                NodeState::stored(node, mesh)
            })
            .collect();
        if let (Some(time), Some(animation)) = (time, &self.animation) {
            animation.apply(time, &mut states);
        }
        states
    }

    /// Transforms of all nodes to the scene.
    fn globals(&self, states: &[NodeState]) -> Vec<Mat4> {
        let mut globals = vec![Mat4::IDENTITY; states.len()];
        for (node, parent) in self.order() {
            let parent = parent.map_or(Mat4::IDENTITY, |parent| globals[parent]);
            globals[node] = parent * states[node].matrix();
        }
        globals
    }

    fn nodes(&self) -> &[Value] {
        self.document["nodes"].as_array().map_or(&[], Vec::as_slice)
    }

    /// Nodes of the scene with their parents, parents first. A node is visited once even if the
    /// file has it under several parents.
    fn order(&self) -> Vec<(usize, Option<usize>)> {
        let nodes = self.nodes();
        let numbers = |list: &Value| -> Vec<usize> {
            let all = list.as_array().map_or(&[][..], Vec::as_slice).iter();
            all.filter_map(Value::as_u64).map(|n| n as usize).filter(|&n| n < nodes.len()).collect()
        };
        let scene = self.document["scene"].as_u64().unwrap_or(0) as usize;
        let mut roots = numbers(&self.document["scenes"][scene]["nodes"]);
        if roots.is_empty() {
            let children: Vec<usize> =
                nodes.iter().flat_map(|node| numbers(&node["children"])).collect();
            roots = (0..nodes.len()).filter(|node| !children.contains(node)).collect();
        }
        let mut open: Vec<(usize, Option<usize>)> =
            roots.iter().rev().map(|&n| (n, None)).collect();
        let mut seen = vec![false; nodes.len()];
        let mut order = Vec::new();
        while let Some((node, parent)) = open.pop() {
            if std::mem::replace(&mut seen[node], true) {
                continue;
            }
            order.push((node, parent));
            open.extend(
                numbers(&nodes[node]["children"]).into_iter().rev().map(|n| (n, Some(node))),
            );
        }
        order
    }

    /// Primitives of the scene with triangles or points, in the order of the nodes.
    fn parts(&self) -> Result<Vec<Part<'_>>, String> {
        let mut parts = Vec::new();
        let mut total = 0usize;
        for (node, _) in self.order() {
            let Some(mesh) = self.nodes()[node]["mesh"].as_u64() else { continue };
            let primitives = self.document["meshes"][mesh as usize]["primitives"].as_array();
            for primitive in primitives.map_or(&[][..], Vec::as_slice) {
                let mode = primitive["mode"].as_u64().unwrap_or(TRIANGLES);
                if ![POINTS, TRIANGLES, TRIANGLE_STRIP, TRIANGLE_FAN].contains(&mode) {
                    continue;
                }
                total += position_count(&self.document, primitive)? as usize;
                if total > MOST_COPIES * self.binary.len() {
                    return Err(format!("{total} vertices in the scene, too many for its size"));
                }
                parts.push(Part { node, primitive });
            }
        }
        if parts.is_empty() {
            return Err("the scene has no mesh".into());
        }
        Ok(parts)
    }
}

/// Positions moved by the weighted matrices of the joints of their skin.
fn skinned(
    data: &Data,
    attributes: &Value,
    positions: &[[f32; 3]],
    matrices: &[Mat4],
) -> Result<Vec<[f32; 3]>, String> {
    let mut sums = vec![(Vec3::ZERO, 0.0f32); positions.len()];
    for set in 0.. {
        let part = |name: &str| attributes[format!("{name}_{set}")].as_u64();
        let (Some(joints), Some(weights)) = (part("JOINTS"), part("WEIGHTS")) else { break };
        let joints: Vec<[f32; 4]> = data.rows(joints)?.fixed("joints")?;
        let weights: Vec<[f32; 4]> = data.rows(weights)?.fixed("weights")?;
        if joints.len() != positions.len() || weights.len() != positions.len() {
            return Err("joints or weights are not as many as positions".into());
        }
        for (vertex, sum) in sums.iter_mut().enumerate() {
            let position = Vec3::from(positions[vertex]);
            for (joint, weight) in joints[vertex].into_iter().zip(weights[vertex]) {
                if weight == 0.0 {
                    continue;
                }
                let matrix = matrices.get(joint as usize).ok_or("a vertex of an unknown joint")?;
                sum.0 += weight * matrix.transform_point3(position);
                sum.1 += weight;
            }
        }
    }
    let place = |(sum, weight): (Vec3, f32)| if weight > 0.0 { sum / weight } else { sum };
    Ok(sums.into_iter().map(|sum| place(sum).to_array()).collect())
}

fn position_count(document: &Value, primitive: &Value) -> Result<u32, String> {
    if primitive["extensions"]["KHR_draco_mesh_compression"].is_object() {
        let accessor = primitive["attributes"]["POSITION"].as_u64().unwrap_or(0) as usize;
        if !document["accessors"][accessor]["bufferView"].is_u64() {
            return Err(compressed("KHR_draco_mesh_compression"));
        }
    }
    let accessor =
        primitive["attributes"]["POSITION"].as_u64().ok_or("a mesh without positions")?;
    let count = document["accessors"][accessor as usize]["count"].as_u64();
    count
        .and_then(|count| u32::try_from(count).ok())
        .ok_or_else(|| format!("accessor {accessor}: no valid count"))
}

fn check_extensions(document: &Value) -> Result<(), String> {
    let required = document["extensionsRequired"].as_array().map_or(&[][..], Vec::as_slice);
    for name in required.iter().filter_map(Value::as_str) {
        if name.contains("draco") || name.contains("meshopt") {
            return Err(compressed(name));
        }
        let harmless =
            ["KHR_materials", "KHR_texture", "EXT_texture", "KHR_lights", "KHR_mesh_quantization"];
        if !harmless.iter().any(|start| name.starts_with(start)) {
            return Err(format!("needs the extension {name}, which is not supported"));
        }
    }
    Ok(())
}

fn compressed(name: &str) -> String {
    format!("its meshes are compressed ({name}): export it again without compression")
}

/// JSON document and binary chunk of a `.glb` file.
fn chunks(bytes: &[u8]) -> Result<(Value, Vec<u8>), String> {
    let word = |at: usize| -> Option<u32> {
        Some(u32::from_le_bytes(bytes.get(at..at.checked_add(4)?)?.try_into().ok()?))
    };
    if word(0) != Some(MAGIC) {
        return Err("not a .glb file (its first bytes are not glTF)".into());
    }
    let version = word(4).unwrap_or(0);
    if version != 2 {
        return Err(format!("version {version}, expected 2"));
    }
    let (mut document, mut binary) = (None, Vec::new());
    let mut at = 12usize;
    while let (Some(length), Some(kind)) = (word(at), word(at + 4)) {
        let end = (at + 8).checked_add(length as usize);
        let chunk = end.and_then(|end| bytes.get(at + 8..end)).ok_or_else(|| {
            let left = bytes.len() - at - 8;
            format!("incomplete: a part of {length} bytes, but {left} follow")
        })?;
        match kind {
            JSON_CHUNK if document.is_none() => {
                let parsed =
                    serde_json::from_slice(chunk).map_err(|error| format!("JSON: {error}"))?;
                document = Some(parsed);
            }
            BINARY_CHUNK if binary.is_empty() => chunk.clone_into(&mut binary),
            _ => {}
        }
        at += 8 + length as usize;
    }
    Ok((document.ok_or("no JSON part")?, binary))
}
