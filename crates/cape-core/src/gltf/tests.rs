use glam::{DQuat, Mat4, Quat, Vec3, Vec4};
use ndarray::Array3;

use super::*;
use crate::smpl::test_model::random_model;

/// Reader of `.glb` files by the specification, for what the writer writes.
struct Glb {
    json: Value,
    binary: Vec<u8>,
}

impl Glb {
    fn parse(bytes: &[u8]) -> Self {
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!((&bytes[..4], word(4), word(8)), (&b"glTF"[..], 2, bytes.len()));
        let length = word(12);
        assert_eq!(&bytes[16..20], b"JSON");
        let json = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
        let at = 20 + length;
        assert_eq!(&bytes[at + 4..at + 8], b"BIN\0");
        assert_eq!(word(at), bytes.len() - at - 8);
        Self { json, binary: bytes[at + 8..].to_vec() }
    }

    fn index(value: &Value) -> usize {
        usize::try_from(value.as_u64().unwrap()).unwrap()
    }

    /// Numbers of an accessor, row by row.
    fn numbers(&self, accessor: &Value) -> Vec<Vec<f32>> {
        let accessor = &self.json["accessors"][Self::index(accessor)];
        let view = &self.json["bufferViews"][Self::index(&accessor["bufferView"])];
        let width = match accessor["type"].as_str().unwrap() {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            "MAT4" => 16,
            other => panic!("{other}"),
        };
        let count = Self::index(&accessor["count"]);
        let start = Self::index(&view["byteOffset"]);
        let bytes = &self.binary[start..][..Self::index(&view["byteLength"])];
        let numbers: Vec<f32> = match accessor["componentType"].as_u64().unwrap() {
            5126 => bytes.as_chunks().0.iter().map(|&b| f32::from_le_bytes(b)).collect(),
            5125 => bytes.as_chunks().0.iter().map(|&b| u32::from_le_bytes(b) as f32).collect(),
            5121 => bytes.iter().map(|&b| b.into()).collect(),
            other => panic!("{other}"),
        };
        assert_eq!(numbers.len(), count * width);
        assert_eq!(start % 4, 0);
        if let Some(low) = accessor["min"].as_array() {
            for (axis, low) in low.iter().enumerate() {
                let found =
                    numbers.chunks(width).map(|row| row[axis]).fold(f32::INFINITY, f32::min);
                assert_eq!(low.as_f64().unwrap() as f32, found);
            }
        }
        numbers.chunks(width).map(<[f32]>::to_vec).collect()
    }

    /// Skinned vertices for local transforms of the joints and weights of the morph targets.
    fn skinned(&self, turns: &[Quat], places: &[Vec3], weights: &[f32]) -> Vec<Vec3> {
        let primitive = &self.json["meshes"][0]["primitives"][0];
        let attributes = &primitive["attributes"];
        let vector = |row: &Vec<f32>| Vec3::from_slice(row);
        let mut vertices: Vec<Vec3> =
            self.numbers(&attributes["POSITION"]).iter().map(vector).collect();
        for (target, &weight) in primitive["targets"].as_array().into_iter().flatten().zip(weights)
        {
            let offsets = self.numbers(&target["POSITION"]);
            for (vertex, offset) in vertices.iter_mut().zip(&offsets) {
                *vertex += weight * vector(offset);
            }
        }
        let nodes = self.json["nodes"].as_array().unwrap();
        let joints: Vec<usize> =
            self.json["skins"][0]["joints"].as_array().unwrap().iter().map(Self::index).collect();
        let mut global = vec![Mat4::NAN; nodes.len()];
        let mut left = vec![(0, Mat4::IDENTITY)];
        while let Some((node, parent)) = left.pop() {
            global[node] = parent * Mat4::from_rotation_translation(turns[node], places[node]);
            for child in nodes[node]["children"].as_array().into_iter().flatten() {
                left.push((Self::index(child), global[node]));
            }
        }
        let inverse = self.numbers(&self.json["skins"][0]["inverseBindMatrices"]);
        let matrices: Vec<Mat4> = joints
            .iter()
            .zip(&inverse)
            .map(|(&joint, inverse)| {
                global[joint] * Mat4::from_cols_array(inverse.as_slice().try_into().unwrap())
            })
            .collect();
        let mut out = vec![Vec4::ZERO; vertices.len()];
        let mut sums = vec![0.0; vertices.len()];
        for set in 0.. {
            let Some(accessor) = attributes.get(format!("JOINTS_{set}")) else { break };
            let joints = self.numbers(accessor);
            let weights = self.numbers(&attributes[format!("WEIGHTS_{set}")]);
            for (vertex, (joints, weights)) in joints.iter().zip(&weights).enumerate() {
                for (&joint, &weight) in joints.iter().zip(weights) {
                    out[vertex] +=
                        weight * (matrices[joint as usize] * vertices[vertex].extend(1.0));
                    sums[vertex] += weight;
                }
            }
        }
        assert!(sums.iter().all(|sum: &f32| (sum - 1.0).abs() < 1e-5));
        out.iter().map(|vertex| vertex.truncate()).collect()
    }

