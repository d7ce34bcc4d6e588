// The model, beside the page: answers the page's requests as the server does.

import { BYTES_PER_VERTEX, HEADER, KINDS, MAGIC } from "./answer.js";
import { Garments } from "./garments.js";
import { Graph } from "./graph.js";
import { sampleCode } from "./prior.js";
import { poseOffsets, triple } from "./skeleton.js";

class Model {
  #tables;
  #faces;
  #decoder;
  #body;
  #garments;
  #covered;
  #influences;
  #registrations;
  #points;
  #maps;

  static async load({ tables, parts }) {
    const found = await Promise.all(Object.entries(parts).map(async ([name, text]) => [name, await unpack(text)]));
    return new Model(tables, Object.fromEntries(found));
  }

  constructor(tables, { decoder, body, faces, flags, shares, joints, weights, registrations, points, maps }) {
    this.#tables = tables;
    this.#decoder = new Graph(decoder);
    this.#body = new Graph(body);
    this.#faces = new Uint32Array(faces.buffer);
    const [covered, trunk, known] = [1, 2, 4].map(bit => flags.map(byte => Number((byte & bit) > 0)));
    const labels = { covered, trunk, known, shares: new Float32Array(shares.buffer) };
    this.#covered = covered;
    this.#garments = new Garments({ ...tables.garments, ...labels }, this.#faces);
    const four = 4 * tables.vertices;
    this.#influences = Array.from({ length: joints.length / four }, (_, i) => ({
      joints: joints.slice(i * four, (i + 1) * four),
      weights: new Float32Array(weights.buffer).slice(i * four, (i + 1) * four),
    }));
    this.#registrations = new Float32Array(registrations.buffer);
    this.#points = new Float32Array(points.buffer);
    this.#maps = new Float32Array(maps.buffer);
  }

  get faces() {
    return this.#faces;
  }

  answer(id, { show, sample, carry, encode, motion }) {
    if (show) return this.#people(id, show);
    if (sample) return JSON.stringify({ id, z: sampleCode(sample, { ...this.#tables, points: this.#points }) });
    if (carry) return JSON.stringify({ id, z: this.#carried(carry) });
    if (encode !== undefined) {
      const { z, betas, pose, outfit } = this.#registration(encode);
      return JSON.stringify({ id, z, betas, pose, outfit });
    }
    const found = motion && this.#tables.motions[motion.name];
    if (found) return JSON.stringify({ id, ...found });
    throw new Error("not available without the program");
  }

  /// Code of clothing in another outfit.
  #carried({ z, from, to }) {
    const number = this.#tables.transports[from]?.[to];
    if (number === undefined) return z;
    const [size, start] = [z.length, number * z.length * (z.length + 1)];
    return z.map((_, i) => z.reduce(
      (sum, x, j) => sum + this.#maps[start + i * size + j] * x,
      this.#maps[start + size * size + i],
    ));
  }

  /// What glTF stores of the clothed body of a picture.
  figure({ show }) {
    const { z, betas, pose, outfit } = this.#shown(show);
    const displacement = this.#decode(z, pose, outfit);
    const at = pose => this.#pose(betas, pose, displacement);
    const [{ vertices: rest, joints }, posed] = [at(new Array(pose.length).fill(0)), at(pose)];
    const { parents } = this.#tables;
    const influences = this.#influences;
    const skinned = { rest, posed: posed.vertices, joints, posedJoints: posed.joints, pose, parents, influences };
    const colours = this.#garments.colours(displacement, outfit);
    return { rest, offsets: poseOffsets(skinned), joints, parents, pose, influences, colours };
  }

  /// Code, shape, pose and outfit of a picture; with the ground truth, those of a registration.
  #shown({ z, betas, pose, outfit, layers, truth }) {
    if (layers.includes("truth")) return this.#registration(truth);
    if (z.length !== this.#tables.latent) throw new Error(`z has ${z.length} values, expected ${this.#tables.latent}`);
    return { z, betas, pose, outfit };
  }

  #registration(number) {
    const { registrations, vertices } = this.#tables;
    if (!registrations[number]) {
      throw new Error(`registration ${number}: the page has ${registrations.length}`);
    }
    const displacement = this.#registrations.slice(3 * vertices * number, 3 * vertices * (number + 1));
    return { ...registrations[number], displacement };
  }

  /// The picture's bodies, laid out as by the server.
  #people(id, show) {
    const { z, betas, pose, outfit, displacement: truth } = this.#shown(show);
    const kinds = [...new Set(show.layers)];
    const { vertices } = this.#tables;
    const bytes = new ArrayBuffer(HEADER + kinds.length * (4 + BYTES_PER_VERTEX * vertices));
    new Uint32Array(bytes).set([MAGIC, id, kinds.length, vertices]);
    let offset = HEADER;
    const put = (type, values) => {
      new type(bytes, offset, values.length).set(values);
      offset += values.length * type.BYTES_PER_ELEMENT;
    };
    const posed = displacement => this.#pose(betas, pose, displacement).vertices;
    const registered = truth && posed(truth);
    for (const kind of kinds) {
      const displacement = { clothed: () => this.#decode(z, pose, outfit), truth: () => truth }[kind]?.()
        ?? new Float32Array(3 * vertices);
      const positions = kind === "truth" ? registered : posed(displacement);
      put(Uint32Array, [KINDS.indexOf(kind)]);
      put(Float32Array, positions);
      put(Float32Array, this.#lengths(displacement));
      put(Float32Array, kind === "clothed" && truth ? this.#errors(positions, registered) : new Float32Array(vertices));
      put(Uint8Array, kind === "body" ? this.#skin() : this.#garments.colours(displacement, outfit));
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
    const { vertices, joints } = this.#body.run({ betas: shape, displacement, ...numbers });
    return { vertices: vertices.data, joints: joints.data };
  }

  #lengths(displacement) {
    return Float32Array.from(this.#covered, (covered, v) =>
      covered && Math.hypot(displacement[3 * v], displacement[3 * v + 1], displacement[3 * v + 2]));
  }

  #errors(positions, registered) {
    return Float32Array.from(this.#covered, (covered, v) => {
      const [a, b] = [triple(positions, v), triple(registered, v)];
      return covered && Math.hypot(...a.map((x, i) => x - b[i]));
    });
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

/// The first message is the model; those that follow are requests as text, or for a figure.
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
  if (data.figure) {
    try {
      self.postMessage(model.figure(data.figure));
    } catch (error) {
      self.postMessage({ error: error.message });
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
