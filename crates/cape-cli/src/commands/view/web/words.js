// What the page says.

export const OUTFITS = {
  shortlong: "short sleeves, long trousers",
  shortshort: "short sleeves, short trousers",
  longshort: "long sleeves, short trousers",
  longlong: "long sleeves, long trousers",
};

/// The layers' names; a model shows its reconstruction beside a registration.
export const layerNames = (kinds, model) => kinds.map(kind => {
  if (kind === "body") return "body";
  if (kind === "truth") return "ground truth";
  return model && kinds.includes("truth") ? "reconstruction" : "clothed";
});

/// Description of the picture for screen readers.
export function describe({ who, names, side, colours, wireframe }) {
  const seen = { front: "from the front", back: "from behind", left: "from the left", right: "from the right" }[side];
  const parts = [`${who}, seen ${seen}`];
  if (names.length > 1) parts.push(`side by side: ${names.join(", ")}`);
  if (colours !== "cloth") parts.push(`coloured by ${colours}`);
  if (wireframe) parts.push("with wireframe");
  return parts.join("; ");
}

/// A file name of some words.
export function fileName(words, format) {
  const plain = words.join("-").toLowerCase().replace(/[^a-z0-9]+/g, "-").replace(/^-+|-+$/g, "");
  return `${plain || "cape"}.${format}`;
}

export const figures = ({ latency, triangles }) => {
  const time = latency < 10 ? latency.toFixed(1) : latency.toFixed(0);
  return `${time} ms · ${triangles.toLocaleString("en")} triangles`;
};
