// Labels at points of the scene, as elements over its canvas.

import { Vector3 } from "three";

export class Labels {
  constructor(element) {
    this.element = element;
    this.entries = new Map();
  }

  put(key, text, point, className = "") {
    let entry = this.entries.get(key);
    if (!entry) {
      entry = { node: document.createElement("span") };
      this.element.append(entry.node);
      this.entries.set(key, entry);
    }
    entry.point = new Vector3(...point);
    entry.node.textContent = text;
    entry.node.className = `label ${className}`;
  }

  drop(prefix) {
    for (const [key, entry] of this.entries) {
      if (key.startsWith(prefix)) {
        entry.node.remove();
        this.entries.delete(key);
      }
    }
  }

  place(camera, width, height) {
    for (const { node, point } of this.entries.values()) {
      const seen = point.clone().project(camera);
      const hidden = seen.z > 1 || Math.abs(seen.x) > 1.02 || Math.abs(seen.y) > 1.02;
      node.style.visibility = hidden ? "hidden" : "visible";
      node.style.left = `${0.5 * (seen.x + 1) * width}px`;
      node.style.top = `${0.5 * (1 - seen.y) * height}px`;
    }
  }
}
