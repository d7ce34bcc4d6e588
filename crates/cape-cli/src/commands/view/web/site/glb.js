// glTF of a clothed body: its rest pose with SMPL's skeleton, and a morph target for what skinning does not
// do, as in the program (cape-core, `gltf`).

import { bounds, smoothNormals } from "./mesh.js";
import { quaternion, triple } from "./skeleton.js";

const [FLOAT, BYTE, WORD] = [5126, 5121, 5125];
const [VERTICES, INDICES] = [34962, 34963];

/// The parts of the file. `figure` has rest vertices and their `offsets` `[vertices, 3]`, rest joints, their
/// names, parents and pose, influences and colours.
export function glb({ rest, offsets, joints, names, parents, pose, influences, colours }, faces) {
  const count = rest.length / 3;
  const parts = [];
  const add = (data, target, accessor) => {
    parts.push({ data, target, accessor });
    return parts.length - 1;
  };
  const floats = (data, type, target, more) =>
    add(data, target, { componentType: FLOAT, count: data.length / { VEC3: 3, VEC4: 4, MAT4: 16 }[type], type, ...more });
  const bounded = data => {
    const { minimum: min, maximum: max } = bounds(data);
    return floats(data, "VEC3", VERTICES, { min, max });
  };
  const attributes = {
    POSITION: bounded(rest),
    NORMAL: floats(smoothNormals(rest, faces), "VEC3", VERTICES),
    COLOR_0: floats(linear(colours), "VEC3", VERTICES),
  };
  influences.forEach((set, i) => {
    attributes[`JOINTS_${i}`] = add(set.joints, VERTICES, { componentType: BYTE, count, type: "VEC4" });
    attributes[`WEIGHTS_${i}`] = floats(set.weights, "VEC4", VERTICES);
  });
  const indices = add(faces, INDICES, { componentType: WORD, count: faces.length, type: "SCALAR" });
  const primitive = { attributes, indices, material: 0, targets: [{ POSITION: bounded(offsets) }] };
  const inverseBindMatrices = floats(bindings(joints), "MAT4");

  let end = 0;
  const bufferViews = parts.map(({ data: { byteLength }, target }) => {
    end += byteLength;
    return { buffer: 0, byteOffset: end - byteLength, byteLength, ...(target && { target }) };
  });
  return container({
    asset: { version: "2.0", generator: "cape" },
    scene: 0,
    scenes: [{ nodes: [0, names.length] }],
    nodes: [...skeleton({ joints, names, parents, pose }), { mesh: 0, skin: 0, name: "clothed" }],
    skins: [{ name: "SMPL", inverseBindMatrices, joints: [...names.keys()], skeleton: 0 }],
    meshes: [{ name: "clothed", primitives: [primitive], weights: [1], extras: { targetNames: ["frame 0"] } }],
    materials: [{ name: "clothed body", pbrMetallicRoughness: { metallicFactor: 0, roughnessFactor: 0.9 } }],
    accessors: parts.map(({ accessor }, bufferView) => ({ bufferView, ...accessor })),
    bufferViews,
    buffers: [{ byteLength: end }],
  }, end, parts.map(({ data }) => data));
}

function skeleton({ joints, names, parents, pose }) {
  return names.map((name, joint) => {
    const above = parents[joint] === null ? [0, 0, 0] : triple(joints, parents[joint]);
    const children = [...names.keys()].filter(child => parents[child] === joint);
    return {
      name,
      translation: triple(joints, joint).map((x, i) => x - above[i]),
      rotation: quaternion(triple(pose, joint)),
      ...(children.length > 0 && { children }),
    };
  });
}

/// Matrices that take rest vertices into the joints' frames, column-major, `[joints, 16]`.
function bindings(joints) {
  const matrices = new Float32Array((joints.length / 3) * 16);
  for (let joint = 0; 3 * joint < joints.length; joint++) {
    for (let i = 0; i < 3; i++) {
      matrices[16 * joint + 5 * i] = 1;
      matrices[16 * joint + 12 + i] = -joints[3 * joint + i];
    }
    matrices[16 * joint + 15] = 1;
  }
  return matrices;
}

function container(scene, bytes, data) {
  const text = new TextEncoder().encode(JSON.stringify(scene));
  const json = new Uint8Array(Math.ceil(text.length / 4) * 4).fill(0x20);
  json.set(text);
  const length = 12 + 8 + json.length + 8 + bytes;
  return [
    Uint32Array.of(0x46546c67, 2, length), Uint32Array.of(json.length, 0x4e4f534a), json,
    Uint32Array.of(bytes, 0x004e4942), ...data,
  ];
}

/// Colours of glTF are linear: `[vertices, 3]`.
function linear(colours) {
  const table = Float32Array.from({ length: 256 }, (_, byte) => {
    const x = byte / 255;
    return x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4;
  });
  return Float32Array.from({ length: (3 * colours.length) / 4 }, (_, i) => table[colours[4 * Math.floor(i / 3) + (i % 3)]]);
}
