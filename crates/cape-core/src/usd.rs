//! Universal Scene Description as text (`.usda`) of skinned, animated bodies.
//!
//! The same body as in [`gltf`](crate::gltf): a skeleton with rotations for each keyframe, SMPL's
//! skinning weights, and one blend shape for each keyframe that has vertex offsets. Units are metres,
//! y points up, time codes count frames.

use std::{
    fmt::Write as _,
    io::{self, Write},
    path::Path,
};

use glam::DVec3;
use ndarray::Array2;

use crate::{
    Mesh, Result,
    gltf::{Keyframe, SkinnedMesh, check, local, rotation, skin},
    joints, write_atomically,
};

/// Writes a `.usda` file, atomically: in the rest pose without keyframes, else animated. Texture and
/// additional morph targets of `skinned` are not written.
///
/// ```
/// use cape_core::{gltf::{Keyframe, SkinnedMesh}, usd};
/// use cape_synth::synthetic_body;
///
/// let body = synthetic_body();
/// let rest = body.rest_shape(&[])?;
/// let skinned = SkinnedMesh {
///     name: "standing",
///     body: &body,
///     joints: body.rest_joints(&rest)?,
///     rest,
///     colours: None,
///     texture: None,
///     targets: Vec::new(),
/// };
/// let pose = vec![0.0; 72];
/// let offset = Some(body.pose_offsets(&pose)?);
/// let directory = tempfile::tempdir()?;
/// let path = directory.path().join("standing.usda");
/// usd::write(&path, &skinned, &[Keyframe { time: 0.0, pose, transl: [0.0; 3], offset }])?;
/// assert!(std::fs::read_to_string(&path)?.starts_with("#usda 1.0"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// If shapes do not fit the body, times do not increase, or the file cannot be written.
pub fn write(path: impl AsRef<Path>, skinned: &SkinnedMesh, keyframes: &[Keyframe]) -> Result<()> {
    check(skinned, keyframes)?;
    write_atomically(path, |file| Stage::new(skinned, keyframes).write(file))
}

struct Stage<'a> {
    skinned: &'a SkinnedMesh<'a>,
    keyframes: &'a [Keyframe],
    /// Name of the root.
    root: String,
    /// Paths of the joints, such as `pelvis/l_hip`.
    paths: Vec<String>,
    /// Frames per second.
    rate: f64,
}

impl<'a> Stage<'a> {
    fn new(skinned: &'a SkinnedMesh<'a>, keyframes: &'a [Keyframe]) -> Self {
        let mut paths: Vec<String> = Vec::new();
        for (joint, parent) in skinned.body.parents.iter().enumerate() {
            let name = joints::JOINT_NAMES
                .get(joint)
                .map_or_else(|| format!("joint_{joint}"), |n| (*n).into());
            paths.push(match parent {
                Some(parent) => format!("{}/{name}", paths[*parent]),
                None => name,
            });
        }
        let rate = match keyframes {
            [first, .., last] => (keyframes.len() - 1) as f64 / f64::from(last.time - first.time),
            _ => 24.0,
        };
        // Single precision of the times must not show in the rate.
        let rate = if (rate - rate.round()).abs() < 1e-3 { rate.round() } else { rate };
        Self { skinned, keyframes, root: identifier(skinned.name), paths, rate }
    }

    /// Time code of a keyframe: its number if the keyframes are evenly spaced.
    fn time_code(&self, frame: &Keyframe) -> f64 {
        let code = f64::from(frame.time - self.keyframes[0].time) * self.rate;
        if (code - code.round()).abs() < 0.01 { code.round() } else { code }
    }

    fn write(&self, file: &mut impl Write) -> io::Result<()> {
        let root = &self.root;
        let last = self.keyframes.last().map_or(0.0, |frame| self.time_code(frame));
        write!(
            file,
            "#usda 1.0\n(\n    defaultPrim = \"{root}\"\n    doc = \"cape {}\"\n    endTimeCode = {last}\n    \
             framesPerSecond = {rate}\n    metersPerUnit = 1\n    startTimeCode = 0\n    \
             timeCodesPerSecond = {rate}\n    upAxis = \"Y\"\n)\n\n",
            env!("CARGO_PKG_VERSION"),
            rate = self.rate
        )?;
        let [low, high] = self.extent();
        write!(
            file,
            "def SkelRoot \"{root}\" (\n    kind = \"component\"\n)\n{{\n    float3[] extent = [{}, {}]\n\n",
            tuple(low),
            tuple(high)
        )?;
        self.skeleton(file)?;
        self.mesh(file)?;
        writeln!(file, "}}")
    }

