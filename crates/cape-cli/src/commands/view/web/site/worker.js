// The model, beside the page: answers the page's requests as the server does.

import { BYTES_PER_VERTEX, HEADER, KINDS, MAGIC } from "./answer.js";
import { Garments } from "./garments.js";
import { Graph } from "./graph.js";
import { sampleCode } from "./prior.js";

class Model {
  #tables;
  #faces;
  #decoder;
  #body;
  #garments;
  #covered;

  static async load({ tables, parts }) {
    const found = await Promise.all(Object.entries(parts).map(async ([name, text]) => [name, await unpack(text)]));
    return new Model(tables, Object.fromEntries(found));
  }

  constructor(tables, { decoder, body, faces, flags, shares }) {
    this.#tables = tables;
    this.#decoder = new Graph(decoder);
    this.#body = new Graph(body);
    this.#faces = new Uint32Array(faces.buffer);
    const [covered, trunk, known] = [1, 2, 4].map(bit => flags.map(byte => Number((byte & bit) > 0)));
    const labels = { covered, trunk, known, shares: new Float32Array(shares.buffer) };
    this.#covered = covered;
    this.#garments = new Garments({ ...tables.garments, ...labels }, this.#faces);
  }

  get faces() {
    return this.#faces;
  }

  answer(id, { show, sample, motion }) {
    if (show) return this.#people(id, show);
    if (sample) return JSON.stringify({ id, z: sampleCode(sample, this.#tables) });
    const found = motion && this.#tables.motions[motion.name];
    if (found) return JSON.stringify({ id, ...found });
    throw new Error("not available without the program");
  }

  /// The picture's bodies, laid out as by the server.
  #people(id, { z, betas, pose, outfit, layers }) {
    if (z.length !== this.#tables.latent) throw new Error(`z has ${z.length} values, expected ${this.#tables.latent}`);
    const kinds = [...new Set(layers)].filter(kind => kind !== "truth");
    const { vertices } = this.#tables;
    const bytes = new ArrayBuffer(HEADER + kinds.length * (4 + BYTES_PER_VERTEX * vertices));
    new Uint32Array(bytes).set([MAGIC, id, kinds.length, vertices]);
    let offset = HEADER;
    const put = (type, values) => {
      new type(bytes, offset, values.length).set(values);
      offset += values.length * type.BYTES_PER_ELEMENT;
    };
    for (const kind of kinds) {
      const clothed = kind === "clothed";
      const displacement = clothed ? this.#decode(z, pose, outfit) : new Float32Array(3 * vertices);
      put(Uint32Array, [KINDS.indexOf(kind)]);
      put(Float32Array, this.#pose(betas, pose, displacement));
      put(Float32Array, this.#lengths(displacement));
      offset += 4 * vertices;
      put(Uint8Array, clothed ? this.#garments.colours(displacement, outfit) : this.#skin());
    }
    return bytes;
  }

  #decode(z, pose, outfit) {
    const label = this.#tables.outfits.map(name => Number(name === outfit));
    if (!label.includes(1)) throw new Error(`unknown outfit ${outfit}`);
    const numbers = { code: z, pose, outfit: label };
    return this.#decoder.run(singles(numbers)).displacement.data;
  }

  #pose(betas, pose, displacement) {
    const shape = new Float32Array(this.#body.inputs.get("betas")[1]);
    shape.set(betas);
    const numbers = singles({ pose, translation: [0, 0, 0] });
    return this.#body.run({ betas: shape, displacement, ...numbers }).vertices.data;
  }

  #lengths(displacement) {
    return Float32Array.from(this.#covered, (covered, v) =>
      covered && Math.hypot(displacement[3 * v], displacement[3 * v + 1], displacement[3 * v + 2]));
  }

  #skin() {
    const colour = [...this.#tables.garments.skin.map(x => Math.round(255 * x)), 255];
    return Uint8Array.from({ length: 4 * this.#tables.vertices }, (_, i) => colour[i % 4]);
  }
}

const singles = numbers =>
  Object.fromEntries(Object.entries(numbers).map(([name, values]) => [name, Float32Array.from(values)]));

/// The bytes of base64 of gzip.
async function unpack(text) {
  const letters = atob(text);
  const packed = new Uint8Array(letters.length);
  for (let i = 0; i < packed.length; i++) packed[i] = letters.charCodeAt(i);
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

let model = null;

/// The first message is the model; those that follow are requests as text.
self.onmessage = async ({ data }) => {
  if (!model) {
    try {
      model = await Model.load(data);
      self.postMessage({ faces: model.faces });
    } catch (error) {
      self.postMessage({ error: `The model cannot be read: ${error.message}` });
    }
    return;
  }
  const { id, ...question } = JSON.parse(data);
  try {
    const answer = model.answer(id, question);
    self.postMessage(answer, typeof answer === "string" ? [] : [answer]);
  } catch (error) {
    self.postMessage(JSON.stringify({ id, error: error.message }));
  }
};
