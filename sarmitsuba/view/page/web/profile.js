// Plots over range from the image's centre: echo of the present pulse, and raw data line by line.

const SPAN = 60; // dB from black to white, and of the profile's axis
const FACE = "12px system-ui, 'DejaVu Sans', sans-serif";

/** Echoes of all pulses in dB of the strongest, on one range axis whose zero is the image's middle. */
class Lines {
  constructor(echo) {
    this.echo = echo;
    const { nPulses, nBins, profiles, scale, firstBin } = echo;
    this.peak = 0;
    let low = Infinity;
    let high = -Infinity;
    for (let t = 0; t < nPulses; t++) {
      let most = 0;
      for (let i = 2 * t * nBins; i < 2 * (t + 1) * nBins; i += 2) most = Math.max(most, profiles[i] ** 2 + profiles[i + 1] ** 2);
      this.peak = Math.max(this.peak, most * (scale ? scale[t] ** 2 : 1));
      low = Math.min(low, firstBin[t]);
      high = Math.max(high, firstBin[t] + (nBins - 1) * echo.binSpacing);
    }
    this.low = low;
    this.high = high;
  }

  /** dB of the strongest echo at a pulse and a bin. */
  db(t, bin) {
    const { nBins, profiles, scale } = this.echo;
    const i = 2 * (t * nBins + bin);
    const power = (profiles[i] ** 2 + profiles[i + 1] ** 2) * (scale ? scale[t] ** 2 : 1);
    return 10 * Math.log10(power / this.peak + 1e-30);
  }

  /** Strongest echo of a pulse between two ranges from the middle, dB. */
  most(t, from, to) {
    const { nBins, firstBin, binSpacing } = this.echo;
    const first = Math.max(0, Math.ceil((from - firstBin[t]) / binSpacing));
    const last = Math.min(nBins - 1, Math.max(first, Math.ceil((to - firstBin[t]) / binSpacing) - 1));
    let most = -300;
    for (let bin = first; bin <= last; bin++) most = Math.max(most, this.db(t, bin));
    return most;
  }
}

export class Signals {
  /** @param {{profile: HTMLCanvasElement, raw: HTMLCanvasElement, page: object, store: object}} options */
  constructor({ profile, raw, page, store }) {
    Object.assign(this, { profile, raw, page, store });
    this.lines = new Map();
    new ResizeObserver(() => this.resize()).observe(raw);
    this.drag(profile, (x) => store.set({ range: this.rangeAt(x), sweep: false }));
    this.drag(raw, (x, y) => store.set({ pulse: this.pulseAt(y), playing: false }));
  }

  get echo() {
    return this.page.looks[this.store.get("look")].echo;
  }

  get data() {
    const { echo } = this;
    if (echo && !this.lines.has(echo)) this.lines.set(echo, new Lines(echo));
    return echo ? this.lines.get(echo) : null;
  }

