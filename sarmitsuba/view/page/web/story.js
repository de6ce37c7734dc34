// Response to a click, in the scene and as text: the paths behind a pixel, and the image positions of a wall's echoes.

import { add, dot, landings, norm, pointOf, row, scaled, sub, unit } from "sarmitsuba/localise.js";
import { fill, html } from "sarmitsuba/markup.js";
import { spillOf, spillView } from "sarmitsuba/spill.js";
import { orderColour } from "sarmitsuba/stage.js";

const NAMES = ["", "one bounce", "two bounces", "three bounces"];
export const bounces = (order) => NAMES[order] ?? `${order} bounces`;
const metres = (value, digits = 1) => `${value.toFixed(digits)} m`;
const percent = (share) => (share < 0.01 ? "under 1 %" : `${Math.round(100 * share)} %`);
const KINDS = {
  coherent: "mirror-like or edge return", diffuse: "scattered by roughness", reciprocal: "scattered, and back the way it came", point: "ideal point", scatterer: "scatterer of known form",
};
// height above the image plane, relative to the scene's size, above which a hit is not on the ground
const HIGH = 0.01;

/** Paths of the cell of a pixel, or of the nearest cell within a few; null: none kept. */
export function cellAt(look, at, reach = 2) {
  const { paths } = look;
  if (!paths) return null;
  const i = Math.floor((at[0] + 0.5) / paths.cell_size[0]);
  const j = Math.floor((at[1] + 0.5) / paths.cell_size[1]);
  let best = null;
  for (let di = -reach; di <= reach; di++) {
    for (let dj = -reach; dj <= reach; dj++) {
      const [r, c] = [i + di, j + dj];
      if (r < 0 || c < 0 || r >= paths.shape[0] || c >= paths.shape[1]) continue;
      const place = find(paths.cell, r * paths.shape[1] + c);
      const away = di * di + dj * dj;
      if (place >= 0 && (best === null || away < best.away)) best = { place, row: r, column: c, away };
    }
  }
  return best;
}

function find(sorted, value) {
  let [low, high] = [0, sorted.length - 1];
  while (low <= high) {
    const middle = (low + high) >> 1;
    if (sorted[middle] === value) return middle;
    if (sorted[middle] < value) low = middle + 1;
    else high = middle - 1;
  }
  return -1;
}

/** Corners of a cell on the image's plane. */
function corners(look, cell) {
  const [height, width] = look.paths.cell_size;
  const [top, left] = [cell.row * height - 0.5, cell.column * width - 0.5];
  return [[top, left], [top, left + width], [top + height, left + width], [top + height, left]].map((at) => pointOf(look.grid, at));
}

/** Points of a path, each [x, y, z]. */
export function pointsOf(look, path) {
  const { paths } = look;
  const first = paths.starts[path];
  return Array.from({ length: paths.order[path] }, (_, i) => row(paths.points, first + i));
}

/** Add what follows from a look's numbers: its image's middle from the page's origin, where the points of every path start. */
export function prepare(look, center) {
  look.middle = sub(look.pixels.center, center);
  if (!look.paths) return;
  const starts = new Int32Array(look.paths.order.length + 1);
  for (let i = 0; i < look.paths.order.length; i++) starts[i + 1] = starts[i] + look.paths.order[i];
  look.paths.starts = starts;
}

export class Story {
  /** @param {{element: HTMLElement, world: object, page: object, store: object}} options */
  constructor({ element, world, page, store }) {
    Object.assign(this, { element, world, page, store });
  }

  get look() {
    return this.page.looks[this.store.get("look")];
  }

  show(markup) {
    fill(this.element, markup);
    this.element.scrollTop = 0;
  }

