// Backprojection in the browser: every recorded pulse is added to every pixel at the pixel's range,
//
//   I(p) = sum_t w_t g_t (R/R0)^2 s_t(R) exp(+j 4 pi (R - R0) / lambda) / sum_t w_t g_t^2,   R = |p - antenna_t|
//
// with s_t already times R0^2/K exp(+j 4 pi R0 / lambda), R0 the distance to the scene's centre (quantised_profiles.py writes it).
//
// Precision. Ranges and phases are float64 once per pulse and block of pixels, here in JavaScript; the shader adds the
// change by the offset q of a pixel from the centre of its block,
//   dR = (2 u.q + q^2/R) / (1 + sqrt(1 + (2 u.q + q^2/R) / R)),
// whose float32 rounding is below 1e-3 rad because a block is at most a few hundred wavelengths of range wide.
// Compensated float32 sums, which a shader compiler may undo, are not needed.
//
// data: {
//   wavelength m; nPulses; nBins; binSpacing m of slant range; bandFraction bandwidth / sampling rate;
//   antenna Float64Array(3 nPulses) m, from the scene's centre; referenceRange Float64Array(nPulses) m, R0;
//   firstBin Float64Array(nPulses) m, slant range of bin 0 minus R0;
//   profiles Int16Array or Float32Array [nPulses][nBins](re, im); scale Float32Array(nPulses), or null for 1;
//   weights Float32Array(nPulses);
//   beam null (isotropic) or {pattern "gaussian" | "rectangular" | "table", perWidth [2], azimuthAxis, elevationAxis,
//     boresight: Float32Array(3 nPulses); a table's azimuthSine, elevationSine Float64Array(2): of its first and last
//     node; azimuthGain, elevationGain Float32Array: the nodes};
//   windows: see windows.js;
//   band null (all pulses serve all pixels) or {half, forward Float32Array(3 nPulses), center, gap, turn Float64Array(nPulses)}
// }
// grid: { nx, ny; origin [3] m from the scene's centre; along, across [3] horizontal unit vectors at right angles;
//   rows Float64Array(ny), columns Float64Array(nx): m along and across from origin }
// pixel (row i, column j) is at origin + rows[i] along + columns[j] across; images are [ny][nx].

import { aperturePlan, beamGain, plainSettings } from "sarmitsuba/aperture.js";
import { OVERSAMPLING, RangeProfiles } from "sarmitsuba/range_profiles.js";

// bounds of a block's half width along its axes:
// wavelengths of range, 100 + 100 of which are 400 turns, of which float32 keeps 2e-5 turns = 1e-4 rad
const BLOCK_WAVES = 100;
// half beams, over which the gain is approximated as linear
const BLOCK_BEAMS = 0.1;
// relative range, over which the sine along the flight is approximated as linear: error of the square of this
const BLOCK_RANGES = 1 / 400;
const BLOCK_SIZES = [64, 32, 16, 8, 4, 2, 1];
// pulses whose profiles share a texture
const GROUP = 64;
const WINDOW_NODES = 1025;
// bin and row are packed in one exact float32: longer profiles are processed on the CPU
const BIN_OFFSET = 8192;
// weight of a pixel relative to the largest weight, below which it is dark
const DARK = 1e-6;

const VERTEX = `#version 300 es
void main() {
  gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0);
}`;

