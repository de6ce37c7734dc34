// Guided tour of the scene: steps with a view, a drawing and a few sentences.

import { add, dot, norm, pixelOf, pointOf, row, scaled, sub, unit } from "sarmitsuba/localise.js";
import { html } from "sarmitsuba/markup.js";
import { pointsOf } from "sarmitsuba/story.js";

/** Index of the greatest of some numbers; -1 where none is above the bound. */
function greatest(count, value, bound = 0) {
  let best = -1;
  let most = bound;
  for (let i = 0; i < count; i++) {
    const v = value(i);
    if (v > most) [best, most] = [i, v];
  }
  return best;
}

/** Path of one bounce from the highest significant point in the image. */
function highest(look) {
  const { paths } = look;
  let strongest = 0;
  for (let i = 0; i < paths.order.length; i++) if (paths.order[i] === 1) strongest = Math.max(strongest, paths.amplitude[i]);
  return greatest(paths.order.length, (i) => (paths.order[i] === 1 && paths.amplitude[i] > 0.01 * strongest ? pointsOf(look, i)[0][2] - look.grid.height : 0));
}

/** Cell with the greatest amplitude of an order, over suitable paths. */
function brightest(look, order, suits) {
  const { paths } = look;
  return greatest(paths.cell.length, (c) => {
    let sum = 0;
    const middle = pointOf(look.grid, cellPixel(look, c));
    for (let i = paths.first[c]; i < paths.first[c + 1]; i++) {
      if (paths.order[i] === order && roundabout(look, i) && suits(pointsOf(look, i), middle)) sum += paths.amplitude[i];
    }
    return paths.by_order[6 * c + order - 1] > 100 ? sum : 0;
  });
}

function cellPixel(look, cell) {
  const { paths } = look;
  const number = paths.cell[cell];
  return [
    (Math.floor(number / paths.shape[1]) + 0.5) * paths.cell_size[0] - 0.5,
    ((number % paths.shape[1]) + 0.5) * paths.cell_size[1] - 0.5,
  ];
}

function cellOfPath(look, path) {
  let c = 0;
  while (look.paths.first[c + 1] <= path) c++;
  return c;
}

/** Whether the hits of a path are apart, unlike those in a corner. */
function roundabout(look, path) {
  const antenna = row(look.radar.position, look.paths.pulse[path]);
  const nearest = Math.min(...pointsOf(look, path).map((point) => norm(sub(point, antenna))));
  return 0.5 * look.paths.length[path] - nearest > 8 * look.image.resolution[1];
}

/** End of the shadow on the ground of the body with a high point, and the edge that casts it; null: none. */
function shadowOf(look, world, high) {
  const antenna = row(look.radar.position, look.radar.time.length >> 1);
  const sight = unit(sub(high, antenna));
  const ground = look.grid.height + 1e-3 * world.radius;
  const level = Math.hypot(sight[0], sight[1]);
  const away = [sight[0] / level, sight[1] / level, 0];
  const reach = (2.5 * (high[2] - look.grid.height) * level) / -sight[2];
  const foot = [high[0], high[1], ground];
  let last = null;
  for (let i = 1; i <= 400; i++) {
    const point = add(foot, scaled(away, (i / 400) * reach));
    const hit = world.firstHit(point, antenna);
    if (hit) last = { end: point, edge: hit.point.toArray() };
    else if (last) break;
  }
  // the very edge is what the last dark ray grazes; one that ended at the search's end is no edge
  if (!last || norm(sub(last.end, foot)) > 0.99 * reach) return null;
  return { ...last, length: Math.hypot(last.end[0] - last.edge[0], last.end[1] - last.edge[1]) };
}

/** Steps available for this look. */
function stepsOf({ page, store, world, story }) {
  const look = page.looks[store.get("look")];
  const steps = [];
  if (look.radar) {
    steps.push({
      text: html`<h2>A radar flies by</h2><p>It flies along the line and looks sideways and down. The blue cone is its beam: ${
        look.radar.mode === "spotlight" ? "in <b>spotlight</b> mode it is held on one place" : look.radar.mode === "stripmap" ? "in <b>stripmap</b> mode it points straight to the side and sweeps over the ground with the platform" : look.radar.mode_doc
      }. Press Play, or drag the pulse slider.</p>`,
      go: () => {
        world.view("overview");
        store.set({ playing: true, drape: "off", range: null });
      },
    });
    steps.push({
      text: html`<h2>It measures distance, nothing else</h2><p>Each pulse runs over the scene as a shell that grows with the speed of light. Whatever the shell touches at
        one moment answers at one moment, and the radar cannot tell such points apart. Drag the white line in the echo below: the shell follows.</p>`,
      go: () => {
        world.view("scene");
        store.set({ playing: false, shell: true, rulings: true, sweep: true });
      },
    });
    steps.push({
      text: html`<h2>Many pulses make the image</h2><p>From one pulse to the next the distances change a little, and differently for every place. Adding all pulses up
        with the right delay for a place makes what is there stand out and all else cancel. Watch the image become sharp while the radar flies.</p>`,
      go: () => {
        world.view("overview");
        store.set({ drape: "ground", building: true, pulse: 0, playing: true, sweep: false, rulings: false, range: null });
      },
    });
  }
  if (look.paths && look.scene !== null) steps.push(...buildingSteps({ look, page, store, world, story }));
  return steps;
}

