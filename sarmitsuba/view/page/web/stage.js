// 3-D scene common to all pages: meshes, a lamp at the radar, camera, thick lines, spots and labels.

import * as THREE from "three";
import { OrbitControls } from "three/orbit_controls";

import { Labels } from "sarmitsuba/labels.js";
import { MAP_SIZE, shadowCamera } from "sarmitsuba/lamp.js";
import { norm, scaled, sub } from "sarmitsuba/localise.js";
import { cleared, loadModel } from "sarmitsuba/models.js";

export const vector = (a) => new THREE.Vector3(a[0], a[1], a[2]);
const ORDER_COLOURS = [0xffd166, 0xffd166, 0x2ee6a8, 0xff7a9c, 0xc3a6ff];
export const orderColour = (order) => ORDER_COLOURS[Math.min(order, ORDER_COLOURS.length - 1)];

export class Stage {
  /**
   * @param {{canvas: HTMLCanvasElement, labels: HTMLElement, groups: string[]}} options groups: of what is drawn beside
   *   meshes (`points` and `pick`, what was clicked, are always there)
   */
  constructor({ canvas, labels, groups }) {
    this.canvas = canvas;
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.autoUpdate = false; // constant from frame to frame
    this.renderer.shadowMap.type = THREE.PCFShadowMap;
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    this.scene = new THREE.Scene();
    this.scene.background = new THREE.Color(0x0b1016);
    this.camera = new THREE.PerspectiveCamera(38, 1, 1, 1e4);
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.addEventListener("change", () => this.request());
    this.labels = new Labels(labels);
    this.sky = new THREE.HemisphereLight(0xcfe2ff, 0x7a7a88, 1.0);
    this.light = new THREE.DirectionalLight(0xfff2d8, 2.6);
    this.light.castShadow = true;
    this.scene.add(this.sky, this.light, this.light.target);
    this.models = [];
    this.groups = {};
    for (const name of [...groups, "pick", "points"]) {
      this.groups[name] = new THREE.Group();
      this.scene.add(this.groups[name]);
    }
    /** Radius of the displayed scene, m. */
    this.radius = 1;
    this.pending = false;
    this.frames = 0;
  }

  // ---- meshes ----------------------------------------------------------------------------------------------------

  /** Read the meshes of the page's scenes and release their packed form. */
  async loadModels(scenes) {
    for (const [number, facts] of scenes.entries()) {
      this.models[number] = await loadModel(facts);
      facts.glb = null;
      this.scene.add(this.models[number]);
    }
  }

  /** Half the diagonal of a scene's meshes, m; 0 where there are none. */
  modelRadius(number) {
    const model = this.models[number ?? -1];
    const box = model ? new THREE.Box3().setFromObject(model) : new THREE.Box3();
    return box.isEmpty() ? 0 : 0.5 * box.getSize(new THREE.Vector3()).length();
  }

  /** Show one scene's meshes and ideal points and no other's; `facts` are the page's of that scene. */
  showModel(number, facts) {
    this.models.forEach((model, i) => {
      model.visible = i === number;
    });
    this.lamp = null;
    cleared(this.groups.points);
    for (const point of facts?.points ?? []) {
      const ball = new THREE.Mesh(new THREE.SphereGeometry(0.012 * this.radius, 12, 8), new THREE.MeshBasicMaterial({ color: 0xff5c5c }));
      ball.position.copy(vector(point.position));
      this.groups.points.add(ball);
    }
  }

  /** Draw meshes `solid`, as `glass` or `hidden`. */
  shade(how) {
    const glass = how === "glass";
    const hidden = how === "hidden";
    this.renderer.shadowMap.needsUpdate = true;
    for (const model of this.models) {
      model?.traverse((node) => {
        if (!node.isMesh) return;
        node.visible = !hidden;
        node.material.transparent = glass;
        node.material.opacity = glass ? 0.35 : 1;
        node.material.depthWrite = !glass;
        node.material.needsUpdate = true;
      });
    }
    this.request();
  }

