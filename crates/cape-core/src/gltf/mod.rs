//! glTF 2.0 binary files (`.glb`) of skinned, animated bodies. [`GltfFile`] reads the meshes of any
//! such file.
//!
//! A [`SkinnedMesh`] is a clothed body with SMPL's skeleton and blend weights, [`Keyframe`]s are its
//! poses. Pose blend shapes and pose-dependent clothing, which skinning cannot express, are stored
//! as one morph target for each keyframe that has vertex offsets. Such a keyframe shows exactly the
//! vertices that this library computes; between them the offsets are interpolated. Units are metres, seconds and radians; y points up.

mod accessor;
mod animation;
mod buffer;
mod read;
pub(crate) mod skin;
#[cfg(test)]
mod tests;

use std::{io::Write, path::Path};

use glam::{DQuat, DVec3};
use ndarray::Array2;
use serde_json::{Value, json};

use crate::{Error, Mesh, Result, SmplModel, joints, obj::Uv, write_atomically};
use buffer::{Buffer, Target};

pub use read::GltfFile;
pub use skin::{JointInfluences, joint_influences};

const MAGIC: u32 = 0x4654_6c67;
const JSON_CHUNK: u32 = 0x4e4f_534a;
const BINARY_CHUNK: u32 = 0x004e_4942;

/// Clothed body in the rest pose with its skeleton, blend weights and appearance.
///
/// ```
/// use cape_core::gltf::{self, SkinnedMesh, Keyframe};
/// use cape_synth::synthetic_body;
///
/// let body = synthetic_body();
/// let rest = body.rest_shape(&[1.0])?;
/// let skinned = SkinnedMesh {
///     name: "waving",
///     body: &body,
///     joints: body.rest_joints(&rest)?,
///     rest,
///     colours: None,
///     texture: None,
///     targets: Vec::new(),
/// };
/// let keyframe = |time: f32, angle: f64| -> cape_core::Result<Keyframe> {
///     let mut pose = vec![0.0; 72];
///     pose[3 * 16 + 2] = angle;
///     let offset = body.pose_offsets(&pose)?;
///     Ok(Keyframe { time, pose, transl: [0.0; 3], offset: Some(offset) })
/// };
/// let file = gltf::encode(&skinned, &[keyframe(0.0, 0.0)?, keyframe(0.5, 1.2)?])?;
/// assert_eq!(&file[..4], b"glTF");
/// // Times must increase.
/// assert!(gltf::encode(&skinned, &[keyframe(0.5, 0.0)?, keyframe(0.0, 1.2)?]).is_err());
/// # Ok::<(), cape_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct SkinnedMesh<'a> {
    /// Name of the mesh in the file.
    pub name: &'a str,
    /// Skeleton, blend weights and triangles.
    pub body: &'a SmplModel,
    /// Clothed rest vertices, `T̄ + B_S(β) + S_clo`, metres, `[V, 3]`.
    pub rest: Array2<f64>,
    /// Rest joints, metres, `[J, 3]`.
    pub joints: Array2<f64>,
    /// sRGB vertex colours, 0 to 1, `[V, 3]`.
    pub colours: Option<&'a [[f32; 3]]>,
    /// Texture coordinates and image.
    pub texture: Option<GltfTexture<'a>>,
    /// Additional named morph targets of weight 0, such as shape directions: offsets of the rest
    /// vertices, metres, `[V, 3]`.
    pub targets: Vec<(String, Array2<f64>)>,
}

/// Texture of a body: coordinates and image.
///
/// ```
/// use cape_core::{gltf::{self, SkinnedMesh, GltfTexture}, obj::Uv};
/// use cape_synth::synthetic_body;
///
/// let body = synthetic_body();
/// let uv = Uv { coordinates: vec![[0.5, 0.5]], faces: vec![[0; 3]; body.faces.len()] };
/// let skinned = SkinnedMesh {
///     name: "textured",
///     body: &body,
///     rest: body.v_template.clone(),
///     joints: body.rest_joints(&body.v_template)?,
///     colours: None,
///     texture: Some(GltfTexture { uv: &uv, image: None }),
///     targets: Vec::new(),
/// };
/// let file = gltf::encode(&skinned, &[])?;
/// assert!(String::from_utf8_lossy(&file).contains("TEXCOORD_0"));
/// # Ok::<(), cape_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy)]
pub struct GltfTexture<'a> {
    /// Texture coordinates of the body's face corners.
    pub uv: &'a Uv,
    /// Bytes of a PNG or JPEG file.
    pub image: Option<&'a [u8]>,
}

