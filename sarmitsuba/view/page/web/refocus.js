// Controls for focusing the recorded pulses again: fewer pulses, another window, a track error.

import { TRACK_ERRORS, apertureFacts, plainSettings } from "sarmitsuba/aperture.js";
import { createBackprojector } from "sarmitsuba/backprojector.js";
import { make, slider, useStyle } from "sarmitsuba/image_view.js";
import { windowNames } from "sarmitsuba/windows.js";

// pixels of the preview while a slider moves
const PREVIEW_PIXELS = 65536;
// ms of work between two pictures, so that the page stays responsive
const SLICE_MS = 80;

const WINDOWS = {
  rectangular: "rectangular: sharpest, side lobes at -13 dB",
  "taylor:4:-35": "Taylor: side lobes at -35 dB",
  "hamming:0.54": "Hamming: side lobes at -43 dB, wider",
};
const KEEP = { 1: "every pulse", 2: "every 2nd", 3: "every 3rd", 4: "every 4th", 6: "every 6th", 8: "every 8th" };
const ERRORS = { none: "none", linear: "linear", quadratic: "bent", sinusoidal: "shaking" };

function menu(name, choices, call) {
  const options = Object.entries(choices).map(([value, text]) => make("option", { value }, text));
  const select = make("select", {}, ...options);
  select.addEventListener("change", () => call(select.value));
  return { node: make("label", {}, name, select), select };
}

/** Grid thinned to every step-th row and column, for a bounded number of pixels. */
export function previewGrid(grid, pixels = PREVIEW_PIXELS) {
  const step = Math.ceil(Math.sqrt((grid.nx * grid.ny) / pixels));
  const some = (axis) => axis.filter((_, i) => i % step === 0);
  const [rows, columns] = [some(grid.rows), some(grid.columns)];
  return { ...grid, rows, columns, ny: rows.length, nx: columns.length, step };
}

/** Pixels of a preview on the whole grid. */
function spread(sum, small, grid) {
  const of = (values) => {
    const out = new Float32Array(grid.nx * grid.ny);
    for (let i = 0; i < grid.ny; i++) {
      const from = Math.floor(i / small.step) * small.nx;
      for (let j = 0; j < grid.nx; j++) out[i * grid.nx + j] = values[from + Math.floor(j / small.step)];
    }
    return out;
  };
  return { re: of(sum.re), im: of(sum.im) };
}

class Refocus {
  constructor(element, { data, grid, onImage, onSettings }) {
    useStyle();
    Object.assign(this, { data, grid, onImage, onSettings });
    this.settings = plainSettings(data);
    this.small = previewGrid(grid);
    this.end = data.nPulses;
    this.projectors = {};
    this.element = make("div", { class: "sar-tools", role: "group", "aria-label": "Focus again" });
    this.text = make("p", { class: "sar-readout", role: "status" });
    element.append(this.element, this.text);
    this.controls();
    this.say();
  }

  controls() {
    const set = (changes, final = true) => this.change(changes, final);
    this.keep = menu("Pulses kept", KEEP, (value) => set({ keepEvery: Number(value) }));
    const percent = { low: 0, high: 100, step: 1, unit: "%" };
    this.from = slider("Aperture from", { ...percent, value: 0 }, (value, final) => {
      const from = Math.min(value / 100, this.settings.to - 0.02);
      this.from.set(Math.round(100 * from));
      set({ from }, final);
    });
    this.to = slider("to", { ...percent, value: 100 }, (value, final) => {
      const to = Math.max(value / 100, this.settings.from + 0.02);
      this.to.set(Math.round(100 * to));
      set({ to }, final);
    });
    const windows = Object.fromEntries(windowNames(this.data).map((text) => [text, WINDOWS[text] ?? text]));
    this.azimuth = menu("Window over the aperture", windows, (azimuthWindow) => set({ azimuthWindow }));
    this.range = menu("over the bandwidth", windows, (rangeWindow) => set({ rangeWindow }));
    const error = (changes, final) => set({ error: { ...this.settings.error, ...changes } }, final);
    this.kind = menu("Error of the track", ERRORS, (kind) => error({ kind }, true));
    const waves = { low: 0, high: 2, step: 0.02, value: 0, unit: "wavelengths" };
    this.amplitude = slider("of", waves, (value, final) => error({ amplitude: value * this.data.wavelength }, final));
    const cycles = { low: 1, high: 20, step: 0.5, value: this.settings.error.cycles, unit: "times" };
    this.cycles = slider("to and fro", cycles, (value, final) => error({ cycles: value }, final));
    const plain = make("button", { type: "button" }, "As it was");
    plain.addEventListener("click", () => this.restore());
    const all = [this.keep, this.from, this.to, this.azimuth, this.range, this.kind, this.amplitude, this.cycles];
    this.element.append(...all.map((one) => one.node), plain);
    this.show();
  }

