// Target in 3-D, with the direction to the radar and the RCS over aspect.

import * as THREE from "three";

import { imageMesh, imageTexture } from "sarmitsuba/drape.js";
import { add, pointOf, scaled, unit } from "sarmitsuba/localise.js";
import { cleared } from "sarmitsuba/models.js";
import { Stage, vector } from "sarmitsuba/stage.js";

const ARROW = 0x5cc8ff;
const CURVE = 0xffd166;
// in radii of the target: distance of the drawn radar, and range of the RCS curve
const AWAY = 2;
const INNER = 1.1;

export class Target extends Stage {
  /** @param {{canvas: HTMLCanvasElement, labels: HTMLElement, page: object, store: object}} options */
  constructor({ canvas, labels, page, store }) {
    super({ canvas, labels, groups: ["curve", "drape"] });
    Object.assign(this, { page, store });
    this.radius = page.radius;
  }

  /** Unit vector from the target to the radar. */
  direction(aspect) {
    const [azimuth, elevation] = [this.page.azimuth[aspect], this.page.elevation[aspect]].map((deg) => (deg * Math.PI) / 180);
    const flat = Math.cos(elevation);
    return [flat * Math.cos(azimuth), flat * Math.sin(azimuth), Math.sin(elevation)];
  }

  async load() {
    await this.loadModels(this.page.scenes);
    this.showModel(0, this.page.scenes[0]);
    this.shade(this.store.get("scene"));
    this.fit();
    this.view("overview");
  }

  /** Draw the arrow of the incident wave, and light the target from there. */
  showAspect() {
    const direction = this.direction(this.store.get("aspect"));
    this.radar = scaled(direction, AWAY * this.radius);
    this.clearPick();
    this.addLine([this.radar, scaled(direction, 1.02 * this.radius)], ARROW, { width: 2.2, arrows: true });
    this.addSpot("radar", this.radar, ARROW, "radar, far away this way", "", 2);
    this.aimLight(direction, this.store.get("shadow"));
    this.request();
  }

  /**
   * The curve about the target: the further out, the stronger.
   * @param {ArrayLike<number>} levels dBsm of every aspect
   * @param {number} bottom, top dBsm at its inner and its outer end
   */
  showCurve(levels, bottom, top) {
    const group = this.groups.curve;
    cleared(group);
    this.labels.drop("curve");
    if (this.store.get("curve")) {
      const share = (value) => Math.min(Math.max((value - bottom) / (top - bottom), 0), 1);
      const at = (reach) => Array.from(levels, (value, i) => vector(scaled(this.direction(i), reach(share(value)) * this.radius)));
      const Line = this.page.whole ? THREE.LineLoop : THREE.Line;
      const line = (points, color, opacity) =>
        new Line(new THREE.BufferGeometry().setFromPoints(points), new THREE.LineBasicMaterial({ color, transparent: true, opacity }));
      group.add(line(at(() => INNER), 0x7f92a6, 0.5), line(at(() => AWAY), 0x7f92a6, 0.5));
      const curve = at((part) => INNER + part * (AWAY - INNER));
      group.add(line(curve, CURVE, 1));
    }
    this.request();
  }

  /** The image below the target; null: none. */
  setImage(canvas, grid) {
    this.grid = grid;
    this.texture?.dispose();
    this.texture = imageTexture(canvas);
    this.showImage();
  }

  showImage() {
    const group = this.groups.drape;
    cleared(group);
    if (this.texture && this.store.get("drape")) group.add(imageMesh(this.grid, this.texture, (grid, at) => this.lowered(pointOf(grid, at))));
    this.request();
  }

  /** A point of the image's plane, which goes through the target's middle, where the image is drawn. */
  lowered(point) {
    return add(point, [0, 0, -1.02 * this.page.below]);
  }

  imageChanged() {
    if (this.texture) this.texture.needsUpdate = true;
    this.request();
  }

  /** @param {string} name overview, radar or map */
  view(name) {
    const directions = { overview: [-0.75, -0.55, 0.55], radar: this.direction(this.store.get("aspect")), map: [0, -1e-3, 1] };
    // upright is undefined straight from above
    const from = unit(add(directions[name], Math.hypot(...directions[name].slice(0, 2)) < 1e-3 ? [0, -1e-3, 0] : [0, 0, 0]));
    this.lookAt(scaled(from, (name === "radar" ? 4 : 6.4) * this.radius), [0, 0, 0]);
  }
}
