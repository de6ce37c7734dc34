// The page of an RCS sweep: the target in 3-D, its RCS over aspect with the numbers of one aspect, and its image.

import { statementView } from "sarmitsuba/account.js";
import { AspectPlot, lineColour } from "sarmitsuba/aspect_plot.js";
import { boot } from "sarmitsuba/boot.js";
import { button, helpText, keyName, ours, switches, turn } from "sarmitsuba/controls.js";
import { bounces, createImageView } from "sarmitsuba/image_view.js";
import { sub } from "sarmitsuba/localise.js";
import { fill, html } from "sarmitsuba/markup.js";
import { Store } from "sarmitsuba/store.js";
import { Target } from "sarmitsuba/target.js";

const $ = (id) => document.getElementById(id);
const TURN_SECONDS = 20;

const VIEWS = [["overview", "Overview", "1"], ["radar", "From the radar", "2"], ["map", "Map", "3"]];
const SWITCHES = [
  ["scene", "Target", "g", ["solid", "glass", "hidden"], { solid: "solid", glass: "glass", hidden: "hidden" }],
  ["shadow", "Radar shadow", "s"],
  ["curve", "RCS about the target", "r"],
];
const IMAGE_SWITCH = ["drape", "Image below it", "i"];
const KEYS = [
  ["Space", "rotate the radar about the target, or stop"], ["← →", "one aspect back or on (with Shift: ten)"], ["Home, End", "first, last aspect"],
  ["1 2 3", "overview, from the radar, map"], ["G", "target: solid, glass, hidden"], ["S", "radar shadow"], ["R", "RCS about the target"],
  ["I", "image below the target"], ["L", "next polarisation"], ["?", "this help"],
];
const AXES = {
  circle: { along: ["north of the origin", "y (m), north ↑"], across: ["east of it", "x (m), east →"] },
  arc: { along: ["across the sight", "across the line of sight (m)"], across: ["behind the middle", "away from the radar (m) →"] },
};

class Page {
  constructor(data) {
    this.data = data;
    const strongest = data.channels[0].total.reduce((best, level, i, all) => (level > all[best] ? i : best), 0);
    this.store = new Store({
      aspect: strongest, channel: 0, playing: false, scene: "solid", shadow: true, curve: true, drape: data.image !== null,
    });
    this.angle = data.swept === "azimuth" ? data.azimuth : data.elevation;
    this.target = new Target({ canvas: $("world-canvas"), labels: $("labels"), page: data, store: this.store });
    this.plot = new AspectPlot($("curves").querySelector("canvas"), {
      angle: this.angle, polar: data.polar, whole: data.whole,
      curves: data.channels.flatMap((channel) => this.linesOf(channel)),
      onAspect: (aspect) => this.store.set({ aspect, playing: false }),
    });
  }

  get channel() {
    return this.data.channels[this.store.get("channel")];
  }

  /** Curves of a polarisation, the sum (order 0) first. */
  linesOf(channel) {
    return [{ order: 0, levels: channel.total }, ...channel.orders.map(({ order, dbsm }) => ({ order, levels: dbsm }))];
  }

  async start() {
    this.controls();
    this.listen();
    await this.target.load();
    performance.mark("geometry");
    this.showChannel();
    this.showAspect();
    requestAnimationFrame((now) => this.tick(now));
  }

  controls() {
    const { data, store } = this;
    $("title").textContent = data.title;
    $("facts").textContent = `Radar cross section at ${(data.frequency / 1e9).toPrecision(4)} GHz from ${this.angle.length} directions`;
    const fixed = data.swept === "azimuth" ? `elevation ${data.elevation[0].toFixed(1)}°` : `azimuth ${data.azimuth[0].toFixed(1)}°`;
    this.about = `dBsm over ${data.swept}, at ${fixed}`;
    $("caption").textContent = "Surfaces visible to the radar are lit. Azimuth 0° is +x (east), 90° is +y (north)."
      + (data.image ? " The image is that of the horizontal plane through the target's centre, drawn below it." : "");
    for (const [name, text, key] of VIEWS) button($("views"), text, key, () => this.target.view(name));
    this.switches = data.image ? [...SWITCHES, IMAGE_SWITCH] : SWITCHES;
    switches($("switches"), this.switches, store);
    data.channels.forEach((channel, i) => {
      button($("channels"), channel.name, "l", () => store.set({ channel: i }));
    });
    fill($("statement"), statementView(data.statement));
    $("image").hidden = !data.image;
    $("aspect").max = this.angle.length - 1;
    $("aspect").addEventListener("input", () => store.set({ aspect: Number($("aspect").value), playing: false }));
    $("play").addEventListener("click", () => turn(store, "playing"));
    $("help").addEventListener("click", () => $("help-text").showModal());
    fill($("help-text"), helpText(KEYS, `Drag in the scene to turn it, wheel to come nearer, right drag to move. Drag in the plot for another aspect. Point at the
      image for how strong a spot is.`));
  }

  listen() {
    const { store, target } = this;
    store.on(["aspect"], () => this.showAspect());
    store.on(["channel"], () => this.showChannel());
    store.on(["shadow"], () => target.showAspect());
    store.on(["scene"], () => target.shade(store.get("scene")));
    store.on(["curve"], () => this.showCurve());
    store.on(["drape"], () => target.showImage());
    store.on(["playing"], () => {
      $("play").textContent = store.get("playing") ? "Stop" : "Turn";
    });
    document.addEventListener("keydown", (event) => this.key(event));
  }

