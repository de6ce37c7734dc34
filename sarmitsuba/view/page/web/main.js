// The page: state, time line, switches, keys, help. Drawing is in world.js, profile.js and the image's modules.

import { accountView } from "sarmitsuba/account.js";
import { plainSettings } from "sarmitsuba/aperture.js";
import { boot } from "sarmitsuba/boot.js";
import { createComparison } from "sarmitsuba/compare.js";
import { button, helpText, keyName, ours, switches, turn } from "sarmitsuba/controls.js";
import { createImageView } from "sarmitsuba/image_view.js";
import { showLabels } from "sarmitsuba/label_view.js";
import { pixelOf, pointOf, sub } from "sarmitsuba/localise.js";
import { fill, html } from "sarmitsuba/markup.js";
import { Signals } from "sarmitsuba/profile.js";
import { createRefocus } from "sarmitsuba/refocus.js";
import { Store } from "sarmitsuba/store.js";
import { Story, prepare } from "sarmitsuba/story.js";
import { Tour } from "sarmitsuba/tour.js";
import { World } from "sarmitsuba/world.js";

const $ = (id) => document.getElementById(id);

/** Image of a look, for image_view.js. */
const imageOf = ({ image }) => ({
  layers: image.layers,
  scale: image.scale,
  cellArea: image.cell_area,
  calibrated: image.calibrated,
  limits: image.limits,
});
const PASS_SECONDS = [40, 20, 10, 5, 2];
const SWEEP_SECONDS = 4; // a shell from the near to the far end of the image

const VIEWS = [["overview", "Overview", "1"], ["scene", "Close-up", "2"], ["radar", "From the radar", "3"], ["map", "Map", "4"]];
const SWITCHES = [
  ["drape", "Image", "i", ["ground", "slant", "off"], { ground: "on the ground", slant: "in the slant plane", off: "off" }],
  ["buildings", "Scene", "g", ["solid", "glass", "hidden"], { solid: "solid", glass: "glass", hidden: "hidden" }],
  ["scale", "Distance", "e", ["near", "true"], { near: "shortened", true: "true" }],
  ["shadow", "Radar shadow", "s"],
  ["beam", "Beam", "b"],
  ["shell", "Wave", "w"],
  ["rulings", "Ranges", "r"],
  ["building", "Image builds up", "p"],
];
const KEYS = [
  ["Space", "play or pause"], ["← →", "one pulse back or on (with Shift: ten)"], ["Home, End", "first, last pulse"],
  ["1 2 3 4", "overview, close-up, from the radar, map"], ["I", "image: on the ground, in the slant plane, off"],
  ["G", "scene: solid, glass, hidden"], ["E", "distance of the radar: shortened or true"], ["S", "radar shadow"], ["B", "beam"],
  ["W", "wave (range shell)"], ["R", "lines of equal range"], ["P", "image building up, or finished"], ["L", "next look"],
  ["C", "compare two looks"], ["F", "focus again, or explanation"], ["T", "guided tour"],
  ["Esc", "clear the selection"], ["?", "this help"],
];

class Page {
  constructor(data) {
    this.data = data;
    for (const look of data.looks) prepare(look, data.center);
    this.store = new Store({
      look: 0, pulse: 0, playing: false, seconds: 10, range: null, sweep: false, drape: "ground", buildings: "solid", scale: "near",
      shadow: true, beam: true, shell: true, rulings: false, building: false, picked: null, path: null,
    });
    this.signals = new Signals({ profile: $("profile"), raw: $("raw"), page: data, store: this.store });
    this.world = new World({
      canvas: $("world-canvas"), labels: $("labels"), page: data, store: this.store,
      onWall: (point, facts) => this.story.wall(point, facts),
      onPixel: (at) => this.story.pixel(at),
    });
    this.story = new Story({ element: $("story"), world: this.world, page: data, store: this.store });
    this.tour = new Tour({ page: data, store: this.store, world: this.world, story: this.story });
  }

  get look() {
    return this.data.looks[this.store.get("look")];
  }

  async start() {
    this.controls();
    this.listen();
    await this.world.load();
    performance.mark("geometry");
    this.showLook();
    this.world.view("overview");
    this.story.welcome();
    requestAnimationFrame((now) => this.tick(now));
  }

  // ---- controls --------------------------------------------------------------------------------------------------