  welcome() {
    this.world.clearPick();
    const { look } = this;
    const marked = look.paths ? `${look.paths.cell.length.toLocaleString("en")} cells of the image have their ray paths in this page: the brightest ones.` : "";
    this.show(html`<h2>What you see</h2>
      <p>A radar flies along the line and looks to its ${look.radar ? look.radar.side : "side"}. It sends pulses and listens: for every echo it knows
      <b>how far</b> it came from, and, from many pulses, <b>how far along the flight</b>. It knows nothing of height.</p>
      <p>Click a <b>bright spot of the image</b> (right, or on the ground) to see the paths that made it. Click a <b>wall or a roof</b> to
      see where its echoes are drawn. Or take the guided tour.</p><p class="quiet">${marked}</p>`);
  }

  // ---- a pixel --------------------------------------------------------------------------------------------------

  /** Show the paths of the pixel at a row and a column (fractions). */
  pixel(at, { reach = 2, head = "" } = {}) {
    const { look, world } = this;
    world.clearPick();
    const place = pointOf(look.grid, at);
    this.store.set({ picked: at });
    const cell = cellAt(look, at, reach);
    const spill = spillOf(look, at, look.paths?.cell_size);
    const spilt = spill && spillView(spill, norm(sub(pointOf(look.grid, [spill.row, spill.column]), place)));
    if (cell === null) return this.dark(place, head, spilt);
    const { paths } = look;
    const [first, end] = [paths.first[cell.place], paths.first[cell.place + 1]];
    const shares = Array.from(paths.by_order.subarray(6 * cell.place, 6 * cell.place + 6), (v) => v / 255);
    const main = shares.indexOf(Math.max(...shares)) + 1;
    const ofMain = (path) => Math.min(paths.order[path], 6) === main;
    // those of the strongest number of bounces first
    const list = Array.from({ length: end - first }, (_, i) => first + i).sort((a, b) => ofMain(b) - ofMain(a) || paths.share[b] - paths.share[a]);
    this.cell = { cell, list, main };
    const middle = pointOf(look.grid, [(cell.row + 0.5) * paths.cell_size[0] - 0.5, (cell.column + 0.5) * paths.cell_size[1] - 0.5]);
    const [lead] = list;
    const parts = shares.map((s, i) => [i + 1, s]).filter(([, s]) => s > 0.005)
      .map(([order, s]) => html`<span class="o${Math.min(order, 4)}">${percent(s)} ${bounces(order)}</span>`)
      .flatMap((part, i) => (i ? [", ", part] : [part]));
    this.show(html`${head}<h2>The paths behind this spot</h2><p>${spilt ?? this.meaning(lead, middle, main)}</p>
      <p>${spilt ? "What is here of its own, by amplitude" : "By amplitude"}: ${parts}. ${paths.found[cell.place] === 1 ? "One path ends in this cell." : `${paths.found[cell.place].toLocaleString("en")} paths end in this cell; the strongest are listed.`}</p>
      <table><thead><tr><th>Bounces</th><th>On</th><th>Length there and back</th><th>Share</th></tr></thead><tbody>
      ${list.slice(0, 8).map((path) => this.line(path))}</tbody></table>`);
    for (const node of this.element.querySelectorAll("tr.path")) {
      const call = () => this.draw(Number(node.dataset.path));
      node.addEventListener("click", call);
      node.addEventListener("keydown", (event) => {
        if (event.key === "Enter") call();
      });
    }
    this.draw(lead);
  }

  line(path) {
    const { paths } = this.look;
    const order = paths.order[path];
    const materials = this.page.scenes[this.look.scene].materials;
    const first = paths.starts[path];
    const on = Array.from({ length: order }, (_, i) => materials[paths.material[first + i]] ?? "point").join(" → ");
    const kind = paths.kinds[paths.kind[path]];
    return html`<tr class="path" tabindex="0" data-path="${path}" data-order="${order}"><td class="o${Math.min(order, 4)}">${order}</td>
      <td>${on} <span class="quiet">${KINDS[kind] ?? kind}</span></td>
      <td class="number">${metres(paths.length[path], 2)}</td><td class="number">${percent(paths.share[path])}</td></tr>`;
  }

