// The focused image as a picture: grey in dB, with axes, a scale bar, a dB slider, a switch per bounce order, and a
// cursor that says where it stands.
//
// image: { layers: [{ order, re, im }] complex amplitudes in m, Float32Array [ny][nx]; scale by which they are too
//   large (default 1); cellArea Float32Array(nx) m^2 for sigma0, or null for RCS; calibrated: false
//   for levels in unknown units; limits [black, white] in dB, as shown at first; without them the brightest pixels say }
// grid: as in backprojector.js, with kind "slant" | "ground", center [3] m, azimuth Float64Array(ny), range
//   Float64Array(nx): numbers of the axes, and axes { along, across } their labels

import { axisTicks, decibels, lengthOf, paintGrey, perMetre, quantile, roundLength, sumOf } from "sarmitsuba/image_math.js";

const STYLE = `
.sar-view { display: flex; flex-direction: column; gap: 4px; min-width: 0; min-height: 0; height: 100%; margin: 0; }
.sar-view > figcaption { font-weight: 600; }
.sar-stage { position: relative; flex: 1 1 auto; min-height: 120px; overflow: hidden; }
.sar-stage canvas { position: absolute; display: block; }
.sar-stage .sar-pixels { transform: scaleY(-1); cursor: crosshair; image-rendering: auto; background: #000; }
.sar-stage .sar-pixels.near { image-rendering: pixelated; }
.sar-stage .sar-drawing { inset: 0; width: 100%; height: 100%; pointer-events: none; }
.sar-tools { display: flex; flex-wrap: wrap; gap: 2px 14px; align-items: center; font-size: .84rem; }
.sar-tools label { display: inline-flex; gap: 5px; align-items: center; white-space: nowrap; }
.sar-tools [role=group] { display: inline-flex; gap: 10px; align-items: center; }
.sar-tools [hidden] { display: none; }
.sar-tools output { min-width: 4.2em; text-align: right; font-variant-numeric: tabular-nums; }
.sar-readout { min-height: 1.3em; margin: 0; font-size: .84rem; font-variant-numeric: tabular-nums; }
`;
const MARGIN = { left: 54, right: 10, top: 8, bottom: 38 };
const SHOWN_DB = 50;

/** Add this module's style rules to the page, once. */
export function useStyle() {
  if (document.getElementById("sar-view-style")) return;
  const node = document.createElement("style");
  node.id = "sar-view-style";
  node.textContent = STYLE;
  document.head.append(node);
}

/** An element with attributes and children. */
export function make(tag, attributes = {}, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  node.append(...children);
  return node;
}

/** Slider with a name, a value and its unit. */
export function slider(name, { low, high, step, value, unit }, call) {
  const input = make("input", { type: "range", min: low, max: high, step, value });
  const output = make("output");
  const show = () => {
    output.textContent = `${input.value} ${unit}`;
  };
  input.addEventListener("input", () => {
    show();
    call(Number(input.value), false);
  });
  input.addEventListener("change", () => call(Number(input.value), true));
  show();
  const node = make("label", {}, name, input, output);
  return {
    node,
    set(number) {
      input.value = number;
      show();
    },
  };
}

export const bounces = (order) => (order === 0 ? "all" : order === 1 ? "1 bounce" : `${order} bounces`);

class ImageView {
  constructor(element, { title = "", image, grid, controls = true, axes, onPick, onCursor, onRange, onPaint, onFit }) {
    useStyle();
    Object.assign(this, { axes, onPick, onCursor, onRange, onPaint, onFit });
    /** Bound on the scale, CSS pixels per metre: views beside each other share one. */
    this.mostPerMetre = Infinity;
    /** Pixels, first row at the top: for a texture too. */
    this.canvas = make("canvas", { class: "sar-pixels", tabindex: 0, role: "application" });
    this.drawing = make("canvas", { class: "sar-drawing", "aria-hidden": "true" });
    this.caption = make("figcaption");
    this.stage = make("div", { class: "sar-stage" }, this.canvas, this.drawing);
    this.tools = make("div", { class: "sar-tools" });
    this.readout = make("p", { class: "sar-readout", role: "status" });
    this.element = make("figure", { class: "sar-view" }, this.caption, this.stage, this.readout, this.tools);
    element.append(this.element);
    this.off = new Set();
    this.cursor = null;
    this.live = null;
    this.painter = null;
    /** Additional text on the pixel under the cursor: (pixel) => text. */
    this.more = () => "";
    this.makeTools(controls);
    this.listen();
    this.setImage(image, grid, title);
  }

  // ---- display -------------------------------------------------------------------------------------------------------

