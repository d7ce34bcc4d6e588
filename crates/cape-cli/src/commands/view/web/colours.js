// What the surface can be coloured by, and the colour maps of the quantities.

const table = text => text.split(" ").map(hex => [0, 2, 4].map(i => parseInt(hex.slice(i, i + 2), 16) / 255));

const VIRIDIS = table("440154 472d7b 3b528b 2c728e 21918c 28ae80 5ec962 addc30 fde725");
const PLASMA = table("0d0887 4c02a1 7e03a8 aa2395 cc4778 e66c5c f89540 fdc527 f0f921");

/// Colours in a table, from nothing to the maximum.
export const STOPS = VIRIDIS.length;

/// The ways to colour, in the order in which they are cycled through.
export const MODES = ["cloth", "displacement", "error"];

/// The modes that show a quantity; `maximum` is in millimetres.
export const QUANTITIES = {
  displacement: { title: "displacement", table: VIRIDIS, maximum: 50 },
  error: { title: "error", table: PLASMA, maximum: 20 },
};

export const cssColour = colour => `rgb(${colour.map(part => Math.round(part * 255)).join(" ")})`;

export const cssGradient = table => `linear-gradient(to right, ${table.map(cssColour).join(", ")})`;