  /** Draw the cell's listed paths, one of them highlighted. */
  draw(chosen) {
    const { look, world } = this;
    const { paths } = look;
    world.clearPick();
    world.addCell(corners(look, this.cell.cell));
    for (const path of this.cell.list.slice(0, 8)) {
      world.addPath(pointsOf(look, path), paths.pulse[path], paths.order[path], path === chosen);
    }
    const points = pointsOf(look, chosen);
    const turn = points.reduce((a, b) => (b[2] > a[2] ? b : a));
    if (paths.order[chosen] === 1 && this.height(turn) > HIGH * world.radius) {
      this.arc(turn, paths.pulse[chosen]);
    }
    world.addSpot("cell", corners(look, this.cell.cell)[0], 0xffffff, "drawn here", "", 0.6);
    for (const node of this.element.querySelectorAll("tr.path")) node.classList.toggle("chosen", Number(node.dataset.path) === chosen);
    this.store.set({ path: chosen });
  }

  height(point) {
    return point[2] - this.look.grid.height;
  }

  arc(point, pulse) {
    const { grid } = this.look;
    const arc = this.world.equalRangeArc(point, pulse, grid.height, grid.across);
    this.world.addLine(arc, 0xffffff, { width: 0.6 });
    if (arc.length) this.world.labels.put("pickarc", "all equally far from the radar", arc[arc.length >> 1], "");
  }

  /** One or two sentences on a path, for newcomers. */
  meaning(path, middle, order) {
    const { look, world } = this;
    const { paths } = look;
    const points = pointsOf(look, path);
    const top = points.reduce((a, b) => (b[2] > a[2] ? b : a));
    const high = this.height(top);
    const away = dot(sub(middle, top), look.grid.across);
    if (order === 1) {
      if (high > HIGH * world.radius) {
        return html`<b>Layover.</b> This echo comes from ${metres(high)} above the ground, and yet it is drawn on the ground ${metres(Math.abs(away))}
          ${away < 0 ? "nearer to" : "further from"} the radar: that ground is just as far from the radar as the high point (white arc). Whatever is high leans
          towards the radar.`;
      }
      return html`<b>A single bounce</b> off the ground and straight back: it is drawn where it is.`;
    }
    const antenna = row(look.radar.position, paths.pulse[path]);
    const detour = 0.5 * paths.length[path] - Math.min(...points.map((point) => norm(sub(point, antenna))));
    const spread = Math.max(...points.map((point) => norm(sub(point, points[0]))));
    const where = Math.abs(away) < 0.02 * world.radius ? "right there" : `${metres(Math.abs(away))} ${away > 0 ? "behind" : "before"} it`;
    if (detour < 3 * look.image.resolution[1] && spread < 0.1 * world.radius) {
      return html`<b>A corner, ${metres(high)} up.</b> ${order === 2 ? "Two" : "Several"} faces that meet here throw the pulse back to where it came from, all of it in step: a
        strong echo. ${high > HIGH * world.radius ? `${where === "right there" ? "" : `Like everything high it leans towards the radar: it is drawn ${where}.`}` : ""}`;
    }
    if (order === 2) {
      return html`<b>Two bounces:</b> off one surface, off another, and back. Where a wall meets the ground, every such path is exactly as long as the way to the
        foot of the wall and back, however high the wall is hit (here ${metres(high)} up). So the whole wall adds up in one bright line, drawn ${where === "right there" ? "at its foot" : where}.`;
    }
    const name = bounces(order);
    return html`<b>${name[0].toUpperCase()}${name.slice(1)}:</b> the pulse went ${metres(detour)} out of its way each way. All that the radar knows is how long it took, so the
      echo is drawn ${where}, where nothing need be: a ghost.`;
  }

