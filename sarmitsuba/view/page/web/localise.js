// Geolocation by range and Doppler on the image plane, and its inverse.
// Positions are in metres from the page's origin, axes east, north, up; plain arrays of three numbers, float64.

export const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const scaled = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const norm = (a) => Math.hypot(a[0], a[1], a[2]);
export const unit = (a) => scaled(a, 1 / norm(a));
export const row = (array, i) => [array[3 * i], array[3 * i + 1], array[3 * i + 2]];

/** Distance to a point (m) and its rate (m/s) from an antenna at `position` with `velocity`. */
export function rangeAndRate(position, velocity, point) {
  const way = sub(position, point);
  const range = norm(way);
  return { range, rate: dot(way, velocity) / range };
}

/**
 * Point of the plane z = height with this range and rate, on the side of `across`; null: no such point.
 * |P - X| = R and (P - X).v = rate R, as in sarmitsuba/view/page/paths.py.
 */
export function onPlane(position, velocity, range, rate, height, across) {
  const drop = position[2] - height;
  const speed = Math.hypot(velocity[0], velocity[1]);
  const ux = velocity[0] / speed;
  const uy = velocity[1] / speed;
  const along = (velocity[2] * drop - rate * range) / speed;
  let sx = across[0] - (across[0] * ux + across[1] * uy) * ux;
  let sy = across[1] - (across[0] * ux + across[1] * uy) * uy;
  const size = Math.hypot(sx, sy);
  sx /= size;
  sy /= size;
  const square = range * range - drop * drop - along * along;
  if (!(square >= 0)) return null;
  const beside = Math.sqrt(square);
  return [position[0] + along * ux + beside * sx, position[1] + along * uy + beside * sy, height];
}

/** Image positions of the echoes of `point`: direct, with one and with two ground reflections (mirror at z = ground). */
export function landings(position, velocity, point, ground, grid) {
  const mirrored = [point[0], point[1], 2 * ground - point[2]];
  const direct = rangeAndRate(position, velocity, point);
  const twice = rangeAndRate(position, velocity, mirrored);
  const places = [
    [direct.range, direct.rate],
    [0.5 * (direct.range + twice.range), 0.5 * (direct.rate + twice.rate)],
    [twice.range, twice.rate],
  ];
  return places.map(([range, rate], i) => ({
    order: i + 1,
    range,
    rate,
    point: onPlane(position, velocity, range, rate, grid.height, grid.across),
  }));
}

/** Row and column (fractions) of a point of the image's plane. */
export function pixelOf(grid, point) {
  const away = sub(point, grid.origin);
  const azimuth = dot(away, grid.along);
  let across = dot(away, grid.across);
  if (grid.kind === "slant") across = Math.hypot(across, grid.origin[2] - grid.height);
  return [(azimuth - grid.azimuth[0]) / grid.azimuth[1], (across - grid.range[0]) / grid.range[1]];
}

/** Point of the image's plane at a row and a column (fractions). */
export function pointOf(grid, at) {
  const azimuth = grid.azimuth[0] + at[0] * grid.azimuth[1];
  let across = grid.range[0] + at[1] * grid.range[1];
  if (grid.kind === "slant") {
    across = Math.sqrt(Math.max(0, across ** 2 - (grid.origin[2] - grid.height) ** 2));
  }
  const flat = add(add([grid.origin[0], grid.origin[1], 0], scaled(grid.along, azimuth)), scaled(grid.across, across));
  return [flat[0], flat[1], grid.height];
}

/**
 * Corners of the level rectangle that holds the image and the footprints of the beam along the whole pass.
 * @param {object} look with radar and grid
 * @param {number} margin m on every side
 * @param {number} count footprints along the pass, both ends included
 */
export function passGround({ radar, grid }, margin, count = 9) {
  const last = [grid.shape[0] - 1, grid.shape[1] - 1];
  const points = [[0, 0], [last[0], 0], [0, last[1]], last].map((at) => pointOf(grid, at));
  const drawn = radar ? count : 0;
  for (let k = 0; k < drawn; k++) {
    const pulse = Math.round((k / (count - 1)) * Math.max(radar.time.length - 1, 0));
    const antenna = row(radar.position, pulse);
    const axes = [radar.boresight, radar.azimuth_axis, radar.elevation_axis].map((axis) => row(axis, pulse));
    points.push(...footprint(antenna, axes, radar.beam_widths, grid.height, 3 * norm(antenna)).filter((p) => Math.abs(p[2] - grid.height) < 1e-3 * norm(antenna)));
  }
  const spans = [grid.along, grid.across].map((axis) => {
    const places = points.map((point) => dot(point, axis));
    return [places.reduce((a, b) => Math.min(a, b)) - margin, places.reduce((a, b) => Math.max(a, b)) + margin];
  });
  const corner = (a, c) => {
    const flat = add(scaled(grid.along, spans[0][a]), scaled(grid.across, spans[1][c]));
    return [flat[0], flat[1], grid.height];
  };
  return [corner(0, 0), corner(0, 1), corner(1, 1), corner(1, 0)];
}

/**
 * Footprint of a beam on the plane z = height: `count` points of its half-power outline, from the antenna's axes.
 * A ray that misses the plane ends at `most` metres.
 */
export function footprint(position, axes, widths, height, most, count = 64) {
  const [boresight, azimuth, elevation] = axes;
  const wide = widths.map((width) => Math.tan(Math.min(0.5 * width, 1.3)));
  const outline = [];
  for (let i = 0; i < count; i++) {
    const angle = (2 * Math.PI * i) / count;
    const ray = unit(
      add(add(boresight, scaled(azimuth, wide[0] * Math.cos(angle))), scaled(elevation, wide[1] * Math.sin(angle))),
    );
    let length = ray[2] < 0 ? (height - position[2]) / ray[2] : Infinity;
    if (!(length < most)) length = most;
    outline.push(add(position, scaled(ray, length)));
  }
  return outline;
}
