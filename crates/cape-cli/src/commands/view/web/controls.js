// The building blocks of the panel.

export const byId = id => document.getElementById(id);

export function element(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

export function signed(value, digits = 2) {
  const size = Math.abs(value).toFixed(digits);
  if (Number(size) === 0) return size;
  return (value > 0 ? "+" : "−") + size;
}

/// A labelled slider with its value; `origin` is what a double click or the key 0 goes back to.
export function slider({ id, label, note = "", range: [minimum, maximum], step, origin = minimum, format, input }) {
  const range = element("input", { type: "range", id, min: minimum, max: maximum, step, value: origin });
  const output = element("output", { htmlFor: id });
  const row = element("div", { className: "slider" }, element("label", { htmlFor: id, textContent: label }), range, output);
  if (note) {
    row.append(element("small", { textContent: note }));
    range.title = `${label}: ${note}`;
  }

  const part = value => `${(100 * (Math.min(maximum, Math.max(minimum, value)) - minimum)) / (maximum - minimum || 1)}%`;
  const set = value => {
    range.value = value;
    output.textContent = format(value);
    range.ariaValueText = output.textContent;
    range.style.setProperty("--from", part(Math.min(value, origin)));
    range.style.setProperty("--to", part(Math.max(value, origin)));
  };
  const limit = count => {
    maximum = count;
    range.max = count;
  };
  range.addEventListener("input", () => input(range.valueAsNumber));
  range.addEventListener("dblclick", () => input(origin));
  range.addEventListener("keydown", event => event.key === "0" && input(origin));
  set(origin);
  return { row, range, set, limit };
}

/// A radio button that looks like one of a row of buttons.
export function choice({ id, name, value, title, chosen }) {
  const radio = element("input", { type: "radio", id, name, value });
  radio.addEventListener("change", () => chosen(value));
  return element("label", { htmlFor: id, className: "choice", title }, radio, element("span", { textContent: value }));
}

export function fill(select, values) {
  select.append(...values.map(value => element("option", { value, textContent: value })));
}

export const onChange = (id, action) => byId(id).addEventListener("change", event => action(event.target));

export const onClick = (id, action) => byId(id).addEventListener("click", action);
