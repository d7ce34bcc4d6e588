// The keyboard, by pressing the controls that do the same.

import { byId, element } from "./controls.js";

const press = id => byId(id).click();

function cycle(select) {
  const options = [...select.options].filter(option => !option.disabled);
  select.value = options[(options.indexOf(select.selectedOptions[0]) + 1) % options.length].value;
  select.dispatchEvent(new Event("change"));
}

const KEYS = [
  [["Space"], "play or pause", () => press("play")],
  [["S"], "sample new clothing", () => press("sample")],
  [["M"], "mean clothing", () => press("mean")],
  [["1", "2", "3", "4", "5", "6", "7", "8", "9"], "outfit", key => byId("outfits").querySelectorAll("input")[key - 1]?.click()],
  [["C"], "next colours", () => cycle(byId("colours"))],
  [["W"], "wireframe", () => press("wireframe")],
  [["F", "B", "L"], "front, back, left side", key => press({ f: "view-front", b: "view-back", l: "view-left" }[key])],
  [["R"], "reset the view", () => press("view-reset")],
  [["?"], "this help", () => press("help-open")],
];

const GESTURES = [
  [["drag", "←↑→↓"], "turn"],
  [["right or Shift drag", "two fingers", "Shift ←↑→↓"], "move"],
  [["wheel", "pinch", "+", "−"], "zoom"],
  [["double click", "0"], "slider to its origin"],
];

const ACTIONS = new Map(KEYS.flatMap(([keys, , action]) =>
  keys.map(key => [key === "Space" ? " " : key.toLowerCase(), action])));

/// Keys that the focused control needs itself.
function taken(target, key) {
  if (target.matches("select, input[type=number]")) return true;
  if (target.matches("input[type=range]") && key === "0") return true;
  return key === " " && target.matches("button, summary, input:not([type=range])");
}

/// Listens to the keyboard; the help has the keys and `notes`.
export function bindKeys(notes) {
  byId("help-keys").tBodies[0].append(...[...KEYS, ...GESTURES].map(([keys, text]) => element("tr", {},
    element("th", { scope: "row" }, ...keys.map(key => element("kbd", { textContent: key }))),
    element("td", { textContent: text }))));
  byId("help-notes").append(...notes.map(textContent => element("li", { textContent })));
  byId("help-notes").hidden = notes.length === 0;
  byId("help-open").addEventListener("click", () => byId("help").showModal());

  document.addEventListener("keydown", event => {
    const key = event.key.toLowerCase();
    const action = ACTIONS.get(key);
    const elsewhere = event.ctrlKey || event.metaKey || event.altKey || byId("help").open;
    if (!action || elsewhere || taken(event.target, key)) return;
    event.preventDefault();
    action(key);
  });
}
