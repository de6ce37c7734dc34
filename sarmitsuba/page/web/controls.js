// Buttons and switches of a page, and the keys that do the same.

import { html } from "sarmitsuba/markup.js";

/** A button that says its key. */
export function button(parent, text, key, call) {
  const node = document.createElement("button");
  node.type = "button";
  node.textContent = text;
  node.title = `key ${key.toUpperCase()}`;
  node.addEventListener("click", call);
  parent.append(node);
  return node;
}

/** The next of a value's settings; on or off where there are none. */
export function turn(store, name, values) {
  const now = store.get(name);
  store.set({ [name]: values ? values[(values.indexOf(now) + 1) % values.length] : !now });
}

/** A button per switch [name, text, key, values, words of the values]; without values: on or off. */
export function switches(parent, list, store) {
  for (const [name, text, key, values, words] of list) {
    const node = button(parent, text, key, () => turn(store, name, values));
    const show = () => {
      const value = store.get(name);
      if (words) node.textContent = `${text}: ${words[value]}`;
      else node.setAttribute("aria-pressed", String(value));
    };
    node.dataset.name = name;
    store.on([name], show);
    show();
  }
}

/** Whether a key is meant for the page, and not for a dialogue, a field or the browser. */
export function ours(event) {
  if (event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog[open]")) return false;
  return !["INPUT", "SELECT", "TEXTAREA"].includes(event.target.tagName) || event.key === "Escape";
}

/** Name of a key, letters in lower case. */
export const keyName = (event) => (event.key.length === 1 ? event.key.toLowerCase() : event.key);

/** What a help dialogue says. */
export function helpText(keys, mouse) {
  return html`<h2>Keys</h2><table>${keys.map(([key, text]) => html`<tr><td><kbd>${key}</kbd></td><td>${text}</td></tr>`)}</table>
    <h2>Mouse</h2><p>${mouse}</p>
    <form method="dialog"><button>Close</button></form>`;
}