const fragment = (weighted) => `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
uniform sampler2D sums, table, profiles, offsets, bandWindow;
uniform ivec2 blockShift;
uniform int nPulses, blocksHigh, last;
uniform float turnsPerMetre, binsPerMetre, halfBand;
out vec4 result;

const int TEXELS = ${weighted ? 4 : 2};

// cosine and sine of |y| <= 1/2 turns from their halves: least squares over the half turn, error below 2e-6; the
// language guarantees only 5e-4
vec2 phasor(float y) {
  float z = y * y;
  float s = y * (3.14158197 + z * (-5.16714121 + z * (2.54188617 - z * 0.55460646)));
  float c = 0.99999995 + z * (-4.93479283 + z * (4.05841130 + z * (-1.33187624 + z * 0.21968885)));
  return vec2(1.0 - 2.0 * s * s, 2.0 * s * c);
}

void main() {
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  ivec2 block = pixel >> blockShift;
  vec2 q = vec2(texelFetch(offsets, ivec2(pixel.y, 1), 0).x, texelFetch(offsets, ivec2(pixel.x, 0), 0).x);
  float square = dot(q, q);
  vec4 sum = texelFetch(sums, pixel, 0);
  for (int k = 0; k < nPulses; ++k) {
    ivec2 at = ivec2(block.x * TEXELS, k * blocksHigh + block.y);
    vec4 a = texelFetch(table, at, 0);                // turns, part of a bin, slope along, slope across
    vec4 b = texelFetch(table, at + ivec2(1, 0), 0);  // 1/R, (R/R0)^2, row and whole bin, pulse's weight
    float change = 2.0 * dot(a.zw, q) + square * b.x;
    float dR = change / (1.0 + sqrt(1.0 + change * b.x));

    float place = a.y + dR * binsPerMetre;
    float whole = floor(place);
    int code = int(b.z);
    int bin = (code & ${2 * BIN_OFFSET - 1}) - ${BIN_OFFSET} + int(whole);
    if (bin < 0 || bin >= last) continue;
    float f = place - whole, g = 1.0 - f;
    int row = code / ${2 * BIN_OFFSET};
    float f2 = f * f, g2 = g * g;
    vec4 low = texelFetch(profiles, ivec2(bin, row), 0);  // two samples each
    vec4 high = texelFetch(profiles, ivec2(bin + 2, row), 0);
    vec2 value = (g2 * g) * low.xy + (4.0 - 3.0 * f2 * (2.0 - f)) * low.zw
      + (4.0 - 3.0 * g2 * (2.0 - g)) * high.xy + (f2 * f) * high.zw;

    float stretch = 1.0 + dR * b.x;
    float amplitude = b.w * b.y * stretch * stretch;
    float power = b.w;
    ${
      weighted
        ? `vec4 c = texelFetch(table, at + ivec2(2, 0), 0);  // sine, its slopes, 1 / step
    vec4 d = texelFetch(table, at + ivec2(3, 0), 0);  // gain, its slopes
    float offset = c.x + dot(c.yz, q);
    float w = clamp((halfBand - abs(offset)) * c.w + 0.5, 0.0, 1.0);
    float node = clamp(0.5 + 0.5 * offset / halfBand, 0.0, 1.0) * float(${WINDOW_NODES} - 1);
    int n0 = min(int(node), ${WINDOW_NODES} - 2);
    w *= mix(texelFetch(bandWindow, ivec2(n0, 0), 0).x, texelFetch(bandWindow, ivec2(n0 + 1, 0), 0).x, node - float(n0));
    float gain = max(d.x + dot(d.yz, q), 0.0);
    amplitude *= w * gain;
    power *= w * gain * gain;`
        : ""
    }
    float turns = a.x + dR * turnsPerMetre;
    vec2 turn = amplitude * (1.0 / 6.0) * phasor(turns - floor(turns + 0.5));
    sum.xyz += vec3(value.x * turn.x - value.y * turn.y, value.x * turn.y + value.y * turn.x, power);
  }
  result = sum;
}`;

/** Blocks of a grid: centres, and the offset of every pixel from its block's centre. */
class Blocks {
  constructor(data, grid) {
    this.rows = Blocks.along(data, grid.along, grid.rows);
    this.columns = Blocks.along(data, grid.across, grid.columns);
    this.high = this.rows.middle.length;
    this.wide = this.columns.middle.length;
  }