  /** Show another image, with the levels of its picture, or of its brightest pixels where it states none. */
  setImage(image, grid, title = this.caption.textContent) {
    this.image = image;
    this.grid = grid;
    this.live = null;
    this.cursor = null;
    this.caption.textContent = title;
    this.caption.hidden = !title;
    this.canvas.setAttribute("aria-label", `${title || "Radar image"}: arrow keys move the cursor, Enter picks`);
    this.showSwitches();
    this.update();
    const brightest = () => quantile(this.db, 0.999) + 3;
    const [black, white] = (image.limits ?? [brightest() - SHOWN_DB, brightest()]).map(Math.round);
    this.wide = white - black;
    this.setRange(black, white);
    this.place();
  }

  /** Show a complex image {re, im}, m, instead of the layers, such as a partial one; null: the layers. */
  setLive(sum) {
    this.live = sum;
    this.update();
    this.paint();
  }

  /** Switch the layer of a bounce order. */
  setOrder(order, on) {
    if (on) this.off.delete(order);
    else this.off.add(order);
    this.showSwitches();
    this.update();
    this.paint();
  }

  /** Orders that are switched on. */
  get orders() {
    return new Set(this.image.layers.map((layer) => layer.order).filter((order) => !this.off.has(order)));
  }

  /** Levels in dB of black and white. */
  setRange(black, white) {
    [this.black, this.white] = [black, white];
    this.brightest.set(white);
    this.span.set(white - black);
    this.paint();
  }

  /** Function of the canvas that paints the pixels instead of grey levels; null: grey levels. */
  setPainter(painter) {
    this.painter = painter;
    this.paint();
  }

  update() {
    const { layers, scale = 1, cellArea = null } = this.image;
    const { nx, ny } = this.grid;
    /** Complex image as shown, m. */
    this.sum = this.live ?? sumOf(layers.filter((layer) => !this.off.has(layer.order)), nx * ny);
    if (!this.live && scale !== 1) {
      this.sum.re.forEach((value, i) => {
        this.sum.re[i] = value / scale;
        this.sum.im[i] /= scale;
      });
    }
    /** Image as shown, dB. */
    this.db = decibels(this.sum, nx, cellArea);
    this.tell();
  }

  paint() {
    if (this.painter) this.painter(this.canvas);
    else paintGrey(this.canvas, this.db, this.grid.nx, this.black, this.white);
    this.onPaint?.(this);
  }

  // ---- controls ------------------------------------------------------------------------------------------------------

  makeTools(controls) {
    const change = () => {
      this.setRange(this.white - this.wide, this.white);
      this.onRange?.(this.black, this.white);
    };
    this.wide = SHOWN_DB;
    this.brightest = slider("Brightest", { low: -60, high: 80, step: 1, value: 0, unit: "dB" }, (value) => {
      this.white = value;
      change();
    });
    this.span = slider("Shown below it", { low: 5, high: 90, step: 1, value: SHOWN_DB, unit: "dB" }, (value) => {
      this.wide = value;
      change();
    });
    this.switches = make("div", { role: "group", "aria-label": "Echoes of" }, "Echoes of");
    if (controls) this.tools.append(this.brightest.node, this.span.node, this.switches);
  }

  showSwitches() {
    const orders = this.image.layers.map((layer) => layer.order);
    this.switches.hidden = orders.length < 2;
    const have = [...this.switches.querySelectorAll("input")];
    if (have.map((node) => Number(node.value)).join() !== orders.join()) {
      have.forEach((node) => node.parentElement.remove());
      for (const order of orders) {
        const box = make("input", { type: "checkbox", value: order });
        box.addEventListener("change", () => this.setOrder(order, box.checked));
        this.switches.append(make("label", {}, box, bounces(order)));
      }
    }
    for (const box of this.switches.querySelectorAll("input")) box.checked = !this.off.has(Number(box.value));
  }

  // ---- cursor --------------------------------------------------------------------------------------------------------

  listen() {
    const { canvas } = this;
    canvas.addEventListener("pointermove", (event) => this.moved(this.pixelAt(event)));
    canvas.addEventListener("pointerleave", () => this.moved(null));
    canvas.addEventListener("click", (event) => this.pick(this.pixelAt(event)));
    canvas.addEventListener("keydown", (event) => this.key(event));
    new ResizeObserver(() => this.place()).observe(this.stage);
  }

