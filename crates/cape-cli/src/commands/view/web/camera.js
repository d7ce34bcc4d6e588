// A camera that circles a point above the floor.

import { multiply, perspective, view } from "./matrix.js";

const FIELD_OF_VIEW = Math.PI / 6;
const TANGENT = Math.tan(FIELD_OF_VIEW / 2);
const ELEVATIONS = [-0.15, 1.5];
const DISTANCES = [0.3, 40];
const RESTING = { azimuth: 0.0, elevation: 0.06 };
const TRANSITION = 280;

const AZIMUTHS = { front: 0, left: Math.PI / 2, back: Math.PI, right: -Math.PI / 2 };

const clamp = (value, [low, high]) => Math.min(high, Math.max(low, value));
const wrap = angle => angle - 2 * Math.PI * Math.round(angle / (2 * Math.PI));
const ease = t => t * t * (3 - 2 * t);

export class Camera {
  azimuth = RESTING.azimuth;
  elevation = RESTING.elevation;
  distance = 4;
  target = [0, 0.9, 0];
  /// True while the body fills the picture, until it is zoomed or moved.
  framed = true;
  #transition = null;
  #still = matchMedia("(prefers-reduced-motion: reduce)");

  orbit(azimuth, elevation) {
    this.#transition = null;
    this.azimuth = wrap(this.azimuth + azimuth);
    this.elevation = clamp(this.elevation + elevation, ELEVATIONS);
  }

  zoom(factor) {
    this.#transition = null;
    this.framed = false;
    this.distance = clamp(this.distance * factor, DISTANCES);
  }

  /// Moves the picture; both lengths are in heights of the picture.
  pan(right, up) {
    this.#transition = null;
    this.framed = false;
    const axes = this.#axes();
    const scale = 2 * this.distance * TANGENT;
    this.target = this.target.map((t, i) => t - scale * (right * axes.right[i] + up * axes.up[i]));
  }

  /// Turns to one of the named sides.
  face(side) {
    this.#moveTo({ ...this.#pose(), azimuth: AZIMUTHS[side], elevation: RESTING.elevation });
  }

  /// Fills pictures of this `aspect` with the box; `turn` goes back to the front as well.
  frame(box, aspect, { turn = false, smooth = true } = {}) {
    this.framed = true;
    const half = box.maximum.map((high, i) => (high - box.minimum[i]) / 2);
    const goal = turn ? RESTING : this.#transition?.end ?? this;
    const [sine, cosine] = [Math.abs(Math.sin(goal.azimuth)), Math.abs(Math.cos(goal.azimuth))];
    const width = half[0] * cosine + half[2] * sine;
    const depth = half[0] * sine + half[2] * cosine;
    const target = box.maximum.map((high, i) => high - half[i]);
    target[1] -= half[1] * 0.05;
    const distance = depth + Math.max(half[1] * 1.2, (width * 1.08) / aspect) / TANGENT;
    const end = { azimuth: goal.azimuth, elevation: goal.elevation, distance, target };
    if (smooth) this.#moveTo(end);
    else this.#set(end);
  }

  /// Goes on with a transition; returns whether it lasts.
  advance(now) {
    if (!this.#transition) return false;
    const { begin, end } = this.#transition;
    this.#transition.since ??= now;
    const t = Math.min(1, (now - this.#transition.since) / TRANSITION);
    const mix = (from, to) => from + (to - from) * ease(t);
    this.azimuth = wrap(begin.azimuth + wrap(end.azimuth - begin.azimuth) * ease(t));
    this.elevation = mix(begin.elevation, end.elevation);
    this.distance = mix(begin.distance, end.distance);
    this.target = begin.target.map((from, i) => mix(from, end.target[i]));
    if (t === 1) this.#transition = null;
    return t < 1;
  }

  /// Matrices of pictures of this `aspect`.
  lens(aspect) {
    const { right, up, back } = this.#axes();
    const eye = this.target.map((t, i) => t + this.distance * back[i]);
    const near = Math.max(0.02, this.distance * 0.05);
    const projection = perspective(FIELD_OF_VIEW, aspect, near, this.distance + 20);
    return { matrix: multiply(projection, view(eye, right, up, back)), eye, azimuth: this.azimuth };
  }

  /// The lowest place of the box in pictures of this `aspect`, from 0 at the top to 1 at the bottom.
  lowest(box, aspect) {
    const { matrix } = this.lens(aspect);
    const row = (i, [x, y, z]) => matrix[i] * x + matrix[4 + i] * y + matrix[8 + i] * z + matrix[12 + i];
    const heights = Array.from({ length: 8 }, (_, corner) => {
      const point = box.minimum.map((low, axis) => ((corner >> axis) & 1 ? box.maximum[axis] : low));
      return row(1, point) / Math.max(1e-3, row(3, point));
    });
    return (1 - Math.min(...heights)) / 2;
  }

  /// In words, from where the person is seen.
  get side() {
    const angle = side => Math.abs(wrap(this.azimuth - AZIMUTHS[side]));
    return Object.keys(AZIMUTHS).reduce((best, side) => (angle(side) < angle(best) ? side : best));
  }

  #pose() {
    const { azimuth, elevation, distance, target } = this.#transition?.end ?? this;
    return { azimuth, elevation, distance, target };
  }

  #set(pose) {
    this.#transition = null;
    Object.assign(this, pose);
  }

  #moveTo(end) {
    if (this.#still.matches) return this.#set(end);
    const { azimuth, elevation, distance, target } = this;
    this.#transition = { begin: { azimuth, elevation, distance, target }, end };
  }

  #axes() {
    const [sa, ca] = [Math.sin(this.azimuth), Math.cos(this.azimuth)];
    const [se, ce] = [Math.sin(this.elevation), Math.cos(this.elevation)];
    return { right: [ca, 0, -sa], up: [-sa * se, ce, -ca * se], back: [sa * ce, se, ca * ce] };
  }
}
