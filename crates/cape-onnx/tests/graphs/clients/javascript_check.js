// Compares graphs computed in JavaScript with the library: `node script.js MODEL…` prints a line for each
// graph, with the largest error relative to the norm.

import { readFileSync } from "node:fs";

import { Graph } from "./graph.js";

const MOST = 1e-4;
const GRAPHS = ["decoder", "encoder", "smpl"];

function error(found, expected) {
  if (found.length !== expected.length) return Infinity;
  const difference = found.map((x, i) => x - expected[i]);
  return Math.hypot(...blocks(difference)) / Math.hypot(...blocks(expected));
}

/// Norms of parts, since a function takes only so many arguments.
function blocks(values) {
  const norms = [];
  for (let at = 0; at < values.length; at += 1000) norms.push(Math.hypot(...values.slice(at, at + 1000)));
  return norms;
}

let failed = false;
for (const model of process.argv.slice(2)) {
  for (const name of GRAPHS) {
    const graph = new Graph(new Uint8Array(readFileSync(`${model}/${name}.onnx`)));
    let most = 0;
    for (const batch of [1, 1, 5]) {
      const arrays = JSON.parse(readFileSync(`${model}/batch-${batch}.json`, "utf8"));
      const inputs = Object.fromEntries([...graph.inputs.keys()].map(name => [name, Float32Array.from(arrays[name])]));
      for (const [output, { data }] of Object.entries(graph.run(inputs))) {
        most = Math.max(most, error(data, arrays[output]));
      }
    }
    const fits = most < MOST;
    failed ||= !fits;
    console.log(`${fits ? "ok" : "BAD"} ${model} ${name}: ${most.toExponential(1)}`);
  }
}
process.exit(failed ? 1 : 0);
