// The controls: built once for what is shown, then kept to the viewer's state.

import { byId, choice, fill, onChange, onClick, signed, slider } from "./controls.js";
import { OUTFITS } from "./words.js";

const FIRST = 8;
const AXES = ["x", "y", "z"];
const DEGREES = 180 / Math.PI;
const LAYERS = ["clothed", "body", "truth"];
const CUSTOM = "custom";

export class Panel {
  #subject;
  #actions;
  #z = [];
  #betas = [];
  #parameters = [];
  #angles = [];
  #temperature = null;
  #truth = null;
  #scrub = null;
  #current = null;

  /// `actions` are the viewer's answers to what is done here.
  constructor(subject, actions) {
    this.#subject = subject;
    this.#actions = actions;
    for (const section of document.querySelectorAll("[data-for]")) {
      section.hidden = !subject[section.dataset.for];
    }
    byId("layers").hidden = !subject.model;
    if (subject.model) this.#buildModel(subject.model);
    if (subject.layer) this.#buildLayer(subject.layer);
    this.#buildPlayer();
    this.#buildDisplay();
  }

  get temperature() {
    return this.#temperature.range.valueAsNumber;
  }

  /// Shows the viewer's state.
  update(state) {
    if (this.#subject.model) this.#updateModel(state);
    if (this.#subject.layer) this.#updateLayer(state);
    byId("colours").value = state.colours;
    byId("wireframe").checked = state.wireframe;
  }

  /// Shows where the player is.
  updatePlayer({ count, fps, position, playing }) {
    byId("play").textContent = playing ? "Pause" : "Play";
    byId("play").ariaPressed = playing;
    const last = Math.max(1, count - 1);
    this.#scrub.range.disabled = count < 2;
    this.#scrub.limit(last);
    this.#scrub.set(position);
    const seconds = frames => (frames / fps).toFixed(2);
    byId("time").textContent = count > 0 ? `${seconds(position)} of ${seconds(count)} s` : "";
  }

  /// Says which quantities there are values of.
  offer(available) {
    for (const option of byId("colours").options) {
      option.disabled = option.value !== "cloth" && !available.includes(option.value);
    }
  }

  #buildModel(model) {
    const { edit, wear } = this.#actions;
    byId("outfits").append(...model.outfits.map(outfit => choice({
      id: `outfit-${outfit}`, name: "outfit", value: outfit, title: OUTFITS[outfit] ?? "",
      chosen: wear,
    })));

    onClick("sample", () => this.#sample(byId("seed").valueAsNumber + 1 || 0));
    onChange("seed", seed => this.#sample(seed.valueAsNumber || 0));
    onClick("mean", () => edit({ z: new Array(model.latent).fill(0) }));
    fill(byId("prior"), model.priors);
    this.#temperature = slider({
      id: "temperature", label: "temperature", range: [0, 2], step: 0.05, origin: 1,
      format: value => value.toFixed(2), input: value => this.#temperature.set(value),
    });
    byId("temperature-slider").append(this.#temperature.row);

    const vector = (name, i, more) => slider({
      id: `${name === "z" ? "z" : "beta"}-${i}`, range: [-3, 3], step: 0.01, origin: 0, format: value => signed(value),
      input: value => edit({ [name]: this.#current[name].with(i, value) }), ...more,
    });
    model.order.forEach((dimension, place) => {
      const note = `${model.effect[dimension].toFixed(1)} mm`;
      this.#z[dimension] = vector("z", dimension, { label: `z ${dimension}`, note });
      byId(place < FIRST ? "z-first" : "z-rest").append(this.#z[dimension].row);
    });
    const all = byId("z-all");
    const fold = () => {
      const open = !byId("z-rest").hidden;
      all.ariaExpanded = open;
      all.textContent = open ? `Show the first ${FIRST}` : `Show all ${model.latent}`;
    };
    all.hidden = model.latent <= FIRST;
    onClick("z-all", () => {
      byId("z-rest").hidden = !byId("z-rest").hidden;
      fold();
    });
    fold();

    this.#betas = Array.from({ length: model.betas }, (_, i) => vector("betas", i, { label: `β ${i}` }));
    byId("betas").append(...this.#betas.map(({ row }) => row));
    onClick("shape-mean", () => edit({ betas: new Array(model.betas).fill(0) }));

    this.#buildPose(model);
    this.#buildTruth(model);
  }

  /// Sliders of a clothing layer.
  #buildLayer(layer) {
    const { edit, movement } = this.#actions;
    fill(byId("movement"), layer.motions.map(({ name }) => name));
    onChange("movement", select => movement(select.value));

    this.#parameters = layer.parameters.map(({ name, value, range }, i) => slider({
      id: `parameter-${i}`, label: name.replaceAll("_", " "), range, step: (range[1] - range[0]) / 200, origin: value,
      format: number => number.toPrecision(3),
      input: number => edit({ parameters: this.#current.parameters.with(i, number) }),
    }));
    byId("parameters").append(...this.#parameters.map(({ row }) => row));
    byId("sizes").hidden = this.#parameters.length === 0;
    onClick("parameters-mean", () => edit({ parameters: layer.parameters.map(({ value }) => value) }));

    this.#betas = Array.from({ length: layer.betas }, (_, i) => slider({
      id: `layer-beta-${i}`, label: `β ${i}`, range: [-3, 3], step: 0.01, origin: 0, format: value => signed(value),
      input: value => edit({ betas: this.#current.betas.with(i, value) }),
    }));
    byId("layer-betas").append(...this.#betas.map(({ row }) => row));
    onClick("layer-shape-mean", () => edit({ betas: new Array(layer.betas).fill(0) }));
  }

  #buildPose(model) {
    const { pose, edit, motion } = this.#actions;
    fill(byId("pose"), [...model.poses.map(({ name }) => name), CUSTOM]);
    Object.assign(byId("pose").lastElementChild, { hidden: true, disabled: true });
    onChange("pose", select => pose(select.value));

    model.joints.forEach((name, i) => byId("joint").add(new Option(name, i)));
    onChange("joint", () => this.#updateAngles());
    this.#angles = AXES.map((axis, i) => slider({
      id: `angle-${axis}`, label: `angle ${axis}`, range: [-180, 180], step: 1, origin: 0,
      format: value => `${signed(value, 0)}°`,
      input: value => edit({ pose: this.#current.pose.with(this.#joint * 3 + i, value / DEGREES), poseName: CUSTOM }),
    }));
    byId("angles").append(...this.#angles.map(({ row }) => row));

    fill(byId("motion"), model.motions);
    onChange("motion", select => motion(select.value));
  }

  #buildTruth(model) {
    const { layer, truth, encode } = this.#actions;
    for (const name of LAYERS) onChange(`layer-${name}`, box => layer(name, box.checked));
    byId("layer-truth").parentElement.hidden = model.truth === 0;
    byId("registrations").hidden = model.truth === 0;
    this.#truth = slider({
      id: "truth", label: "registration", range: [0, Math.max(1, model.truth - 1)], step: 1,
      format: value => `${value}`, input: truth,
    });
    this.#truth.range.disabled = model.truth < 2;
    byId("truth-slider").append(this.#truth.row);
    onClick("encode", encode);
  }

  #buildPlayer() {
    const { play, seek, loop } = this.#actions;
    this.#scrub = slider({
      id: "scrub", label: "frame", range: [0, 1], step: 1, format: value => `${value}`, input: seek,
    });
    byId("scrub-slider").append(this.#scrub.row);
    const moves = this.#subject.model?.motions.length > 0 || this.#subject.layer || this.#subject.sequence?.frames > 1;
    if (!moves) {
      byId("player").hidden = true;
      for (const slot of document.querySelectorAll(".player-slot")) slot.parentElement.hidden = true;
      return;
    }
    document.querySelector("[data-for]:not([hidden]) .player-slot").append(byId("player"));
    onClick("play", play);
    onChange("loop", box => loop(box.checked));
  }

  #buildDisplay() {
    const { look, face, reset, download } = this.#actions;
    onChange("colours", select => look({ colours: select.value }));
    onChange("wireframe", box => look({ wireframe: box.checked }));
    for (const side of ["front", "back", "left"]) onClick(`view-${side}`, () => face(side));
    onClick("view-reset", reset);
    for (const format of ["obj", "glb", "ply", "png"]) onClick(`download-${format}`, () => download(format));
  }

