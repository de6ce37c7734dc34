// Buttons and switches of a page, with their keys.

import { html } from "sarmitsuba/markup.js";

/** Button labelled with its key. */
export function button(parent, text, key, call) {
  const node = document.createElement("button");
  node.type = "button";
  node.textContent = text;
  node.title = `key ${key.toUpperCase()}`;
  node.addEventListener("click", call);
  parent.append(node);
  return node;
}

/** Next setting of a value; on or off without settings. */
export function turn(store, name, values) {
  const now = store.get(name);
  store.set({ [name]: values ? values[(values.indexOf(now) + 1) % values.length] : !now });
}

/** One button per switch [name, text, key, values, labels of the values]; without values: on or off. */
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

/** Whether a key event is for the page, not for a dialogue, a field or the browser. */
export function ours(event) {
  if (event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog[open]")) return false;
  return !["INPUT", "SELECT", "TEXTAREA"].includes(event.target.tagName) || event.key === "Escape";
}

/** Name of a key, letters in lower case. */
export const keyName = (event) => (event.key.length === 1 ? event.key.toLowerCase() : event.key);

/** Content of a help dialogue. */
export function helpText(keys, mouse) {
  return html`<h2>Keys</h2><table>${keys.map(([key, text]) => html`<tr><td><kbd>${key}</kbd></td><td>${text}</td></tr>`)}</table>
    <h2>Mouse</h2><p>${mouse}</p>
    <form method="dialog"><button>Close</button></form>`;
}