  /** Apply settings, and focus: a preview while a slider moves, the whole image when it is released. */
  change(changes, final = true) {
    Object.assign(this.settings, changes);
    this.show();
    this.say();
    this.onSettings?.(this.settings);
    return this.request(!final);
  }

  /** All pulses, with the windows of the page's own image. */
  restore() {
    return this.change(plainSettings(this.data));
  }

  show() {
    const { keepEvery, from, to, azimuthWindow, rangeWindow, error } = this.settings;
    this.keep.select.value = keepEvery;
    this.from.set(Math.round(100 * from));
    this.to.set(Math.round(100 * to));
    this.azimuth.select.value = azimuthWindow;
    this.range.select.value = rangeWindow;
    this.kind.select.value = error.kind;
    this.amplitude.set((error.amplitude / this.data.wavelength).toFixed(2));
    this.cycles.set(error.cycles);
    this.amplitude.node.hidden = error.kind === "none";
    this.cycles.node.hidden = error.kind !== "sinusoidal";
  }

  /** Description of the effect of the settings. */
  say() {
    const { pulses, azimuth, range, apart } = apertureFacts(this.data, this.settings);
    const { kind, amplitude } = this.settings.error;
    const error = kind === "none" ? "" : ` Track error ${(1000 * amplitude).toFixed(1)} mm: ${TRACK_ERRORS[kind]}.`;
    this.text.textContent =
      `${pulses} pulses; cell ${azimuth.toPrecision(3)} m in azimuth, ${range.toPrecision(3)} m in slant range; ` +
      `azimuth ambiguities of a point ${apart.toPrecision(3)} m beside it.${error}`;
  }

  /** Image of the pulses before `end`, for the time line. */
  setEnd(end) {
    this.end = end;
    return this.request(false);
  }

  /** Request a picture, which replaces one in progress. Resolves when the last requested one is shown. */
  request(preview) {
    this.wanted = { preview, end: this.end };
    this.halted = false;
    this.running ??= this.work()
      .catch((error) => {
        this.text.textContent = error.message;
      })
      .finally(() => {
        this.running = null;
      });
    return this.running;
  }

  async work() {
    while (this.wanted && !this.halted) {
      const { preview, end } = this.wanted;
      this.wanted = null;
      const name = preview && this.small.step > 1 ? "small" : "whole";
      const one = await this.projector(name);
      const settings = JSON.stringify(this.settings);
      if (one.settings !== settings || end < one.done) {
        one.bp.reset(this.settings);
        one.settings = settings;
        one.done = 0;
      }
      do {
        const start = performance.now();
        const next = Math.min(one.done + one.chunk, end);
        one.bp.add(one.done, next);
        one.done = next;
        const sum = await one.bp.read();
        if (this.halted) break;
        // a preview is shown when complete, so that a moving slider does not flicker
        if (name === "whole") this.onImage(sum, { preview: false, done: next, end });
        else if (next === end) this.onImage(spread(sum, this.small, this.grid), { preview: true, done: next, end });
        await new Promise((resolve) => setTimeout(resolve)); // yield to the page
        if (this.halted || (this.wanted && name === "whole")) break;
        const passed = performance.now() - start;
        // reading and showing take constant time: they must not take most of the total
        one.least = Math.min(one.least, passed);
        one.chunk = Math.max(1, passed < Math.max(SLICE_MS, 2 * one.least) ? 2 * one.chunk : one.chunk >> 1);
      } while (one.done < end);
    }
  }

  async projector(name) {
    if (!this.projectors[name]) {
      const bp = await createBackprojector(null, this.data, name === "small" ? this.small : this.grid);
      this.projectors[name] = { bp, done: 0, chunk: 8, least: Infinity, settings: "" };
    }
    return this.projectors[name];
  }

  /** Stop at the present pulse; the next request continues from there. Resolves when no further image will come. */
  async stop() {
    this.wanted = null;
    this.halted = true;
    await this.running;
  }

  /** Release the GPU memory when it is no longer in use, and remove the controls. */
  async remove() {
    this.element.remove();
    this.text.remove();
    await this.stop();
    for (const { bp } of Object.values(this.projectors)) bp.free();
    this.projectors = {};
  }
}

/**
 * @param {HTMLElement} element in which the controls are put
 * @param {object} options data, grid: see backprojector.js; onImage({re, im}, {preview, done, end}): the image so far;
 *   onSettings(settings): see plainSettings in aperture.js
 */
export function createRefocus(element, options) {
  return new Refocus(element, options);
}
