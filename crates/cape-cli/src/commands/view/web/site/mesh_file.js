// Files of a mesh: OBJ and PLY.

const FORMATS = { obj, ply };

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
