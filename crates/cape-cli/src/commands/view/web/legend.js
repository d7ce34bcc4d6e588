// The colour bar below the picture.

import { QUANTITIES, cssGradient } from "./colours.js";
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
