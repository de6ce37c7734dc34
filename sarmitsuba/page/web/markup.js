// Markup whose values are text: whatever stands between the pieces of a template is escaped, unless it is markup itself.
// The only place where text becomes elements: names in a run's files are data, wherever they come from.

const ENTITIES = { "&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;", "'": "&#39;" };

class Markup {
  constructor(text) {
    this.text = text;
  }
}

function written(value) {
  if (value instanceof Markup) return value.text;
  if (Array.isArray(value)) return value.map(written).join("");
  return String(value ?? "").replace(/[&<>"']/g, (c) => ENTITIES[c]);
}

/** Tag of template literals: markup of their pieces as they stand, and of their values as text (arrays: one after the other). */
export function html(pieces, ...values) {
  return new Markup(pieces.reduce((text, piece, i) => text + written(values[i - 1]) + piece));
}

/** Markup, or text, in place of all that an element holds. */
export function fill(element, markup) {
  const holder = document.createElement("template");
  holder.innerHTML = written(markup);
  element.replaceChildren(holder.content);
}
