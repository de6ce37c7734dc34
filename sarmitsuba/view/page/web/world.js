// 3-D scene with the radar's pass: platform, beam, line of sight, range shells, shadow, image, paths.

import * as THREE from "three";

import { imageMesh, imageTexture } from "sarmitsuba/drape.js";
import { add, dot, footprint, norm, onPlane, passGround, pointOf, rangeAndRate, row, scaled, sub, unit } from "sarmitsuba/localise.js";
import { cleared, platformModel } from "sarmitsuba/models.js";
import { Stage, orderColour, vector } from "sarmitsuba/stage.js";

const BEAM = 0x5cc8ff;
const SHELL = 0xffffff;
const GROUND = 0x1c2530;

export class World extends Stage {
  /**
   * @param {{canvas: HTMLCanvasElement, labels: HTMLElement, page: object, store: object,
   *   onWall: function, onPixel: function}} options
   */
  constructor({ canvas, labels, page, store, onWall, onPixel }) {
    super({ canvas, labels, groups: ["ground", "track", "beam", "shell", "rulings", "drape"] });
    Object.assign(this, { page, store, onWall, onPixel });
    this.listen();
  }

  get look() {
    return this.page.looks[this.store.get("look")];
  }

  /** Read the meshes; resolves when the scene can be drawn. */
  async load() {
    await this.loadModels(this.page.scenes);
    this.measure();
    this.showLook();
    this.fit();
    this.view("overview");
  }

  /** Radius of the display: that of the image's ground, widened to the scene up to twice that. */
  measure() {
    const { grid } = this.look;
    const corners = [[0, 0], [grid.shape[0] - 1, grid.shape[1] - 1]].map((at) => pointOf(grid, at));
    const across = norm(sub(corners[1], corners[0]));
    this.radius = Math.max(0.5 * across, 1);
    this.radius = Math.min(Math.max(this.radius, this.modelRadius(this.look.scene)), 2 * this.radius);
  }

  // ---- one look of a radar at the scene -------------------------------------------------------------------------

  showLook() {
    const { look } = this;
    this.showModel(look.scene, this.page.scenes[look.scene ?? -1]);
    this.setBuildings();
    this.place = this.placing();
    this.drawGround();
    this.drawTrack();
    this.drawRulings();
    this.drawDrape();
    this.showPulse();
  }

  /** Level ground under the whole pass, behind everything: the beam's footprint lies on it where the scene ends. */
  drawGround() {
    const group = this.groups.ground;
    cleared(group);
    const corners = passGround(this.look, 0.5 * this.radius).map(vector);
    const geometry = new THREE.BufferGeometry().setFromPoints(corners).setIndex([0, 1, 2, 0, 2, 3]);
    const material = new THREE.MeshBasicMaterial({ color: GROUND, side: THREE.DoubleSide, depthTest: false, depthWrite: false });
    const sheet = new THREE.Mesh(geometry, material);
    sheet.renderOrder = -1;
    group.add(sheet);
  }

  /** Map from true positions to drawn positions of the platform. */
  placing() {
    const { radar } = this.look;
    if (!radar || this.store.get("scale") === "true") return (point) => point;
    const n = radar.time.length;
    const middle = row(radar.position, n >> 1);
    const along = unit([...row(radar.velocity, n >> 1).slice(0, 2), 0]);
    const ends = [row(radar.position, 0), row(radar.position, n - 1)].map((p) => Math.abs(dot(p, along)));
    const nearer = Math.min(1, (1.75 * this.radius) / norm(middle));
    const shorter = Math.min(1, (1.2 * this.radius) / Math.max(...ends, 1e-9));
    return (point) => {
      const forward = dot(point, along);
      return add(scaled(sub(point, scaled(along, forward)), nearer), scaled(along, forward * shorter));
    };
  }

  drawTrack() {
    const { radar } = this.look;
    const group = this.groups.track;
    cleared(group);
    this.labels.drop("track");
    if (!radar) return;
    const n = radar.time.length;
    const points = [];
    for (let i = 0; i < n; i++) points.push(vector(this.place(row(radar.position, i))));
    const line = (from, to, colour) =>
      new THREE.Line(new THREE.BufferGeometry().setFromPoints(points.slice(from, to)), new THREE.LineBasicMaterial({ color: colour }));
    group.add(line(0, n, 0x7f92a6));
    this.flown = line(0, n, 0xffd166);
    group.add(this.flown);
    const far = this.store.get("scale") === "true" ? 0.4 * norm(row(radar.position, n >> 1)) : 0;
    this.platform = platformModel(0.08 * (far + this.radius));
    group.add(this.platform);
  }