  /** A pixel without a path kept: shadow, or weak. */
  dark(place, head, spilt) {
    const { look, world } = this;
    world.addSpot("dark", place, 0xffffff, "here", "");
    let text = "No path of this page ends here: the echo is weaker than those kept.";
    if (look.radar && look.scene !== null) {
      const pulse = look.radar.time.length >> 1;
      const lifted = add(place, [0, 0, 2e-3 * world.radius]);
      const hit = world.firstHit(lifted, row(look.radar.position, pulse));
      if (hit) {
        const point = hit.point.toArray();
        world.addLine([place, point], 0x8899aa, { width: 0.7 });
        world.addLine([point, add(point, scaled(unit(sub(row(look.radar.position, pulse), point)), world.radius))], 0xffd166, { width: 0.7 });
        text = html`<b>Shadow.</b> On the straight way from the radar to this ground stands ${hit.object.userData.material || "something"}: no pulse gets here, nothing
          comes back, and the image stays dark.`;
      }
    }
    this.show(html`${head}<h2>This spot</h2>${spilt ? html`<p>${spilt}</p>` : ""}<p>${text}</p>`);
  }

  // ---- a wall ---------------------------------------------------------------------------------------------------

  /** Show the image positions of the echoes of a point of the scene. */
  wall(point, facts, { head = "" } = {}) {
    const { look, world } = this;
    world.clearPick();
    if (!look.radar) return this.show(html`${head}<p>This run's track is not known.</p>`);
    const { grid } = look;
    const pulse = look.radar.time.length >> 1;
    const antenna = row(look.radar.position, pulse);
    const nearer = unit(sub(antenna, point));
    const before = add(point, scaled(nearer, 4e-3 * world.radius));
    const lit = world.lit(before, pulse);
    const below = facts.steep ? world.firstHit(before, [before[0], before[1], before[2] - 4 * world.radius], 0) : null;
    const ground = below ? below.point.z : grid.height;
    const high = point[2] - (facts.steep ? ground : grid.height);
    const upright = high > HIGH * world.radius;
    const foot = [point[0], point[1], ground];
    const places = landings(antenna, row(look.radar.velocity, pulse), point, ground, grid).slice(0, facts.steep && upright ? 3 : 1);
    const titles = ["one bounce: layover", "two bounces: the foot", "three bounces: a ghost"];
    world.addSpot("wall", point, 0xffffff, "clicked", "");
    const rows = [];
    for (const landing of places) {
      if (!landing.point) continue;
      world.addSpot(`landing${landing.order}`, landing.point, orderColour(landing.order), upright ? titles[landing.order - 1] : "drawn here", `o${landing.order}`);
      const away = dot(sub(landing.point, foot), grid.across);
      rows.push(html`<tr data-landing="${landing.order}"><td class="o${landing.order}">${bounces(landing.order)}</td><td class="number">${metres(landing.range - norm(sub(antenna, look.middle)), 2)}</td>
        <td>${Math.abs(away) < 0.05 ? "where it stands" : `${metres(Math.abs(away))} ${away < 0 ? "nearer to the radar" : "further away"}`}</td></tr>`);
    }
    if (upright) {
      this.arc(point, pulse);
      world.addLine([point, foot], 0x8899aa, { width: 0.4 });
    }
    const name = [facts.mesh, facts.material].filter(Boolean).join(", ");
    this.landed = places;
    const sees = lit ? "The radar sees it." : html`<b>It lies in shadow:</b> something stands between it and the radar, so nothing of this comes back from here.`;
    const why = !upright ? "" : html`The single echo is drawn nearer to the radar than the point stands, because what is high is nearer to the radar than its foot
      (white arc: all of it is equally far).${facts.steep ? html` The echo over the ground and the wall is as long as the way to the foot, and is drawn there. The one that touches the
      ground twice seems to come from a mirror image under the ground, and is drawn behind. <span class="quiet">Two and three bounces need smooth, level ground before the
      wall.</span>` : ""}`;
    this.show(html`${head}<h2>Where this point is drawn</h2>
      <p>${name ? `${name}: ` : ""}${upright ? `${metres(high)} above ${facts.steep ? "what lies below it" : "the ground"}.` : "level with the ground."} ${sees}</p>
      <table><thead><tr><th>Echo</th><th>Range from the image's middle</th><th>Drawn</th></tr></thead><tbody>${rows}</tbody></table>
      <p>${why}</p>`);
  }
}
