// Settings of the aperture (pulses, windows, track error), and sines of pixels along the flight.

import { windowOf } from "sarmitsuba/windows.js";

/** Settings with which the page's own image was focused. */
export function plainSettings(data) {
  return {
    rangeWindow: data.windows?.range ?? "rectangular",
    azimuthWindow: data.windows?.azimuth ?? "rectangular",
    keepEvery: 1, // 2: every second pulse is dropped
    from: 0, // used part of the aperture, 0 ... 1
    to: 1,
    error: { kind: "none", amplitude: 0, cycles: 3 },
  };
}

/** Kinds of track errors and their effects. */
export const TRACK_ERRORS = {
  none: "the track is known exactly",
  linear: "the error grows linearly along the aperture: the image is displaced in azimuth",
  quadratic: "the error is quadratic: points are smeared in azimuth, the image is out of focus",
  sinusoidal: "the error oscillates: paired echoes appear beside every point in azimuth",
};

/**
 * Weights of the pulses, and the track error assumed by the focuser.
 * @param {object} data see backprojector.js
 * @param {object} settings see plainSettings, which has the defaults
 * @returns weights Float32Array(nPulses), 0 for pulses not used; trackError Float64Array(nPulses), m by which the
 *   antenna is believed to be too far from the scene's centre; band: null or {half, shift, step, window}
 */
export function aperturePlan(data, settings) {
  const s = { ...plainSettings(data), ...settings };
  const kept = [];
  for (let t = 0; t < data.nPulses; t += s.keepEvery) kept.push(t);
  const weights = new Float32Array(data.nPulses);
  const window = windowOf(data, s.azimuthWindow);
  const trackError = makeTrackError(data.nPulses, s.error);
  if (data.band) {
    for (const t of kept) weights[t] = data.weights[t];
    const { half } = data.band;
    // a pixel ahead of the antenna has a positive sine: early pulses come first
    const band = { half: half * (s.to - s.from), shift: half * (1 - s.from - s.to), step: s.keepEvery, window };
    return { weights, trackError, band };
  }
  const used = kept.slice(Math.round(s.from * kept.length), Math.max(Math.round(s.to * kept.length), 1));
  used.forEach((t, i) => {
    weights[t] = data.weights[t] * window((i + 0.5) / used.length - 0.5);
  });
  return { weights, trackError, band: null };
}

/** Error of every pulse, m; amplitude: at the aperture's ends (linear, quadratic), or of the oscillation. */
export function makeTrackError(nPulses, { kind, amplitude, cycles = 3 }) {
  const out = new Float64Array(nPulses);
  for (let t = 0; t < nPulses; t++) {
    const u = nPulses > 1 ? (2 * t) / (nPulses - 1) - 1 : 0;
    if (kind === "linear") out[t] = amplitude * u;
    else if (kind === "quadratic") out[t] = amplitude * u * u;
    else if (kind === "sinusoidal") out[t] = amplitude * Math.sin(Math.PI * cycles * u);
    else if (kind !== "none") throw new Error(`track error ${kind}: unknown`);
  }
  return out;
}

const SINC_HALF_POWER = 0.442946470689452; // sinc(pi u) = 1/sqrt(2)

/** Gain of a measured cut, linear between nodes uniform in the sine; constant beyond its ends. */
function lookedUp(sine, ends, gain) {
  const last = gain.length - 1;
  const place = Math.min(Math.max(((sine - ends[0]) / (ends[1] - ends[0])) * last, 0), last);
  const low = Math.min(Math.floor(place), last - 1);
  return gain[low] + (place - low) * (gain[low + 1] - gain[low]);
}

/** Gain on a grid of both sines, azimuth first, bilinear between nodes; constant beyond the ends. */
function lookedUpInPlane(azimuth, elevation, beam) {
  const n = Math.round(Math.sqrt(beam.gain.length));
  const place = (sine, ends) => {
    const x = Math.min(Math.max(((sine - ends[0]) / (ends[1] - ends[0])) * (n - 1), 0), n - 1);
    const low = Math.min(Math.floor(x), n - 2);
    return [low, x - low];
  };
  const [i, u] = place(azimuth, beam.azimuthSine);
  const [j, v] = place(elevation, beam.elevationSine);
  const row = (k) => (1 - v) * beam.gain[k * n + j] + v * beam.gain[k * n + j + 1];
  return (1 - u) * row(i) + u * row(i + 1);
}

/** Relative two-way amplitude of the antenna towards a unit vector; zero behind the aperture. */
export function beamGain(beam, t, x, y, z) {
  const i = 3 * t;
  const dot = (axis) => x * axis[i] + y * axis[i + 1] + z * axis[i + 2];
  if (dot(beam.boresight) <= 0) return 0;
  if (beam.gain) {
    return lookedUpInPlane(dot(beam.azimuthAxis), dot(beam.elevationAxis), beam);
  }
  if (beam.azimuthGain) {
    return (
      lookedUp(dot(beam.azimuthAxis), beam.azimuthSine, beam.azimuthGain) *
      lookedUp(dot(beam.elevationAxis), beam.elevationSine, beam.elevationGain)
    );
  }
  const a = dot(beam.azimuthAxis) * beam.perWidth[0];
  const e = dot(beam.elevationAxis) * beam.perWidth[1];
  if (beam.pattern === "gaussian") return Math.exp(-Math.LN2 * (a * a + e * e));
  if (beam.pattern !== "rectangular") throw new Error(`antenna pattern ${beam.pattern}: neither known nor sampled`);
  const sinc = (v) => (Math.abs(v) > 1e-6 ? Math.sin(v) / v : 1);
  const u = sinc(Math.PI * SINC_HALF_POWER * a);
  const v = sinc(Math.PI * SINC_HALF_POWER * e);
  return u * u * v * v;
}

/**
 * Resolution cells and ambiguities of the used aperture at the scene's centre.
 * @returns {{pulses: number, azimuth: number, range: number, apart: number}} pulses used; noise-equivalent cells in
 *   azimuth and slant range, m; distance of the azimuth ambiguities of a point, m
 */
export function apertureFacts(data, settings) {
  const s = { ...plainSettings(data), ...settings };
  const { weights, band } = aperturePlan(data, s);
  const used = [];
  weights.forEach((weight, t) => weight > 0 && used.push(t));
  const broadening = (text) => {
    const window = windowOf(data, text);
    let [sum, squares] = [0, 0];
    const n = 1024;
    for (let i = 0; i < n; i++) {
      const w = window((i + 0.5) / n - 0.5);
      sum += w;
      squares += w * w;
    }
    return (squares * n) / sum ** 2;
  };
  const direction = (t) => [0, 1, 2].map((i) => data.antenna[3 * t + i] / data.referenceRange[t]);
  let turn = 0;
  for (let k = 1; k < used.length; k++) {
    const [a, b] = [direction(used[k - 1]), direction(used[k])];
    turn += Math.hypot(...a.map((value, i) => value - b[i]));
  }
  const step = turn / Math.max(used.length - 1, 1);
  const angle = band ? Math.min(2 * band.half, turn + step) : turn + step;
  return {
    pulses: used.length,
    azimuth: (broadening(s.azimuthWindow) * data.wavelength) / (2 * angle),
    range: (broadening(s.rangeWindow) * data.binSpacing) / data.bandFraction,
    apart: data.wavelength / (2 * step),
  };
}
