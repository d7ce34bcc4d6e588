// SMPL's skeleton: rotations of joints, and skinning undone.

/// Rotation of an axis-angle, radians, as a quaternion `[x, y, z, w]`.
export function quaternion([x, y, z]) {
  const angle = Math.hypot(x, y, z);
  const scale = angle > 1e-12 ? Math.sin(angle / 2) / angle : 0.5;
  return [x * scale, y * scale, z * scale, Math.cos(angle / 2)];
}

/// The same as a matrix, row-major.
function matrix(turn) {
  const [x, y, z, w] = quaternion(turn);
  return [
    1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),
    2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
    2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y),
  ];
}

const product = (a, b) =>
  Array.from({ length: 9 }, (_, at) => {
    const [row, column] = [3 * Math.floor(at / 3), at % 3];
    return a[row] * b[column] + a[row + 1] * b[column + 3] + a[row + 2] * b[column + 6];
  });

const apply = (m, [x, y, z]) => [0, 3, 6].map(row => m[row] * x + m[row + 1] * y + m[row + 2] * z);

function inverse([a, b, c, d, e, f, g, h, i]) {
  const [p, q, r] = [e * i - f * h, f * g - d * i, d * h - e * g];
  const determinant = a * p + b * q + c * r;
  return [p, c * h - b * i, b * f - c * e, q, a * i - c * g, c * d - a * f, r, b * g - a * h, a * e - b * d]
    .map(x => x / determinant);
}

export const triple = (values, i) => [values[3 * i], values[3 * i + 1], values[3 * i + 2]];

/// Offsets of the vertices `rest` `[vertices, 3]` that skinning takes to `posed`: pose blend shapes.
/// `joints` are those of the rest pose, `posedJoints` those of `pose`, `[joints, 3]`; `influences` has for
/// each set of four the joints and weights of all vertices.
export function poseOffsets({ rest, posed, joints, posedJoints, pose, parents, influences }) {
  const turns = [];
  for (const [joint, parent] of parents.entries()) {
    const own = matrix(triple(pose, joint));
    turns.push(parent === null ? own : product(turns[parent], own));
  }
  const shifts = turns.map((turn, joint) => {
    const turned = apply(turn, triple(joints, joint));
    return triple(posedJoints, joint).map((x, i) => x - turned[i]);
  });
  const offsets = new Float32Array(rest.length);
  for (let v = 0; 3 * v < rest.length; v++) {
    const [blended, shift] = [new Array(9).fill(0), [0, 0, 0]];
    for (const set of influences) {
      for (let k = 4 * v; k < 4 * v + 4; k++) {
        const weight = set.weights[k];
        if (weight === 0) continue;
        turns[set.joints[k]].forEach((x, i) => { blended[i] += weight * x; });
        shifts[set.joints[k]].forEach((x, i) => { shift[i] += weight * x; });
      }
    }
    const at = apply(inverse(blended), triple(posed, v).map((x, i) => x - shift[i]));
    at.forEach((x, i) => { offsets[3 * v + i] = x - rest[3 * v + i]; });
  }
  return offsets;
}
