// Computation of a graph, operator by operator. Tensors are `{ shape, data }`, row-major.

import { readGraph } from "./onnx.js";
import { OPERATORS, VIEWS } from "./operators.js";
import { fuse } from "./sparse.js";

export class Graph {
  #steps;
  #constants;
  #inputs;
  #outputs;
  #free = new Map();

  /// The graph of an ONNX file.
  constructor(bytes) {
    const { nodes, constants, inputs, outputs } = readGraph(bytes);
    const missing = nodes.find(({ operator }) => !OPERATORS[operator]);
    if (missing) throw new Error(`the operator ${missing.operator} is not known`);
    this.#constants = constants;
    this.#inputs = inputs;
    this.#outputs = outputs;
    const variable = this.#fold(nodes);
    for (const tensor of constants.values()) tensor.constant = true;
    this.#steps = this.#plan(fuse(variable, constants, outputs));
  }

  /// Shapes of the inputs by name, with null for the batch.
  get inputs() {
    return this.#inputs;
  }

  /// Outputs by name, for the numbers of each input by name. The outputs are the caller's.
  run(numbers) {
    const values = new Map(this.#constants);
    for (const [name, extents] of this.#inputs) {
      const data = numbers[name];
      const each = extents.slice(1).reduce((a, b) => a * b, 1);
      const batch = data ? data.length / each : 0;
      if (batch < 1 || !Number.isInteger(batch)) {
        throw new Error(`${name}: ${data?.length ?? 0} numbers, expected a multiple of ${each}`);
      }
      values.set(name, { shape: [batch, ...extents.slice(1)], data });
    }
    const take = length => this.#free.get(length)?.pop() ?? new Float32Array(length);
    for (const { apply, node, finished } of this.#steps) {
      const results = apply(node.inputs.map(name => values.get(name)), node, take);
      node.outputs.forEach((name, i) => values.set(name, results[i]));
      for (const name of finished) this.#give(values.get(name).data);
    }
    return Object.fromEntries(this.#outputs.map(name => [name, values.get(name)]));
  }

  /// Computes what depends on constants alone; the other nodes.
  #fold(nodes) {
    return nodes.filter(node => {
      if (!node.inputs.every(name => this.#constants.has(name))) return true;
      const inputs = node.inputs.map(name => this.#constants.get(name));
      const results = OPERATORS[node.operator](inputs, node, length => new Float32Array(length));
      node.outputs.forEach((name, i) => this.#constants.set(name, results[i]));
      return false;
    });
  }

  /// Steps, each with the names of those values whose memory nothing uses afterwards.
  #plan(nodes) {
    const owner = new Map();
    const last = new Map();
    nodes.forEach((node, step) => {
      for (const name of node.inputs) last.set(owner.get(name), step);
      for (const name of node.outputs) {
        const own = VIEWS.has(node.operator) ? owner.get(node.inputs[0]) : name;
        owner.set(name, own);
        last.set(own, step);
      }
    });
    for (const name of this.#outputs) last.delete(owner.get(name));
    const finished = nodes.map(() => []);
    for (const [name, step] of last) if (name) finished[step].push(name);
    return nodes.map((node, step) => ({
      apply: node.apply ?? OPERATORS[node.operator], node, finished: finished[step],
    }));
  }

  #give(data) {
    if (!this.#free.has(data.length)) this.#free.set(data.length, []);
    this.#free.get(data.length).push(data);
  }
}
