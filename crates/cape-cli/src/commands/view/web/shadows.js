// Soft shadows of people on the floor, as textures seen from above.

const SIZE = 160;
/// Floor around a person, in metres.
const MARGIN = 0.55;
/// Blur radius of the narrow and the wide shadow, metres.
const WIDTHS = [0.045, 0.3];

export class Shadows {
  #gl;
  #programs;
  #framebuffer;
  #scratch;

  constructor(gl, programs) {
    this.#gl = gl;
    this.#programs = programs;
    this.#framebuffer = gl.createFramebuffer();
    this.#scratch = this.#texture();
  }

  /// A shadow that has not been cast yet.
  create() {
    return { texture: this.#texture(), centre: [0, 0], radius: 1 };
  }

  /// Casts the mesh of the bound vertex array, of `count` indices, which lies in `box`.
  cast(shadow, box, ground, count) {
    const gl = this.#gl;
    const { contact, blur } = this.#programs;
    const half = [0, 2].map(axis => (box.maximum[axis] - box.minimum[axis]) / 2);
    shadow.centre = [0, 2].map((axis, i) => box.minimum[axis] + half[i]);
    shadow.radius = Math.max(...half) + MARGIN;

    gl.bindFramebuffer(gl.FRAMEBUFFER, this.#framebuffer);
    gl.viewport(0, 0, SIZE, SIZE);
    gl.disable(gl.DEPTH_TEST);

    this.#target(shadow.texture);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.enable(gl.BLEND);
    gl.blendEquation(gl.MAX);
    gl.useProgram(contact.program);
    gl.uniform2fv(contact.centre, shadow.centre);
    gl.uniform1f(contact.radius, shadow.radius);
    gl.uniform1f(contact.ground, ground);
    gl.drawElements(gl.TRIANGLES, count, gl.UNSIGNED_INT, 0);
    gl.blendEquation(gl.FUNC_ADD);
    gl.disable(gl.BLEND);

    gl.bindVertexArray(null);
    gl.useProgram(blur.program);
    gl.uniform2fv(blur.widths, WIDTHS.map(width => width / (2 * shadow.radius)));
    this.#blur(shadow.texture, this.#scratch, [1, 0]);
    this.#blur(this.#scratch, shadow.texture, [0, 1]);
  }

  #blur(source, target, direction) {
    const gl = this.#gl;
    this.#target(target);
    gl.bindTexture(gl.TEXTURE_2D, source);
    gl.uniform2fv(this.#programs.blur.direction, direction);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  }

  #target(texture) {
    const gl = this.#gl;
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
  }

  #texture() {
    const gl = this.#gl;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA8, SIZE, SIZE);
    for (const parameter of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) {
      gl.texParameteri(gl.TEXTURE_2D, parameter, gl.CLAMP_TO_EDGE);
    }
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
    return texture;
  }
}
