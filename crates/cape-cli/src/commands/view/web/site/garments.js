// Colours of skin, shirt and trousers, which are told apart by the steps of displacements at hems, as in
// the program (cape-infer, `GarmentLabels`).

const ramp = (value, low, high) => Math.min(1, Math.max(0, (value - low) / (high - low)));

const mix = (a, b, t) => a.map((x, i) => x + (b[i] - x) * t);

export class Garments {
  #tables;
  #starts;
  #near;
  #couplings;

  /// `tables` has for each vertex `covered`, `trunk`, `known` (flags) and `shares` (of trousers, known
  /// or guessed first), and the numbers and colours of the method.
  constructor(tables, faces) {
    this.#tables = tables;
    const neighbours = Array.from(tables.covered, () => new Set());
    for (let f = 0; f < faces.length; f += 3) {
      for (let i = 0; i < 3; i++) {
        const [a, b] = [faces[f + i], faces[f + ((i + 1) % 3)]];
        neighbours[a].add(b);
        neighbours[b].add(a);
      }
    }
    this.#starts = new Uint32Array(neighbours.length + 1);
    neighbours.forEach((near, v) => { this.#starts[v + 1] = this.#starts[v] + near.size; });
    this.#near = Uint32Array.from(neighbours.flatMap(near => [...near].sort((a, b) => a - b)));
    this.#couplings = new Float32Array(this.#near.length);
  }

  /// Colours of displacements `[vertices, 3]`, metres: bytes `[vertices, 4]`.
  colours(displacement, outfit) {
    const { skin, trousers: below, shirts } = this.#tables;
    this.#couple(displacement);
    const trousers = this.#trousers();
    const cloth = this.#cloth(displacement);
    const colours = new Uint8ClampedArray(4 * cloth.length);
    for (let v = 0; v < cloth.length; v++) {
      const worn = mix(shirts[outfit], below, ramp(trousers[v], 0.4, 0.6));
      const colour = mix(skin, worn, ramp(cloth[v], 0.4, 0.6));
      for (let i = 0; i < 3; i++) colours[4 * v + i] = Math.round(255 * colour[i]);
      colours[4 * v + 3] = 255;
    }
    return colours;
  }

  /// Neighbours are coupled the less, the more their displacements differ. The couplings of each vertex
  /// sum to 1.
  #couple(displacement) {
    const { coupling, step } = this.#tables;
    const [starts, near, couplings] = [this.#starts, this.#near, this.#couplings];
    for (let v = 0; v + 1 < starts.length; v++) {
      let sum = 0;
      for (let at = starts[v]; at < starts[v + 1]; at++) {
        let squared = 0;
        for (let i = 0; i < 3; i++) squared += (displacement[3 * v + i] - displacement[3 * near[at] + i]) ** 2;
        couplings[at] = coupling + 1 / (1 + (squared / (step * step)) ** 2);
        sum += couplings[at];
      }
      for (let at = starts[v]; at < starts[v + 1]; at++) couplings[at] /= sum;
    }
  }

  /// Mean of the values of a vertex's neighbours.
  #mean(v, values) {
    let sum = 0;
    for (let at = this.#starts[v]; at < this.#starts[v + 1]; at++) {
      sum += this.#couplings[at] * values[this.#near[at]];
    }
    return sum;
  }

  #trousers() {
    const { shares: first, known, sweeps } = this.#tables;
    const shares = Float32Array.from(first);
    const unknown = this.#where(v => !known[v]);
    for (let sweep = 0; sweep < sweeps[0]; sweep++) {
      for (const v of unknown) shares[v] = this.#mean(v, shares);
    }
    return shares;
  }

  #cloth(displacement) {
    const { covered, trunk, cloth: [low, high], skin_weight, sweeps } = this.#tables;
    const shares = Float32Array.from(covered, (covered, v) => {
      if (!covered || trunk[v]) return covered;
      return ramp(Math.hypot(...displacement.subarray(3 * v, 3 * v + 3)), low, high);
    });
    const likely = shares.slice();
    const free = this.#where(v => covered[v] && !trunk[v]);
    for (let sweep = 0; sweep < sweeps[1]; sweep++) {
      for (const v of free) {
        const weight = skin_weight + (1 - skin_weight) * likely[v];
        shares[v] = (weight * likely[v] + this.#mean(v, shares)) / (weight + 1);
      }
    }
    return shares;
  }

  #where(test) {
    return Uint32Array.from(this.#tables.covered.keys()).filter(test);
  }
}