function buildingSteps({ look, store, world, story }) {
  const steps = [];
  // the neighbourhood of some points that is worth seeing
  const around = (points) => {
    const center = scaled(points.reduce(add), 1 / points.length);
    const reach = Math.max(...points.map((point) => norm(sub(point, center))), 2.2 * (high ? high[2] - look.grid.height : 0), 0.25 * world.radius);
    return { center: [center[0], center[1], 0.5 * (center[2] + look.grid.height)], radius: Math.min(reach, world.radius) };
  };
  const still = { pulse: look.radar.time.length >> 1, playing: false, building: false, drape: "ground", range: null, sweep: false, rulings: false };
  const top = highest(look);
  const high = top >= 0 ? pointsOf(look, top)[0] : null;
  if (high && high[2] - look.grid.height > 0.02 * world.radius) {
    steps.push({
      text: html`<h2>Why high things lean towards the radar</h2>`,
      go: (head) => {
        store.set(still);
        world.view("scene", around([high]));
        story.pixel(cellPixel(look, cellOfPath(look, top)), { reach: 0, head });
      },
    });
    const shadow = shadowOf(look, world, high);
    if (shadow) {
      steps.push({
        text: html`<h2>Where the shadow falls</h2><p>The straight line from the radar over the edge meets the ground ${shadow.length.toFixed(0)} m further. Between them no pulse
          reaches the ground: nothing comes back, and the image is black there. The scene is lit here as if the radar were a lamp, so the lamp's shadow and the black of the
          image are the same place. Turn the image off and on with <kbd>I</kbd>.</p>`,
        go: (head) => {
          store.set({ ...still, shadow: true });
          world.view("scene", around([shadow.edge, shadow.end]));
          world.clearPick();
          const toRadar = add(shadow.edge, scaled(unit(sub(shadow.edge, shadow.end)), 1.2 * world.radius));
          world.addLine([toRadar, shadow.edge, shadow.end], 0xffd166, { width: 0.9, arrows: true });
          world.addSpot("edge", shadow.edge, 0xffd166, "edge", "o1");
          world.addSpot("end", shadow.end, 0xffffff, "shadow ends here", "");
          store.set({ picked: pixelOf(look.grid, shadow.end) });
          story.show(head);
        },
      });
    }
  }
  // off the ground and off a wall, drawn where the wall stands
  const atFoot = (points, middle) => {
    const [low, high_] = points[0][2] < points[1][2] ? points : [points[1], points[0]];
    return Math.abs(low[2] - look.grid.height) < 0.01 * world.radius && Math.abs(dot(sub(middle, high_), look.grid.across)) < 0.02 * world.radius;
  };
  const foot = brightest(look, 2, atFoot);
  if (foot >= 0) {
    steps.push({
      text: html`<h2>The bright line at the foot</h2>`,
      go: (head) => {
        store.set(still);
        world.view("scene", around([pointOf(look.grid, cellPixel(look, foot))]));
        story.pixel(cellPixel(look, foot), { reach: 0, head });
      },
    });
  }
  const ghost = brightest(look, 3, () => true);
  if (ghost >= 0) {
    steps.push({
      text: html`<h2>Ghosts</h2>`,
      go: (head) => {
        store.set(still);
        world.view("scene", around([pointOf(look.grid, cellPixel(look, ghost))]));
        story.pixel(cellPixel(look, ghost), { reach: 0, head });
      },
    });
  }
  steps.push({
    text: html`<h2>Your turn</h2><p>Click anything: a spot of the image, a wall, a roof. Press <kbd>?</kbd> for all keys.</p>`,
    go: (head) => {
      story.welcome();
      story.show(head);
    },
  });
  return steps;
}

export class Tour {
  constructor(parts) {
    this.parts = parts;
    this.at = -1;
  }

  start() {
    this.steps = stepsOf(this.parts);
    this.go(0);
  }

  go(at) {
    const { story } = this.parts;
    if (!this.steps || at < 0 || at >= this.steps.length) return this.end();
    this.at = at;
    const step = this.steps[at];
    const bar = html`<p><button type="button" data-tour="-1" ${at === 0 ? "disabled" : ""}>Back</button>
      <button type="button" data-tour="1">${at + 1 < this.steps.length ? "Next" : "Done"}</button> <span class="quiet">${at + 1} of ${this.steps.length}</span></p>`;
    const head = html`${bar}${step.text}`;
    story.show(head);
    step.go(head);
    story.element.onclick = (event) => {
      const move = event.target.dataset?.tour;
      if (move) this.go(this.at + Number(move));
    };
  }

  end() {
    this.at = -1;
    this.steps = null;
    this.parts.story.welcome();
  }
}