  key(event) {
    const steps = { ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowUp: [1, 0], ArrowDown: [-1, 0] };
    const { nx, ny } = this.grid;
    const now = this.cursor ?? { row: ny >> 1, column: nx >> 1 };
    if (event.key in steps) {
      const [rows, columns] = steps[event.key].map((step) => step * (event.shiftKey ? 10 : 1));
      const clip = (value, n) => Math.min(Math.max(value, 0), n - 1);
      this.moved({ row: clip(now.row + rows, ny), column: clip(now.column + columns, nx) });
    } else if (event.key === "Enter") {
      this.pick(now);
    } else {
      return;
    }
    event.preventDefault();
    event.stopPropagation(); // the page uses the same keys
  }

  pixelAt(event) {
    const frame = this.canvas.getBoundingClientRect();
    const { nx, ny } = this.grid;
    const column = Math.floor(((event.clientX - frame.left) / frame.width) * nx);
    const row = Math.floor((1 - (event.clientY - frame.top) / frame.height) * ny);
    return row >= 0 && row < ny && column >= 0 && column < nx ? { row, column } : null;
  }

  moved(pixel) {
    this.setCursor(pixel);
    this.onCursor?.(pixel, pixel && this.pointOf(pixel));
  }

  pick(pixel) {
    if (pixel) this.onPick?.(pixel, this.pointOf(pixel));
  }

  /** Show the cursor at a pixel {row, column}, or nowhere (null). */
  setCursor(pixel) {
    this.cursor = pixel;
    this.tell();
    this.draw();
  }

  /** (x, y, z) of a pixel in m, in the frame of the scene's file. */
  pointOf({ row, column }) {
    const { center, origin, along, across, rows, columns } = this.grid;
    return [0, 1, 2].map((i) => center[i] + origin[i] + rows[row] * along[i] + columns[column] * across[i]);
  }

  /** Pixel nearest to a point, or null where the image does not reach. */
  pixelOf(point) {
    const { center, origin, along, across, rows, columns } = this.grid;
    const place = (axis) => axis.reduce((sum, value, i) => sum + value * (point[i] - center[i] - origin[i]), 0);
    const row = nearest(rows, place(along));
    const column = nearest(columns, place(across));
    return row === null || column === null ? null : { row, column };
  }

  /** Update the text on the cursor's pixel. */
  tell() {
    if (!this.cursor) {
      this.readout.textContent = "Point at the image for position and level.";
      return;
    }
    const { row, column } = this.cursor;
    const { azimuth, range, nx } = this.grid;
    const names = this.names();
    const step = lengthOf(range) / range.length || 1;
    const text = (value) => value.toFixed(Math.max(1, Math.ceil(-Math.log10(step))));
    const [x, y] = this.pointOf(this.cursor).map(text);
    // axes that are x and y of the scene say nothing more
    const more = [[names.along[0], azimuth[row]], [names.across[0], range[column]]]
      .filter(([name]) => name)
      .map(([name, value]) => `${name} ${text(value)} m`);
    this.readout.textContent =
      `${[`x ${x} m, y ${y} m`, more.join(", ")].filter(Boolean).join("; ")}; ` +
      `${this.quantity()} ${this.levelText(row * nx + column)}${this.more(this.cursor)}`;
  }

  /** Names of the axes: short, empty where it is x or y of the scene, and in full. */
  names() {
    if (this.axes) return this.axes;
    const { along, across } = this.grid.axes;
    const short = (label) => (/^[xy] of the scene/.test(label) ? "" : label.replace(/ \(m\)/, ""));
    return { along: [short(along), `${along}, flight →`], across: [short(across), `${across}, away from the radar →`] };
  }

  quantity() {
    if (this.image.calibrated === false) return "intensity (uncalibrated)";
    return this.image.cellArea ? "sigma0" : "RCS";
  }

  levelText(index) {
    const db = this.db[index];
    const unit = this.image.cellArea || this.image.calibrated === false ? "dB" : "dBm²";
    return Number.isFinite(db) ? `${db.toFixed(1)} ${unit}` : "no echo";
  }

  // ---- drawing over the pixels ---------------------------------------------------------------------------------------

  /** Scale at which the picture fills the stage, CSS pixels per metre; null while it is not shown. */
  get fittingPerMetre() {
    const { clientWidth: width, clientHeight: height } = this.stage;
    if (!width || !height) return null;
    return perMetre(this.grid, width - MARGIN.left - MARGIN.right, height - MARGIN.top - MARGIN.bottom);
  }