  controls() {
    $("title").textContent = this.data.title;
    for (const [name, text, key] of VIEWS) button($("views"), text, key, () => this.world.view(name)).dataset.view = name;
    switches($("switches"), SWITCHES, this.store);
    this.data.looks.forEach((look, i) => {
      if (this.data.looks.length > 1) button($("looks"), this.nameOf(look), "l", () => this.store.set({ look: i })).dataset.look = i;
    });
    fill($("speed"), PASS_SECONDS.map((s) => html`<option value="${s}" ${s === 10 ? "selected" : ""}>${s} s</option>`));
    $("speed").addEventListener("change", () => this.store.set({ seconds: Number($("speed").value) }));
    $("play").addEventListener("click", () => this.play());
    $("pulse").addEventListener("input", () => this.store.set({ pulse: Number($("pulse").value), playing: false }));
    $("tour").addEventListener("click", () => this.tour.start());
    $("help").addEventListener("click", () => this.help());
    $("compare").hidden = this.data.looks.length < 2;
    $("compare").addEventListener("click", () => this.compare());
    $("comparison").addEventListener("close", () => this.comparison?.remove());
    for (const tab of document.querySelectorAll("[role=tab]")) tab.addEventListener("click", () => this.showTab(tab.id));
    fill($("help-text"), helpText(KEYS, `Drag to turn, wheel to come nearer, right drag to move. Click a spot of the image for its paths, a wall for where its echoes
      are drawn. Drag in the echo for the wave at one range; drag in the raw data to go to a pulse.`));
  }

  nameOf(look) {
    return [look.name, look.radar?.mode].filter(Boolean).join(": ");
  }

  play() {
    if (!this.look.radar) return;
    const last = this.look.radar.time.length - 1;
    const pulse = this.store.get("pulse") >= last ? 0 : this.store.get("pulse");
    this.store.set({ playing: !this.store.get("playing"), pulse });
  }

  help() {
    $("help-text").showModal();
  }

  listen() {
    const { store, world } = this;
    store.on(["look"], () => this.showLook());
    store.on(["pulse"], () => {
      world.showPulse();
      this.signals.draw();
      this.showTime();
      if (store.get("building")) this.buildUp();
    });
    store.on(["playing"], () => {
      $("play").textContent = store.get("playing") ? "Pause" : "Play";
    });
    store.on(["range"], () => {
      world.drawShell();
      this.signals.draw();
    });
    store.on(["shell"], () => world.drawShell());
    store.on(["beam", "shadow"], () => world.showPulse());
    store.on(["drape"], () => {
      world.drawDrape();
      world.request();
    });
    store.on(["rulings"], () => {
      world.drawRulings();
      world.request();
    });
    store.on(["buildings"], () => world.setBuildings());
    store.on(["scale"], () => {
      world.showLook();
      world.view("overview");
    });
    store.on(["building"], () => this.buildUp());
    store.on(["picked"], ({ picked }) => {
      const [row, column] = picked ? picked.map(Math.round) : [-1, -1];
      const inside = row >= 0 && column >= 0 && row < this.look.grid.shape[0] && column < this.look.grid.shape[1];
      this.view.setCursor(inside ? { row, column } : null);
      if (picked) this.showTab("tab-story");
    });
    document.addEventListener("keydown", (event) => this.key(event));
  }

  key(event) {
    if (!ours(event)) return;
    const { store } = this;
    const key = keyName(event);
    const view = VIEWS.find(([, , k]) => k === key);
    const change = SWITCHES.find(([, , k]) => k === key);
    const last = (this.look.radar?.time.length ?? 1) - 1;
    const step = event.shiftKey ? 10 : 1;
    const go = (pulse) => store.set({ pulse: Math.min(Math.max(pulse, 0), last), playing: false });
    if (view) this.world.view(view[0]);
    else if (change) turn(store, change[0], change[3]);
    else if (key === " ") {
      if (event.target.tagName === "BUTTON") return;
      this.play();
    } else if (key === "ArrowLeft") go(store.get("pulse") - step);
    else if (key === "ArrowRight") go(store.get("pulse") + step);
    else if (key === "Home") go(0);
    else if (key === "End") go(last);
    else if (key === "c" && this.data.looks.length > 1) this.compare();
    else if (key === "f") this.showTab($("refocus").hidden ? "tab-refocus" : "tab-story");
    else if (key === "l") store.set({ look: (store.get("look") + 1) % this.data.looks.length });
    else if (key === "t") this.tour.start();
    else if (key === "Escape") this.tour.end();
    else if (key === "?") this.help();
    else return;
    event.preventDefault();
  }

  // ---- display ---------------------------------------------------------------------------------------------------

  showLook() {
    const { look, store, world } = this;
    for (const node of $("looks").children) node.setAttribute("aria-pressed", String(Number(node.dataset.look) === store.get("look")));
    const { radar } = look;
    $("facts").textContent = radar
      ? `${radar.mode} (${radar.mode_doc}), ${(radar.frequency / 1e9).toFixed(2)} GHz, ${(radar.bandwidth / 1e6).toFixed(0)} MHz, ${look.channel}, ${radar.time.length} pulses, look ${radar.side}`
      : `${look.channel}`;
    const last = Math.max((radar?.time.length ?? 1) - 1, 0);
    $("pulse").max = last;
    $("play").disabled = !radar;
    store.set({ pulse: Math.min(store.get("pulse") || last >> 1, last), picked: null, building: false });
    this.showImage();
    world.measure();
    world.showLook();
    this.signals.draw();
    this.showTime();
    this.caption();
  }