  static along(data, axis, places) {
    const range = data.referenceRange.reduce((a, b) => Math.min(a, b));
    let slope = Math.abs(places.at(-1) - places[0]) / range;
    for (let t = 0; t < data.nPulses; t++) {
      const along = axis.reduce((sum, value, i) => sum + value * data.antenna[3 * t + i], 0);
      slope = Math.max(slope, Math.abs(along) / data.referenceRange[t]);
    }
    const most = Math.min(
      (BLOCK_WAVES * data.wavelength) / slope,
      data.beam ? (BLOCK_BEAMS * range) / Math.max(...data.beam.perWidth) : Infinity,
      data.band ? BLOCK_RANGES * range : Infinity,
    );
    const step = places.length > 1 ? Math.abs(places[1] - places[0]) : 0;
    const size = BLOCK_SIZES.find((pixels) => 0.5 * pixels * step <= most) ?? 1;
    const middle = new Float64Array(Math.ceil(places.length / size));
    const offset = new Float32Array(places.length);
    middle.forEach((_, b) => {
      const first = b * size;
      const last = Math.min(first + size, places.length) - 1;
      middle[b] = 0.5 * (places[first] + places[last]);
      for (let i = first; i <= last; i++) offset[i] = places[i] - middle[b];
    });
    return { middle, offset, shift: Math.log2(size) };
  }
}

/** Assumed antenna position of a pulse: with the track error along the line from the scene's centre. */
function believedAntenna(data, t, error) {
  const stretch = 1 + error / data.referenceRange[t];
  return [0, 1, 2].map((axis) => data.antenna[3 * t + axis] * stretch);
}

/** Sums over pulses on the GPU: WebGL2 with float textures. */
class GpuSums {
  constructor(gl, data, grid, own) {
    this.gl = gl;
    this.own = own;
    this.data = data;
    this.grid = grid;
    this.blocks = new Blocks(data, grid);
    this.weighted = Boolean(data.beam || data.band);
    this.texels = this.weighted ? 4 : 2;
    const { high, wide, rows, columns } = this.blocks;
    this.perDraw = Math.max(1, Math.min(GROUP, Math.floor(gl.getParameter(gl.MAX_TEXTURE_SIZE) / high)));
    this.table = new Float32Array(4 * this.texels * wide * high * this.perDraw);
    this.program = this.build(fragment(this.weighted));
    this.at = (name) => gl.getUniformLocation(this.program, name);
    this.vertices = gl.createVertexArray();
    this.tableTexture = this.texture(gl.RGBA32F, wide * this.texels, high * this.perDraw);
    const length = Math.max(grid.nx, grid.ny);
    const offsets = new Float32Array(2 * length);
    offsets.set(columns.offset, 0);
    offsets.set(rows.offset, length);
    this.offsets = this.texture(gl.R32F, length, 2, gl.RED, offsets);
    this.window = this.texture(gl.R32F, WINDOW_NODES, 1, gl.RED, new Float32Array(WINDOW_NODES).fill(1));
    this.sums = [0, 1].map(() => this.texture(gl.RGBA32F, grid.nx, grid.ny));
    this.targets = this.sums.map((texture) => {
      const target = gl.createFramebuffer();
      gl.bindFramebuffer(gl.FRAMEBUFFER, target);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
      return target;
    });
    if (gl.checkFramebufferStatus(gl.FRAMEBUFFER) !== gl.FRAMEBUFFER_COMPLETE) throw new Error("no float frame buffer");
    this.pixelBuffer = gl.createBuffer();
    this.groups = [];
  }

  /** Whether a context and its limits fit the data. */
  static fits(gl, data, grid) {
    const most = gl.getParameter(gl.MAX_TEXTURE_SIZE);
    const nStored = (data.nBins - 1) * OVERSAMPLING + 4;
    const { high, wide } = new Blocks(data, grid);
    return nStored <= Math.min(most, BIN_OFFSET) && Math.max(grid.nx, grid.ny, 4 * wide, high) <= most;
  }

