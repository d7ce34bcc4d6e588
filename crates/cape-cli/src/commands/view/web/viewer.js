// The viewer: what is shown, and how the parts of the page act on it.

import { Camera } from "./camera.js";
import { MODES, QUANTITIES } from "./colours.js";
import { byId, element } from "./controls.js";
import { listen } from "./gestures.js";
import { bindKeys } from "./keys.js";
import { Legend } from "./legend.js";
import { Link } from "./link.js";
import { statistics, union, within } from "./mesh.js";
import { Panel } from "./panel.js";
import { Player } from "./player.js";
import { save } from "./save.js";
import { Scene } from "./scene.js";
import { describe, figures, fileName, layerNames } from "./words.js";

/// Distance by which bodies may leave the box that fills the picture, metres.
const SLACK = 0.06;
const MOTION = { seconds: 2, fps: 15 };

class Viewer {
  #source;
  #subject;
  #canvas = byId("canvas");
  #camera = new Camera();
  #scene;
  #panel;
  #legend = new Legend(() => this.#restyle());
  #player = new Player(frame => this.#showFrame(frame), () => this.#playerChanged());
  #link;
  #dark = matchMedia("(prefers-color-scheme: dark)");

  #person;
  #look = { colours: MODES[0], wireframe: false };
  #motions = new Map();
  #motion = null;

  #layers = [];
  #statistics = [];
  #extent = null;
  #ground = Infinity;
  #answers = 0;
  #latency = null;
  #message = "";

  #frame = 0;
  #tasks = 0;
  #waiting = [];

  /// `source` has the `subject`, its `faces`, `connect()`, which opens a WebSocket or the like, and
  /// `download(format, question, layers)`, which returns a file of a picture.
  constructor(source) {
    const { subject, faces } = source;
    this.#source = source;
    this.#subject = subject;
    this.#person = initial(subject);
    this.#scene = new Scene(this.#canvas, faces, subject.vertices, () => this.#invalidate());
    this.#panel = new Panel(subject, this.#actions());
    document.title = `${subject.title} · cape view`;
    byId("title").textContent = subject.title;
    bindKeys(subject.notes ?? []);
    listen(this.#canvas, this.#camera, () => this.#invalidate());
    new ResizeObserver(() => this.#frameAll({ smooth: false })).observe(this.#canvas);
    this.#dark.addEventListener("change", () => this.#invalidate());
    const frames = subject.sequence ?? subject.layer?.motions[0];
    if (frames) this.#player.load(frames.frames, frames.fps);
    this.#update();
    this.#panel.updatePlayer(this.#player);

    this.#link = new Link(source.connect, {
      answer: (layers, latency) => this.#show(layers, latency),
      failure: message => this.#say(message, true),
      lost: seconds => this.#say(`The connection is lost; trying again in ${seconds} s.`, true),
      found: () => this.#say("Connected again."),
      settled: () => this.#settle(),
    });
    this.#request();
  }

  state() {
    const { azimuth, elevation, distance, target } = this.#camera;
    return structuredClone({
      ...this.#person,
      ...this.#look,
      answers: this.#answers,
      latency: this.#latency,
      triangles: this.#scene.triangles,
      playing: this.#player.playing,
      camera: { azimuth, elevation, distance, target },
    });
  }