  /** Show the look's image beside the scene and on its ground, with the controls for focusing again. */
  showImage() {
    const { look, world } = this;
    const image = imageOf(look);
    this.uncolour?.();
    this.uncolour = null;
    if (this.view) this.view.setImage(image, look.pixels);
    else {
      this.view = createImageView($("image"), {
        image,
        grid: look.pixels,
        onPick: ({ row, column }) => this.story.pixel([row, column]),
        onCursor: (_, point) => world.showCursor(point && sub(point, this.data.center)),
        onPaint: () => world.imageChanged(),
      });
    }
    world.setImage(this.view.canvas);
    fill($("account"), accountView(look.account));
    $("tab-labelled").hidden = !look.labels;
    if (look.labels) this.uncolour = showLabels($("labelled"), look.labels, this.view);
    else if (!$("labelled").hidden) this.showTab("tab-story");
    this.refocus?.remove();
    this.refocus = null;
    $("refocus").replaceChildren();
    if (!look.echo) {
      $("refocus").textContent = "This run kept no raw data, so that there are no pulses to focus.";
      return;
    }
    const about = document.createElement("p");
    about.className = "quiet";
    about.textContent = "Here your browser focuses the recorded pulses. Drop some of them, shorten the aperture, change the window, or add a track error, and see the effect.";
    $("refocus").append(about);
    this.changed = false;
    this.refocus = createRefocus($("refocus"), {
      data: look.echo,
      grid: look.pixels,
      onImage: (sum) => {
        if (this.changed || this.store.get("building")) this.view.setLive(sum);
      },
      onSettings: (settings) => {
        this.changed = JSON.stringify(settings) !== JSON.stringify(plainSettings(look.echo));
        if (!this.changed && !this.store.get("building")) this.view.setLive(null);
      },
    });
  }

  /** The image of the pulses so far, made here from the recorded echoes; or the finished one again. */
  buildUp() {
    const { store, look } = this;
    if (!this.refocus) return;
    if (store.get("building")) {
      this.refocus.setEnd(store.get("pulse") + 1);
    } else {
      this.refocus.end = look.echo.nPulses;
      if (this.changed) this.refocus.setEnd(look.echo.nPulses);
      else {
        this.refocus.stop();
        if (this.view.live) this.view.setLive(null);
      }
    }
  }

  /** Compare the present image with that of the next look. */
  compare() {
    const { looks } = this.data;
    const now = this.store.get("look");
    const [first, second] = [looks[now], looks[(now + 1) % looks.length]].map((look) => ({
      title: this.nameOf(look),
      image: imageOf(look),
      grid: look.pixels,
    }));
    $("comparison").showModal();
    this.comparison = createComparison($("comparison-images"), {
      first,
      second,
      onPick: (_, point) => {
        $("comparison").close();
        this.story.pixel(pixelOf(looks[now].grid, sub(point, this.data.center)));
      },
    });
  }

  showTab(id) {
    for (const tab of document.querySelectorAll("[role=tab]")) {
      tab.setAttribute("aria-selected", String(tab.id === id));
      $(tab.getAttribute("aria-controls")).hidden = tab.id !== id;
    }
  }

  caption() {
    const { radar } = this.look;
    if (!radar) return;
    const about = {
      antenna: "The blue cone is the antenna's beam (half power).",
      processed: "This antenna is isotropic; the blue cone is as wide as the processed beam.",
      image: "This antenna is isotropic; the blue cone encloses the image.",
    };
    const near = this.store.get("scale") === "near" ? " The radar is drawn closer than it is (key E)." : "";
    $("caption").textContent = about[radar.beam] + near;
  }

  showTime() {
    const { radar } = this.look;
    if (!radar) return;
    const pulse = this.store.get("pulse");
    $("pulse").value = pulse;
    $("pulse-text").textContent = `${pulse + 1} of ${radar.time.length}, ${radar.time[pulse].toFixed(3)} s`;
  }

  /** One frame of the animation. */
  tick(now) {
    const passed = Math.min((now - (this.before ?? now)) / 1000, 0.5);
    this.before = now;
    const { store } = this;
    if (store.get("playing") && this.look.radar) {
      const last = this.look.radar.time.length - 1;
      this.exact = (Math.floor(this.exact ?? -1) === store.get("pulse") ? this.exact : store.get("pulse")) + (passed / store.get("seconds")) * last;
      if (this.exact >= last) {
        store.set({ pulse: last, playing: false });
        this.exact = last;
      } else store.set({ pulse: Math.floor(this.exact) });
    }
    const data = this.signals.data;
    if (store.get("sweep") && data) {
      this.swept = ((this.swept ?? 0) + passed / SWEEP_SECONDS) % 1;
      store.set({ range: data.low + this.swept * (data.high - data.low) });
    }
    requestAnimationFrame((next) => this.tick(next));
  }
}

await boot((data) => new Page(data), { pointOf });