    fn node(&self, node: usize) -> (Quat, Vec3) {
        let of = |key: &str| {
            let values = self.json["nodes"][node][key].as_array()?;
            Some(values.iter().map(|x| x.as_f64().unwrap() as f32).collect::<Vec<_>>())
        };
        let turn = of("rotation").map_or(Quat::IDENTITY, |q| Quat::from_slice(&q));
        (turn, of("translation").map_or(Vec3::ZERO, |t| Vec3::from_slice(&t)))
    }
}

struct Scene {
    body: SmplModel,
    rest: Array2<f64>,
    joints: Array2<f64>,
    displacement: Array2<f64>,
}

fn scene() -> Scene {
    let body = random_model();
    let betas = vec![0.3; body.betas()];
    let shape = body.rest_shape(&betas).unwrap();
    let displacement =
        Array2::from_shape_fn(shape.dim(), |(v, axis)| ((3 * v + axis) as f64).sin() * 0.03);
    Scene {
        rest: &shape + &displacement,
        joints: body.rest_joints(&shape).unwrap(),
        displacement,
        body,
    }
}

impl Scene {
    fn figure(&self) -> SkinnedMesh<'_> {
        SkinnedMesh {
            name: "test",
            body: &self.body,
            rest: self.rest.clone(),
            joints: self.joints.clone(),
            colours: None,
            texture: None,
            targets: Vec::new(),
        }
    }

    fn keyframes(&self) -> Vec<Keyframe> {
        (0..4)
            .map(|frame| {
                let pose: Vec<f64> = (0..3 * self.body.joints())
                    .map(|i| ((i * 7 + frame * 13) as f64).sin() * 1.5)
                    .collect();
                Keyframe {
                    time: frame as f32 * 0.1,
                    offset: Some(self.body.pose_offsets(&pose).unwrap()),
                    transl: [0.1 * frame as f64, 1.0, -2.0],
                    pose,
                }
            })
            .collect()
    }

    /// Clothed vertices posed by this library.
    fn expected(&self, frame: &Keyframe) -> Vec<Vec3> {
        let betas = vec![0.3; self.body.betas()];
        let posed =
            self.body.pose(&betas, &frame.pose, frame.transl, Some(&self.displacement)).unwrap();
        posed
            .vertices
            .rows()
            .into_iter()
            .map(|v| Vec3::new(v[0] as f32, v[1] as f32, v[2] as f32))
            .collect()
    }
}

fn largest(a: &[Vec3], b: &[Vec3]) -> f32 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| a.distance(*b)).fold(0.0, f32::max)
}