  /** The image on the ground, or in the slant plane, where range is drawn to scale. */
  drawDrape() {
    const group = this.groups.drape;
    cleared(group);
    const mode = this.store.get("drape");
    this.drape = null;
    if (mode === "off" || !this.texture) return;
    this.drape = imageMesh(this.look.grid, this.texture, mode === "slant" ? this.slantPlane() : pointOf);
    group.add(this.drape);
  }

  /** Slant plane through the image's centre: azimuth and measured slant range. */
  slantPlane() {
    const { grid, radar } = this.look;
    const middle = [0.5 * (grid.shape[0] - 1), 0.5 * (grid.shape[1] - 1)];
    const center = pointOf(grid, middle);
    const antenna = radar ? row(radar.position, radar.time.length >> 1) : [0, 0, 1];
    let sight = sub(center, antenna);
    sight = unit(sub(sight, scaled(grid.along, dot(sight, grid.along))));
    const slant = (at) => {
      if (grid.kind === "slant") return grid.range[0] + at[1] * grid.range[1];
      const way = sub(pointOf(grid, at), antenna);
      return norm(sub(way, scaled(grid.along, dot(way, grid.along))));
    };
    const reference = slant(middle);
    return (_, at) => add(add(center, scaled(grid.along, (at[0] - middle[0]) * grid.azimuth[1])), scaled(sight, slant(at) - reference));
  }

  /** Canvas with the image, first row at its top; call `imageChanged` when it was painted. */
  setImage(canvas) {
    this.texture?.dispose();
    this.texture = imageTexture(canvas);
    this.drawDrape();
    this.request();
  }

  imageChanged() {
    if (this.texture) this.texture.needsUpdate = true;
    this.request();
  }

  /** Lines of equal range on the ground, with equal spacing in range. */
  drawRulings() {
    const group = this.groups.rulings;
    cleared(group);
    this.labels.drop("ruling");
    const { radar, grid } = this.look;
    if (!radar || !this.store.get("rulings")) return;
    const antenna = row(radar.position, radar.time.length >> 1);
    const velocity = row(radar.velocity, radar.time.length >> 1);
    const center = norm(sub(antenna, this.look.middle));
    const depth = this.radius;
    const step = niceStep(depth / 5);
    const material = new THREE.LineBasicMaterial({ color: 0x9fb2c6, transparent: true, opacity: 0.55 });
    for (let i = Math.ceil(-depth / step); i <= depth / step; i++) {
      const points = this.rangeLine(antenna, velocity, center + i * step, grid);
      if (points.length > 1) {
        group.add(new THREE.Line(new THREE.BufferGeometry().setFromPoints(points), material.clone()));
        this.labels.put(`ruling${i}`, `${i > 0 ? "+" : ""}${+(i * step).toPrecision(3)} m`, points[0].toArray(), "quiet");
      }
    }
  }

  /** The ground's points of one range, within the scene. */
  rangeLine(antenna, velocity, range, grid) {
    const points = [];
    const speed = norm(velocity);
    for (let k = -24; k <= 24; k++) {
      // range rate of a point so far ahead of the antenna as the scene's middle and k steps more
      const ahead = -dot(antenna, velocity) / speed + (k / 24) * this.radius;
      const point = onPlane(antenna, velocity, range, (-ahead * speed) / range, grid.height, grid.across);
      if (point && norm(point) < 1.6 * this.radius) points.push(vector([point[0], point[1], point[2] + 2e-3 * this.radius]));
    }
    return points;
  }

  // ---- one pulse ------------------------------------------------------------------------------------------------

  showPulse() {
    const { radar } = this.look;
    if (!radar) return this.request();
    const pulse = this.store.get("pulse");
    const antenna = row(radar.position, pulse);
    const shown = this.place(antenna);
    this.flown.geometry.setDrawRange(0, pulse + 1);
    this.platform.position.copy(vector(shown));
    const course = unit(row(radar.velocity, pulse));
    // the model flies towards its -y
    this.platform.rotation.set(0, 0, Math.atan2(course[1], course[0]) + 0.5 * Math.PI);
    this.labels.put("track", "radar", add(shown, [0, 0, 0.06 * this.radius]), "");
    this.aimLight(unit(antenna), this.store.get("shadow"));
    this.drawBeam(pulse, antenna, shown);
    this.drawShell();
    this.request();
  }

