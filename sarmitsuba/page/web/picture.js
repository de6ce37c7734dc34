// The focused image as a grey picture: dB from the complex layers that are switched on, painted on a canvas.

/** Complex sum of some layers, interleaved (re, im) Float32Array, RCS amplitude in m. */
export function sumOf(image, orders) {
  const n = image.layers[0].re.length;
  const sum = new Float32Array(2 * n);
  for (const layer of image.layers) {
    if (!orders.has(layer.order)) continue;
    for (let i = 0; i < n; i++) {
      sum[2 * i] += layer.re[i];
      sum[2 * i + 1] += layer.im[i];
    }
  }
  for (let i = 0; i < 2 * n; i++) sum[i] /= image.scale;
  return sum;
}

/** sigma0 in dB, [azimuth][range]. */
export function sigmaDb(sum, cellArea, columns) {
  const db = new Float32Array(sum.length / 2);
  for (let i = 0; i < db.length; i++) {
    db[i] = 10 * Math.log10((sum[2 * i] ** 2 + sum[2 * i + 1] ** 2) / cellArea[i % columns] + 1e-30);
  }
  return db;
}

/** Value below which a share of the finite values lies. */
export function quantile(values, share) {
  const some = [];
  const step = Math.max(1, Math.floor(values.length / 20000));
  for (let i = 0; i < values.length; i += step) if (values[i] > -250) some.push(values[i]);
  some.sort((a, b) => a - b);
  return some.length ? some[Math.min(some.length - 1, Math.floor(share * some.length))] : 0;
}

/** Paint dB values on a canvas of [rows][columns] pixels, first row at the top. */
export function paint(canvas, db, shape, black, white) {
  canvas.width = shape[1];
  canvas.height = shape[0];
  const context = canvas.getContext("2d");
  const picture = context.createImageData(shape[1], shape[0]);
  const pixels = new Uint32Array(picture.data.buffer);
  for (let i = 0; i < db.length; i++) {
    const grey = 255 * Math.min(Math.max((db[i] - black) / (white - black), 0), 1);
    pixels[i] = 0xff000000 | (grey << 16) | (grey << 8) | grey;
  }
  context.putImageData(picture, 0, 0);
}