#[test]
fn a_single_pose_is_posed_as_here() {
    let scene = scene();
    let keyframes = &scene.keyframes()[1..2];
    let glb = Glb::parse(&encode(&scene.figure(), keyframes).unwrap());
    let joints = scene.body.joints();
    let (turns, places): (Vec<_>, Vec<_>) = (0..joints).map(|node| glb.node(node)).unzip();
    let weights = glb.json["meshes"][0]["weights"].as_array().unwrap();
    let weights: Vec<f32> = weights.iter().map(|w| w.as_f64().unwrap() as f32).collect();
    let found = glb.skinned(&turns, &places, &weights);
    assert!(largest(&found, &scene.expected(&keyframes[0])) < 1e-5);
    assert!(glb.json.get("animations").is_none());
}

#[test]
fn every_keyframe_of_an_animation_is_posed_as_here() {
    let scene = scene();
    let keyframes = scene.keyframes();
    let figure = SkinnedMesh {
        targets: vec![("beta 0".into(), scene.displacement.clone())],
        ..scene.figure()
    };
    let glb = Glb::parse(&encode(&figure, &keyframes).unwrap());
    let animation = &glb.json["animations"][0];
    let joints = scene.body.joints();
    let of = |node: usize, path: &str| {
        let channels = animation["channels"].as_array().unwrap();
        let channel = channels
            .iter()
            .find(|c| c["target"]["node"] == json!(node) && c["target"]["path"] == json!(path))
            .unwrap();
        let sampler = &animation["samplers"][Glb::index(&channel["sampler"])];
        let times = glb.numbers(&sampler["input"]);
        assert_eq!(times.iter().map(|t| t[0]).collect::<Vec<_>>(), [0.0, 0.1, 0.2, 0.3]);
        glb.numbers(&sampler["output"])
    };
    let turns: Vec<Vec<Vec<f32>>> = (0..joints).map(|node| of(node, "rotation")).collect();
    let translation = of(0, "translation");
    let weights = of(joints, "weights");
    for (k, frame) in keyframes.iter().enumerate() {
        let turn = |node: usize| Quat::from_slice(&turns[node][k]);
        let mut places: Vec<Vec3> = (0..joints).map(|node| glb.node(node).1).collect();
        places[0] = Vec3::from_slice(&translation[k]);
        let turns: Vec<Quat> = (0..joints).map(turn).collect();
        let weights: Vec<f32> = weights[5 * k..][..5].iter().map(|w| w[0]).collect();
        let found = glb.skinned(&turns, &places, &weights);
        assert!(largest(&found, &scene.expected(frame)) < 1e-5, "keyframe {k}");
    }
    // Consecutive quaternions are in the same hemisphere.
    for turns in &turns {
        for pair in turns.windows(2) {
            let dot: f32 = pair[0].iter().zip(&pair[1]).map(|(a, b)| a * b).sum();
            assert!(dot >= 0.0);
        }
    }
    let names = &glb.json["meshes"][0]["extras"]["targetNames"];
    assert_eq!(names, &json!(["beta 0", "frame 0", "frame 1", "frame 2", "frame 3"]));
}

#[test]
fn textures_split_vertices_at_seams() {
    let scene = scene();
    let faces = scene.body.faces.len() as u32;
    // Every face corner has its own texture coordinate.
    let uv = Uv {
        coordinates: (0..3 * faces).map(|i| [i as f32 / (3 * faces) as f32, 0.25]).collect(),
        faces: (0..faces).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect(),
    };
    let image = b"\x89PNG not really".as_slice();
    let colours: Vec<[f32; 3]> = vec![[1.0, 0.5, 0.0]; scene.body.vertices()];
    let figure = SkinnedMesh {
        texture: Some(GltfTexture { uv: &uv, image: Some(image) }),
        colours: Some(&colours),
        ..scene.figure()
    };
    let glb = Glb::parse(&encode(&figure, &[]).unwrap());
    let primitive = &glb.json["meshes"][0]["primitives"][0];
    let points = glb.numbers(&primitive["attributes"]["TEXCOORD_0"]);
    let positions = glb.numbers(&primitive["attributes"]["POSITION"]);
    let indices = glb.numbers(&primitive["indices"]);
    assert_eq!((points.len(), indices.len()), (3 * faces as usize, 3 * faces as usize));
    for (corner, index) in indices.iter().enumerate() {
        let index = index[0] as usize;
        let vertex = scene.body.faces[corner / 3][corner % 3] as usize;
        assert_eq!(positions[index][1], scene.rest[[vertex, 1]] as f32);
        assert_eq!(points[index], [corner as f32 / (3 * faces) as f32, 0.75]);
    }
    let colours = glb.numbers(&primitive["attributes"]["COLOR_0"]);
    assert!((colours[0][1] - 0.214).abs() < 1e-3 && colours[0][0] == 1.0);
    let view = &glb.json["bufferViews"][Glb::index(&glb.json["images"][0]["bufferView"])];
    assert_eq!(&glb.binary[Glb::index(&view["byteOffset"])..][..image.len()], image);
}

