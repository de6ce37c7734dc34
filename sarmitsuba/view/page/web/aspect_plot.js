// RCS over aspect on a canvas: polar (0 to the right, counter-clockwise), or decibels over the angle.

const LINES = ["#eef3f8", "#ffd166", "#2ee6a8", "#ff7a9c", "#c3a6ff"];
export const lineColour = (order) => LINES[Math.min(order, LINES.length - 1)];
const SPAN_DB = 60;

export class AspectPlot {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {object} options angle: deg of every aspect; polar, whole: see below; curves: of all polarisations, which the
   *   axis fits; onAspect(index): of the aspect nearest to where the pointer is dragged
   */
  constructor(canvas, { angle, polar, whole, curves, onAspect }) {
    Object.assign(this, { canvas, angle, polar, whole });
    const most = curves.reduce((top, { levels }) => Math.max(top, ...levels), -Infinity);
    /** dBsm at the rim, and at the centre or bottom. */
    this.top = Number.isFinite(most) ? 5 * Math.ceil(most / 5) : 0;
    this.bottom = this.top - SPAN_DB;
    this.lines = [];
    this.aspect = 0;
    const go = (event) => onAspect(this.aspectAt(event.offsetX, event.offsetY));
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      go(event);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (event.buttons) go(event);
    });
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  /** @param {{order: number, levels: ArrayLike<number>}[]} lines order 0: the sum; drawn in turn */
  show(lines, aspect) {
    this.lines = lines;
    this.aspect = aspect;
    this.draw();
  }

  get frame() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (this.polar) return { x: 0.5 * width, y: 0.5 * height, reach: Math.max(0.5 * Math.min(width, height) - 20, 1) };
    return { x: 40, y: 8, width: Math.max(width - 52, 1), height: Math.max(height - 42, 1) };
  }

  share(level) {
    return Math.min(Math.max((level - this.bottom) / SPAN_DB, 0), 1);
  }

  /** Canvas position of an angle and a level. */
  at(angle, level) {
    const { frame } = this;
    const share = this.share(level);
    if (this.polar) {
      const turn = (angle * Math.PI) / 180;
      return [frame.x + frame.reach * share * Math.cos(turn), frame.y - frame.reach * share * Math.sin(turn)];
    }
    return [frame.x + this.along(angle) * frame.width, frame.y + (1 - share) * frame.height];
  }

  along(angle) {
    const first = this.angle[0];
    const width = this.angle.at(-1) - first;
    return width ? (angle - first) / width : 0.5;
  }

  aspectAt(x, y) {
    const { frame, angle } = this;
    const wanted = this.polar
      ? (Math.atan2(frame.y - y, x - frame.x) * 180) / Math.PI
      : angle[0] + ((x - frame.x) / frame.width) * (angle.at(-1) - angle[0]);
    const away = (value) => (this.polar ? Math.abs(((((value - wanted) % 360) + 540) % 360) - 180) : Math.abs(value - wanted));
    let best = 0;
    for (let i = 1; i < angle.length; i++) if (away(angle[i]) < away(angle[best])) best = i;
    return best;
  }

  draw() {
    const { canvas, angle } = this;
    const ratio = window.devicePixelRatio || 1;
    canvas.width = Math.round(canvas.clientWidth * ratio);
    canvas.height = Math.round(canvas.clientHeight * ratio);
    const context = canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.font = `12px ${getComputedStyle(canvas).fontFamily}`;
    this.drawAxes(context);
    const path = (points, colour, width) => {
      context.strokeStyle = colour;
      context.lineWidth = width;
      context.beginPath();
      points.forEach((point, i) => (i ? context.lineTo(...point) : context.moveTo(...point)));
      context.stroke();
    };
    for (const { order, levels } of [...this.lines].reverse()) {
      const points = Array.from(levels, (level, i) => this.at(angle[i], level));
      path(this.whole ? [...points, points[0]] : points, lineColour(order), order ? 1.2 : 1.8);
    }
    const here = angle[this.aspect];
    path([this.at(here, this.bottom), this.at(here, this.top)], "#5cc8ff", 2);
  }

  drawAxes(context) {
    const { frame, angle } = this;
    context.strokeStyle = "#3a4757";
    context.fillStyle = "#b4c2d0";
    context.lineWidth = 1;
    const levels = [0, 20, 40, 60].map((below) => this.top - below);
    const line = (from, to) => {
      context.beginPath();
      context.moveTo(...from);
      context.lineTo(...to);
      context.stroke();
    };
    if (this.polar) {
      for (const level of levels) {
        context.beginPath();
        context.arc(frame.x, frame.y, frame.reach * this.share(level), 0, 2 * Math.PI);
        context.stroke();
      }
      context.textAlign = "center";
      for (let turn = 0; turn < 360; turn += 45) {
        line(this.at(turn, this.bottom), this.at(turn, this.top));
        const [x, y] = this.at(turn, this.top);
        const out = (turn * Math.PI) / 180;
        context.fillText(`${turn}°`, x + 15 * Math.cos(out), y + 4 - 11 * Math.sin(out));
      }
      for (const level of levels.slice(0, 3)) context.fillText(`${level}`, ...this.at(67.5, level));
      return;
    }
    context.textAlign = "right";
    for (const level of levels) {
      const [x, y] = this.at(angle[0], level);
      line([frame.x, y], [frame.x + frame.width, y]);
      context.fillText(`${level}`, Math.min(x, frame.x) - 5, y + 4);
    }
    context.textAlign = "center";
    const [first, last] = [angle[0], angle.at(-1)];
    const step = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20].find((value) => (last - first) / value <= 10) ?? 30;
    for (let k = Math.ceil(first / step - 1e-9); k * step <= last + 1e-9; k++) {
      const [x] = this.at(k * step, this.bottom);
      line([x, frame.y], [x, frame.y + frame.height]);
      context.fillText(`${+(k * step).toFixed(1)}°`, x, frame.y + frame.height + 16);
    }
  }
}