  /** Fit the pixels into the stage in true proportions, and the drawing over them. */
  place() {
    this.onFit?.();
    const { stage, canvas, drawing, grid } = this;
    const [width, height] = [stage.clientWidth, stage.clientHeight];
    if (!width || !height) return;
    this.perMetre = Math.min(this.fittingPerMetre, this.mostPerMetre);
    const [x, y] = [lengthOf(grid.range), lengthOf(grid.azimuth)];
    this.box = { left: MARGIN.left, top: MARGIN.top, width: x * this.perMetre, height: y * this.perMetre };
    for (const [name, value] of Object.entries(this.box)) canvas.style[name] = `${value}px`;
    canvas.classList.toggle("near", this.box.width > 3 * grid.nx);
    const ratio = window.devicePixelRatio || 1;
    drawing.width = Math.round(width * ratio);
    drawing.height = Math.round(height * ratio);
    this.draw();
  }

  draw() {
    if (!this.box) return;
    const { drawing, box, grid } = this;
    const context = drawing.getContext("2d");
    const ratio = drawing.width / this.stage.clientWidth;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, drawing.width, drawing.height);
    const style = getComputedStyle(this.element);
    context.fillStyle = context.strokeStyle = style.color;
    context.font = `12px ${style.fontFamily}`;
    this.drawAxes(context);
    this.drawScaleBar(context);
    if (this.cursor) {
      const x = box.left + ((this.cursor.column + 0.5) / grid.nx) * box.width;
      const y = box.top + (1 - (this.cursor.row + 0.5) / grid.ny) * box.height;
      for (const [colour, width] of [["#000", 4], ["#ffd166", 1.6]]) {
        context.strokeStyle = colour;
        context.lineWidth = width;
        context.beginPath();
        for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
          context.moveTo(x + 4 * dx, y + 4 * dy);
          context.lineTo(x + 13 * dx, y + 13 * dy);
        }
        context.stroke();
      }
    }
  }

  drawAxes(context) {
    const { box, grid } = this;
    context.lineWidth = 1;
    const bottom = box.top + box.height;
    const digits = (step) => Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    context.textAlign = "center";
    for (const { place, value, step } of axisTicks(grid.range, box.width, 70)) {
      context.fillRect(box.left + place - 0.5, bottom, 1, 4);
      context.fillText(value.toFixed(digits(step)), box.left + place, bottom + 16);
    }
    // below the middle of the picture, but whole: a narrow picture is narrower than its label
    const label = this.names().across[1];
    const half = context.measureText(label).width / 2 + 2;
    const middle = Math.max(Math.min(box.left + box.width / 2, this.stage.clientWidth - half), half);
    context.fillText(label, middle, bottom + 32);
    /** Ends of that label, picture elements from the left of the stage. */
    this.labelEnds = [middle - half, middle + half];
    context.textAlign = "right";
    for (const { place, value, step } of axisTicks(grid.azimuth, box.height, 45)) {
      context.fillRect(box.left - 4, bottom - place - 0.5, 4, 1);
      context.fillText(value.toFixed(digits(step)), box.left - 6, bottom - place + 4);
    }
    context.save();
    context.translate(11, box.top + box.height / 2);
    context.rotate(-Math.PI / 2);
    context.textAlign = "center";
    context.fillText(this.names().along[1], 0, 0);
    context.restore();
  }

  drawScaleBar(context) {
    const { box } = this;
    /** Length of the scale bar, m. */
    this.scaleBar = roundLength((0.3 * box.width) / this.perMetre);
    const length = this.scaleBar * this.perMetre;
    const [x, y] = [box.left + 10, box.top + box.height - 12];
    context.fillStyle = "rgba(0, 0, 0, .72)";
    context.fillRect(x - 6, y - 20, length + 12, 28);
    context.fillStyle = "#fff";
    context.fillRect(x, y, length, 3);
    context.fillRect(x, y - 3, 1.5, 9);
    context.fillRect(x + length - 1.5, y - 3, 1.5, 9);
    context.textAlign = "center";
    context.fillText(`${this.scaleBar} m`, x + length / 2, y - 6);
  }
}

/** Index of the uniform or slowly varying axis's entry nearest to a value; null beyond half a step of its ends. */
function nearest(axis, value) {
  let best = 0;
  for (let i = 1; i < axis.length; i++) if (Math.abs(axis[i] - value) < Math.abs(axis[best] - value)) best = i;
  const step = axis.length > 1 ? Math.abs(axis[1] - axis[0]) : Infinity;
  return Math.abs(axis[best] - value) <= 0.5 * step * (1 + 1e-6) ? best : null;
}

/**
 * @param {HTMLElement} element in which the view is put; its height bounds the picture's
 * @param {object} options title; image, grid: see the head of this file; controls: false leaves sliders and switches
 *   away; axes: { along, across } of [name, label], in place of the grid's; onPick(pixel, point),
 *   onCursor(pixel | null, point | null), onRange(black, white), onPaint(view), onFit() before the picture is placed
 */
export function createImageView(element, options) {
  return new ImageView(element, options);
}