    /// Bounds of the body in all keyframes: around each translation as far as the body reaches.
    fn extent(&self) -> [[f32; 3]; 2] {
        let pelvis = DVec3::from_array([0, 1, 2].map(|axis| self.skinned.joints[[0, axis]]));
        let at = |v: ndarray::ArrayView1<f64>| DVec3::new(v[0], v[1], v[2]);
        let reach = self.skinned.rest.rows().into_iter().map(|v| at(v).distance(pelvis));
        let reach = DVec3::splat(reach.fold(0.0, f64::max));
        let (mut low, mut high) = (pelvis - reach, pelvis + reach);
        for frame in self.keyframes {
            let t = DVec3::from_array(frame.transl);
            low = low.min(pelvis + t - reach);
            high = high.max(pelvis + t + reach);
        }
        [low.as_vec3().to_array(), high.as_vec3().to_array()]
    }

    fn skeleton(&self, file: &mut impl Write) -> io::Result<()> {
        let joints = self.skinned.body.joints();
        let at = |joint: usize| [0, 1, 2].map(|axis| self.skinned.joints[[joint, axis]]);
        let bind: Vec<[f64; 3]> = (0..joints).map(at).collect();
        let rest: Vec<[f64; 3]> =
            (0..joints).map(|joint| local(self.skinned, joint).to_array()).collect();
        let names = strings(&self.paths);
        write!(
            file,
            "    def Skeleton \"Skeleton\" (\n        prepend apiSchemas = [\"SkelBindingAPI\"]\n    )\n    \
             {{\n        uniform matrix4d[] bindTransforms = [{}]\n        uniform token[] joints = \
             [{names}]\n        uniform matrix4d[] restTransforms = [{}]\n",
            matrices(&bind),
            matrices(&rest)
        )?;
        if !self.keyframes.is_empty() {
            writeln!(
                file,
                "        rel skel:animationSource = </{}/Skeleton/Animation>\n",
                self.root
            )?;
            self.animation(file, &names)?;
        }
        write!(file, "    }}\n\n")
    }

    fn animation(&self, file: &mut impl Write, names: &str) -> io::Result<()> {
        let joints = self.skinned.body.joints();
        let morphs = self.morphs();
        let tokens: Vec<String> = morphs.iter().map(|(name, _)| name.clone()).collect();
        write!(
            file,
            "        def SkelAnimation \"Animation\"\n        {{\n            uniform token[] blendShapes = \
             [{}]\n            float[] blendShapeWeights.timeSamples = {{\n",
            strings(&tokens)
        )?;
        let shown = self.keyframes.iter().filter(|frame| frame.offset.is_some());
        for (index, frame) in shown.enumerate() {
            let weights: Vec<&str> =
                (0..morphs.len()).map(|morph| if morph == index { "1" } else { "0" }).collect();
            let code = self.time_code(frame);
            writeln!(file, "                {code}: [{}],", weights.join(", "))?;
        }
        write!(
            file,
            "            }}\n            uniform token[] joints = [{names}]\n            quatf[] \
             rotations.timeSamples = {{\n"
        )?;
        let mut before: Option<Vec<[f32; 4]>> = None;
        for frame in self.keyframes {
            let mut turns: Vec<[f32; 4]> =
                (0..joints).map(|joint| rotation(frame, joint)).collect();
            if let Some(before) = &before {
                for (turn, before) in turns.iter_mut().zip(before) {
                    let dot: f32 = turn.iter().zip(before).map(|(a, b)| a * b).sum();
                    if dot < 0.0 {
                        *turn = turn.map(|x| -x);
                    }
                }
            }
            let texts: Vec<String> =
                turns.iter().map(|[x, y, z, w]| format!("({w}, {x}, {y}, {z})")).collect();
            writeln!(file, "                {}: [{}],", self.time_code(frame), texts.join(", "))?;
            before = Some(turns);
        }
        let ones = vec!["(1, 1, 1)"; joints].join(", ");
        write!(
            file,
            "            }}\n            half3[] scales = [{ones}]\n            float3[] \
             translations.timeSamples = {{\n"
        )?;
        for frame in self.keyframes {
            let places: Vec<String> = (0..joints)
                .map(|joint| {
                    let mut at = local(self.skinned, joint);
                    if self.skinned.body.parents[joint].is_none() {
                        at += DVec3::from_array(frame.transl);
                    }
                    tuple(at.as_vec3().to_array())
                })
                .collect();
            writeln!(file, "                {}: [{}],", self.time_code(frame), places.join(", "))?;
        }
        write!(file, "            }}\n        }}\n")
    }

    /// Blend shapes: names and offsets.
    fn morphs(&self) -> Vec<(String, &Array2<f64>)> {
        let frames = self.keyframes.iter().enumerate();
        frames
            .filter_map(|(index, frame)| Some((format!("frame_{index}"), frame.offset.as_ref()?)))
            .collect()
    }

