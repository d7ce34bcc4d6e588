// The programs of the picture, in GLSL.

import { STOPS } from "./colours.js";

const VERSION = "#version 300 es\nprecision highp float;\nprecision highp int;\n";

const COLOUR = `
vec3 linear(vec3 c) { return mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)), step(0.04045, c)); }
vec3 encoded(vec3 c) {
  return mix(c * 12.92, 1.055 * pow(max(c, 0.0), vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c));
}
`;

/// Less than a step of the colours, so that wide gradients have none.
const DITHER = `
float dither() {
  return (fract(52.9829189 * fract(dot(gl_FragCoord.xy, vec2(0.06711056, 0.00583715)))) - 0.5) / 255.0;
}
`;

/// Attributes of a layer by their locations.
export const POSITION = 0;
export const NORMAL = 1;
export const DISPLACEMENT = 2;
export const ERROR = 3;
export const SURFACE = 4;

/// Values of the uniform `quantity`.
export const PAINTS = { cloth: 0, displacement: 1, error: 2, neutral: 3 };

const SURFACE_VERTEX = `${VERSION}
layout(location = ${POSITION}) in vec3 position;
layout(location = ${NORMAL}) in vec3 normal;
layout(location = ${DISPLACEMENT}) in float displacement;
layout(location = ${ERROR}) in float error;
layout(location = ${SURFACE}) in vec4 surface;
uniform mat4 matrix;
uniform float ground, maximum;
uniform int paint;
out vec3 place, direction, cloth;
out float level;
void main() {
  place = position - vec3(0.0, ground, 0.0);
  direction = normal;
  cloth = surface.rgb;
  level = (paint == ${PAINTS.error} ? error : displacement) / maximum;
  gl_Position = matrix * vec4(place, 1.0);
}`;

const PAINT = `
in vec3 place, direction, cloth;
in float level;
uniform int paint;
uniform vec3 table[${STOPS}];
vec3 painted() {
  if (paint == ${PAINTS.cloth}) return cloth;
  if (paint == ${PAINTS.neutral}) return vec3(0.68, 0.69, 0.71);
  float at = clamp(level, 0.0, 1.0) * ${STOPS - 1}.0;
  int stop = min(int(at), ${STOPS - 2});
  return mix(table[stop], table[stop + 1], at - float(stop));
}
`;

/// A person in the light of three lamps that go round with the camera.
const person = [SURFACE_VERTEX, `${VERSION}${COLOUR}${PAINT}
uniform vec3 eye, lamps[3];
out vec4 result;
const vec3 KEY = vec3(1.0, 0.94, 0.86) * 0.92;
const vec3 FILL = vec3(0.80, 0.89, 1.0) * 0.26;
const vec3 RIM = vec3(0.93, 0.97, 1.0) * 0.75;
const vec3 SKY = vec3(0.95, 0.98, 1.0) * 0.34;
const vec3 FLOOR = vec3(0.95, 0.90, 0.86) * 0.14;
float wrapped(vec3 n, vec3 l) { float d = (dot(n, l) + 0.25) / 1.25; return d > 0.0 ? d * d : 0.0; }
void main() {
  vec3 n = normalize(gl_FrontFacing ? direction : -direction);
  vec3 v = normalize(eye - place);
  vec3 colour = linear(painted());
  if (paint == ${PAINTS.displacement} || paint == ${PAINTS.error}) {
    // Lit nearly alike from everywhere, so that the colours can be compared with the legend.
    float light = 0.55 + 0.33 * max(dot(n, v), 0.0) + 0.20 * wrapped(n, lamps[0]);
    result = vec4(encoded(colour * light), 1.0);
    return;
  }
  float away = 1.0 - max(dot(n, v), 0.0);
  vec3 light = mix(FLOOR, SKY, 0.5 + 0.5 * n.y) + KEY * wrapped(n, lamps[0]) + FILL * wrapped(n, lamps[1]);
  vec3 rim = RIM * wrapped(n, lamps[2]) * (0.25 + 0.75 * away * away);
  float shine = pow(max(dot(n, normalize(lamps[0] + v)), 0.0), 24.0) * 0.05;
  // Nearer to the floor less light comes from all around.
  float open = 0.72 + 0.28 * smoothstep(0.0, 0.5, place.y);
  vec3 lit = colour * (light * open + rim) + shine + 0.04 * away * away * away;
  result = vec4(encoded(lit / (1.0 + 0.12 * lit)), 1.0);
}`];

