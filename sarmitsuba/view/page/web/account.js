// Error by cause and time by stage of a run, as tables with bars.

import { html } from "sarmitsuba/markup.js";

/** Share of every cause in the likely sum of the known error energies, 0 where it is not known. */
export function shares(errors) {
  const energy = errors.map((part) => {
    const level = part.likely_db ?? part.error_db;
    return level === null ? 0 : 10 ** (level / 10);
  });
  const sum = energy.reduce((a, b) => a + b, 0);
  return energy.map((x) => (sum > 0 ? x / sum : 0));
}

const seconds = (value) => (value === null ? "-" : `${value.toFixed(2)} s`);
const level = (part) => {
  if (part.error_db === null) return part.known;
  const likely = (part.likely_db ?? part.error_db) < part.error_db - 1 ? ` (likely ${part.likely_db.toFixed(0)} dB)` : "";
  const kind = part.samples ? `${part.known} (${part.samples})` : part.known;
  const against = part.contradicts ? `, contradicts the law of ${part.law_db.toFixed(1)} dB` : "";
  return `${part.error_db.toFixed(1)} dB${likely}, ${kind}${against}`;
};

/** Bar of a share, light where it is a bound or a law. */
function bar(share, light) {
  return html`<td class="share"><div class="${light ? "bound" : "known"}" style="width: ${(100 * share).toFixed(1)}%"></div></td>`;
}

/** Both tables and the advice; `account` of a look, or null. */
export function accountView(account) {
  if (!account) return html`<p class="quiet">The record of this run holds no account of error and time.</p>`;
  const parts = shares(account.errors);
  const longest = Math.max(...account.stages.map((stage) => stage.seconds ?? 0), 1e-9);
  const total = account.total_db === null ? "" : ` The sum is ${account.total_db.toFixed(1)} dB of the image's energy (${account.known}).`;
  return html`<h2>What the error is made of</h2>
    <p class="quiet">Bars: share of the likely sum of the known errors, light where they are bounds or by a law.${total}</p>
    <table>${account.errors.map((part, i) => html`<tr><th scope="row">${part.name}</th>${bar(parts[i], part.known === "bound" || part.known === "law")}
      <td class="number">${level(part)}</td></tr>`)}</table>
    <h2>Where the time went</h2>
    <table><tr><th></th><td></td><td class="number quiet">elapsed</td><td class="number quiet">processor</td></tr>
    ${account.stages.map((stage) => html`<tr><th scope="row">${stage.name}</th>${bar((stage.seconds ?? 0) / longest, false)}
      <td class="number">${seconds(stage.seconds)}</td><td class="number">${seconds(stage.processor)}</td></tr>`)}</table>
    ${account.advice.map((text) => html`<p>${text}</p>`)}`;
}

/** The statement of a sweep's error: sampling, bounces left out, theory and total; a warning in bold. */
export function statementView({ text, warning }) {
  const words = `${text[0].toUpperCase()}${text.slice(1)}.`;
  return html`${words}${warning ? html` <b>${`${warning[0].toUpperCase()}${warning.slice(1)}.`}</b>` : ""}`;
}
