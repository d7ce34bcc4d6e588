// The colour bar below the picture.

import { QUANTITIES, cssColour, cssGradient } from "./colours.js";
import { byId, element, onChange } from "./controls.js";

/// Round numbers from nothing to `maximum`, at most seven.
export function ticks(maximum) {
  const magnitude = 10 ** Math.floor(Math.log10(maximum / 6));
  const step = [1, 2, 5, 10].map(factor => factor * magnitude).find(step => maximum / step <= 6);
  return Array.from({ length: Math.floor(maximum / step + 1e-6) + 1 }, (_, i) => Number((i * step).toPrecision(6)));
}

export class Legend {
  #maxima = Object.fromEntries(Object.entries(QUANTITIES).map(([name, { maximum }]) => [name, maximum]));
  #shown = null;

  /// `changed` is called when another maximum is chosen.
  constructor(changed) {
    onChange("legend-maximum", input => {
      if (input.valueAsNumber > 0) {
        this.#maxima[this.#shown] = input.valueAsNumber;
        changed();
      }
      input.value = this.#maxima[this.#shown];
    });
  }

  /// The maximum of a quantity in millimetres.
  maximum(quantity) {
    return this.#maxima[quantity];
  }

  /// `picture`, with the colour bar below it if there is one.
  under(picture) {
    if (!this.#shown) return picture;
    const { table } = QUANTITIES[this.#shown];
    const maximum = this.#maxima[this.#shown];
    const style = getComputedStyle(document.body);
    const unit = Math.max(10, picture.width / 40);
    const canvas = element("canvas", { width: picture.width, height: picture.height + Math.ceil(5 * unit) });
    const pen = canvas.getContext("2d");
    pen.fillStyle = style.backgroundColor;
    pen.fillRect(0, 0, canvas.width, canvas.height);
    pen.drawImage(picture, 0, 0);
    const [left, top, width] = [2 * unit, picture.height + 2 * unit, canvas.width - 4 * unit];
    const gradient = pen.createLinearGradient(left, 0, left + width, 0);
    table.forEach((colour, i) => gradient.addColorStop(i / (table.length - 1), cssColour(colour)));
    pen.fillStyle = gradient;
    pen.fillRect(left, top, width, unit);
    pen.fillStyle = style.color;
    pen.font = `${unit}px ${style.fontFamily}`;
    pen.fillText(byId("legend-text").textContent, left, top - 0.6 * unit, width);
    pen.textAlign = "center";
    for (const tick of ticks(maximum)) {
      const x = left + (width * tick) / maximum;
      pen.fillRect(x - unit / 20, top + unit, unit / 10, unit / 3);
      pen.fillText(tick, x, top + 2.4 * unit);
    }
    return canvas;
  }

  /// Shows a quantity with the statistics of its values, or nothing.
  update(quantity, values) {
    this.#shown = quantity;
    byId("legend").hidden = !quantity;
    if (!quantity) return;
    const { title, table } = QUANTITIES[quantity];
    const maximum = this.#maxima[quantity];
    byId("legend-bar").style.backgroundImage = cssGradient(table);
    byId("legend-maximum").value = maximum;
    byId("legend-ticks").replaceChildren(...ticks(maximum).map(tick => {
      const mark = element("span", { textContent: tick });
      mark.style.left = `${(100 * tick) / maximum}%`;
      return mark;
    }));
    const millimetres = length => `${(1000 * length).toFixed(1)} mm`;
    const text = values ? `: mean ${millimetres(values.mean)}, largest ${millimetres(values.largest)}` : " in mm";
    byId("legend-text").textContent = title + text;
  }
}
