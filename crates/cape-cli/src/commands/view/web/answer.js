// The binary answers, of the server or of a worker in its place.

export const MAGIC = 0x45504143;
export const HEADER = 16;
export const BYTES_PER_VERTEX = 24;
export const KINDS = ["clothed", "body", "truth"];

/// The layers as views into `buffer`, from left to right as they are shown.
export function readAnswer(buffer) {
  const words = new DataView(buffer);
  if (buffer.byteLength < HEADER || words.getUint32(0, true) !== MAGIC) {
    throw new Error("the answer is not understood");
  }
  const [id, count, vertices] = [4, 8, 12].map(offset => words.getUint32(offset, true));
  if (buffer.byteLength !== HEADER + count * (4 + BYTES_PER_VERTEX * vertices)) {
    throw new Error("the answer is incomplete");
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