/// Pose, translation and vertex offsets of a body at one time of an animation.
#[derive(Debug, Clone)]
pub struct Keyframe {
    /// Time, seconds.
    pub time: f32,
    /// Pose in axis-angle, radians, `[3·J]`.
    pub pose: Vec<f64>,
    /// Translation of the body, metres.
    pub transl: [f64; 3],
    /// Offset of the rest vertices before skinning, metres, `[V, 3]`: pose blend shapes plus the
    /// difference of the clothing displacement from the one in [`SkinnedMesh::rest`]. Without one it
    /// is interpolated between the keyframes around; the first and the last need one.
    pub offset: Option<Array2<f64>>,
}

/// Writes a `.glb` file, atomically: in the rest pose without keyframes, in the pose of a single
/// keyframe, or animated by several.
///
/// # Errors
/// If shapes do not fit the body, times do not increase, or the file cannot be written.
pub fn write(path: impl AsRef<Path>, skinned: &SkinnedMesh, keyframes: &[Keyframe]) -> Result<()> {
    let path = path.as_ref();
    let bytes = encode(skinned, keyframes)?;
    write_atomically(path, |file| file.write_all(&bytes))
}

/// Encodes a `.glb` file in memory; see [`write()`].
///
/// # Errors
/// See [`write()`].
pub fn encode(skinned: &SkinnedMesh, keyframes: &[Keyframe]) -> Result<Vec<u8>> {
    check(skinned, keyframes)?;
    let joint_count = skinned.body.joints();
    let mut buffer = Buffer::default();
    let corners = UvVertices::new(skinned);

    let mesh = mesh(skinned, keyframes, &corners, &mut buffer);
    let inverse_bind = inverse_bind(skinned, &mut buffer);
    let mut nodes: Vec<Value> =
        (0..joint_count).map(|joint| joint_node(skinned, joint, keyframes.first())).collect();
    let mesh_node = nodes.len();
    nodes.push(json!({ "name": skinned.name, "mesh": 0, "skin": 0 }));
    let mut document = json!({
        "asset": { "version": "2.0", "generator": concat!("cape ", env!("CARGO_PKG_VERSION")) },
        "scene": 0,
        "scenes": [{ "name": skinned.name, "nodes": [0, mesh_node] }],
        "nodes": nodes,
        "meshes": [mesh],
        "skins": [{
            "name": "SMPL",
            "inverseBindMatrices": inverse_bind,
            "joints": (0..joint_count).collect::<Vec<_>>(),
            "skeleton": 0,
        }],
        "materials": [{
            "name": "clothed body",
            "pbrMetallicRoughness": { "metallicFactor": 0.0, "roughnessFactor": 0.9 },
        }],
    });
    if keyframes.len() > 1 {
        document["animations"] = json!([animation(skinned, keyframes, mesh_node, &mut buffer)]);
    }
    if let Some(image) = skinned.texture.and_then(|texture| texture.image) {
        let view = buffer.raw(image);
        document["images"] = json!([{ "bufferView": view, "mimeType": mime_type(image)? }]);
        document["samplers"] = json!([{ "magFilter": 9729, "minFilter": 9987 }]);
        document["textures"] = json!([{ "source": 0, "sampler": 0 }]);
        document["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] =
            json!({ "index": 0 });
    }
    let Buffer { bytes, views, accessors } = buffer;
    document["buffers"] = json!([{ "byteLength": bytes.len() }]);
    document["bufferViews"] = Value::Array(views);
    document["accessors"] = Value::Array(accessors);
    assemble(&document, bytes)
}

/// A `.glb` file of a document and its binary chunk.
pub(crate) fn assemble(document: &Value, mut binary: Vec<u8>) -> Result<Vec<u8>> {
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    binary.resize(binary.len().next_multiple_of(4), 0);
    let total = 12 + 8 + text.len() + 8 + binary.len();
    let too_large = |_| Error::Argument(format!("glTF: {total} bytes, more than 4 GiB"));
    let length = u32::try_from(total).map_err(too_large)?;
    let mut file = Vec::with_capacity(total);
    for word in [MAGIC, 2, length, text.len() as u32, JSON_CHUNK] {
        file.extend(word.to_le_bytes());
    }
    file.extend(text);
    for word in [binary.len() as u32, BINARY_CHUNK] {
        file.extend(word.to_le_bytes());
    }
    file.extend(binary);
    Ok(file)
}

pub(crate) fn check(skinned: &SkinnedMesh, keyframes: &[Keyframe]) -> Result<()> {
    let (v, j) = (skinned.body.vertices(), skinned.body.joints());
    let expect = |name: &str, found: &[usize], expected: &[usize]| {
        if found == expected {
            return Ok(());
        }
        Err(Error::Argument(format!(
            "animated body: {name} of shape {found:?}, expected {expected:?}"
        )))
    };
    if j > 256 {
        return Err(Error::Argument(format!("glTF: body of {j} joints, expected at most 256")));
    }
    expect("rest vertices", skinned.rest.shape(), &[v, 3])?;
    expect("joints", skinned.joints.shape(), &[j, 3])?;
    if let Some(colours) = skinned.colours {
        expect("colours", &[colours.len(), 3], &[v, 3])?;
    }
    if let Some(texture) = &skinned.texture {
        let faces = skinned.body.faces.len();
        expect("texture coordinates", &[texture.uv.faces.len(), 3], &[faces, 3])?;
        let points = texture.uv.coordinates.len();
        if texture.uv.faces.iter().flatten().any(|&point| point as usize >= points) {
            return Err(Error::Argument(format!(
                "glTF: a texture coordinate index is out of range for {points} coordinates"
            )));
        }
    }
    for (name, target) in &skinned.targets {
        expect(name, target.shape(), &[v, 3])?;
    }
    for (index, frame) in keyframes.iter().enumerate() {
        expect(&format!("pose of keyframe {index}"), &[frame.pose.len()], &[3 * j])?;
        if let Some(offset) = &frame.offset {
            expect(&format!("offset of keyframe {index}"), offset.shape(), &[v, 3])?;
        }
    }
    if [keyframes.first(), keyframes.last()].iter().flatten().any(|frame| frame.offset.is_none()) {
        return Err(Error::Argument(
            "glTF: the first and the last keyframe need vertex offsets".into(),
        ));
    }
    if !keyframes.is_sorted_by(|a, b| a.time < b.time)
        || keyframes.iter().any(|frame| !(frame.time.is_finite() && frame.time >= 0.0))
    {
        return Err(Error::Argument(
            "glTF: keyframe times must be finite, at least 0 and increasing".into(),
        ));
    }
    Ok(())
}

fn mime_type(image: &[u8]) -> Result<&'static str> {
    match image {
        [0x89, b'P', b'N', b'G', ..] => Ok("image/png"),
        [0xff, 0xd8, 0xff, ..] => Ok("image/jpeg"),
        _ => Err(Error::Argument("glTF: the texture image must be a PNG or JPEG file".into())),
    }
}

