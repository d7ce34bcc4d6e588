// Products of sparse matrices with tensors `[batch, vertices, channels]`, which graphs spell out as rows
// that are gathered, weighted, summed, concatenated and brought into order: each as one step.

/// The nodes with sparse products in the place of what spells them out.
export function fuse(nodes, constants, outputs) {
  const source = new Map(nodes.flatMap(node => node.outputs.map(name => [name, node])));
  const found = new Map();

  /// The matrix that makes the value of a value `from`; null if no matrix does.
  const matrixOf = name => {
    if (!found.has(name)) found.set(name, source.has(name) ? make(source.get(name)) : null);
    return found.get(name);
  };
  const make = ({ operator, inputs, attributes }) => {
    const [first, second] = inputs;
    const constant = constants.get(second);
    if (operator === "Mul" && constant?.shape.length === 2 && constant.shape[1] === 1) {
      return scaled(matrixOf(first) ?? identity(first, constant.data.length), constant.data);
    }
    if (operator === "Gather" && attributes.axis === 1 && constant?.shape.length === 1) {
      return selected(matrixOf(first), first, constant.data);
    }
    if (operator === "ReduceSum" && attributes.keepdims === 0 && constant?.data[0] === 2) return summed(first);
    if (operator === "Concat" && attributes.axis === 1) return stacked(inputs.map(matrixOf));
    return null;
  };
  /// Sums of weighted rows; null if the value is another one.
  const summed = name => {
    let [node, weights] = [source.get(name), null];
    if (node?.operator === "Mul") {
      weights = constants.get(node.inputs[1]);
      node = weights && source.get(node.inputs[0]);
    }
    const places = constants.get(node?.inputs[1]);
    if (node?.operator !== "Gather" || node.attributes.axis !== 1 || places?.shape.length !== 2) return null;
    const [count, width] = places.shape;
    if (weights && weights.shape.join() !== `${count},${width},1`) return null;
    const starts = Uint32Array.from({ length: count + 1 }, (_, row) => row * width);
    return of(node.inputs[0], { starts, columns: places.data, weights: weights?.data ?? ones(places.data) });
  };
  /// The matrix, of the value that its own input is made of if that is scaled only.
  const of = (from, matrix) => {
    const inner = matrixOf(from);
    if (!inner || inner.gathers) return { ...matrix, from, gathers: true };
    const weights = matrix.weights.map((weight, k) => weight * inner.weights[matrix.columns[k]]);
    return { ...matrix, weights, from: inner.from, gathers: true };
  };
  const selected = (matrix, from, rows) => {
    const all = matrix?.gathers ? matrix : null;
    if (!all) {
      const starts = Uint32Array.from({ length: rows.length + 1 }, (_, row) => row);
      return of(from, { starts, columns: rows, weights: ones(rows) });
    }
    const order = Array.from(rows, row => [all.starts[row], all.starts[row + 1]]);
    const take = values => joined(order.map(([start, end]) => values.subarray(start, end)));
    const lengths = order.map(([start, end]) => end - start);
    return { ...all, starts: sums(lengths), columns: take(all.columns), weights: take(all.weights) };
  };

  const steps = nodes.map(node => {
    const matrix = matrixOf(node.outputs[0]);
    if (!matrix?.gathers) return node;
    return { operator: "SparseProduct", apply: product, inputs: [matrix.from], outputs: node.outputs, attributes: matrix };
  });
  return used(steps, outputs);
}

const ones = values => new Float32Array(values.length).fill(1);

/// Arrays of one type after each other.
function joined(parts) {
  const all = new parts[0].constructor(parts.reduce((sum, { length }) => sum + length, 0));
  let at = 0;
  for (const part of parts) {
    all.set(part, at);
    at += part.length;
  }
  return all;
}

/// The starts of parts of some lengths, and the end.
function sums(lengths) {
  const starts = new Uint32Array(lengths.length + 1);
  lengths.forEach((length, i) => { starts[i + 1] = starts[i] + length; });
  return starts;
}

const identity = (from, count) => ({
  from, gathers: false, starts: Uint32Array.from({ length: count + 1 }, (_, row) => row),
  columns: Uint32Array.from({ length: count }, (_, row) => row), weights: new Float32Array(count).fill(1),
});

function scaled(matrix, factors) {
  const weights = matrix.weights.slice();
  for (let row = 0; row < factors.length; row++) {
    for (let k = matrix.starts[row]; k < matrix.starts[row + 1]; k++) weights[k] *= factors[row];
  }
  return { ...matrix, weights };
}

/// Matrices of the same value below each other; null if they are of several.
function stacked(parts) {
  const [first] = parts;
  if (!parts.every(part => part?.gathers && part.from === first.from)) return null;
  const lengths = parts.flatMap(({ starts }) => Array.from(starts.subarray(1), (end, row) => end - starts[row]));
  return {
    ...first, starts: sums(lengths),
    columns: joined(parts.map(({ columns }) => columns)), weights: joined(parts.map(({ weights }) => weights)),
  };
}

/// The nodes that outputs depend on.
function used(nodes, outputs) {
  const needed = new Set(outputs);
  return nodes.toReversed().filter(node => {
    const needs = node.outputs.some(name => needed.has(name));
    if (needs) node.inputs.forEach(name => needed.add(name));
    return needs;
  }).toReversed();
}

function product([{ shape: [batch, n, ...rest], data }], { attributes: { starts, columns, weights } }, take) {
  const count = starts.length - 1;
  const inner = rest.reduce((a, b) => a * b, 1);
  const out = take(batch * count * inner);
  for (let b = 0, to = 0; b < batch; b++) {
    for (let row = 0; row < count; row++, to += inner) {
      const end = starts[row + 1];
      for (let k = starts[row]; k < end; k++) {
        const from = (b * n + columns[k]) * inner;
        const weight = weights[k];
        if (k === starts[row]) for (let i = 0; i < inner; i++) out[to + i] = weight * data[from + i];
        else for (let i = 0; i < inner; i++) out[to + i] += weight * data[from + i];
      }
      if (starts[row] === end) out.fill(0, to, to + inner);
    }
  }
  return [{ shape: [batch, count, ...rest], data: out }];
}