/// Edges, dark on light surfaces and light on dark ones.
const wire = [SURFACE_VERTEX, `${VERSION}${PAINT}
out vec4 result;
void main() {
  float luma = dot(painted(), vec3(0.2126, 0.7152, 0.0722));
  result = luma > 0.4 ? vec4(0.05, 0.06, 0.09, 0.42) : vec4(0.95, 0.97, 1.0, 0.30);
}`];

const CORNERS = `${VERSION}
out vec2 at;
void main() {
  at = vec2(gl_VertexID & 1, gl_VertexID >> 1);
  gl_Position = vec4(at * 2.0 - 1.0, 0.0, 1.0);
}`;

/// The studio behind the person.
const backdrop = [CORNERS, `${VERSION}${DITHER}
in vec2 at;
uniform vec3 top, bottom;
out vec4 result;
void main() {
  vec2 centred = at - vec2(0.5, 0.58);
  float glow = exp(-5.0 * dot(centred, centred));
  vec3 colour = mix(bottom, top, smoothstep(0.0, 0.85, at.y)) * (0.94 + 0.08 * glow);
  result = vec4(colour + dither(), 1.0);
}`];

/// The floor below one person with its shadow.
const floor = [`${VERSION}
uniform mat4 matrix;
uniform vec2 centre;
uniform float radius;
out vec2 at;
void main() {
  at = vec2(gl_VertexID & 1, gl_VertexID >> 1);
  vec2 place = centre + (at * 2.0 - 1.0) * radius;
  gl_Position = matrix * vec4(place.x, 0.0, place.y, 1.0);
}`, `${VERSION}${DITHER}
in vec2 at;
uniform sampler2D shadow;
uniform vec4 pool;
uniform vec2 span;
uniform float radius;
out vec4 result;
void main() {
  vec2 dark = texture(shadow, at).rg;
  float far = length(at * 2.0 - 1.0) * max(1.0, radius / 1.05);
  // Nothing shows where one person's part of the picture ends.
  float across = abs((gl_FragCoord.x - span.x) / span.y * 2.0 - 1.0);
  float lit = pool.a * (1.0 - smoothstep(0.0, 1.0, far)) * (1.0 - smoothstep(0.5, 1.0, across));
  float alpha = 1.0 - (1.0 - 0.52 * dark.r) * (1.0 - 0.42 * dark.g);
  // The light on the floor first, its shadow over it.
  float cover = alpha + lit * (1.0 - alpha);
  result = vec4(pool.rgb * lit * (1.0 - alpha) + dither(), cover);
}`];

/// Nearness of the lowest surface to the floor, seen from above: fine and coarse.
const contact = [`${VERSION}
layout(location = ${POSITION}) in vec3 position;
uniform vec2 centre;
uniform float ground, radius;
out float height;
void main() {
  height = position.y - ground;
  gl_Position = vec4((position.xz - centre) / radius, 0.0, 1.0);
}`, `${VERSION}
in float height;
out vec4 result;
void main() { result = vec4(exp(-22.0 * height), exp(-2.2 * height), 0.0, 1.0); }`];

/// One direction of a blur; `widths` are those of the two channels.
const blur = [CORNERS, `${VERSION}
in vec2 at;
uniform sampler2D source;
uniform vec2 direction, widths;
out vec4 result;
void main() {
  vec2 sum = vec2(0.0);
  float total = 0.0;
  for (int i = -6; i <= 6; i++) {
    float t = float(i) / 6.0;
    float weight = exp(-4.0 * t * t);
    sum += weight * vec2(
      texture(source, at + direction * t * widths.x).r, texture(source, at + direction * t * widths.y).g);
    total += weight;
  }
  result = vec4(sum / total, 0.0, 1.0);
}`];

export const PROGRAMS = { person, wire, backdrop, floor, contact, blur };

/// Compiles and links a program; returns it with its uniforms' locations.
export function build(gl, [vertex, fragment]) {
  const program = gl.createProgram();
  for (const [type, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, source.trim());
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
    const logs = gl.getAttachedShaders(program).map(shader => gl.getShaderInfoLog(shader));
    throw new Error(`a shader does not compile: ${[...logs, gl.getProgramInfoLog(program)].join(" ")}`);
  }
  const uniforms = {};
  for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
    const name = gl.getActiveUniform(program, i).name.replace("[0]", "");
    uniforms[name] = gl.getUniformLocation(program, name);
  }
  return { program, ...uniforms };
}