/// Vertices of the glTF mesh: one for each pair of body vertex and texture coordinate in use.
struct UvVertices {
    /// Body vertex of each glTF vertex.
    vertex: Vec<u32>,
    uv: Option<Vec<[f32; 2]>>,
    indices: Vec<u32>,
}

impl UvVertices {
    fn new(skinned: &SkinnedMesh) -> Self {
        let faces = skinned.body.faces.as_flattened();
        let Some(GltfTexture { uv, .. }) = &skinned.texture else {
            let vertex = (0..skinned.body.vertices() as u32).collect();
            return Self { vertex, uv: None, indices: faces.to_vec() };
        };
        let mut known = std::collections::HashMap::new();
        let (mut vertex, mut points) = (Vec::new(), Vec::new());
        let pairs = faces.iter().copied().zip(uv.faces.as_flattened().iter().copied());
        let indices = pairs
            .map(|pair| {
                *known.entry(pair).or_insert_with(|| {
                    let [u, v] = uv.coordinates[pair.1 as usize];
                    vertex.push(pair.0);
                    // The texture origin is the top left in glTF, the bottom left in OBJ.
                    points.push([u, 1.0 - v]);
                    vertex.len() as u32 - 1
                })
            })
            .collect();
        Self { vertex, uv: Some(points), indices }
    }

