// The random numbers of the program: ChaCha with 8 rounds, and normal numbers by the ziggurat method of
// Doornik (2005), so that a seed means the same clothing here and there.

const ROUNDS = 8;
const MASK = (1n << 64n) - 1n;
/// Start of the tail and area of each of the ziggurat's 256 layers.
const TAIL = 3.654152885361008796;
const AREA = 0.00492867323399;
const density = x => Math.exp((-x * x) / 2);
const EDGES = edges();

/// Right edges of the layers, from the lowest to the top.
function edges() {
  const found = [AREA / density(TAIL), TAIL];
  for (let i = 2; i < 256; i++) {
    const x = found[i - 1];
    found.push(Math.sqrt(-2 * Math.log(AREA / x + density(x))));
  }
  return [...found, 0];
}

/// The 32 bytes of a seed as words, by steps of a PCG.
function expand(seed) {
  let state = BigInt(seed);
  return Array.from({ length: 8 }, () => {
    state = (state * 6364136223846793005n + 11634580027462260723n) & MASK;
    const shifted = Number((((state >> 18n) ^ state) >> 27n) & 0xffffffffn);
    const turn = Number(state >> 59n);
    return ((shifted >>> turn) | (shifted << (32 - turn) % 32)) >>> 0;
  });
}

export class Random {
  #state;
  #block = new Uint32Array(16);
  #used = 16;

  /// `seed` and `stream` are whole numbers.
  constructor(seed, stream) {
    this.#state = Uint32Array.of(0x61707865, 0x3320646e, 0x79622d32, 0x6b206574, ...expand(seed), 0, 0, stream, 0);
  }

  /// Uniform in [0, 1).
  uniform() {
    const [low, high] = this.#words();
    return (high * 2 ** 21 + (low >>> 11)) * 2 ** -53;
  }

  /// Uniform among the whole numbers below `count`, by Canon's method.
  below(count) {
    const product = () => BigInt(this.#word()) * BigInt(count);
    const drawn = product();
    const [whole, rest] = [Number(drawn >> 32n), Number(drawn & 0xffffffffn)];
    if (rest <= 2 ** 32 - count) return whole;
    return whole + Number(rest + Number(product() >> 32n) >= 2 ** 32);
  }

  /// Standard normal.
  normal() {
    for (;;) {
      const [low, high] = this.#words();
      const layer = low & 255;
      const u = (high * 2 ** 20 + (low >>> 12)) * 2 ** -51 - 1;
      const x = u * EDGES[layer];
      if (Math.abs(x) < EDGES[layer + 1]) return x;
      if (layer === 0) return this.#tail(u);
      const [top, bottom] = [density(EDGES[layer + 1]), density(EDGES[layer])];
      if (top + (bottom - top) * this.uniform() < density(x)) return x;
    }
  }

  #tail(side) {
    let [x, y] = [1, 0];
    while (-2 * y < x * x) {
      x = Math.log(this.#open()) / TAIL;
      y = Math.log(this.#open());
    }
    return side < 0 ? x - TAIL : TAIL - x;
  }

  /// Uniform in (0, 1).
  #open() {
    const [low, high] = this.#words();
    return (high * 2 ** 20 + (low >>> 12)) * 2 ** -52 + 2 ** -53;
  }

  #words() {
    return [this.#word(), this.#word()];
  }

  #word() {
    if (this.#used === 16) this.#next();
    return this.#block[this.#used++];
  }

  #next() {
    const x = this.#block;
    x.set(this.#state);
    const turn = (i, bits) => { x[i] = (x[i] << bits) | (x[i] >>> (32 - bits)); };
    const quarter = (a, b, c, d) => {
      for (const [to, from, other, bits] of [[a, b, d, 16], [c, d, b, 12], [a, b, d, 8], [c, d, b, 7]]) {
        x[to] += x[from];
        x[other] ^= x[to];
        turn(other, bits);
      }
    };
    for (let round = 0; round < ROUNDS; round += 2) {
      for (let i = 0; i < 4; i++) quarter(i, 4 + i, 8 + i, 12 + i);
      for (let i = 0; i < 4; i++) quarter(i, 4 + ((i + 1) % 4), 8 + ((i + 2) % 4), 12 + ((i + 3) % 4));
    }
    for (let i = 0; i < 16; i++) x[i] += this.#state[i];
    if (++this.#state[12] === 0) this.#state[13]++;
    this.#used = 0;
  }
}