  build(source) {
    const { gl } = this;
    const program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, source]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
      gl.deleteShader(shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) {
      const logs = gl.getAttachedShaders(program).map((shader) => gl.getShaderInfoLog(shader));
      throw new Error(`backprojector: the shader does not build: ${logs.join(" ")}${gl.getProgramInfoLog(program)}`);
    }
    return program;
  }

  texture(kind, width, height, format, values) {
    const { gl } = this;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, kind, width, height);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
    if (values) gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, width, height, format, gl.FLOAT, values);
    return texture;
  }

  /** Empty sums; profiles are recomputed if their window changed. */
  reset(profiles, band) {
    const { gl } = this;
    if (profiles !== this.profiles) {
      for (const group of this.groups) if (group) gl.deleteTexture(group);
      this.groups = [];
      this.profiles = profiles;
    }
    this.band = band;
    if (band) {
      const nodes = Float32Array.from({ length: WINDOW_NODES }, (_, i) => band.window(i / (WINDOW_NODES - 1) - 0.5));
      gl.bindTexture(gl.TEXTURE_2D, this.window);
      gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, WINDOW_NODES, 1, gl.RED, gl.FLOAT, nodes);
    }
    for (const target of this.targets) {
      gl.bindFramebuffer(gl.FRAMEBUFFER, target);
      gl.clearBufferfv(gl.COLOR, 0, [0, 0, 0, 0]);
    }
  }

  /** The texture with the profiles of a group of pulses: every sample beside the next, two look-ups for four taps. */
  group(index) {
    if (!this.groups[index]) {
      const { nStored } = this.profiles;
      const count = Math.min(GROUP, this.data.nPulses - index * GROUP);
      const line = new Float32Array(2 * nStored + 2);
      const pairs = new Float32Array(4 * nStored * count);
      for (let i = 0; i < count; i++) {
        this.profiles.fill(index * GROUP + i, line, 0);
        for (let k = 0; k < nStored; k++) pairs.set(line.subarray(2 * k, 2 * k + 4), 4 * (i * nStored + k));
      }
      this.groups[index] = this.texture(this.gl.RGBA32F, nStored, count, this.gl.RGBA, pairs);
    }
    return this.groups[index];
  }

  add(first, last, weights, trackError) {
    for (let start = first; start < last; ) {
      const index = Math.floor(start / GROUP);
      const stop = Math.min(last, (index + 1) * GROUP);
      const pulses = [];
      for (let t = start; t < stop; t++) if (weights[t] !== 0) pulses.push(t);
      for (let i = 0; i < pulses.length; i += this.perDraw) {
        this.draw(index, pulses.slice(i, i + this.perDraw), weights, trackError);
      }
      start = stop;
    }
  }

  draw(index, pulses, weights, trackError) {
    const { gl, blocks } = this;
    pulses.forEach((t, k) => this.fillTable(k, t, t - index * GROUP, weights[t], trackError[t]));
    const group = this.group(index);
    gl.bindTexture(gl.TEXTURE_2D, this.tableTexture);
    gl.texSubImage2D(
      gl.TEXTURE_2D, 0, 0, 0, blocks.wide * this.texels, blocks.high * pulses.length, gl.RGBA, gl.FLOAT, this.table,
    );
    gl.useProgram(this.program);
    gl.bindVertexArray(this.vertices);
    const inputs = { sums: this.sums[0], table: this.tableTexture, profiles: group, offsets: this.offsets };
    if (this.weighted) inputs.bandWindow = this.window;
    Object.entries(inputs).forEach(([name, texture], unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.uniform1i(this.at(name), unit);
    });
    gl.activeTexture(gl.TEXTURE0);
    gl.uniform1i(this.at("nPulses"), pulses.length);
    gl.uniform1i(this.at("blocksHigh"), blocks.high);
    gl.uniform2i(this.at("blockShift"), blocks.columns.shift, blocks.rows.shift);
    gl.uniform1i(this.at("last"), this.profiles.last);
    gl.uniform1f(this.at("turnsPerMetre"), 2 / this.data.wavelength);
    gl.uniform1f(this.at("binsPerMetre"), OVERSAMPLING / this.data.binSpacing);
    gl.uniform1f(this.at("halfBand"), this.band ? this.band.half : 1e30);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.targets[1]);
    gl.viewport(0, 0, this.grid.nx, this.grid.ny);
    gl.disable(gl.BLEND);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    this.sums.reverse();
    this.targets.reverse();
  }

  /** Parameters of one pulse for the shader, for every block; float64 until the values are small. */
  fillTable(k, t, row, weight, error) {
    const { data, grid, blocks, table, texels } = this;
    const { origin, along, across } = grid;
    const [ax, ay, az] = believedAntenna(data, t, error);
    const [bx, by, bz] = [origin[0] - ax, origin[1] - ay, origin[2] - az];
    const reference = data.referenceRange[t];
    const turnsPerMetre = 2 / data.wavelength;
    const binsPerMetre = OVERSAMPLING / data.binSpacing;
    let at = 4 * texels * blocks.wide * blocks.high * k;
    const start = at;
    for (const r of blocks.rows.middle) {
      const [rx, ry, rz] = [bx + r * along[0], by + r * along[1], bz + r * along[2]];
      for (const c of blocks.columns.middle) {
        const [x, y, z] = [rx + c * across[0], ry + c * across[1], rz + c * across[2]];
        const range = Math.sqrt(x * x + y * y + z * z);
        const turns = (range - reference) * turnsPerMetre;
        const place = (range - reference - data.firstBin[t]) * binsPerMetre;
        const whole = Math.floor(place);
        table[at] = turns - Math.round(turns);
        table[at + 1] = place - whole;
        table[at + 2] = (x * along[0] + y * along[1] + z * along[2]) / range;
        table[at + 3] = (x * across[0] + y * across[1] + z * across[2]) / range;
        table[at + 4] = 1 / range;
        table[at + 5] = (range / reference) ** 2;
        table[at + 6] = 2 * BIN_OFFSET * row + Math.min(Math.max(whole + BIN_OFFSET, 0), 2 * BIN_OFFSET - 1);
        table[at + 7] = weight;
        if (texels === 4) this.fillWeights(at + 8, t, x / range, y / range, z / range, 1 / range);
        at += 4 * texels;
      }
    }
    if (data.beam) this.fillGainSlopes(start);
  }

  /** Sine along the flight with its slopes over the block, and the antenna's gain at its middle. */
  fillWeights(at, t, x, y, z, inverse) {
    const { data, grid, table, band } = this;
    if (band) {
      const f = data.band.forward;
      const sine = x * f[3 * t] + y * f[3 * t + 1] + z * f[3 * t + 2];
      const slope = (axis, u) =>
        (axis[0] * f[3 * t] + axis[1] * f[3 * t + 1] + axis[2] * f[3 * t + 2] - sine * u) * inverse;
      table[at] = sine - data.band.center[t] - band.shift;
      table[at + 1] = slope(grid.along, table[at - 6]);
      table[at + 2] = slope(grid.across, table[at - 5]);
      const step = data.band.gap[t] * (1 - sine * sine) * inverse + data.band.turn[t];
      table[at + 3] = 1 / Math.max(Math.abs(step) * band.step, 1e-12);
    } else {
      table.fill(0, at, at + 3);
      table[at + 3] = 1;
    }
    table[at + 4] = data.beam ? beamGain(data.beam, t, x, y, z) : 1;
    table[at + 5] = 0;
    table[at + 6] = 0;
  }

  /** Slopes of the gain from the neighbouring blocks' middles. */
  fillGainSlopes(start) {
    const { blocks, table } = this;
    const slope = (i, middle, gain) => {
      const low = Math.max(i - 1, 0);
      const high = Math.min(i + 1, middle.length - 1);
      return high > low ? (gain(high) - gain(low)) / (middle[high] - middle[low]) : 0;
    };
    const at = (i, j) => start + 16 * (i * blocks.wide + j) + 12;
    for (let i = 0; i < blocks.high; i++) {
      for (let j = 0; j < blocks.wide; j++) {
        table[at(i, j) + 1] = slope(i, blocks.rows.middle, (n) => table[at(n, j)]);
        table[at(i, j) + 2] = slope(j, blocks.columns.middle, (n) => table[at(i, n)]);
      }
    }
  }

  /** (re, im, weight, 0) of every pixel, without blocking the page. */
  async read() {
    const { gl, grid } = this;
    const out = new Float32Array(4 * grid.nx * grid.ny);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.targets[0]);
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, this.pixelBuffer);
    gl.bufferData(gl.PIXEL_PACK_BUFFER, out.byteLength, gl.STREAM_READ);
    gl.readPixels(0, 0, grid.nx, grid.ny, gl.RGBA, gl.FLOAT, 0);
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, null);
    const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    for (;;) {
      const state = gl.clientWaitSync(fence, 0, 0);
      if (state === gl.ALREADY_SIGNALED || state === gl.CONDITION_SATISFIED) break;
      if (gl.isContextLost()) throw new Error("backprojector: the browser lost the GPU; reload the page");
      await new Promise((resolve) => setTimeout(resolve, 2));
    }
    gl.deleteSync(fence);
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, this.pixelBuffer);
    gl.getBufferSubData(gl.PIXEL_PACK_BUFFER, 0, out);
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, null);
    return out;
  }

  free() {
    const { gl } = this;
    for (const one of [this.tableTexture, this.offsets, this.window, ...this.sums, ...this.groups]) {
      if (one) gl.deleteTexture(one);
    }
    for (const one of this.targets) gl.deleteFramebuffer(one);
    gl.deleteBuffer(this.pixelBuffer);
    gl.deleteProgram(this.program);
    // browsers limit the number of live contexts
    if (this.own) gl.getExtension("WEBGL_lose_context")?.loseContext();
  }
}

