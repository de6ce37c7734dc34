// Comparison of two images of one scene: side by side with a common cursor, alternating, or their difference.

import { atPixelsOf, complexDifference, decibels, likeness, paintGrey, paintRatio } from "sarmitsuba/image_math.js";
import { createImageView, make, slider, useStyle } from "sarmitsuba/image_view.js";

const STYLE = `
.sar-pair { display: flex; flex-direction: column; gap: 6px; height: 100%; min-height: 0; }
.sar-pair > .sar-views { display: grid; grid-template-columns: 1fr 1fr; gap: 10px; flex: 1; min-height: 0; }
.sar-pair > .sar-views.one { grid-template-columns: 1fr; }
.sar-pair [hidden] { display: none; }
.sar-pair p { margin: 0; font-size: .88rem; }
`;
// ms between changes of the picture: one flash per second, a third of the accessibility limit
const FLICKER_MS = 500;
const MODES = {
  side: ["Side by side", "Both images; the cursor is at the same place of the ground in both."],
  flicker: ["Flicker", "The images alternate in the same place: whatever moves or blinks differs."],
  ratio: ["Difference in dB", ""],
  complex: ["Complex difference", ""],
};

class Comparison {
  constructor(element, { first, second, onPick }) {
    useStyle();
    if (!document.getElementById("sar-pair-style")) {
      const style = make("style", { id: "sar-pair-style" });
      style.textContent = STYLE;
      document.head.append(style);
    }
    this.titles = [first.title, second.title];
    this.modes = make("div", { class: "sar-tools", role: "radiogroup", "aria-label": "How the images are compared" });
    this.text = make("p", { role: "status" });
    this.holders = [make("div"), make("div")];
    this.frame = make("div", { class: "sar-views" }, ...this.holders);
    this.colours = slider("Full colour at", { low: 1, high: 30, step: 1, value: 10, unit: "dB" }, (value) => {
      this.most = value;
      this.first.paint();
    });
    this.most = 10;
    this.pause = make("button", { type: "button" });
    this.pause.addEventListener("click", () => this.turn());
    this.element = make("div", { class: "sar-pair" }, this.modes, this.text, this.frame);
    element.append(this.element);
    this.first = createImageView(this.holders[0], { ...first, onPick, ...this.links(() => this.second) });
    this.second = createImageView(this.holders[1], { ...second, onPick, controls: false, ...this.links(() => this.first) });
    this.second.setRange(this.first.black, this.first.white);
    this.first.more = (pixel) => this.beside(pixel);
    this.element.append(this.first.tools); // below both: the pictures are of one size
    this.buttons();
    this.setMode("side");
  }

  /** Synchronise the cursors of both views. */
  links(other) {
    return {
      onCursor: (_, point) => other().setCursor(point && other().pixelOf(point)),
      onRange: (black, white) => other().setRange(black, white),
      onPaint: (view) => this.painted(view),
      onFit: () => this.fit(),
    };
  }

  /** Give both pictures the smaller of their scales while they are side by side. */
  fit() {
    if (!this.first || !this.second || this.fitting) return;
    const both = [this.first, this.second];
    const scales = both.map((view) => view.fittingPerMetre).filter(Boolean);
    const most = this.holders[1].hidden ? Infinity : Math.min(...scales);
    this.fitting = true; // placing a view asks again
    for (const view of both) {
      if (view.mostPerMetre === most) continue;
      view.mostPerMetre = most;
      view.place();
    }
    this.fitting = false;
  }

  /** Show the same orders in the second view as in the first, and update their comparison. */
  painted(view) {
    if (!this.mode || this.busy) return;
    this.busy = true;
    if (view === this.first) {
      for (const { order } of this.second.image.layers) {
        const on = !this.first.off.has(order);
        if (on === this.second.off.has(order)) this.second.setOrder(order, on);
      }
    }
    if (this.mode !== "side") this.first.paint();
    this.busy = false;
    this.say();
  }

  buttons() {
    for (const [mode, [name]] of Object.entries(MODES)) {
      const node = make("input", { type: "radio", name: "sar-compare", value: mode });
      node.addEventListener("change", () => this.setMode(mode));
      this.modes.append(make("label", {}, node, name));
    }
    this.modes.append(this.colours.node, this.pause);
  }

  /** Whether the pixels of both have equal positions. */
  get alike() {
    const [a, b] = [this.first, this.second].map((view) => view.grid);
    if (a.nx !== b.nx || a.ny !== b.ny) return false;
    const corners = [{ row: 0, column: 0 }, { row: a.ny - 1, column: a.nx - 1 }];
    const near = (p, q) => Math.hypot(...p.map((value, i) => value - q[i]));
    const step = Math.abs(a.columns.at(-1) - a.columns[0]) / a.nx;
    return corners.every((corner) => near(this.first.pointOf(corner), this.second.pointOf(corner)) < 0.01 * step + 1e-6);
  }

