// Codes by seed, as the program draws them.

import { Random } from "./random.js";

/// A code of `latent` numbers for an outfit. `densities` has by the prior's name, and by the outfit's name or
/// "all", the components of a mixture or the first and number of the points of a kernel density and its
/// bandwidth; `points` are those of all kernel densities, and `streams` has a number for each outfit.
export function sampleCode({ prior, temperature, seed, outfit }, { latent, densities, points, streams }) {
  if (!(temperature >= 0)) throw new Error(`temperature ${temperature}: must be at least 0`);
  if (prior === "normal") return normals(new Random(seed, 0), latent).map(x => x * temperature);
  const groups = densities[prior];
  if (!groups) throw new Error(`the model has no prior ${prior}`);
  const random = new Random(seed, streams[outfit]);
  const density = groups[outfit] ?? groups.all;
  if (!density) return normals(random, latent).map(x => x * temperature);
  if (!density.components) {
    const { first, count, bandwidth } = density;
    const start = latent * (first + random.below(count));
    return normals(random, latent).map((x, i) => points[start + i] + bandwidth * temperature * x);
  }
  const { mean, covariance } = choose(density.components, random);
  const noise = normals(random, latent);
  const factor = cholesky(covariance);
  return mean.map((x, i) => x + temperature * factor[i].reduce((sum, value, j) => sum + value * noise[j], 0));
}

const normals = (random, count) => Array.from({ length: count }, () => random.normal());

function choose(components, random) {
  let left = random.uniform() * components.reduce((sum, { weight }) => sum + weight, 0);
  const chosen = components.find(({ weight }) => (left -= weight) < 0);
  return chosen ?? components.findLast(({ weight }) => weight > 0) ?? components[0];
}

/// The rows of the lower triangle L with L Lᵀ = `matrix`.
function cholesky(matrix) {
  const rows = [];
  for (const [i, row] of matrix.entries()) {
    const made = [];
    for (let j = 0; j <= i; j++) {
      let sum = row[j];
      for (let k = 0; k < j; k++) sum -= made[k] * (rows[j] ?? made)[k];
      made.push(i === j ? Math.sqrt(sum) : sum / rows[j][j]);
    }
    rows.push(made);
  }
  return rows;
}