/** The same sums on the CPU, every pixel's range in float64: slower, for browsers without float textures. */
class CpuSums {
  constructor(data, grid) {
    this.data = data;
    this.grid = grid;
    this.sums = new Float64Array(4 * grid.nx * grid.ny);
  }

  reset(profiles, band) {
    if (profiles !== this.profiles) this.line = new Float32Array(2 * profiles.nStored);
    this.profiles = profiles;
    this.band = band;
    this.sums.fill(0);
  }

  add(first, last, weights, trackError) {
    for (let t = first; t < last; t++) if (weights[t] !== 0) this.addPulse(t, weights[t], trackError[t]);
  }

  addPulse(t, weight, error) {
    const { data, grid, profiles, line, sums } = this;
    profiles.fill(t, line, 0);
    const { origin, along, across, rows, columns } = grid;
    const [ax, ay, az] = believedAntenna(data, t, error);
    const reference = data.referenceRange[t];
    const wavenumber = (4 * Math.PI) / data.wavelength;
    const binsPerMetre = OVERSAMPLING / data.binSpacing;
    let at = -4;
    for (const r of rows) {
      for (const c of columns) {
        at += 4;
        const x = origin[0] + r * along[0] + c * across[0] - ax;
        const y = origin[1] + r * along[1] + c * across[1] - ay;
        const z = origin[2] + r * along[2] + c * across[2] - az;
        const range = Math.sqrt(x * x + y * y + z * z);
        const place = (range - reference - data.firstBin[t]) * binsPerMetre;
        const bin = Math.floor(place);
        if (bin < 0 || bin >= profiles.last) continue;
        const f = place - bin;
        const g = 1 - f;
        const [t0, t1, t2, t3] = [g * g * g, 4 - 3 * f * f * (2 - f), 4 - 3 * g * g * (2 - g), f * f * f];
        const i = 2 * bin;
        const re = t0 * line[i] + t1 * line[i + 2] + t2 * line[i + 4] + t3 * line[i + 6];
        const im = t0 * line[i + 1] + t1 * line[i + 3] + t2 * line[i + 5] + t3 * line[i + 7];
        const w = weight * this.share(t, x / range, y / range, z / range, range);
        const gain = data.beam ? beamGain(data.beam, t, x / range, y / range, z / range) : 1;
        const amplitude = (w * gain * (range / reference) ** 2) / 6;
        const phase = wavenumber * (range - reference);
        const cos = amplitude * Math.cos(phase);
        const sin = amplitude * Math.sin(phase);
        sums[at] += re * cos - im * sin;
        sums[at + 1] += re * sin + im * cos;
        sums[at + 2] += w * gain * gain;
      }
    }
  }

