// Range-compressed pulses prepared for interpolation: window over the band, twofold upsampling, and the transform
// of the interpolation's cubic B-spline divided out. The same weights as sarmitsuba/signal/focusing/profiles.py.
//
// Error of the four-tap B-spline at twofold upsampling of data sampled at 1.2 times the band: its strongest image is
// (f / (1 - f))^4 at the band's edge f = 1/4.8, -46 dB, lower within the band and different in every pulse; images agree
// with exact interpolation to -55 dB (benchmarks/suite/browser.py).

import { windowOf } from "sarmitsuba/windows.js";

export const OVERSAMPLING = 2;
// the B-spline's taps reach one sample back and two on
export const LEAD = 1;
// samples of zeros between a profile's end and its periodic repetition
const GUARD = 64;

/** In-place radix-2 transforms of one length. */
class Fourier {
  constructor(n) {
    this.n = n;
    this.cos = new Float64Array(n / 2);
    this.sin = new Float64Array(n / 2);
    for (let i = 0; i < n / 2; i++) {
      this.cos[i] = Math.cos((2 * Math.PI * i) / n);
      this.sin[i] = Math.sin((2 * Math.PI * i) / n);
    }
    this.order = new Uint32Array(n);
    for (let i = 1; i < n; i++) this.order[i] = (this.order[i >> 1] >> 1) | (i & 1 ? n >> 1 : 0);
  }

  /** sum_k x_k exp(sign 2 pi j k m / n) in place; not scaled. */
  run(re, im, sign) {
    const { n, cos, sin, order } = this;
    for (let i = 0; i < n; i++) {
      const j = order[i];
      if (j > i) {
        [re[i], re[j]] = [re[j], re[i]];
        [im[i], im[j]] = [im[j], im[i]];
      }
    }
    for (let half = 1; half < n; half <<= 1) {
      const stride = n / (2 * half);
      for (let start = 0; start < n; start += 2 * half) {
        for (let k = 0; k < half; k++) {
          const c = cos[k * stride];
          const s = sign * sin[k * stride];
          const a = start + k;
          const b = a + half;
          const xr = re[b] * c - im[b] * s;
          const xi = re[b] * s + im[b] * c;
          re[b] = re[a] - xr;
          im[b] = im[a] - xi;
          re[a] += xr;
          im[a] += xi;
        }
      }
    }
  }
}

function sinc(x) {
  return x === 0 ? 1 : Math.sin(Math.PI * x) / (Math.PI * x);
}

/** Conversion of the recorded bins of a pulse to samples for interpolation. */
export class RangeProfiles {
  /**
   * @param {object} data see backprojector.js
   * @param {string} window over the band, one of the data's
   */
  constructor(data, window) {
    this.data = data;
    const n = 2 ** Math.ceil(Math.log2(data.nBins + GUARD));
    this.forward = new Fourier(n);
    this.inverse = new Fourier(n * OVERSAMPLING);
    /** Samples of one pulse; entry LEAD is the first recorded bin. */
    this.nStored = (data.nBins - 1) * OVERSAMPLING + 4;
    /** Largest valid position, in samples from the first bin; the smallest is 0. */
    this.last = (data.nBins - 1) * OVERSAMPLING;
    this.re = new Float64Array(n * OVERSAMPLING);
    this.im = new Float64Array(n * OVERSAMPLING);
    this.gains = this.makeGains(n, windowOf(data, window));
  }

  /** Weight of every frequency, in the transform's order. */
  makeGains(n, window) {
    const { data } = this;
    const half = 0.5 * data.bandFraction * n;
    const weight = new Float64Array(n);
    let sum = 0;
    for (let k = 0; k < n; k++) {
      const bin = k < n / 2 ? k : k - n;
      // a bin that the band's edge cuts counts by the part inside
      const inside = 2 * half >= n ? 1 : Math.min(Math.max(half - Math.abs(bin) + 0.5, 0), 1);
      weight[k] = inside ? inside * window(Math.min(Math.max(bin / (2 * half), -0.5), 0.5)) : 0;
      sum += weight[k];
    }
    // the record's finite length blurs the band's edge: scaled so that a point amid the record keeps its peak
    const re = this.re.subarray(0, n).fill(0);
    const im = this.im.subarray(0, n).fill(0);
    const middle = data.nBins >> 1;
    for (let i = 0; i < data.nBins; i++) re[(i - middle + n) % n] = sinc((i - middle) * data.bandFraction);
    this.forward.run(re, im, -1);
    let peak = 0;
    for (let k = 0; k < n; k++) peak += re[k] * weight[k];
    const gains = new Float64Array(n);
    for (let k = 0; k < n; k++) {
      const cycles = (k < n / 2 ? k : k - n) / (n * OVERSAMPLING);
      gains[k] = weight[k] ? weight[k] / (peak * sinc(cycles) ** 4) : 0;
    }
    return gains;
  }

  /**
   * Interpolable samples of one pulse.
   * @param {number} pulse
   * @param {Float32Array} out (re, im) interleaved, nStored of them from `start`
   * @param {number} start in complex samples
   */
  fill(pulse, out, start) {
    const { data, re, im, gains } = this;
    const n = this.forward.n;
    const nUp = this.inverse.n;
    const scale = data.scale ? data.scale[pulse] : 1;
    re.fill(0);
    im.fill(0);
    const from = 2 * pulse * data.nBins;
    for (let i = 0; i < data.nBins; i++) {
      re[i] = scale * data.profiles[from + 2 * i];
      im[i] = scale * data.profiles[from + 2 * i + 1];
    }
    this.forward.run(re.subarray(0, n), im.subarray(0, n), -1);
    for (let k = 0; k < n / 2; k++) {
      re[k] *= gains[k];
      im[k] *= gains[k];
    }
    // negative frequencies move to the end of the longer spectrum
    for (let k = n / 2; k < n; k++) {
      const to = k + nUp - n;
      re[to] = re[k] * gains[k];
      im[to] = im[k] * gains[k];
    }
    re.fill(0, n / 2, nUp - n / 2);
    im.fill(0, n / 2, nUp - n / 2);
    this.inverse.run(re, im, 1);
    for (let i = 0; i < this.nStored; i++) {
      const k = (i - LEAD + nUp) % nUp;
      out[2 * (start + i)] = re[k];
      out[2 * (start + i) + 1] = im[k];
    }
  }
}
