// Radar image as a textured sheet in the scene.

import * as THREE from "three";

/** A canvas with the image, first row at its top, as a texture. */
export function imageTexture(canvas) {
  const texture = new THREE.CanvasTexture(canvas);
  texture.colorSpace = THREE.SRGBColorSpace;
  texture.flipY = false;
  texture.generateMipmaps = false;
  texture.minFilter = THREE.LinearFilter;
  return texture;
}

/**
 * A sheet with the image on it.
 * @param {object} grid of the look
 * @param {function} toPlane (grid, [row, column]) => point
 */
export function imageMesh(grid, texture, toPlane) {
  const [rows, columns] = grid.shape;
  const steps = Math.min(columns - 1, 256) || 1;
  const positions = [];
  const uv = [];
  const index = [];
  for (let j = 0; j <= steps; j++) {
    const column = -0.5 + (j / steps) * columns;
    for (const end of [0, 1]) {
      positions.push(...toPlane(grid, [-0.5 + end * rows, column]));
      uv.push(j / steps, end);
    }
    if (j > 0) index.push(2 * j - 2, 2 * j, 2 * j - 1, 2 * j - 1, 2 * j, 2 * j + 1);
  }
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(positions, 3));
  geometry.setAttribute("uv", new THREE.Float32BufferAttribute(uv, 2));
  geometry.setIndex(index);
  return new THREE.Mesh(geometry, new THREE.MeshBasicMaterial({
    map: texture, side: THREE.DoubleSide, polygonOffset: true, polygonOffsetFactor: -2, polygonOffsetUnits: -8,
    transparent: true, opacity: 0.93,
  }));
}