  /** Weight of the pulse within the pixel's aperture. */
  share(t, x, y, z, range) {
    const { data, band } = this;
    if (!band) return 1;
    const f = data.band.forward;
    const sine = x * f[3 * t] + y * f[3 * t + 1] + z * f[3 * t + 2];
    const offset = sine - data.band.center[t] - band.shift;
    const each = (data.band.gap[t] * (1 - sine * sine)) / range + data.band.turn[t];
    const step = Math.max(Math.abs(each) * band.step, 1e-12);
    const inside = Math.min(Math.max((band.half - Math.abs(offset)) / step + 0.5, 0), 1);
    return inside && inside * band.window(Math.min(Math.max(offset / (2 * band.half), -0.5), 0.5));
  }

  async read() {
    return this.sums;
  }

  free() {}
}

/** Image accumulated pulse by pulse. */
class Backprojector {
  constructor(sums, data, grid, device) {
    this.sums = sums;
    this.data = data;
    this.grid = grid;
    /** "gpu" or "cpu" */
    this.device = device;
    this.reset();
  }

  /**
   * Empty the image, and take other settings.
   * @param {object} settings see plainSettings in aperture.js; what is left out is as there
   */
  reset(settings = {}) {
    const text = settings.rangeWindow ?? plainSettings(this.data).rangeWindow;
    if (text !== this.rangeWindow) {
      this.profiles = new RangeProfiles(this.data, text);
      this.rangeWindow = text;
    }
    this.plan = aperturePlan(this.data, settings);
    this.sums.reset(this.profiles, this.plan.band);
  }

