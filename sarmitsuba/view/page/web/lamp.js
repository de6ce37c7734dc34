// Shadow map of the lamp at the radar: its extent, and the bias without which lit faces would shade themselves.

/** Texels along an edge of the shadow map. */
export const MAP_SIZE = 4096;
// distance of the lamp and half the edge of its map, in radii of the scene
const AWAY = 4;
const HALF = 1.5;
// texels from the centre of a sample to the furthest one that it is averaged with
const TAPS = 1.5;
// angle of incidence up to which lit faces have no shadow of their own, deg: beyond, they are dark anyway
const STEEPEST_DEG = 80;

/**
 * Orthographic camera of a shadow map about a scene's middle, for faces of any orientation and either side.
 * @param {number} radius of the scene, m
 * @returns {{away: number, half: number, near: number, far: number, bias: number}} distance of the lamp and half the
 *   map's edge, near and far planes, m; bias in depths of the map (negative: nearer to the lamp)
 */
export function shadowCamera(radius) {
  const away = AWAY * radius;
  const half = HALF * radius;
  const [near, far] = [0.05 * away, 2 * away];
  const texel = (2 * half) / MAP_SIZE;
  // a sample is so much deeper than the texel it is compared with; both axes of the map can be off
  const deepest = Math.SQRT2 * TAPS * texel * Math.tan((STEEPEST_DEG * Math.PI) / 180);
  return { away, half, near, far, bias: -deepest / (far - near) };
}
