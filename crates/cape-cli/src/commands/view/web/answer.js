// The binary answers of the server.

const MAGIC = 0x45504143;
const HEADER = 16;
const BYTES_PER_VERTEX = 24;
const KINDS = ["clothed", "body", "truth"];

/// The layers as views into `buffer`, from left to right as they are shown.
export function readAnswer(buffer) {
  const words = new DataView(buffer);
  if (buffer.byteLength < HEADER || words.getUint32(0, true) !== MAGIC) {
    throw new Error("the server's answer is not understood");
  }
  const [id, count, vertices] = [4, 8, 12].map(offset => words.getUint32(offset, true));
  if (buffer.byteLength !== HEADER + count * (4 + BYTES_PER_VERTEX * vertices)) {
    throw new Error("the server's answer is incomplete");
  }
  let offset = HEADER;
  const take = (type, length) => {
    const part = new type(buffer, offset, length);
    offset += part.byteLength;
    return part;
  };
  const layers = Array.from({ length: count }, () => ({
    kind: KINDS[take(Uint32Array, 1)[0]],
    positions: take(Float32Array, 3 * vertices),
    displacement: take(Float32Array, vertices),
    error: take(Float32Array, vertices),
    colours: take(Uint8Array, 4 * vertices),
  }));
  const place = ["body", "clothed", "truth"];
  layers.sort((a, b) => place.indexOf(a.kind) - place.indexOf(b.kind));
  return { id, layers };
}
