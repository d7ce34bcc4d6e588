// The picture: people side by side in a studio, each seen by the same camera.

import { STOPS } from "./colours.js";
import { bounds, edges, smoothNormals, union } from "./mesh.js";
import { DISPLACEMENT, ERROR, NORMAL, PAINTS, POSITION, PROGRAMS, SURFACE, build } from "./shaders.js";
import { Shadows } from "./shadows.js";

const PIXEL_RATIO = 2;
/// Directions to the lamps when the camera looks from the front.
const LAMPS = [[-0.5, 0.65, 0.75], [0.85, 0.15, 0.5], [0.3, 0.5, -0.85]];
const STUDIOS = {
  light: { top: [0.925, 0.935, 0.95], bottom: [0.745, 0.76, 0.785], pool: [0.94, 0.945, 0.955, 0.45] },
  dark: { top: [0.185, 0.2, 0.225], bottom: [0.085, 0.092, 0.105], pool: [0.33, 0.345, 0.375, 0.6] },
};

/// Quantities of a layer per vertex, by name.
const ATTRIBUTES = [
  { name: "positions", location: POSITION, size: 3 },
  { name: "normals", location: NORMAL, size: 3 },
  { name: "displacement", location: DISPLACEMENT, size: 1 },
  { name: "error", location: ERROR, size: 1 },
  { name: "colours", location: SURFACE, size: 4, bytes: true },
];

/// The light's direction after turning it around the vertical axis.
function turned([x, y, z], azimuth) {
  const length = Math.hypot(x, y, z);
  const [sine, cosine] = [Math.sin(azimuth), Math.cos(azimuth)];
  return [(cosine * x + sine * z) / length, y / length, (cosine * z - sine * x) / length];
}

export class Scene {
  #canvas;
  #gl;
  #faces;
  #edges;
  #layers = [];
  #ground = 0;
  #resources = null;

  /// Throws if there is no WebGL2. `restored` is called when the picture has to be drawn again.
  constructor(canvas, faces, vertices, restored) {
    this.#canvas = canvas;
    this.#gl = canvas.getContext("webgl2", { antialias: true, alpha: false, preserveDrawingBuffer: true });
    if (!this.#gl) throw new Error("This viewer needs WebGL 2, which this browser does not offer.");
    this.#faces = faces;
    this.#edges = edges(faces, vertices);
    this.#build();
    canvas.addEventListener("webglcontextlost", event => {
      event.preventDefault();
      this.#resources = null;
    });
    canvas.addEventListener("webglcontextrestored", () => {
      this.#build();
      this.#upload();
      restored();
    });
  }

  /// The layers to show from left to right, on a floor at the height `ground`.
  setLayers(layers, ground) {
    this.#ground = ground;
    this.#layers = layers.map(layer => ({ ...layer, normals: smoothNormals(layer.positions, this.#faces) }));
    if (this.#resources) this.#upload();
  }

  get columns() {
    return Math.max(1, this.#layers.length);
  }

  /// Width over height of each person's part of the picture.
  get aspect() {
    return this.#canvas.clientWidth / this.columns / Math.max(1, this.#canvas.clientHeight);
  }

  /// Triangles in the picture.
  get triangles() {
    return (this.#layers.length * this.#faces.length) / 3;
  }

  /// The box around all people, above the floor.
  get box() {
    const box = this.#layers.map(({ positions }) => bounds(positions)).reduce(union);
    box.minimum[1] -= this.#ground;
    box.maximum[1] -= this.#ground;
    return box;
  }

  /// `look` has `paint` for each layer, a quantity's `table` and `maximum` in metres, `wireframe`
  /// and `dark`.
  draw(camera, look) {
    if (!this.#resources) return;
    const gl = this.#gl;
    const ratio = Math.min(PIXEL_RATIO, devicePixelRatio);
    const [width, height] = [this.#canvas.clientWidth, this.#canvas.clientHeight]
      .map(length => Math.max(1, Math.round(length * ratio)));
    if (this.#canvas.width !== width || this.#canvas.height !== height) {
      Object.assign(this.#canvas, { width, height });
    }
    const studio = STUDIOS[look.dark ? "dark" : "light"];
    const lens = camera.lens(this.aspect);

    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, width, height);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    this.#drawBackdrop(studio);
    this.#layers.forEach((layer, i) => {
      const edge = column => Math.round((column * width) / this.columns);
      const span = [edge(i), edge(i + 1) - edge(i)];
      gl.viewport(span[0], 0, span[1], height);
      if (lens.eye[1] > 0) this.#drawFloor(layer, lens, { ...studio, span });
      this.#drawPerson(layer, lens, { ...look, paint: PAINTS[look.paints[i]] });
    });
  }

  #build() {
    const gl = this.#gl;
    const index = data => {
      const buffer = gl.createBuffer();
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffer);
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, data, gl.STATIC_DRAW);
      return buffer;
    };
    gl.bindVertexArray(null);
    const programs = Object.fromEntries(
      Object.entries(PROGRAMS).map(([name, sources]) => [name, build(gl, sources)]));
    this.#resources = {
      programs,
      faces: index(this.#faces),
      edges: index(this.#edges),
      shadows: new Shadows(gl, programs),
      people: [],
    };
  }

  #upload() {
    const gl = this.#gl;
    const { people, faces, shadows } = this.#resources;
    this.#layers.forEach((layer, i) => {
      const person = (people[i] ??= this.#person());
      for (const { name } of ATTRIBUTES) {
        gl.bindBuffer(gl.ARRAY_BUFFER, person.buffers[name]);
        gl.bufferData(gl.ARRAY_BUFFER, layer[name], gl.DYNAMIC_DRAW);
      }
      gl.bindVertexArray(person.array);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, faces);
      shadows.cast(person.shadow, bounds(layer.positions), this.#ground, this.#faces.length);
      layer.person = person;
    });
  }