  /// The layers of the picture, with their numbers as arrays.
  layers() {
    return this.#layers.map(({ kind, ...values }) => ({
      kind, ...Object.fromEntries(Object.entries(values).map(([name, numbers]) => [name, Array.from(numbers)])),
    }));
  }

  /// Resolves when nothing is waited for and all is drawn.
  settled() {
    return new Promise(resolve => {
      this.#waiting.push(resolve);
      this.#settle();
    });
  }

  #actions() {
    return {
      edit: patch => this.#edit(patch),
      wear: outfit => this.#task(this.#wear(outfit)),
      sample: question => this.#task(this.#sample(question)),
      encode: () => this.#task(this.#encode()),
      pose: name => this.#pose(name),
      motion: name => this.#task(this.#loadMotion(name)),
      movement: name => this.#move(name),
      play: () => this.#task(this.#play()),
      seek: frame => this.#seek(frame),
      loop: loop => { this.#player.loop = loop; },
      layer: (name, shown) => this.#toggleLayer(name, shown),
      truth: truth => this.#set({ truth }),
      look: patch => this.#restyle(patch),
      face: side => this.#turn(side),
      reset: () => this.#reset(),
      download: format => this.#task(this.#download(format)),
    };
  }

  /// Changes the person by hand, which ends any motion that changes the same.
  #edit(patch) {
    if (patch.pose) this.#player.pause();
    this.#set(patch);
  }

  #set(patch) {
    Object.assign(this.#person, patch);
    this.#update();
    this.#request();
  }

  #pose(name) {
    this.#extent = null;
    this.#edit({ pose: this.#subject.model.poses.find(pose => pose.name === name).pose, poseName: name });
  }

  #toggleLayer(name, shown) {
    const layers = this.#person.layers.filter(layer => layer !== name);
    if (shown) layers.push(name);
    if (name === "truth") this.#player.pause();
    this.#extent = null;
    // One layer has to stay.
    this.#set(layers.length > 0 ? { layers } : {});
  }

  async #sample({ prior, temperature, seed }) {
    const { outfit } = this.#person;
    const { z } = await this.#link.ask({ sample: { prior, temperature, seed, outfit } });
    this.#edit({ z });
  }

  /// Changes the outfit. A code is moved to its place among the other outfit's, unless it is of the prior that
  /// is the same for all.
  async #wear(outfit) {
    const { z, outfit: from } = this.#person;
    const same = byId("prior").value === "normal";
    const carried = same ? { z } : await this.#link.ask({ carry: { z, from, to: outfit } });
    this.#edit({ z: carried.z, outfit });
  }

  async #encode() {
    const { truth } = this.#person;
    const { z, betas, pose, outfit } = await this.#link.ask({ encode: truth });
    const layers = this.#person.layers.filter(layer => layer !== "truth");
    this.#extent = null;
    this.#edit({ z, betas, pose, outfit, poseName: `registration ${truth}`, layers: layers.length ? layers : ["clothed"] });
  }

  async #loadMotion(name) {
    this.#player.pause();
    if (!this.#motions.has(name)) {
      this.#motions.set(name, await this.#link.ask({ motion: { name, ...MOTION } }));
    }
    const { poses, fps } = this.#motions.get(name);
    this.#motion = name;
    this.#extent = null;
    this.#player.load(poses.length, fps);
    this.#seek(0);
  }

  /// Moves a clothing layer otherwise.
  #move(name) {
    const { frames, fps } = this.#subject.layer.motions.find(motion => motion.name === name);
    this.#player.pause();
    this.#player.load(frames, fps);
    this.#extent = null;
    this.#person.motion = name;
    this.#seek(0);
  }

  async #play() {
    if (this.#player.count === 0) await this.#loadMotion(byId("motion").value);
    this.#player.toggle();
  }

  #seek(frame) {
    this.#player.seek(frame);
    this.#panel.updatePlayer(this.#player);
  }

  #showFrame(frame) {
    if (this.#subject.model) {
      this.#set({ pose: this.#motions.get(this.#motion).poses[frame], poseName: this.#motion });
    } else {
      this.#set({ frame });
    }
    this.#panel.updatePlayer(this.#player);
  }

  #playerChanged() {
    // Nobody wants to hear each frame.
    byId("status").ariaLive = this.#player.playing ? "off" : "polite";
    this.#panel.updatePlayer(this.#player);
    this.#settle();
  }

  #turn(side) {
    this.#camera.face(side);
    this.#frameAll();
  }

  #reset() {
    this.#extent = this.#layers.length > 0 ? this.#scene.box : null;
    this.#camera.framed = true;
    this.#frameAll({ turn: true });
  }

  #picture() {
    if (this.#subject.layer) return { worn: { ...this.#person } };
    if (!this.#subject.model) return { frame: this.#person.frame };
    const { z, betas, pose, outfit, layers, truth } = this.#person;
    return { show: { z, betas, pose, outfit, layers, truth } };
  }

  #request() {
    this.#link.show(this.#picture());
  }

  #show(layers, latency) {
    this.#layers = layers;
    this.#statistics = layers.map(layer => ({
      displacement: statistics(layer.displacement),
      error: statistics(layer.error),
    }));
    this.#ground = this.#floorBelow(layers);
    this.#scene.setLayers(layers, this.#ground);
    this.#answers += 1;
    this.#latency = latency ?? this.#latency;

    const { box } = this.#scene;
    if (!this.#extent || !within(box, this.#extent, SLACK)) {
      this.#extent = this.#extent ? union(this.#extent, box) : box;
      this.#frameAll({ smooth: this.#answers > 1 });
    }
    this.#message = "";
    this.#restyle();
  }

  /// People stand on the floor; in a sequence they may also leave it.
  #floorBelow(layers) {
    let lowest = this.#subject.sequence ? this.#ground : Infinity;
    for (const { positions } of layers) {
      for (let y = 1; y < positions.length; y += 3) lowest = Math.min(lowest, positions[y]);
    }
    return lowest;
  }

  /// Changes how the layers are drawn.
  #restyle(patch = {}) {
    Object.assign(this.#look, patch);
    const available = Object.keys(QUANTITIES).filter(quantity => this.#has(quantity));
    if (this.#look.colours === "error" && !available.includes("error")) this.#look.colours = "cloth";
    this.#panel.offer(available);
    const names = this.#subject.model || this.#layers.length > 1 ? this.#names : [];
    byId("labels").replaceChildren(...names.map(textContent => element("span", { textContent })));
    this.#update();
    this.#tell();
    this.#invalidate();
  }

  /// True if any layer has values of the quantity; clothing of a model always has displacements.
  #has(quantity) {
    if (quantity === "displacement" && this.#subject.model) return true;
    return this.#statistics.some(values => values[quantity].largest > 0);
  }

  get #names() {
    return layerNames(this.#layers.map(({ kind }) => kind), Boolean(this.#subject.model));
  }

  #update() {
    const { colours } = this.#look;
    this.#panel.update({ ...this.#person, ...this.#look });
    const clothed = this.#layers.findIndex(({ kind }) => kind === "clothed");
    this.#legend.update(colours in QUANTITIES ? colours : null, this.#statistics[clothed]?.[colours]);
  }

  #say(message, problem = false) {
    this.#message = message;
    byId("status").classList.toggle("problem", problem);
    this.#tell();
    this.#settle();
  }

  #tell() {
    const shown = this.#latency === null ? "" : figures({ latency: this.#latency, triangles: this.#scene.triangles });
    byId("status").textContent = [this.#message, shown].filter(Boolean).join(" · ");
    if (!this.#message) byId("status").classList.remove("problem");
  }

  #describe() {
    const { outfit, poseName, layers, truth } = this.#person;
    const posed = `a person in ${outfit}, pose ${poseName}`;
    const who = !this.#subject.model ? this.#subject.title : layers.includes("truth") ? `registration ${truth}` : posed;
    const text = describe({ who, names: this.#names, side: this.#camera.side, ...this.#look });
    if (this.#canvas.ariaLabel !== text) this.#canvas.ariaLabel = text;
  }

  #frameAll(options = {}) {
    if (this.#extent && this.#camera.framed) this.#camera.frame(this.#extent, this.#scene.aspect, options);
    this.#invalidate();
  }

  #invalidate() {
    this.#frame ||= requestAnimationFrame(now => {
      this.#frame = 0;
      if (this.#camera.advance(now)) this.#invalidate();
      this.#draw();
      this.#settle();
    });
  }

  #draw() {
    const { colours, wireframe } = this.#look;
    const quantity = QUANTITIES[colours];
    this.#scene.draw(this.#camera, {
      paints: this.#statistics.map(values => (!quantity || values[colours].largest > 0 ? colours : "neutral")),
      table: quantity?.table,
      maximum: quantity ? this.#legend.maximum(colours) / 1000 : 1,
      wireframe,
      dark: this.#dark.matches,
    });
    this.#describe();
    if (this.#extent) {
      const under = this.#camera.lowest(this.#extent, this.#scene.aspect);
      byId("labels").style.setProperty("--under", `${(100 * under).toFixed(1)}%`);
    }
  }

  /// Says what goes wrong with something that takes time.
  async #task(work) {
    this.#tasks += 1;
    try {
      await work;
    } catch (error) {
      this.#say(error.message, true);
    }
    this.#tasks -= 1;
    this.#settle();
  }

  #settle() {
    const busy = this.#frame || this.#tasks || this.#player.playing || !this.#link?.idle;
    if (!busy) this.#waiting.splice(0).forEach(resolve => resolve());
  }

  async #download(format) {
    const { outfit, poseName, layers, truth, frame, motion } = this.#person;
    const posed = layers?.includes("truth") ? ["registration", truth] : [outfit, poseName];
    const moment = [this.#subject.layer && motion, this.#player.count > 1 && `frame ${frame}`];
    const still = [this.#subject.title, ...moment.filter(Boolean)];
    const name = fileName(this.#subject.model ? ["cape", ...posed] : still, format);
    if (format === "png") {
      this.#draw();
      // At once: what WebGL drew lasts until the browser has shown it.
      const picture = this.#legend.under(this.#canvas);
      save(await new Promise(resolve => picture.toBlob(resolve)), name);
    } else {
      save(await this.#source.download(format, this.#picture(), this.#layers), name);
    }
    this.#say(`Saved ${name}.`);
  }
}

/// The person that is shown first.
function initial({ model, layer }) {
  if (layer) {
    const parameters = layer.parameters.map(({ value }) => value);
    return { frame: 0, motion: layer.motions[0].name, parameters, betas: new Array(layer.betas).fill(0) };
  }
  if (!model) return { frame: 0 };
  const [{ name, pose }] = model.poses;
  return {
    z: new Array(model.latent).fill(0),
    betas: new Array(model.betas).fill(0),
    pose,
    poseName: name,
    outfit: model.outfit,
    layers: ["clothed"],
    truth: 0,
  };
}

/// Shows what `open` resolves to: a source of the viewer.
export function start(open) {
  let viewer = null;
  const ready = show();
  // The page says it itself.
  ready.catch(() => {});

  async function show() {
    try {
      viewer = new Viewer(await open());
    } catch (error) {
      byId("failure").textContent = error.message;
      byId("failure").hidden = false;
      byId("status").textContent = "";
      byId("panel").hidden = true;
      throw error;
    }
    await viewer.settled();
  }

  window.cape = {
    ready,
    state: () => viewer?.state() ?? null,
    layers: () => viewer?.layers() ?? [],
    settled: () => ready.then(() => viewer.settled()),
  };
}
