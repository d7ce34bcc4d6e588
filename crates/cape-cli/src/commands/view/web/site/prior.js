// Codes by seed, as the program draws them.

import { Random } from "./random.js";

/// A code of `latent` numbers for an outfit. `mixtures` has components by the outfit's name, or by "all";
/// `streams` a number for each outfit.
export function sampleCode({ prior, temperature, seed, outfit }, { latent, mixtures, streams }) {
  if (!(temperature >= 0)) throw new Error(`temperature ${temperature}: must be at least 0`);
  if (prior === "normal") return normals(new Random(seed, 0), latent).map(x => x * temperature);
  const random = new Random(seed, streams[outfit]);
  const components = mixtures[outfit] ?? mixtures.all;
  if (!components) return normals(random, latent).map(x => x * temperature);
  const { mean, covariance } = choose(components, random);
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