    fn mesh(&self, file: &mut impl Write) -> io::Result<()> {
        let SkinnedMesh { body, rest, colours, .. } = self.skinned;
        let mesh = Mesh { vertices: rows(rest), faces: body.faces.clone() };
        let [low, high] = mesh.bounding_box().unwrap_or_default();
        let root = &self.root;
        let corners: Vec<String> = body.faces.as_flattened().iter().map(u32::to_string).collect();
        write!(
            file,
            "    def Mesh \"Mesh\" (\n        prepend apiSchemas = [\"SkelBindingAPI\"]\n    )\n    {{\n        \
             float3[] extent = [{}, {}]\n        int[] faceVertexCounts = [{}]\n        int[] \
             faceVertexIndices = [{}]\n        normal3f[] normals = [{}] (\n            interpolation = \
             \"vertex\"\n        )\n        point3f[] points = [{}]\n",
            tuple(low),
            tuple(high),
            vec!["3"; body.faces.len()].join(", "),
            corners.join(", "),
            tuples(&mesh.vertex_normals()),
            tuples(&mesh.vertices)
        )?;
        if let Some(colours) = colours {
            let linear: Vec<[f32; 3]> =
                colours.iter().map(|c| c.map(crate::gltf::linear)).collect();
            write!(
                file,
                "        color3f[] primvars:displayColor = [{}] (\n            interpolation = \
                 \"vertex\"\n        )\n",
                tuples(&linear)
            )?;
        }
        let sets = skin::joint_influences(body);
        let influences = |vertex: usize| sets.iter().flat_map(move |set| set[vertex]);
        let vertices = 0..body.vertices();
        let numbers: Vec<String> =
            vertices.clone().flat_map(influences).map(|(joint, _)| joint.to_string()).collect();
        let weights: Vec<String> =
            vertices.flat_map(influences).map(|(_, weight)| weight.to_string()).collect();
        let options = format!(
            "(\n            elementSize = {}\n            interpolation = \"vertex\"\n        )",
            4 * sets.len()
        );
        write!(
            file,
            "        matrix4d primvars:skel:geomBindTransform = {}\n        int[] \
             primvars:skel:jointIndices = [{}] {options}\n        float[] primvars:skel:jointWeights = \
             [{}] {options}\n",
            matrices(&[[0.0; 3]]),
            numbers.join(", "),
            weights.join(", ")
        )?;
        let morphs = self.morphs();
        let tokens: Vec<String> = morphs.iter().map(|(name, _)| name.clone()).collect();
        let targets: Vec<String> =
            tokens.iter().map(|name| format!("</{root}/Mesh/{name}>")).collect();
        write!(
            file,
            "        uniform token[] skel:blendShapes = [{}]\n        rel skel:blendShapeTargets = [{}]\n        \
             rel skel:skeleton = </{root}/Skeleton>\n        uniform token subdivisionScheme = \"none\"\n",
            strings(&tokens),
            targets.join(", ")
        )?;
        for (name, offsets) in morphs {
            write!(
                file,
                "\n        def BlendShape \"{name}\"\n        {{\n            uniform vector3f[] offsets = \
                 [{}]\n        }}\n",
                tuples(&rows(offsets))
            )?;
        }
        writeln!(file, "    }}")
    }
}

/// A name of letters, digits and underscores.
fn identifier(name: &str) -> String {
    let clean: String =
        name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    let letter = clean.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_');
    if letter { clean } else { format!("_{clean}") }
}

fn rows(array: &Array2<f64>) -> Vec<[f32; 3]> {
    array.rows().into_iter().map(|v| [v[0] as f32, v[1] as f32, v[2] as f32]).collect()
}

fn tuple([x, y, z]: [f32; 3]) -> String {
    format!("({x}, {y}, {z})")
}

fn tuples(points: &[[f32; 3]]) -> String {
    let mut text = String::with_capacity(36 * points.len());
    for (index, [x, y, z]) in points.iter().enumerate() {
        let comma = if index == 0 { "" } else { ", " };
        // Writing to a string does not fail.
        let _ = write!(text, "{comma}({x}, {y}, {z})");
    }
    text
}

fn strings(names: &[String]) -> String {
    names.iter().map(|name| format!("\"{name}\"")).collect::<Vec<_>>().join(", ")
}

/// Matrices of translations, in rows.
fn matrices(translations: &[[f64; 3]]) -> String {
    let matrix = |[x, y, z]: &[f64; 3]| {
        format!("( (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), ({x}, {y}, {z}, 1) )")
    };
    translations.iter().map(matrix).collect::<Vec<_>>().join(", ")
}
