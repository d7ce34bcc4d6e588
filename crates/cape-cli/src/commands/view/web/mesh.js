// What is computed of a mesh before it is drawn.

/// Unit normals of the vertices, from the normals of the faces around weighted by their areas.
export function smoothNormals(positions, faces) {
  const normals = new Float32Array(positions.length);
  for (let f = 0; f < faces.length; f += 3) {
    const [a, b, c] = [faces[f] * 3, faces[f + 1] * 3, faces[f + 2] * 3];
    const ux = positions[b] - positions[a];
    const uy = positions[b + 1] - positions[a + 1];
    const uz = positions[b + 2] - positions[a + 2];
    const vx = positions[c] - positions[a];
    const vy = positions[c + 1] - positions[a + 1];
    const vz = positions[c + 2] - positions[a + 2];
    const [x, y, z] = [uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx];
    for (const corner of [a, b, c]) {
      normals[corner] += x;
      normals[corner + 1] += y;
      normals[corner + 2] += z;
    }
  }
  for (let i = 0; i < normals.length; i += 3) {
    const length = Math.hypot(normals[i], normals[i + 1], normals[i + 2]) || 1;
    normals[i] /= length;
    normals[i + 1] /= length;
    normals[i + 2] /= length;
  }
  return normals;
}

/// Each edge of the faces once, as pairs of vertices.
export function edges(faces, vertices) {
  const seen = new Set();
  const pairs = [];
  for (let f = 0; f < faces.length; f += 3) {
    for (let i = 0; i < 3; i++) {
      const [a, b] = [faces[f + i], faces[f + ((i + 1) % 3)]];
      const key = Math.min(a, b) * vertices + Math.max(a, b);
      if (seen.has(key)) continue;
      seen.add(key);
      pairs.push(a, b);
    }
  }
  return new Uint32Array(pairs);
}

/// The box around the points.
export function bounds(positions) {
  const minimum = [Infinity, Infinity, Infinity];
  const maximum = [-Infinity, -Infinity, -Infinity];
  for (let i = 0; i < positions.length; i++) {
    minimum[i % 3] = Math.min(minimum[i % 3], positions[i]);
    maximum[i % 3] = Math.max(maximum[i % 3], positions[i]);
  }
  return { minimum, maximum };
}

/// The box around two boxes.
export const union = (a, b) => ({
  minimum: a.minimum.map((low, i) => Math.min(low, b.minimum[i])),
  maximum: a.maximum.map((high, i) => Math.max(high, b.maximum[i])),
});

/// True if the box lies within another one that is larger by `slack` all around.
export const within = (box, outer, slack) => [0, 1, 2].every(i =>
  box.minimum[i] >= outer.minimum[i] - slack && box.maximum[i] <= outer.maximum[i] + slack);

/// Mean and largest of some values.
export function statistics(values) {
  let [sum, largest] = [0, 0];
  for (const value of values) {
    sum += value;
    largest = Math.max(largest, value);
  }
  return { mean: sum / values.length, largest };
}
