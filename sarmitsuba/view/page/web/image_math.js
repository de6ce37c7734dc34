// Arithmetic on images [row][column]: sums of layers, decibels, differences, values at the pixels of another grid, scales.

/**
 * Coherent sum of layers.
 * @param {{re: Float32Array, im: Float32Array}[]} layers
 * @param {number} n pixels, for a sum of none
 */
export function sumOf(layers, n) {
  const re = new Float32Array(n);
  const im = new Float32Array(n);
  for (const layer of layers) {
    for (let i = 0; i < n; i++) {
      re[i] += layer.re[i];
      im[i] += layer.im[i];
    }
  }
  return { re, im };
}

/**
 * Power in dB; -Infinity where it is zero.
 * @param {Float32Array | null} cellArea m^2 per column, for sigma0; null: RCS in dB of 1 m^2
 */
export function decibels({ re, im }, columns, cellArea) {
  const out = new Float32Array(re.length);
  const area = cellArea ? Float32Array.from(cellArea, (value) => 10 * Math.log10(value)) : null;
  for (let i = 0; i < out.length; i++) {
    out[i] = 10 * Math.log10(re[i] * re[i] + im[i] * im[i]) - (area ? area[i % columns] : 0);
  }
  return out;
}

/** Quantile of the finite values; 0 if there are none. */
export function quantile(values, share) {
  const some = values.filter(Number.isFinite).sort();
  return some.length ? some[Math.min(some.length - 1, Math.floor(share * some.length))] : 0;
}

/** a - b. */
export function complexDifference(a, b) {
  return { re: a.re.map((value, i) => value - b.re[i]), im: a.im.map((value, i) => value - b.im[i]) };
}

/**
 * Coherence of two complex images, and their relative difference.
 * @returns {{coherence: number, error: number}} |sum a b*| / sqrt(sum |a|^2 sum |b|^2), and the power of a - b over that
 *   of a in dB; NaN where one of them is empty
 */
export function likeness(a, b) {
  let [aa, bb, re, im, difference] = [0, 0, 0, 0, 0];
  for (let i = 0; i < a.re.length; i++) {
    const [ar, ai, br, bi] = [a.re[i], a.im[i], b.re[i], b.im[i]];
    aa += ar * ar + ai * ai;
    bb += br * br + bi * bi;
    re += ar * br + ai * bi;
    im += ai * br - ar * bi;
    difference += (ar - br) ** 2 + (ai - bi) ** 2;
  }
  return { coherence: Math.hypot(re, im) / Math.sqrt(aa * bb), error: 10 * Math.log10(difference / aa) };
}

/** Grey of a dB value, 0 ... 255. */
function grey(db, black, white) {
  return 255 * Math.min(Math.max((db - black) / (white - black), 0), 1);
}

/** Paint dB values in grey, first row at the top. */
export function paintGrey(canvas, db, columns, black, white) {
  paint(canvas, db.length / columns, columns, (i) => {
    const value = db[i] > black ? grey(db[i], black, white) : 0;
    return 0xff000000 | (value << 16) | (value << 8) | value;
  });
}

/**
 * Paint dB values in grey, tinted by labels.
 * @param {object} values place of every pixel in the palette
 * @param {object} palette [r, g, b] each, or null for grey alone
 */
export function paintTinted(canvas, db, columns, black, white, values, palette) {
  paint(canvas, db.length / columns, columns, (i) => {
    const value = db[i] > black ? grey(db[i], black, white) : 0;
    const colour = palette[values[i]];
    const [r, g, b] = colour ? colour.map((part) => Math.round(0.55 * value + 0.45 * part)) : [value, value, value];
    return 0xff000000 | (b << 16) | (g << 8) | r;
  });
}

/**
 * Paint the ratio of two images: orange where the first is stronger, blue where the second is, white where they are
 * equal, black where both are below `black`.
 * @param {number} most dB at which the colour is full
 */
export function paintRatio(canvas, first, second, columns, black, most) {
  paint(canvas, first.length / columns, columns, (i) => {
    if (!(Math.max(first[i], second[i]) > black)) return 0xff000000;
    const part = Math.min(Math.max((first[i] - second[i]) / most, -1), 1);
    const rest = 1 - Math.abs(part);
    // towards #e66100 and #1a6fdf, distinguishable also with colour blindness
    const [r, g, b] = part > 0 ? [230, 97, 0] : [26, 111, 223];
    const mix = (value) => Math.round(value + (245 - value) * rest);
    return 0xff000000 | (mix(b) << 16) | (mix(g) << 8) | mix(r);
  });
}