  /**
   * Add pulses first ... last - 1.
   * @param {Float32Array | null} weights of all pulses; null: those of the settings
   * @param {Float64Array | null} trackError m of all pulses; null: that of the settings
   */
  add(first, last, weights = null, trackError = null) {
    this.sums.add(first, last, weights ?? this.plan.weights, trackError ?? this.plan.trackError);
  }

  /** Add all pulses. */
  addAll() {
    this.add(0, this.data.nPulses);
  }

  /**
   * The image so far: |I|^2 is the RCS in m^2 at a point's peak, as if the pulses so far were all.
   * @returns {Promise<{re: Float32Array, im: Float32Array}>} [ny][nx]
   */
  async read() {
    const sums = await this.sums.read();
    const n = this.grid.nx * this.grid.ny;
    const re = new Float32Array(n);
    const im = new Float32Array(n);
    let most = 0;
    for (let i = 0; i < n; i++) most = Math.max(most, sums[4 * i + 2]);
    for (let i = 0; i < n; i++) {
      const factor = sums[4 * i + 2] > DARK * most ? 1 / sums[4 * i + 2] : 0;
      re[i] = factor * sums[4 * i];
      im[i] = factor * sums[4 * i + 1];
    }
    return { re, im };
  }

  /** Present image in dB of 1 m^2, Float32Array [ny][nx]; -Infinity where the power is zero. */
  async magnitudeDb() {
    const { re, im } = await this.read();
    return re.map((value, i) => 10 * Math.log10(value * value + im[i] * im[i]));
  }

  /** Release the GPU memory. */
  free() {
    this.sums.free();
  }
}

/** WebGL2 context with additive float blending, or null. */
function floatContext(canvas) {
  const gl = (canvas ?? new OffscreenCanvas(1, 1)).getContext("webgl2", { antialias: false, depth: false });
  return gl?.getExtension("EXT_color_buffer_float") ? gl : null;
}

/**
 * @param {HTMLCanvasElement | OffscreenCanvas | null} canvas of the WebGL2 context; null: a new one
 * @param {object} data see the head of this file
 * @param {object} grid see the head of this file
 * @param {"auto" | "gpu" | "cpu"} device auto: the GPU where it can, else the CPU
 */
export async function createBackprojector(canvas, data, grid, device = "auto") {
  const gl = device === "cpu" ? null : floatContext(canvas);
  if (gl && GpuSums.fits(gl, data, grid)) {
    return new Backprojector(new GpuSums(gl, data, grid, canvas === null), data, grid, "gpu");
  }
  if (device === "gpu") throw new Error("backprojector: this browser has no WebGL2 with float textures that fit");
  return new Backprojector(new CpuSums(data, grid), data, grid, "cpu");
}
