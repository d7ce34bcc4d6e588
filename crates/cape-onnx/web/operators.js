// The operators of ONNX that graphs of cape use: each takes its inputs, the node, and a function that
// gives memory of any content, and returns its outputs.

import { matrixProduct } from "./products.js";

const size = shape => shape.reduce((a, b) => a * b, 1);

/// Operators whose output is their first input with another shape.
export const VIEWS = new Set(["Cast", "Identity", "Reshape"]);

export const OPERATORS = {
  Add: broadcast((out, o, n, x, a, da, y, b, db) => {
    for (let i = 0; i < n; i++, a += da, b += db) out[o + i] = x[a] + y[b];
  }),
  Sub: broadcast((out, o, n, x, a, da, y, b, db) => {
    for (let i = 0; i < n; i++, a += da, b += db) out[o + i] = x[a] - y[b];
  }),
  Mul: broadcast((out, o, n, x, a, da, y, b, db) => {
    for (let i = 0; i < n; i++, a += da, b += db) out[o + i] = x[a] * y[b];
  }),
  Div: broadcast((out, o, n, x, a, da, y, b, db) => {
    for (let i = 0; i < n; i++, a += da, b += db) out[o + i] = x[a] / y[b];
  }),
  Max: broadcast((out, o, n, x, a, da, y, b, db) => {
    for (let i = 0; i < n; i++, a += da, b += db) out[o + i] = Math.max(x[a], y[b]);
  }),
  Expand([x, shape], node, take) {
    return copy([x, { shape: shape.data, data: x.data }], node, take);
  },
  Relu: each((out, x) => {
    for (let i = 0; i < out.length; i++) out[i] = x[i] > 0 ? x[i] : 0;
  }),
  LeakyRelu: each((out, x, { alpha }) => {
    for (let i = 0; i < out.length; i++) out[i] = x[i] > 0 ? x[i] : alpha * x[i];
  }),
  Sqrt: each((out, x) => {
    for (let i = 0; i < out.length; i++) out[i] = Math.sqrt(x[i]);
  }),
  Sin: each((out, x) => {
    for (let i = 0; i < out.length; i++) out[i] = Math.sin(x[i]);
  }),
  Cast: ([x]) => [x],
  Identity: ([x]) => [x],
  Reshape([{ shape, data }, extents]) {
    const known = extents.data.reduce((a, b) => (b < 0 ? a : a * b), 1);
    return [{ shape: Array.from(extents.data, extent => (extent < 0 ? size(shape) / known : extent)), data }];
  },
  ReduceSum: (inputs, node, take) => [reduce(inputs, node, take, false)],
  ReduceMean: (inputs, node, take) => [reduce(inputs, node, take, true)],
  Gather,
  Concat,
  Split,
  Transpose,
  Pad,
  MatMul,
};

const copy = broadcast((out, o, n, x, a, da) => {
  for (let i = 0; i < n; i++, a += da) out[o + i] = x[a];
});

/// An operator of two inputs of which either is repeated along axes of extent 1. `row` computes `n`
/// numbers with steps `da` and `db` between those of the inputs.
function broadcast(row) {
  return ([a, b], node, take) => {
    const { shape, loops } = alignShapes(a.shape, b.shape);
    const out = take(size(shape));
    const [inner, ...outer] = loops;
    const { n, a: da, b: db } = inner ?? { n: 1, a: 0, b: 0 };
    const counts = outer.map(() => 0);
    let [from, to] = [0, 0];
    for (let o = 0; o < out.length; o += n) {
      row(out, o, n, a.data, from, da, b.data, to, db);
      for (let i = 0; i < outer.length; i++) {
        from += outer[i].a;
        to += outer[i].b;
        if (++counts[i] < outer[i].n) break;
        from -= outer[i].a * outer[i].n;
        to -= outer[i].b * outer[i].n;
        counts[i] = 0;
      }
    }
    return [{ shape, data: out }];
  };
}

/// The shape of the result, and loops from the innermost to the outermost with their extents and the
/// steps in both inputs.
function alignShapes(a, b) {
  const rank = Math.max(a.length, b.length);
  const [shape, loops] = [new Array(rank), []];
  let [stepA, stepB] = [1, 1];
  for (let axis = rank - 1; axis >= 0; axis--) {
    const x = a[axis - rank + a.length] ?? 1;
    const y = b[axis - rank + b.length] ?? 1;
    if (x !== y && x !== 1 && y !== 1) throw new Error(`shapes [${a}] and [${b}] do not go together`);
    const n = x === 1 ? y : x;
    shape[axis] = n;
    if (n > 1) {
      const loop = { n, a: x > 1 ? stepA : 0, b: y > 1 ? stepB : 0 };
      const inner = loops.at(-1);
      if (inner && loop.a === inner.n * inner.a && loop.b === inner.n * inner.b) inner.n *= n;
      else loops.push(loop);
    }
    stepA *= x;
    stepB *= y;
  }
  return { shape, loops };
}

