// Files of a mesh: OBJ, PLY and glTF.

import { bounds, smoothNormals } from "./mesh.js";

const FORMATS = { obj, ply, glb };

/// A file of a layer of the picture.
export const encodeMesh = (format, layer, faces) => new Blob(FORMATS[format](layer, faces));

function obj({ positions }, faces) {
  const lines = [];
  for (let i = 0; i < positions.length; i += 3) {
    lines.push(`v ${[...positions.subarray(i, i + 3)].map(shortest).join(" ")}`);
  }
  for (let i = 0; i < faces.length; i += 3) lines.push(`f ${faces[i] + 1} ${faces[i + 1] + 1} ${faces[i + 2] + 1}`);
  return [lines.join("\n"), "\n"];
}

/// Nine digits tell all numbers of single precision apart.
const shortest = value => Number(value.toPrecision(9)).toString();

function ply({ positions, colours }, faces) {
  const [count, triangles] = [positions.length / 3, faces.length / 3];
  const header = [
    "ply", "format binary_little_endian 1.0", `element vertex ${count}`,
    ...["x", "y", "z"].map(axis => `property float ${axis}`),
    ...["red", "green", "blue"].map(part => `property uchar ${part}`),
    `element face ${triangles}`, "property list uchar uint vertex_indices", "end_header", "",
  ].join("\n");
  const body = new DataView(new ArrayBuffer(15 * count + 13 * triangles));
  let at = 0;
  for (let v = 0; v < count; v++) {
    for (let i = 0; i < 3; i++, at += 4) body.setFloat32(at, positions[3 * v + i], true);
    for (let i = 0; i < 3; i++) body.setUint8(at++, colours[4 * v + i]);
  }
  for (let f = 0; f < triangles; f++) {
    body.setUint8(at++, 3);
    for (let i = 0; i < 3; i++, at += 4) body.setUint32(at, faces[3 * f + i], true);
  }
  return [header, body];
}

const [FLOAT, BYTE, WORD] = [5126, 5121, 5125];
const [VERTICES, INDICES] = [34962, 34963];

function glb({ positions, colours }, faces) {
  const { minimum, maximum } = bounds(positions);
  const count = positions.length / 3;
  const parts = [
    [positions, VERTICES, { componentType: FLOAT, count, type: "VEC3", min: minimum, max: maximum }],
    [smoothNormals(positions, faces), VERTICES, { componentType: FLOAT, count, type: "VEC3" }],
    [linear(colours), VERTICES, { componentType: FLOAT, count, type: "VEC3" }],
    [faces, INDICES, { componentType: WORD, count: faces.length, type: "SCALAR" }],
  ];
  let end = 0;
  const bufferViews = parts.map(([{ byteLength }, target]) => {
    end += byteLength;
    return { buffer: 0, byteOffset: end - byteLength, byteLength, target };
  });
  const scene = {
    asset: { version: "2.0", generator: "cape" },
    scene: 0,
    scenes: [{ nodes: [0] }],
    nodes: [{ mesh: 0, name: "clothed" }],
    meshes: [{ primitives: [{ attributes: { POSITION: 0, NORMAL: 1, COLOR_0: 2 }, indices: 3, material: 0 }] }],
    materials: [{ pbrMetallicRoughness: { metallicFactor: 0, roughnessFactor: 0.9 } }],
    accessors: parts.map(([, , accessor], bufferView) => ({ bufferView, ...accessor })),
    bufferViews,
    buffers: [{ byteLength: end }],
  };
  const text = new TextEncoder().encode(JSON.stringify(scene));
  const json = new Uint8Array(Math.ceil(text.length / 4) * 4).fill(0x20);
  json.set(text);
  const length = 12 + 8 + json.length + 8 + end;
  return [
    Uint32Array.of(0x46546c67, 2, length), Uint32Array.of(json.length, 0x4e4f534a), json,
    Uint32Array.of(end, 0x004e4942), ...parts.map(([data]) => data),
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