  /** Whether levels of both have one unit. */
  get commensurable() {
    const unit = ({ image }) => (image.calibrated === false ? "uncalibrated" : image.cellArea ? "sigma0" : "RCS");
    return unit(this.first) === unit(this.second);
  }

  /** Whether a mode other than side by side can be shown. */
  canShow(mode) {
    return this.alike || (mode !== "complex" && this.commensurable);
  }

  /** The second image, dB, at the pixels of the first; its power is interpolated where the pixels differ. */
  get secondDb() {
    const { db } = this.second;
    if (this.alike) return db;
    if (this.interpolated?.of !== db) {
      const power = atPixelsOf(db.map((value) => 10 ** (value / 10)), this.second.grid, this.first.grid);
      this.interpolated = { of: db, db: power.map((value) => 10 * Math.log10(value)) };
    }
    return this.interpolated.db;
  }

  /** Show the images "side" by side, in turn ("flicker"), or their difference ("ratio" in dB, "complex"). */
  setMode(mode) {
    clearInterval(this.timer);
    this.mode = mode;
    this.swapped = false;
    for (const node of this.modes.querySelectorAll("input[type=radio]")) node.checked = node.value === mode;
    const single = mode !== "side" && this.canShow(mode);
    this.holders[1].hidden = single;
    this.frame.classList.toggle("one", single);
    this.colours.node.hidden = mode !== "ratio";
    this.pause.hidden = mode !== "flicker" || !single;
    this.first.place();
    this.first.setPainter(single ? (canvas) => this.paintBoth(canvas) : null);
    if (mode === "flicker" && single && !matchMedia("(prefers-reduced-motion: reduce)").matches) this.start();
    this.say();
  }

  start() {
    this.timer = setInterval(() => this.swap(), FLICKER_MS);
  }

  /** The other of the two images. */
  swap() {
    this.swapped = !this.swapped;
    this.busy = true;
    this.first.paint();
    this.busy = false;
    this.say();
  }

  /** Stop the flicker at the present image, or switch to the other one. */
  turn() {
    if (this.timer) {
      clearInterval(this.timer);
      this.timer = null;
    }
    this.swap();
  }

  paintBoth(canvas) {
    const { first, second } = this;
    const { nx } = first.grid;
    if (this.mode === "ratio") {
      paintRatio(canvas, first.db, this.secondDb, nx, first.black, this.most);
    } else if (this.mode === "complex") {
      const db = decibels(complexDifference(first.sum, second.sum), nx, first.image.cellArea ?? null);
      paintGrey(canvas, db, nx, first.black, first.white);
    } else {
      paintGrey(canvas, this.swapped ? this.secondDb : first.db, nx, first.black, first.white);
    }
  }

  /** Description of the present display. */
  say() {
    const [a, b] = this.titles;
    const names = { flicker: this.swapped ? b : a, ratio: `${a} over ${b}`, complex: `${a} minus ${b}` };
    this.first.caption.textContent = (this.canShow(this.mode) && names[this.mode]) || a;
    this.pause.textContent = `Show ${this.swapped ? a : b}`;
    if (this.mode !== "side" && !this.canShow(this.mode)) {
      this.text.textContent = this.commensurable
        ? "The two images have different pixels: their complex difference cannot be shown, their difference in dB can."
        : "The levels of the two images have different units: their difference cannot be shown.";
      return;
    }
    let text = MODES[this.mode][1];
    if (this.mode === "ratio") {
      text = `Orange: ${a} is stronger; blue: ${b} is stronger; white: equal; black: both below the dB slider's black.`;
    }
    if (this.mode === "complex") {
      text = "Magnitude of the complex difference of both images, on their dB scale.";
    }
    if (!this.alike && this.mode !== "side") {
      text += ` ${b} is shown at the pixels of ${a}, at the same places of the ground; black also where it does not reach.`;
    }
    this.text.textContent = this.alike ? `${text} ${this.figures()}` : text;
  }

  /** The second image's level at a pixel of the first. */
  beside(pixel) {
    if (!this.second) return "";
    const there = this.second.pixelOf(this.first.pointOf(pixel));
    const text = there ? this.second.levelText(there.row * this.second.grid.nx + there.column) : "not imaged";
    return `; ${this.titles[1]} ${text}`;
  }

  figures() {
    const { coherence, error } = likeness(this.first.sum, this.second.sum);
    if (!Number.isFinite(coherence)) return "";
    const left = Number.isFinite(error) ? `the difference has ${error.toFixed(1)} dB of the first's power` : "no difference";
    return `Coherence ${coherence.toFixed(4)}; ${left}.`;
  }

  /** Stop all animation and remove the views. */
  remove() {
    clearInterval(this.timer);
    this.element.remove();
  }
}

/**
 * @param {HTMLElement} element in which both are put
 * @param {object} options first, second: { title, image, grid } as in image_view.js; onPick(pixel, point)
 */
export function createComparison(element, options) {
  return new Comparison(element, options);
}