#[test]
fn many_influences_take_several_sets() {
    let mut scene = scene();
    let joints = scene.body.joints();
    let spread = Array3::<f64>::from_shape_fn((1, scene.body.vertices(), joints), |(_, v, j)| {
        1.0 + (v + j) as f64
    });
    let spread = spread.index_axis_move(ndarray::Axis(0), 0);
    let sums = spread.sum_axis(ndarray::Axis(1)).insert_axis(ndarray::Axis(1));
    scene.body.weights = &spread / &sums;
    assert_eq!(joint_influences(&scene.body).len(), joints.div_ceil(4));
    let keyframes = &scene.keyframes()[2..3];
    let glb = Glb::parse(&encode(&scene.figure(), keyframes).unwrap());
    let (turns, places): (Vec<_>, Vec<_>) = (0..joints).map(|node| glb.node(node)).unzip();
    let found = glb.skinned(&turns, &places, &[1.0]);
    assert!(largest(&found, &scene.expected(&keyframes[0])) < 1e-5);
}

#[test]
fn rotations_are_those_of_the_axis_angles() {
    let frame = Keyframe {
        time: 0.0,
        pose: vec![0.0, 0.0, 1.2, 0.3, -0.4, 0.5],
        transl: [0.0; 3],
        offset: Some(Array2::zeros((0, 3))),
    };
    let expected = DQuat::from_rotation_z(1.2).as_quat();
    assert!(Quat::from_array(rotation(&frame, 0)).angle_between(expected) < 1e-3);
    let expected = DQuat::from_scaled_axis(DVec3::new(0.3, -0.4, 0.5)).as_quat();
    assert!(Quat::from_array(rotation(&frame, 1)).angle_between(expected) < 1e-3);
}

#[test]
fn invalid_input_is_named() {
    let scene = scene();
    let says = |figure: &SkinnedMesh, keyframes: &[Keyframe], expected: &str| {
        let message = encode(figure, keyframes).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    };
    let mut keyframes = scene.keyframes();
    keyframes[2].time = 0.05;
    says(&scene.figure(), &keyframes, "increasing");
    let mut keyframes = scene.keyframes();
    keyframes[1].pose.pop();
    says(&scene.figure(), &keyframes, "pose of keyframe 1");
    let figure = SkinnedMesh { rest: Array2::zeros((1, 3)), ..scene.figure() };
    says(&figure, &[], "rest vertices of shape [1, 3]");
    let uv = Uv { coordinates: Vec::new(), faces: vec![[0, 0, 0]; scene.body.faces.len()] };
    let figure =
        SkinnedMesh { texture: Some(GltfTexture { uv: &uv, image: None }), ..scene.figure() };
    says(&figure, &[], "texture coordinate index is out of range");
    let uv = Uv { coordinates: vec![[0.0; 2]], ..uv };
    let texture = Some(GltfTexture { uv: &uv, image: Some(b"GIF89a") });
    says(&SkinnedMesh { texture, ..scene.figure() }, &[], "PNG or JPEG");
}