function paint(canvas, rows, columns, colour) {
  canvas.width = columns;
  canvas.height = rows;
  const context = canvas.getContext("2d");
  const picture = context.createImageData(columns, rows);
  const pixels = new Uint32Array(picture.data.buffer);
  for (let i = 0; i < pixels.length; i++) pixels[i] = colour(i);
  context.putImageData(picture, 0, 0);
}

/** A length of 1, 2 or 5 times a power of ten, at most `length`. */
export function roundLength(length) {
  const power = 10 ** Math.floor(Math.log10(length));
  return power * [5, 2, 1].find((step) => step * power <= length * (1 + 1e-9));
}

/** Length of an axis of pixels, from edge to edge, m; 1 for a single pixel. */
export function lengthOf(axis) {
  return (Math.abs(axis.at(-1) - axis[0]) * axis.length) / Math.max(axis.length - 1, 1) || 1;
}

/** Scale at which an image fills a frame in true proportions, pixels of the frame per metre. */
export function perMetre(grid, width, height) {
  return Math.min(width / lengthOf(grid.range), height / lengthOf(grid.azimuth));
}

/** Round values on an axis of pixels, either way, with their places in CSS pixels, at least `apart` from each other. */
export function axisTicks(axis, length, apart) {
  const scale = length / lengthOf(axis);
  const turn = axis.at(-1) < axis[0] ? -1 : 1;
  const wanted = apart / scale;
  const power = 10 ** Math.floor(Math.log10(wanted));
  const step = power * [1, 2, 5, 10].find((value) => value * power >= wanted * (1 - 1e-9));
  const [low, high] = turn > 0 ? [axis[0], axis.at(-1)] : [axis.at(-1), axis[0]];
  const out = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) {
    out.push({ value: k * step || 0, step, place: turn * (k * step - axis[0]) * scale + 0.5 * (length / axis.length) });
  }
  return out;
}

/** Place of a value on a rising axis, in steps; NaN beyond its ends, where half a step more belongs to them. */
function placeOn(axis, value) {
  const last = axis.length - 1;
  if (last === 0) return Math.abs(value - axis[0]) < 1e-6 ? 0 : NaN;
  let [low, high] = [0, last];
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (axis[middle] <= value) low = middle;
    else high = middle;
  }
  const place = low + (value - axis[low]) / (axis[high] - axis[low]);
  return place < -0.5 || place > last + 0.5 ? NaN : Math.min(Math.max(place, 0), last);
}

/**
 * Values at the pixels of another grid, bilinear between the four pixels around the same place of the ground.
 * @param {Float32Array} values at the pixels of `own`, [row][column]
 * @param {object} own, other: grids as in image_view.js; the height of their planes is not compared
 * @returns {Float32Array} at the pixels of `other`; NaN where `own` does not reach
 */
export function atPixelsOf(values, own, other) {
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1];
  const apart = [0, 1].map((i) => other.center[i] + other.origin[i] - own.center[i] - own.origin[i]);
  const [up, across] = [own.along, own.across].map((axis) => ({
    start: dot(apart, axis),
    row: dot(other.along, axis),
    column: dot(other.across, axis),
  }));
  const out = new Float32Array(other.nx * other.ny);
  for (let i = 0; i < other.ny; i++) {
    for (let j = 0; j < other.nx; j++) {
      const [y, x] = [other.rows[i], other.columns[j]];
      const row = placeOn(own.rows, up.start + y * up.row + x * up.column);
      const column = placeOn(own.columns, across.start + y * across.row + x * across.column);
      const [r, c] = [Math.min(Math.floor(row), own.ny - 2), Math.min(Math.floor(column), own.nx - 2)].map((k) => Math.max(k, 0));
      const [v, u] = [row - r, column - c];
      const at = (a, b) => values[Math.min(r + a, own.ny - 1) * own.nx + Math.min(c + b, own.nx - 1)];
      out[i * other.nx + j] = (1 - v) * ((1 - u) * at(0, 0) + u * at(0, 1)) + v * ((1 - u) * at(1, 0) + u * at(1, 1));
    }
  }
  return out;
}
