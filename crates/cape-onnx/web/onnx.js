// A reader of ONNX files, as far as graphs of cape need it.

const WIRES = { varint: 0, eight: 1, bytes: 2, four: 5 };
const TYPES = { 1: Float32Array, 6: Int32Array, 7: BigInt64Array, 10: Uint16Array };
const HALF = 10;

/// A graph in the order of computation: `nodes`, `constants` and `inputs` by name, names of `outputs`,
/// and `metadata`. Inputs have shapes whose unknown extents are null. Throws if the bytes are no such file.
export function readGraph(bytes) {
  const model = message(bytes);
  const graph = message(one(model, 7, "graph"));
  return {
    nodes: all(graph, 1).map(readNode),
    constants: new Map(all(graph, 5).map(readTensor)),
    inputs: new Map(all(graph, 11).map(readInput)),
    outputs: all(graph, 12).map(bytes => text(message(bytes), 1)),
    metadata: new Map(all(model, 14).map(message).map(entry => [text(entry, 1), text(entry, 2)])),
  };
}

function readNode(bytes) {
  const node = message(bytes);
  return {
    operator: text(node, 4),
    inputs: all(node, 1).map(decode),
    outputs: all(node, 2).map(decode),
    attributes: Object.fromEntries(all(node, 5).map(readAttribute)),
  };
}

function readAttribute(bytes) {
  const attribute = message(bytes);
  const value = attribute.get(2)?.[0] ?? attribute.get(3)?.[0] ?? integers(attribute, 8);
  return [text(attribute, 1), value];
}

function readTensor(bytes) {
  const tensor = message(bytes);
  const [name, shape] = [text(tensor, 8), integers(tensor, 1)];
  const [type] = tensor.get(2) ?? [];
  const raw = one(tensor, 9, `numbers of ${name}`);
  const numbers = TYPES[type];
  const count = shape.reduce((a, b) => a * b, 1);
  if (!numbers || raw.length !== count * numbers.BYTES_PER_ELEMENT) {
    throw new Error(`the table ${name} of the graph is not understood`);
  }
  // A copy, since the file does not align its tables.
  const values = new numbers(raw.slice().buffer);
  if (type === HALF) return [name, { shape, data: singles(values) }];
  return [name, { shape, data: type === 7 ? Array.from(values, Number) : values }];
}

function readInput(bytes) {
  const input = message(bytes);
  const tensor = message(one(message(one(input, 2, "type")), 1, "type"));
  const extents = all(message(one(tensor, 2, "shape")), 1).map(message);
  return [text(input, 1), extents.map(extent => extent.get(1)?.[0] ?? null)];
}

/// Numbers of half precision in single precision.
export function singles(halves) {
  const table = new Float32Array(1 << 16);
  for (let bits = 0; bits < table.length; bits++) {
    const [exponent, fraction] = [(bits >> 10) & 31, bits & 1023];
    const size = exponent === 0 ? fraction * 2 ** -24
      : exponent < 31 ? (1024 + fraction) * 2 ** (exponent - 25)
        : fraction ? NaN : Infinity;
    table[bits] = bits >> 15 ? -size : size;
  }
  const numbers = new Float32Array(halves.length);
  for (let i = 0; i < numbers.length; i++) numbers[i] = table[halves[i]];
  return numbers;
}

/// The fields of a message of protocol buffers: all values of each number.
function message(bytes) {
  const fields = new Map();
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.length);
  let at = 0;
  const varint = () => {
    let value = 0n;
    for (let shift = 0n; ; shift += 7n) {
      const byte = view.getUint8(at++);
      value |= BigInt(byte & 127) << shift;
      if (byte < 128) return Number(BigInt.asIntN(64, value));
    }
  };
  const part = length => {
    if (length < 0 || at + length > bytes.length) throw new Error("the graph is cut off");
    at += length;
    return bytes.subarray(at - length, at);
  };
  while (at < bytes.length) {
    const tag = varint();
    const wire = tag & 7;
    let value;
    if (wire === WIRES.varint) value = varint();
    else if (wire === WIRES.bytes) value = part(varint());
    else if (wire === WIRES.four) value = view.getFloat32((at += 4) - 4, true);
    else if (wire === WIRES.eight) value = view.getFloat64((at += 8) - 8, true);
    else throw new Error("the graph is no ONNX file");
    const number = tag >>> 3;
    if (!fields.has(number)) fields.set(number, []);
    fields.get(number).push(value);
  }
  return fields;
}

const all = (message, field) => message.get(field) ?? [];

function one(message, field, name) {
  const [value] = all(message, field);
  if (value === undefined) throw new Error(`the graph has no ${name}`);
  return value;
}

const decode = bytes => new TextDecoder().decode(bytes);

const text = (message, field) => decode(all(message, field)[0] ?? new Uint8Array());

/// Repeated integers, one by one or packed.
function integers(message, field) {
  return all(message, field).flatMap(value => {
    if (typeof value === "number") return [value];
    const found = [];
    for (let at = 0; at < value.length;) {
      let [number, factor, byte] = [0, 1, 128];
      while (byte >= 128) {
        byte = value[at++];
        number += (byte & 127) * factor;
        factor *= 128;
      }
      found.push(number);
    }
    return found;
  });
}