  drag(canvas, call) {
    const at = (event) => {
      const frame = canvas.getBoundingClientRect();
      if (this.data) call((event.clientX - frame.left) / frame.width, (event.clientY - frame.top) / frame.height);
    };
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      at(event);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (event.buttons) at(event);
    });
  }

  rangeAt(x) {
    return this.data.low + Math.min(Math.max(x, 0), 1) * (this.data.high - this.data.low);
  }

  pulseAt(y) {
    return Math.round(Math.min(Math.max(y, 0), 1) * (this.echo.nPulses - 1));
  }

  resize() {
    for (const canvas of [this.profile, this.raw]) {
      canvas.width = Math.max(2, Math.round(canvas.clientWidth * Math.min(window.devicePixelRatio, 2)));
      canvas.height = Math.max(2, Math.round(canvas.clientHeight * Math.min(window.devicePixelRatio, 2)));
    }
    this.picture = null;
    this.draw();
  }

  draw() {
    this.drawProfile();
    this.drawRaw();
  }

  drawProfile() {
    const { data, profile } = this;
    const context = profile.getContext("2d");
    const { width, height } = profile;
    const pixel = width / Math.max(profile.clientWidth, 1);
    context.clearRect(0, 0, width, height);
    context.font = FACE.replace("12px", `${12 * pixel}px`);
    if (!data) return this.nothing(context, "This run kept no raw data.");
    const pulse = this.store.get("pulse");
    const y = (db) => (-db / SPAN) * (height - 18 * pixel) + 2 * pixel;
    context.strokeStyle = "#2c3846";
    context.fillStyle = "#b4c2d0";
    context.lineWidth = pixel;
    for (let db = 0; db >= -SPAN; db -= 20) {
      context.beginPath();
      context.moveTo(0, y(db));
      context.lineTo(width, y(db));
      context.stroke();
      if (db > -SPAN) context.fillText(`${db} dB`, 4 * pixel, y(db) + 12 * pixel);
    }
    context.beginPath();
    for (let x = 0; x < width; x++) {
      const db = Math.max(data.most(pulse, this.rangeAt(x / width), this.rangeAt((x + 1) / width)), -SPAN);
      context.lineTo(x, y(db));
    }
    context.strokeStyle = "#ffd166";
    context.stroke();
    this.axis(context, width, height, pixel);
    this.cursor(context, width, height, pixel);
  }

  axis(context, width, height, pixel) {
    const { data } = this;
    const step = 10 ** Math.floor(Math.log10((data.high - data.low) / 3));
    const wide = (data.high - data.low) / step > 12 ? 5 * step : (data.high - data.low) / step > 6 ? 2 * step : step;
    context.textAlign = "center";
    /** Texts below the echo, with their ends in picture elements of the canvas. */
    this.texts = [];
    const write = (text, range) => {
      const x = ((range - data.low) / (data.high - data.low)) * width;
      const half = context.measureText(text).width / 2 + 3 * pixel;
      if (x < 50 * pixel || x > width - 60 * pixel) return;
      if (this.texts.some(({ left, right }) => x - half < right && x + half > left)) return;
      this.texts.push({ text, left: x - half, right: x + half });
      context.fillText(text, x, height - 4 * pixel);
    };
    write("0 m", 0);
    for (let range = Math.ceil(data.low / wide) * wide; range <= data.high; range += wide) {
      if (Math.abs(range) > 1e-9) write(`${range > 0 ? "+" : ""}${+range.toPrecision(3)} m`, range);
    }
    context.textAlign = "start";
  }

  cursor(context, width, height, pixel) {
    const range = this.store.get("range");
    if (range === null) return;
    const x = ((range - this.data.low) / (this.data.high - this.data.low)) * width;
    context.strokeStyle = "#ffffff";
    context.lineWidth = 1.5 * pixel;
    context.beginPath();
    context.moveTo(x, 0);
    context.lineTo(x, height);
    context.stroke();
  }

  /** Raw data as a picture of the canvas's size, cached per look and size. */
  wholeRaw() {
    const { data, echo, raw } = this;
    const { width, height } = raw;
    if (this.picture && this.picture.echo === echo) return this.picture.image;
    const image = new ImageData(width, height);
    for (let y = 0; y < height; y++) {
      const t = Math.floor((y * echo.nPulses) / height);
      for (let x = 0; x < width; x++) {
        const db = data.most(t, this.rangeAt(x / width), this.rangeAt((x + 1) / width));
        const grey = 255 * Math.min(Math.max(1 + db / SPAN, 0), 1);
        image.data.set([grey, grey, grey, 255], 4 * (y * width + x));
      }
    }
    this.picture = { echo, image };
    return image;
  }

  drawRaw() {
    const { data, raw } = this;
    const context = raw.getContext("2d");
    const { width, height } = raw;
    const pixel = width / Math.max(raw.clientWidth, 1);
    context.clearRect(0, 0, width, height);
    context.font = FACE.replace("12px", `${12 * pixel}px`);
    if (!data) return this.nothing(context, "This run kept no raw data.");
    const end = Math.max(1, Math.round(((this.store.get("pulse") + 1) / this.echo.nPulses) * height));
    context.putImageData(this.wholeRaw(), 0, 0, 0, 0, width, end);
    context.fillStyle = "#ffd166";
    context.fillRect(0, end - 1, width, 1.5 * pixel);
    this.cursor(context, width, height, pixel);
  }

  nothing(context, text) {
    context.fillStyle = "#b4c2d0";
    context.fillText(text, 12, 24);
  }
}
