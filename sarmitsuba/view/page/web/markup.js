// Markup templates: values are escaped as text, unless they are markup themselves. The only place where text becomes
// elements: names in a run's files are untrusted data.

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

/** Template tag: literal pieces are markup, values are text (arrays: concatenated). */
export function html(pieces, ...values) {
  return new Markup(pieces.reduce((text, piece, i) => text + written(values[i - 1]) + piece));
}

/** Replace the content of an element by markup or text. */
export function fill(element, markup) {
  const holder = document.createElement("template");
  holder.innerHTML = written(markup);
  element.replaceChildren(holder.content);
}
