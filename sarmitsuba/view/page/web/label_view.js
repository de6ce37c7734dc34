// Labels of the image's pixels: a choice of what colours the image, and the legend with shares.
//
// layer: { name, description, names, share, values: place in names of every pixel, and for shares part_names and parts, in 1/255 }

import { paintTinted } from "sarmitsuba/image_math.js";
import { fill, html } from "sarmitsuba/markup.js";

// distinguishable in turn, also with most kinds of colour blindness; pixels without a label are not coloured
const COLOURS = [
  [230, 97, 0], [26, 111, 223], [148, 90, 190], [0, 158, 115], [204, 60, 110], [240, 200, 40], [90, 190, 230], [150, 90, 40],
  [120, 160, 40], [110, 110, 160],
];
const PLAIN = ["none", "valid", "no surface"];

/** Colour [r, g, b] of the name at a place of a layer; null: none. */
export function colourOf(layer, place) {
  if (PLAIN.includes(layer.names[place])) return null;
  const before = layer.names.slice(0, place).filter((name) => !PLAIN.includes(name)).length;
  return COLOURS[before % COLOURS.length];
}

/** Name of a pixel, or the shares of its parts of one per cent and more, largest first. */
export function textOf(layer, index) {
  if (!layer.parts) return layer.names[layer.values[index]];
  const n = layer.part_names.length;
  const parts = layer.part_names.map((name, i) => [name, layer.parts[index * n + i] / 255]).filter(([, share]) => share >= 0.01);
  if (!parts.length) return "none";
  return parts.sort((a, b) => b[1] - a[1]).map(([name, share]) => `${name} ${Math.round(100 * share)} %`).join(", ");
}

const spoken = (name) => name.replaceAll("_", " ");

/** Choice and legend in an element, for an image view; returns a function that takes the colours away. */
export function showLabels(element, labels, view) {
  const show = (layer) => {
    for (const node of element.querySelectorAll("input")) node.checked = node.value === (layer?.name ?? "");
    fill(element.querySelector(".legend"), layer ? legend(layer) : "");
    view.more = layer ? ({ row, column }) => `; ${spoken(layer.name)}: ${textOf(layer, row * view.grid.nx + column)}` : () => "";
    const palette = layer?.names.map((_, place) => colourOf(layer, place));
    view.setPainter(layer ? (canvas) => paintTinted(canvas, view.db, view.grid.nx, view.black, view.white, layer.values, palette) : null);
    view.tell();
  };
  const choice = (value, text, checked) =>
    html`<label><input type="radio" name="sar-labels" value="${value}" ${checked ? "checked" : ""}> ${text}</label> `;
  fill(element, html`<h2>Colour the image by</h2><p role="radiogroup" aria-label="What colours the image">${choice("", "nothing", true)}
    ${labels.map((layer) => choice(layer.name, spoken(layer.name), false))}</p><div class="legend"></div>`);
  for (const node of element.querySelectorAll("input")) {
    node.addEventListener("change", () => show(labels.find((layer) => layer.name === node.value)));
  }
  return () => show(undefined);
}

function legend(layer) {
  const swatch = (colour) => (colour ? `rgb(${colour.join(", ")})` : "transparent");
  return html`<p class="quiet">${layer.description}. Shares are of the image's pixels.</p><table>${layer.names.map((name, place) => html`<tr>
    <td><svg width="14" height="14" aria-hidden="true"><rect width="14" height="14" fill="${swatch(colourOf(layer, place))}" stroke="gray"/></svg></td>
    <th scope="row">${name}</th><td class="number">${(100 * layer.share[place]).toFixed(1)} %</td></tr>`)}</table>`;
}