  #sample(seed) {
    byId("seed").value = seed;
    this.#actions.sample({ prior: byId("prior").value, temperature: this.temperature, seed });
  }

  get #joint() {
    return byId("joint").selectedIndex;
  }

  #updateModel(state) {
    this.#current = state;
    const locked = state.layers.includes("truth");
    byId("editing").disabled = locked;
    byId("locked").hidden = !locked;
    for (const outfit of document.getElementsByName("outfit")) outfit.checked = outfit.value === state.outfit;
    this.#z.forEach((slider, i) => slider.set(state.z[i]));
    this.#betas.forEach((slider, i) => slider.set(state.betas[i]));
    const known = this.#subject.model.poses.some(({ name }) => name === state.poseName);
    byId("pose").value = known ? state.poseName : CUSTOM;
    this.#updateAngles();
    for (const name of LAYERS) byId(`layer-${name}`).checked = state.layers.includes(name);
    this.#truth.set(state.truth);
  }

  #updateLayer(state) {
    this.#current = state;
    byId("movement").value = state.motion;
    this.#parameters.forEach((slider, i) => slider.set(state.parameters[i]));
    this.#betas.forEach((slider, i) => slider.set(state.betas[i]));
  }

  #updateAngles() {
    this.#angles.forEach((slider, i) => slider.set(this.#current.pose[this.#joint * 3 + i] * DEGREES));
  }
}