  key(event) {
    if (!ours(event)) return;
    const { store } = this;
    const key = keyName(event);
    const view = VIEWS.find(([, , k]) => k === key);
    const change = this.switches.find(([, , k]) => k === key);
    const last = this.angle.length - 1;
    const step = event.shiftKey ? 10 : 1;
    const go = (aspect) => store.set({ aspect: this.data.whole ? (aspect + last + 1) % (last + 1) : Math.min(Math.max(aspect, 0), last), playing: false });
    if (view) this.target.view(view[0]);
    else if (change) turn(store, change[0], change[3]);
    else if (key === " ") {
      if (event.target.tagName === "BUTTON") return;
      turn(store, "playing");
    } else if (key === "ArrowLeft") go(store.get("aspect") - step);
    else if (key === "ArrowRight") go(store.get("aspect") + step);
    else if (key === "Home") go(0);
    else if (key === "End") go(last);
    else if (key === "l") store.set({ channel: (store.get("channel") + 1) % this.data.channels.length });
    else if (key === "?") $("help-text").showModal();
    else return;
    event.preventDefault();
  }

  showChannel() {
    const { data, store } = this;
    const number = store.get("channel");
    [...$("channels").children].forEach((node, i) => node.setAttribute("aria-pressed", String(i === number)));
    $("curves").querySelector("figcaption").textContent = `${this.channel.name}: ${this.about}`;
    this.showCurve();
    this.showAspect();
    if (!data.image) return;
    const image = { layers: data.image.channels[number].layers, scale: data.image.channels[number].scale, cellArea: null };
    if (this.view) this.view.setImage(image, data.image.pixels);
    else {
      this.view = createImageView($("image"), {
        image,
        grid: data.image.pixels,
        axes: AXES[data.whole ? "circle" : "arc"],
        onCursor: (_, point) => this.target.showCursor(point && this.target.lowered(sub(point, data.center))),
        onPaint: () => this.target.imageChanged(),
      });
    }
    this.target.setImage(this.view.canvas, data.image.grid);
  }

  showCurve() {
    this.target.showCurve(this.channel.total, this.plot.bottom, this.plot.top);
  }

  /** One aspect: in the scene, in the plot and in numbers. */
  showAspect() {
    const { data, store } = this;
    const aspect = store.get("aspect");
    this.target.showAspect();
    const lines = this.linesOf(this.channel);
    this.plot.show(lines.length > 2 ? lines : lines.slice(0, 1), aspect);
    $("aspect").value = aspect;
    const place = `azimuth ${data.azimuth[aspect].toFixed(2)}°, elevation ${data.elevation[aspect].toFixed(2)}°`;
    $("aspect-text").textContent = place;
    $("aspect").setAttribute("aria-valuetext", place);
    const plotted = $("curves").querySelector("canvas");
    plotted.setAttribute("aria-label", `RCS over ${data.swept}: drag, or arrow keys, for another aspect; now ${place}`);
    this.showNumbers(aspect);
  }

  showNumbers(aspect) {
    const { channels } = this.data;
    const text = (value, unit) => (Number.isFinite(value) ? `${value.toFixed(2)} ${unit}` : "none");
    const number = this.store.get("channel");
    const rows = [
      { name: "all, added coherently", order: 0, values: channels.map(({ total }) => text(total[aspect], "dBsm")) },
      ...channels[0].orders.map(({ order }, i) => ({
        name: bounces(order), order, values: channels.map(({ orders }) => text(orders[i].dbsm[aspect], "dBsm")),
      })),
      { name: "phase of all", order: null, values: channels.map(({ total, phase }) => (Number.isFinite(total[aspect]) ? text(phase[aspect], "°") : "none")) },
    ];
    const head = channels.map(({ name, error }, i) =>
      html`<th scope="col" ${i === number ? html`class="shown"` : ""}>${name}${error === null ? "" : html`<span class="quiet"> sampling error ${error.toFixed(1)} dB</span>`}</th>`);
    const mark = (order) => (order === null ? "" : html`<i style="background: ${lineColour(order)}"></i>`);
    fill($("numbers"), html`<thead><tr><th scope="col">From here</th>${head}</tr></thead><tbody>${rows.map(({ name, order, values }) =>
      html`<tr data-order="${order ?? "phase"}"><th scope="row">${mark(order)}${name}</th>${values.map((value) => html`<td>${value}</td>`)}</tr>`)}</tbody>`);
  }

  /** One frame of the rotation. */
  tick(now) {
    const passed = Math.min((now - (this.before ?? now)) / 1000, 0.5);
    this.before = now;
    const { store } = this;
    const n = this.angle.length;
    if (store.get("playing")) {
      if (Math.floor(this.exact ?? -1) !== store.get("aspect")) this.exact = store.get("aspect");
      this.exact = (this.exact + (passed / TURN_SECONDS) * n) % n;
      store.set({ aspect: Math.floor(this.exact) });
    }
    requestAnimationFrame((next) => this.tick(next));
  }
}

await boot((data) => new Page(data));