  drawBeam(pulse, antenna, shown) {
    const group = this.groups.beam;
    cleared(group);
    this.labels.drop("beam");
    const { radar, grid } = this.look;
    const axes = [radar.boresight, radar.azimuth_axis, radar.elevation_axis].map((axis) => row(axis, pulse));
    const most = 3 * norm(antenna);
    const outline = footprint(antenna, axes, radar.beam_widths, grid.height, most);
    this.footprint = outline;
    const middle = footprint(antenna, axes, [0, 0], grid.height, most, 1)[0];
    this.beamCenter = middle;
    if (!this.store.get("beam")) return;
    const lifted = outline.map((p) => vector(add(p, [0, 0, 3e-3 * this.radius])));
    const apex = vector(shown);
    const sides = [];
    lifted.forEach((p, i) => sides.push(apex, p, lifted[(i + 1) % lifted.length]));
    const glass = (opacity) =>
      new THREE.MeshBasicMaterial({ color: BEAM, transparent: true, opacity, side: THREE.DoubleSide, depthWrite: false });
    group.add(new THREE.Mesh(new THREE.BufferGeometry().setFromPoints(sides), glass(0.1)));
    group.add(new THREE.LineLoop(new THREE.BufferGeometry().setFromPoints(lifted), new THREE.LineBasicMaterial({ color: BEAM })));
    group.add(new THREE.Line(
      new THREE.BufferGeometry().setFromPoints([apex, vector(middle)]),
      new THREE.LineBasicMaterial({ color: 0xffffff, transparent: true, opacity: 0.7 }),
    ));
    this.labels.put("beam", "line of sight", scaled(add(shown, middle), 0.5), "quiet");
  }