    fn rows(&self, array: &Array2<f64>) -> Vec<[f32; 3]> {
        let row = |&vertex: &u32| [0, 1, 2].map(|axis| array[[vertex as usize, axis]] as f32);
        self.vertex.iter().map(row).collect()
    }

    fn gather<T: Copy>(&self, values: &[T]) -> Vec<T> {
        self.vertex.iter().map(|&vertex| values[vertex as usize]).collect()
    }
}

fn mesh(
    skinned: &SkinnedMesh,
    keyframes: &[Keyframe],
    corners: &UvVertices,
    buffer: &mut Buffer,
) -> Value {
    let rest: Vec<[f32; 3]> =
        skinned.rest.rows().into_iter().map(|v| [v[0] as f32, v[1] as f32, v[2] as f32]).collect();
    let surface = Mesh { vertices: rest, faces: skinned.body.faces.clone() };
    // Isolated vertices have no normal; glTF requires unit length.
    let normals: Vec<[f32; 3]> = surface
        .vertex_normals()
        .into_iter()
        .map(|n| if n.iter().any(|&x| x != 0.0) { n } else { [0.0, 1.0, 0.0] })
        .collect();
    let mut attributes = json!({
        "POSITION": buffer.vec3(&corners.gather(&surface.vertices), Target::Vertices, true),
        "NORMAL": buffer.vec3(&corners.gather(&normals), Target::Vertices, false),
    });
    if let Some(points) = &corners.uv {
        attributes["TEXCOORD_0"] = json!(buffer.vec2(points));
    }
    if let Some(colours) = skinned.colours {
        let linear: Vec<[f32; 3]> = colours.iter().map(|colour| colour.map(linear)).collect();
        attributes["COLOR_0"] =
            json!(buffer.vec3(&corners.gather(&linear), Target::Vertices, false));
    }
    for (set, influences) in joint_influences(skinned.body).into_iter().enumerate() {
        let joints: Vec<[u8; 4]> = influences.iter().map(|four| four.map(|(j, _)| j)).collect();
        let weights: Vec<[f32; 4]> = influences.iter().map(|four| four.map(|(_, w)| w)).collect();
        attributes[format!("JOINTS_{set}")] = json!(buffer.joints(&corners.gather(&joints)));
        attributes[format!("WEIGHTS_{set}")] = json!(buffer.vec4(&corners.gather(&weights)));
    }
    let indices = buffer.indices(&corners.indices);
    let mut primitive = json!({ "attributes": attributes, "indices": indices, "material": 0 });

    let mut names: Vec<String> = skinned.targets.iter().map(|(name, _)| name.clone()).collect();
    let mut weights = vec![0.0; names.len()];
    let offsets = skinned.targets.iter().map(|(_, target)| target);
    let mut targets: Vec<Value> = Vec::new();
    for target in offsets.chain(keyframes.iter().filter_map(|frame| frame.offset.as_ref())) {
        let rows = corners.rows(target);
        targets.push(json!({ "POSITION": buffer.vec3(&rows, Target::Vertices, true) }));
    }
    for (index, _) in keyframes.iter().enumerate().filter(|(_, frame)| frame.offset.is_some()) {
        names.push(format!("frame {index}"));
        weights.push(if index == 0 { 1.0 } else { 0.0 });
    }
    let mut mesh = json!({ "name": skinned.name });
    if !targets.is_empty() {
        primitive["targets"] = Value::Array(targets);
        mesh["weights"] = json!(weights);
        mesh["extras"] = json!({ "targetNames": names });
    }
    mesh["primitives"] = json!([primitive]);
    mesh
}

/// Converts an sRGB component to linear.
pub(crate) fn linear(x: f32) -> f32 {
    let x = x.clamp(0.0, 1.0);
    if x <= 0.04045 { x / 12.92 } else { ((x + 0.055) / 1.055).powf(2.4) }
}

