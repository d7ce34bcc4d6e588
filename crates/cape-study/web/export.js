"use strict";
// The study as a jsPsych timeline. Results are sent to JATOS or DataPipe where configured, and can be
// saved as a file; ?simulate=data-only or ?simulate=visual runs it without a rater.
(async () => {
  const study = window.CAPE_STUDY;
  const { page, pair, feedback, size, INSTRUCTIONS } = window.capeStudy;
  const inJatos = typeof window.jatos !== "undefined";
  if (inJatos) await new Promise((loaded) => window.jatos.onLoad(loaded));
  const query = new URLSearchParams(location.search);
  const parameter = (name) => (inJatos ? window.jatos.urlQueryParameters[name] : query.get(name)) || "";
  const random = crypto.getRandomValues(new Uint32Array(4));
  const hexadecimal = [...random].map((x) => x.toString(16).padStart(8, "0")).join("");
  const rater = parameter("PROLIFIC_PID") || parameter("rater") || hexadecimal;

  // FNV-1a, so that a reload or a second visit gets the same schedule.
  let hash = 2166136261;
  for (const letter of rater) hash = Math.imul(hash ^ letter.codePointAt(0), 16777619) >>> 0;
  const given = Number.parseInt(parameter("schedule"), 10);
  const number = Number.isInteger(given) && given >= 0 ? given : hash;
  const schedule = number % study.schedules.length;

  const jsPsych = window.initJsPsych();
  const done = (result) => jsPsych.finishTrial(result);
  const { ParameterType } = window.jsPsychModule;

  class TextPlugin {
    static info = {
      name: "cape-text", version: "1.0.0", data: {},
      parameters: { title: { type: ParameterType.STRING }, texts: { type: ParameterType.COMPLEX }, label: { type: ParameterType.STRING } },
    };
    trial(display, { title, texts, label }) { page(display, title, texts, label).then(() => done({ window: size() })); }
    simulate(trial, mode, options, loaded) {
      loaded();
      if (mode === "data-only") { done({ window: size() }); return; }
      this.trial(jsPsych.getDisplayElement(), trial);
      document.querySelector(".next").click();
    }
  }

  class PairPlugin {
    static info = {
      name: "cape-pair", version: "1.0.0", data: {},
      parameters: { left: { type: ParameterType.STRING }, right: { type: ParameterType.STRING }, pair: { type: ParameterType.INT },
        number: { type: ParameterType.INT }, count: { type: ParameterType.INT }, practice: { type: ParameterType.BOOL } },
    };
    result({ left, right, pair: index }, { side, ...raw }) {
      return { rater, schedule, pair: index, left, right, chosen: side === "left" ? left : right, ...raw };
    }
    async trial(display, trial) {
      const shown = { ...trial, left: `stimuli/${trial.left}`, right: `stimuli/${trial.right}` };
      const result = this.result(trial, await pair(display, shown));
      if (trial.practice) await feedback(display, study.practice[trial.pair] === result.chosen);
      done(result);
    }
    simulate(trial, mode, options, loaded) {
      loaded();
      const side = Math.random() < 0.5 ? "left" : "right";
      if (mode === "data-only") { done(this.result(trial, { side, rt_ms: 1000, window: size(), events: [] })); return; }
      this.trial(jsPsych.getDisplayElement(), trial);
      const act = setInterval(() => {
        const next = document.querySelector(`.choice[value=${side}]:enabled, .next`);
        if (next) next.click();
        if (next && (!trial.practice || next.matches(".next"))) clearInterval(act);
      }, 50);
    }
  }

  const text = (title, texts, label) => ({ type: TextPlugin, title, texts, label });
  const own = study.schedules[schedule];
  const practised = own.filter(([index]) => index in study.practice).length;
  const trials = own.map(([index, flip], place) => {
    const [first, second] = study.pairs[index];
    const practice = place < practised;
    return {
      type: PairPlugin, pair: index, practice,
      left: flip ? second : first, right: flip ? first : second,
      number: practice ? place + 1 : place + 1 - practised,
      count: practice ? practised : own.length - practised,
    };
  });
  const timeline = [text("A study of clothing", study.consent, "I agree, begin"), text("How it works", INSTRUCTIONS, "Start")];
  timeline.push(...trials.slice(0, practised));
  if (practised) timeline.push(text("Practice is over", ["From now on you are not told the answer."], "Begin"));
  timeline.push(...trials.slice(practised));
  jsPsych.data.addProperties({
    study: study.id, agent: navigator.userAgent, prolific_study: parameter("STUDY_ID"), prolific_session: parameter("SESSION_ID"),
  });

  const simulate = query.get("simulate");
  if (simulate) await jsPsych.simulate(timeline, simulate); else await jsPsych.run(timeline);

  const results = jsPsych.data.get().json();
  window.capeResults = results;
  const root = document.querySelector(".jspsych-content") || document.body;
  const save = () => {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([results], { type: "application/json" }));
    link.download = `answers-${rater.replace(/[^A-Za-z0-9_-]/g, "_")}.json`;
    link.click();
  };
  const finish = () => { if (study.completion) location.assign(study.completion); };
  const thank = async (texts, label) => { await page(root, "Thank you", texts, label); };
  if (inJatos) {
    if (study.completion) window.jatos.endStudyAndRedirect(study.completion, results); else window.jatos.endStudy(results);
    return;
  }
  if (study.pipe && !simulate) {
    try {
      const response = await fetch("https://pipe.jspsych.org/api/data/", {
        method: "POST", headers: { "Content-Type": "application/json", Accept: "*/*" },
        body: JSON.stringify({ experimentID: study.pipe, filename: `${hexadecimal}.json`, data: results }),
      });
      if (!response.ok) throw new Error(`status ${response.status}`);
      await thank(["All answers are saved. You can close this page."]);
      finish();
      return;
    } catch (error) {
      await thank(["The answers could not be sent. Save them as a file and send it to the authors."], "Save answers");
      save();
      return;
    }
  }
  await thank(["Save your answers as a file and send it to the authors of the study."], "Save answers");
  save();
  finish();
})();
