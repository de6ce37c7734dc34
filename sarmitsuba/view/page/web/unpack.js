// Reads the page's data: JSON with references to gzipped arrays in separate elements.

const TYPES = {
  uint8: Uint8Array, int8: Int8Array, bool: Uint8Array, uint16: Uint16Array, int16: Int16Array, uint32: Uint32Array,
  int32: Int32Array, float32: Float32Array, float64: Float64Array, float16: Uint16Array,
};

function bytesOf(text) {
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
  const binary = atob(text);
  const bytes = new Uint8Array(binary.length);
  for (let i = 0; i < binary.length; i++) bytes[i] = binary.charCodeAt(i);
  return bytes;
}

async function gunzip(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

let halves = null;

/** Values of half-precision floats, from a table of all of them. */
function fromHalf(bits) {
  if (halves === null) {
    halves = new Float32Array(65536);
    for (let i = 0; i < 65536; i++) {
      const sign = i & 0x8000 ? -1 : 1;
      const exponent = (i >> 10) & 31;
      const mantissa = i & 1023;
      if (exponent === 31) halves[i] = mantissa ? NaN : sign * Infinity;
      else halves[i] = sign * (exponent ? (1 + mantissa / 1024) * 2 ** (exponent - 15) : (mantissa / 1024) * 2 ** -14);
    }
  }
  const values = new Float32Array(bits.length);
  for (let i = 0; i < bits.length; i++) values[i] = halves[bits[i]];
  return values;
}

/** Bytes in their original order, from bytes sorted by rank within a number. */
function fromPlanes(planes, size) {
  if (size === 1) return planes;
  const n = planes.length / size;
  const bytes = new Uint8Array(planes.length);
  for (let rank = 0; rank < size; rank++) {
    const start = rank * n;
    for (let i = 0, at = rank; i < n; i++, at += size) bytes[at] = planes[start + i];
  }
  return bytes;
}

async function arrayOf(reference) {
  const element = document.getElementById(`blob${reference.$}`);
  const bytes = await gunzip(bytesOf(element.textContent));
  element.remove(); // the text is no longer needed
  const Type = TYPES[reference.dtype];
  const plain = fromPlanes(bytes, Type.BYTES_PER_ELEMENT);
  const values = new Type(plain.buffer, 0, plain.length / Type.BYTES_PER_ELEMENT);
  return reference.dtype === "float16" ? fromHalf(values) : values;
}

async function filled(value) {
  if (Array.isArray(value)) return Promise.all(value.map(filled));
  if (value === null || typeof value !== "object") return value;
  if ("$" in value) return arrayOf(value);
  const entries = await Promise.all(Object.entries(value).map(async ([key, entry]) => [key, await filled(entry)]));
  return Object.fromEntries(entries);
}

/** Data of the page; arrays are typed arrays, row by row. */
export async function readPayload() {
  return filled(JSON.parse(document.getElementById("payload").textContent));
}