  #person() {
    const gl = this.#gl;
    const person = { array: gl.createVertexArray(), buffers: {}, shadow: this.#resources.shadows.create() };
    gl.bindVertexArray(person.array);
    for (const { name, location, size, bytes = false } of ATTRIBUTES) {
      person.buffers[name] = gl.createBuffer();
      gl.bindBuffer(gl.ARRAY_BUFFER, person.buffers[name]);
      gl.enableVertexAttribArray(location);
      gl.vertexAttribPointer(location, size, bytes ? gl.UNSIGNED_BYTE : gl.FLOAT, bytes, 0, 0);
    }
    return person;
  }

  #drawBackdrop(studio) {
    const gl = this.#gl;
    const { backdrop } = this.#resources.programs;
    gl.disable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    gl.useProgram(backdrop.program);
    gl.uniform3fv(backdrop.top, studio.top);
    gl.uniform3fv(backdrop.bottom, studio.bottom);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  }

  #drawFloor({ person: { shadow } }, lens, { pool, span }) {
    const gl = this.#gl;
    const { floor } = this.#resources.programs;
    gl.disable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.useProgram(floor.program);
    gl.uniformMatrix4fv(floor.matrix, false, lens.matrix);
    gl.uniform2fv(floor.centre, shadow.centre);
    gl.uniform1f(floor.radius, shadow.radius);
    gl.uniform4fv(floor.pool, pool);
    gl.uniform2fv(floor.span, span);
    gl.bindTexture(gl.TEXTURE_2D, shadow.texture);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  }

  #drawPerson({ person }, lens, look) {
    const gl = this.#gl;
    const { programs, faces, edges } = this.#resources;
    gl.enable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    gl.bindVertexArray(person.array);

    gl.enable(gl.POLYGON_OFFSET_FILL);
    gl.polygonOffset(1, 1);
    this.#useSurface(programs.person, lens, look);
    gl.uniform3fv(programs.person.eye, lens.eye);
    gl.uniform3fv(programs.person.lamps, LAMPS.flatMap(lamp => turned(lamp, lens.azimuth)));
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, faces);
    gl.drawElements(gl.TRIANGLES, this.#faces.length, gl.UNSIGNED_INT, 0);
    gl.disable(gl.POLYGON_OFFSET_FILL);

    if (look.wireframe) {
      gl.enable(gl.BLEND);
      gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
      this.#useSurface(programs.wire, lens, look);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, edges);
      gl.drawElements(gl.LINES, this.#edges.length, gl.UNSIGNED_INT, 0);
    }
    gl.bindVertexArray(null);
  }

  #useSurface(program, lens, { paint, table, maximum }) {
    const gl = this.#gl;
    gl.useProgram(program.program);
    gl.uniformMatrix4fv(program.matrix, false, lens.matrix);
    gl.uniform1f(program.ground, this.#ground);
    gl.uniform1f(program.maximum, maximum);
    gl.uniform1i(program.paint, paint);
    gl.uniform3fv(program.table, table?.flat() ?? new Float32Array(3 * STOPS));
  }
}