  /** The wave at one range: part of a sphere about the antenna, and its line on the ground. */
  drawShell() {
    const group = this.groups.shell;
    cleared(group);
    this.labels.drop("shell");
    const { radar, grid } = this.look;
    const fromMiddle = this.store.get("range");
    if (!radar || fromMiddle === null || !this.store.get("shell")) return this.request();
    const pulse = this.store.get("pulse");
    const antenna = row(radar.position, pulse);
    const velocity = row(radar.velocity, pulse);
    const range = norm(sub(antenna, this.look.middle)) + fromMiddle;
    const sight = unit(scaled(antenna, -1));
    const course = unit(velocity);
    const side = unit(sub(course, scaled(sight, dot(course, sight))));
    const up = [sight[1] * side[2] - sight[2] * side[1], sight[2] * side[0] - sight[0] * side[2], sight[0] * side[1] - sight[1] * side[0]];
    const half = Math.min(0.9 * this.radius / range, 0.7);
    const n = 24;
    const positions = [];
    const index = [];
    for (let i = 0; i <= n; i++) {
      for (let j = 0; j <= n; j++) {
        const a = half * ((2 * i) / n - 1);
        const b = half * ((2 * j) / n - 1);
        const ray = unit(add(sight, add(scaled(side, Math.tan(a)), scaled(up, Math.tan(b)))));
        const point = add(antenna, scaled(ray, range));
        positions.push(point[0], point[1], point[2]);
        if (i && j) {
          const k = i * (n + 1) + j;
          index.push(k, k - 1, k - n - 1, k - 1, k - n - 2, k - n - 1);
        }
      }
    }
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.Float32BufferAttribute(positions, 3));
    geometry.setIndex(index);
    group.add(new THREE.Mesh(geometry, new THREE.MeshBasicMaterial({
      color: SHELL, transparent: true, opacity: 0.16, side: THREE.DoubleSide, depthWrite: false,
    })));
    const line = this.rangeLine(antenna, velocity, range, grid);
    if (line.length > 1) {
      group.add(new THREE.Line(new THREE.BufferGeometry().setFromPoints(line), new THREE.LineBasicMaterial({ color: SHELL })));
      this.labels.put("shell", "the wave now", line[line.length - 1].toArray(), "quiet");
    }
    this.request();
  }

  setBuildings() {
    this.shade(this.store.get("buildings"));
  }

  // ---- what was clicked ------------------------------------------------------------------------------------------

  /** One path: in from the radar, from bounce to bounce, and back. */
  addPath(points, pulse, order, strong = true) {
    const antenna = row(this.look.radar.position, pulse);
    const reach = 1.1 * this.radius;
    const towards = (point) => add(point, scaled(unit(sub(antenna, point)), reach));
    const colour = orderColour(order);
    const line = [towards(points[0]), ...points, towards(points[points.length - 1])];
    this.addLine(line, colour, { width: strong ? 1 : 0.45, opacity: strong ? 1 : 0.45, arrows: strong });
    if (strong) {
      points.forEach((point, i) => this.addSpot(`path${i}`, point, colour, points.length > 1 ? `${i + 1}` : "", `o${Math.min(order, 4)}`, 0.8));
    }
  }

  /** Edge of a cell of the image, four corners of its plane. */
  addCell(corners, colour = 0xffffff) {
    const points = [...corners, corners[0]].map((p) => add(p, [0, 0, 4e-3 * this.radius]));
    this.addLine(points, colour, { width: 0.7 });
  }

  /** The points as far from the radar and with the same Doppler as `point`, from it down to the image's plane. */
  equalRangeArc(point, pulse, height, across) {
    const { radar } = this.look;
    const antenna = row(radar.position, pulse);
    const velocity = row(radar.velocity, pulse);
    const { range, rate } = rangeAndRate(antenna, velocity, point);
    const arc = [];
    for (let i = 0; i <= 32; i++) {
      const at = onPlane(antenna, velocity, range, rate, point[2] + (i / 32) * (height - point[2]), across);
      if (at) arc.push(at);
    }
    return arc;
  }

  /** First face on the line from one point to another: {distance, point, object}, or null. */
  firstHit(from, to, slack = 1e-3) {
    const way = sub(to, from);
    const length = norm(way);
    const caster = new THREE.Raycaster(vector(add(from, scaled(way, (slack * this.radius) / length))), vector(scaled(way, 1 / length)));
    caster.far = Math.min(length, 8 * this.radius);
    const model = this.models[this.look.scene ?? -1];
    return model ? (caster.intersectObject(model, true)[0] ?? null) : null;
  }

  /** Whether the antenna sees a point at a pulse. */
  lit(point, pulse) {
    return this.firstHit(point, row(this.look.radar.position, pulse)) === null;
  }

  listen() {
    let down = null;
    this.canvas.addEventListener("pointerdown", (event) => {
      down = [event.clientX, event.clientY];
    });
    this.canvas.addEventListener("pointerup", (event) => {
      if (down && Math.hypot(event.clientX - down[0], event.clientY - down[1]) < 5) this.pick(event.clientX, event.clientY);
      down = null;
    });
  }

  /** Object at a position of the window: a wall, or a pixel of the image on the ground. */
  pick(x, y) {
    const frame = this.canvas.getBoundingClientRect();
    const at = new THREE.Vector2((2 * (x - frame.left)) / frame.width - 1, 1 - (2 * (y - frame.top)) / frame.height);
    const caster = new THREE.Raycaster();
    caster.setFromCamera(at, this.camera);
    const model = this.models[this.look.scene ?? -1];
    const walls = model && this.store.get("buildings") !== "hidden" ? caster.intersectObject(model, true) : [];
    const image = this.drape ? caster.intersectObject(this.drape) : [];
    const wall = walls[0];
    const { grid } = this.look;
    const flat = wall && Math.abs(wall.point.z - grid.height) < 5e-3 * this.radius;
    if (image.length && (!wall || flat || image[0].distance < wall.distance)) {
      const { uv } = image[0];
      this.onPixel([uv.y * grid.shape[0] - 0.5, uv.x * grid.shape[1] - 0.5]);
    } else if (wall) {
      this.onWall(wall.point.toArray(), { ...wall.object.userData, steep: Math.abs(wall.face.normal.z) < 0.5 });
    }
  }

  /** Depth of the camera's view: to the drawn radar. */
  get depth() {
    const { radar } = this.look;
    return radar ? 2 * norm(this.place(row(radar.position, 0))) : 0;
  }

  // ---- the camera -----------------------------------------------------------------------------------------------

  /**
   * @param {string} name overview, scene, radar or map
   * @param {{center: number[], radius: number} | null} part of the scene that is to fill the view; null: all of it
   */
  view(name, part = null) {
    const { radar, grid } = this.look;
    const r = part?.radius ?? this.radius;
    const center = part?.center ?? [0, 0, 0];
    const { along, across } = grid;
    const antenna = radar ? row(radar.position, radar.time.length >> 1) : scaled(across, -this.radius);
    const from = (direction, away) => this.lookAt(add(center, scaled(unit(direction), away * r)), center);
    if (name === "overview") {
      const shown = this.place(antenna);
      const target = scaled(shown, 0.45);
      const away = 1.75 * (0.55 * norm(shown) + 0.8 * r);
      this.lookAt(add(target, scaled(unit(add(add(scaled(along, -1), scaled(across, -0.1)), [0, 0, 0.34])), away)), target);
    } else if (name === "scene") from(add(add(scaled(along, -0.8), scaled(across, -0.5)), [0, 0, 0.6]), 2.5);
    else if (name === "radar") from(antenna, 3.4);
    else from(add(scaled(across, -1e-3), [0, 0, 1]), 3.2);
  }
}

/** 1, 2 or 5 times a power of ten, near a given value. */
function niceStep(wish) {
  const power = 10 ** Math.floor(Math.log10(wish));
  const share = wish / power;
  return power * (share < 1.5 ? 1 : share < 3.5 ? 2 : share < 7.5 ? 5 : 10);
}
