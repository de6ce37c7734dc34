// Weighting functions w(u), |u| <= 1/2, of a band or an aperture, interpolated from nodes in the data.
//
// data.windows: { texts: names such as "taylor:4:-35"; range, azimuth: those that the image was made with;
//   nodes Float32Array [texts][n]: w at n places from u = -1/2 to 1/2 }; left out: rectangular alone

/** Names of the windows that come with the data. */
export function windowNames(data) {
  return data.windows ? data.windows.texts : ["rectangular"];
}

/**
 * The function w(u) of a window's name, such as "taylor:4:-35"; linear between nodes, zero outside |u| <= 1/2.
 * @returns {(u: number) => number}
 */
export function windowOf(data, text) {
  const names = windowNames(data);
  const index = names.indexOf(text);
  if (index < 0) throw new Error(`window ${text}: not in this page; choose one of ${names.join(", ")}`);
  if (!data.windows) return (u) => (Math.abs(u) <= 0.5 ? 1 : 0);
  const n = data.windows.nodes.length / names.length;
  const nodes = data.windows.nodes.slice(index * n, (index + 1) * n);
  return (u) => {
    if (!(Math.abs(u) <= 0.5)) return 0;
    const place = (u + 0.5) * (n - 1);
    const i = Math.min(Math.floor(place), n - 2);
    return nodes[i] + (place - i) * (nodes[i + 1] - nodes[i]);
  };
}