function each(compute) {
  return ([{ shape, data }], { attributes }, take) => {
    const out = take(data.length);
    compute(out, data, attributes);
    return [{ shape, data: out }];
  };
}

/// Extents before, at and after an axis.
const around = (shape, axis) => [size(shape.slice(0, axis)), shape[axis], size(shape.slice(axis + 1))];

function reduce([{ shape, data }, axes], { attributes }, take, mean) {
  const axis = Number(axes.data[0]);
  const [outer, n, inner] = around(shape, axis);
  const out = take(outer * inner);
  const sums = new Float64Array(inner);
  const factor = mean ? 1 / n : 1;
  for (let o = 0, at = 0; o < outer; o++) {
    sums.fill(0);
    for (let k = 0; k < n; k++) for (let i = 0; i < inner; i++) sums[i] += data[at++];
    for (let i = 0; i < inner; i++) out[o * inner + i] = sums[i] * factor;
  }
  const kept = attributes.keepdims === 0 ? [] : [1];
  return { shape: [...shape.slice(0, axis), ...kept, ...shape.slice(axis + 1)], data: out };
}

function Gather([{ shape, data }, rows], { attributes: { axis } }, take) {
  const [outer, n, inner] = around(shape, axis);
  const result = [...shape.slice(0, axis), ...rows.shape, ...shape.slice(axis + 1)];
  const out = take(size(result));
  for (let o = 0, to = 0; o < outer; o++) {
    for (const row of rows.data) {
      const from = (o * n + row) * inner;
      for (let i = 0; i < inner; i++) out[to++] = data[from + i];
    }
  }
  return [{ shape: result, data: out }];
}

function Concat(inputs, { attributes: { axis } }, take) {
  const [{ shape }] = inputs;
  const total = inputs.reduce((sum, input) => sum + input.shape[axis], 0);
  const result = shape.with(axis, total);
  const out = take(size(result));
  const [outer, , inner] = around(result, axis);
  let start = 0;
  for (const { shape, data } of inputs) {
    const length = shape[axis] * inner;
    for (let o = 0; o < outer; o++) {
      out.set(data.subarray(o * length, (o + 1) * length), o * total * inner + start);
    }
    start += length;
  }
  return [{ shape: result, data: out }];
}

function Split([{ shape, data }], { attributes: { axis, num_outputs: parts } }, take) {
  const [outer, n, inner] = around(shape, axis);
  const length = (n / parts) * inner;
  return Array.from({ length: parts }, (_, part) => {
    const out = take(outer * length);
    for (let o = 0, to = 0; o < outer; o++) {
      const from = o * n * inner + part * length;
      for (let i = 0; i < length; i++) out[to++] = data[from + i];
    }
    return { shape: shape.with(axis, n / parts), data: out };
  });
}

const steps = shape => shape.map((_, axis) => size(shape.slice(axis + 1)));

/// Calls `visit` with the offset of each entry of a tensor, in order, where its axes have `strides`.
function walk(shape, strides, visit) {
  const [place, count] = [shape.map(() => 0), size(shape)];
  for (let i = 0, at = 0; i < count; i++) {
    visit(i, at);
    for (let axis = shape.length - 1; axis >= 0; axis--) {
      at += strides[axis];
      if (++place[axis] < shape[axis]) break;
      at -= strides[axis] * shape[axis];
      place[axis] = 0;
    }
  }
}

function Transpose([{ shape, data }], { attributes: { perm } }, take) {
  const result = perm.map(axis => shape[axis]);
  const strides = steps(shape);
  const out = take(data.length);
  walk(result, perm.map(axis => strides[axis]), (i, at) => { out[i] = data[at]; });
  return [{ shape: result, data: out }];
}

/// Zeros before and after the entries along each axis.
function Pad([{ shape, data }, pads], node, take) {
  const rank = shape.length;
  const result = shape.map((extent, axis) => pads.data[axis] + extent + pads.data[axis + rank]);
  const strides = steps(result);
  const start = strides.reduce((sum, stride, axis) => sum + stride * pads.data[axis], 0);
  const out = take(size(result)).fill(0);
  walk(shape, strides, (i, at) => { out[start + at] = data[i]; });
  return [{ shape: result, data: out }];
}

/// Products of the last two axes; either input may be one matrix for all.
function MatMul([a, b], node, take) {
  const [m, k, n] = [a.shape.at(-2), a.shape.at(-1), b.shape.at(-1)];
  const [before, others] = [a.shape.slice(0, -2), b.shape.slice(0, -2)];
  const shape = [...(others.length > 0 ? others : before), m, n];
  const out = take(size(shape));
  if (others.length === 0) {
    matrixProduct(out, a.data, b.data, { m: size(before) * m, k, n }, b.constant);
    return [{ shape, data: out }];
  }
  const part = (data, length, at) => data.subarray(at * length, (at + 1) * length);
  for (let at = 0; at < size(others); at++) {
    const left = before.length > 0 ? part(a.data, m * k, at) : a.data;
    matrixProduct(part(out, m * n, at), left, part(b.data, k * n, at), { m, k, n }, false);
  }
  return [{ shape, data: out }];
}