/// Translation of a joint relative to its parent, metres.
pub(crate) fn local(skinned: &SkinnedMesh, joint: usize) -> DVec3 {
    let at = |joint: usize| DVec3::from_array([0, 1, 2].map(|axis| skinned.joints[[joint, axis]]));
    skinned.body.parents[joint].map_or_else(|| at(joint), |parent| at(joint) - at(parent))
}

pub(crate) fn rotation(frame: &Keyframe, joint: usize) -> [f32; 4] {
    let axis_angle = [0, 1, 2].map(|axis| frame.pose[3 * joint + axis]);
    DQuat::from_scaled_axis(DVec3::from_array(axis_angle)).as_quat().to_array()
}

fn joint_node(skinned: &SkinnedMesh, joint: usize, frame: Option<&Keyframe>) -> Value {
    let name = joints::JOINT_NAMES
        .get(joint)
        .map_or_else(|| format!("joint {joint}"), ToString::to_string);
    let mut at = local(skinned, joint);
    if let (None, Some(frame)) = (skinned.body.parents[joint], frame) {
        at += DVec3::from_array(frame.transl);
    }
    let mut node = json!({ "name": name, "translation": at.as_vec3().to_array() });
    if let Some(frame) = frame {
        node["rotation"] = json!(rotation(frame, joint));
    }
    let children: Vec<usize> = (0..skinned.body.joints())
        .filter(|&child| skinned.body.parents[child] == Some(joint))
        .collect();
    if !children.is_empty() {
        node["children"] = json!(children);
    }
    node
}

fn inverse_bind(skinned: &SkinnedMesh, buffer: &mut Buffer) -> usize {
    let matrices: Vec<[f32; 16]> = skinned
        .joints
        .rows()
        .into_iter()
        .map(|joint| {
            let at = [0, 1, 2].map(|axis| -joint[axis] as f32);
            [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, at[0], at[1], at[2], 1.0]
        })
        .collect();
    buffer.matrices(&matrices)
}

fn animation(
    skinned: &SkinnedMesh,
    keyframes: &[Keyframe],
    mesh_node: usize,
    buffer: &mut Buffer,
) -> Value {
    let start = keyframes[0].time;
    let times: Vec<f32> = keyframes.iter().map(|frame| frame.time - start).collect();
    let time_accessor = buffer.times(&times);
    let (mut samplers, mut channels) = (Vec::new(), Vec::new());
    let mut add = |node: usize, path: &str, [input, output]: [usize; 2]| {
        channels.push(json!({
            "sampler": samplers.len(),
            "target": { "node": node, "path": path },
        }));
        samplers.push(json!({ "input": input, "output": output, "interpolation": "LINEAR" }));
    };
    for joint in 0..skinned.body.joints() {
        let mut rotations: Vec<[f32; 4]> =
            keyframes.iter().map(|frame| rotation(frame, joint)).collect();
        // Of the two quaternions of a rotation take the one nearer to the previous keyframe's, so that
        // interpolation takes the shorter arc.
        for index in 1..rotations.len() {
            let dot: f32 =
                rotations[index].iter().zip(&rotations[index - 1]).map(|(a, b)| a * b).sum();
            if dot < 0.0 {
                rotations[index] = rotations[index].map(|x| -x);
            }
        }
        add(joint, "rotation", [time_accessor, buffer.values(&rotations, "VEC4")]);
    }
    let root = local(skinned, 0);
    let translations: Vec<[f32; 3]> = keyframes
        .iter()
        .map(|frame| (root + DVec3::from_array(frame.transl)).as_vec3().to_array())
        .collect();
    add(0, "translation", [time_accessor, buffer.values(&translations, "VEC3")]);
    let times: Vec<f32> = keyframes
        .iter()
        .filter(|frame| frame.offset.is_some())
        .map(|frame| frame.time - start)
        .collect();
    let before = skinned.targets.len();
    let width = before + times.len();
    let weights: Vec<[f32; 1]> = (0..times.len() * width)
        .map(|at| [if at % width == before + at / width { 1.0 } else { 0.0 }])
        .collect();
    let inputs = if times.len() == keyframes.len() { time_accessor } else { buffer.times(&times) };
    add(mesh_node, "weights", [inputs, buffer.values(&weights, "SCALAR")]);
    json!({ "name": "motion", "samplers": samplers, "channels": channels })
}