  /**
   * Put the lamp where the radar is.
   * @param {number[]} direction unit vector from the scene's middle
   * @param {boolean} on whether it throws a shadow
   */
  aimLight(direction, on) {
    // rotation of the lamp, rad, below which the shadow is not updated
    if (this.lamp && this.light.castShadow === on && norm(sub(direction, this.lamp)) < 2e-3) return;
    this.lamp = direction;
    this.renderer.shadowMap.needsUpdate = true;
    const { away, half, near, far, bias } = shadowCamera(this.radius);
    this.light.position.copy(vector(scaled(direction, away)));
    const camera = this.light.shadow.camera;
    Object.assign(camera, { left: -half, right: half, top: half, bottom: -half, near, far });
    camera.updateProjectionMatrix();
    const size = Math.min(MAP_SIZE, this.renderer.capabilities.maxTextureSize);
    if (this.light.shadow.mapSize.x !== size) this.light.shadow.mapSize.set(size, size);
    // faces are of either side and have no normals, so that the bias is along the light
    this.light.shadow.bias = (bias * MAP_SIZE) / size;
    this.light.castShadow = on;
  }

  // ---- lines and spots -------------------------------------------------------------------------------------------

  clearPick() {
    cleared(this.groups.pick);
    this.labels.drop("pick");
    this.request();
  }

  /** A thick line through points, true scene positions. */
  addLine(points, colour, { width = 1, opacity = 1, arrows = false } = {}) {
    const thick = 0.0035 * this.radius * width;
    const material = () => new THREE.MeshBasicMaterial({ color: colour, transparent: opacity < 1, opacity });
    for (let i = 1; i < points.length; i++) {
      const [a, b] = [vector(points[i - 1]), vector(points[i])];
      const length = a.distanceTo(b);
      if (!(length > 0)) continue;
      const turn = new THREE.Quaternion().setFromUnitVectors(new THREE.Vector3(0, 1, 0), b.clone().sub(a).normalize());
      const put = (geometry, share) => {
        const mesh = new THREE.Mesh(geometry, material());
        mesh.position.lerpVectors(a, b, share);
        mesh.quaternion.copy(turn);
        this.groups.pick.add(mesh);
      };
      put(new THREE.CylinderGeometry(thick, thick, length, 6), 0.5);
      if (arrows && length > 12 * thick) put(new THREE.ConeGeometry(3.2 * thick, 10 * thick, 10), 0.55);
    }
    this.request();
  }

  addSpot(key, point, colour, text, className = "", size = 1) {
    const ball = new THREE.Mesh(
      new THREE.SphereGeometry(0.011 * this.radius * size, 16, 10),
      new THREE.MeshBasicMaterial({ color: colour, depthTest: false, transparent: true }),
    );
    ball.renderOrder = 5;
    ball.position.copy(vector(point));
    this.groups.pick.add(ball);
    if (text) this.labels.put(`pick${key}`, text, point, className);
    this.request();
  }

  /** Mark the position of the image's cursor on the ground; null: none. */
  showCursor(point) {
    if (!this.cursor) {
      this.cursor = new THREE.Mesh(
        new THREE.SphereGeometry(0.008 * this.radius, 12, 8),
        new THREE.MeshBasicMaterial({ color: 0xffd166, depthTest: false, transparent: true }),
      );
      this.cursor.renderOrder = 6;
      this.scene.add(this.cursor);
    }
    this.cursor.visible = point !== null;
    if (point) this.cursor.position.copy(vector(point));
    this.request();
  }

  // ---- the camera ------------------------------------------------------------------------------------------------

  /** Additional depth of the camera's view beyond its target, m. */
  get depth() {
    return 0;
  }

  /** Follow the size of the element around the canvas. */
  fit() {
    new ResizeObserver(() => this.resize()).observe(this.canvas.parentElement);
    this.resize();
  }

  lookAt(from, target) {
    this.camera.position.copy(vector(from));
    this.controls.target.copy(vector(target));
    const away = norm(sub(from, target));
    this.camera.near = Math.max(away / 500, 0.01);
    this.camera.far = 4 * away + 10 * this.radius + this.depth;
    this.camera.updateProjectionMatrix();
    this.controls.update();
    this.request();
  }

  resize() {
    const { clientWidth, clientHeight } = this.canvas.parentElement;
    if (!clientWidth || !clientHeight) return;
    this.renderer.setSize(clientWidth, clientHeight, false);
    this.camera.aspect = clientWidth / clientHeight;
    this.camera.updateProjectionMatrix();
    this.request();
  }

  request() {
    if (this.pending) return;
    this.pending = true;
    requestAnimationFrame(() => this.draw());
  }

  draw() {
    this.pending = false;
    this.frames += 1;
    this.renderer.render(this.scene, this.camera);
    const size = this.canvas.parentElement;
    this.labels.place(this.camera, size.clientWidth, size.clientHeight);
  }
}
