// Weighting functions w(u), |u| <= 1/2, of a band or an aperture; the same names and formulas as
// sarmitsuba/focusing/windows (a test compares them).

/** Fourier coefficients F_m of Taylor's window; Carrara, Goodman, Majewski, Spotlight SAR, appendix D.2. */
function taylorCoefficients(nBar, levelDb) {
  const a = Math.acosh(10 ** (-levelDb / 20)) / Math.PI;
  const s2 = nBar ** 2 / (a ** 2 + (nBar - 0.5) ** 2);
  const out = [];
  for (let i = 1; i < nBar; i++) {
    let top = 1;
    let bottom = 1;
    for (let m = 1; m < nBar; m++) {
      top *= 1 - i ** 2 / s2 / (a ** 2 + (m - 0.5) ** 2);
      if (m !== i) bottom *= 1 - i ** 2 / m ** 2;
    }
    out.push((0.5 * (-1) ** (i + 1) * top) / bottom);
  }
  return out;
}

const FAMILIES = {
  rectangular: () => () => 1,
  hamming: (pedestal = 0.54) => (u) => pedestal + (1 - pedestal) * Math.cos(2 * Math.PI * u),
  hann: () => (u) => 0.5 + 0.5 * Math.cos(2 * Math.PI * u),
  taylor: (nBar = 4, levelDb = -35) => {
    const f = taylorCoefficients(nBar, levelDb);
    return (u) => f.reduce((sum, value, i) => sum + 2 * value * Math.cos(2 * Math.PI * (i + 1) * u), 1);
  },
};

/** Names of the windows that a page can offer. */
export const WINDOW_NAMES = Object.keys(FAMILIES);

/**
 * The function w(u) of a window's text, such as "taylor:4:-35".
 * @param {string} text name, then parameters, between colons
 * @returns {(u: number) => number} zero outside |u| <= 1/2
 */
export function parseWindow(text) {
  const [name, ...rest] = text.split(":");
  if (!(name in FAMILIES)) throw new Error(`window ${text}: unknown; choose one of ${WINDOW_NAMES.join(", ")}`);
  if (!rest.map(Number).every(Number.isFinite)) throw new Error(`window ${text}: parameters must be numbers`);
  const weight = FAMILIES[name](...rest.map(Number));
  return (u) => (Math.abs(u) <= 0.5 ? weight(u) : 0);
}
