// Whether a pixel's level is its own or spills over from a brighter neighbour, by the side lobes of the windows.

import { sumOf } from "sarmitsuba/image_math.js";
import { html } from "sarmitsuba/markup.js";

// a neighbour counts where it is stronger by so much, dB, and more than half a cell away
const STRONGER_DB = 10;
// most by which a pixel may exceed its neighbour's side lobes, dB: two of them in phase
const ABOVE_DB = 6;

/** Intensity of every pixel, kept with the look. */
function powers(look) {
  if (!look.powers) {
    const [rows, columns] = look.grid.shape;
    const { re, im } = sumOf(look.image.layers, rows * columns);
    look.powers = re.map((value, i) => value * value + im[i] * im[i]);
  }
  return look.powers;
}

/**
 * The bright neighbour whose side lobes a pixel shows; null: its level is its own.
 * @param {object} look with image.layers, image.side_lobes and grid
 * @param {number[]} at row and column
 * @param {number[]} cell edges of a resolution cell, pixels
 * @returns {{row: number, column: number, strongerDb: number, reachesDb: number} | null} place of the neighbour, by how
 *   much it is stronger, and how far below it its side lobes are here at most
 */
export function spillOf(look, at, cell = [1, 1]) {
  const lobes = look.image.side_lobes;
  if (!lobes) return null;
  const [rows, columns] = look.grid.shape;
  const [row, column] = at.map(Math.round);
  if (row < 0 || column < 0 || row >= rows || column >= columns) return null;
  const power = powers(look);
  const own = power[row * columns + column];
  const stronger = 10 ** (STRONGER_DB / 10);
  let best = null;
  for (let i = Math.max(0, row - lobes.azimuth.length + 1); i < Math.min(rows, row + lobes.azimuth.length); i++) {
    const along = lobes.azimuth[Math.abs(i - row)] ** 2;
    for (let j = Math.max(0, column - lobes.range.length + 1); j < Math.min(columns, column + lobes.range.length); j++) {
      const there = power[i * columns + j];
      if (!(there > stronger * own)) continue;
      // of a lobe its top alone, along the axes on which the spot lies aside
      const under = (step) => power[i * columns + j + step] > there;
      if (i !== row && ((i > 0 && under(-columns)) || (i < rows - 1 && under(columns)))) continue;
      if (j !== column && ((j > 0 && under(-1)) || (j < columns - 1 && under(1)))) continue;
      if (Math.abs(i - row) <= 0.5 * cell[0] && Math.abs(j - column) <= 0.5 * cell[1]) continue;
      const spilt = there * along * lobes.range[Math.abs(j - column)] ** 2;
      if (best === null || spilt > best.spilt) best = { row: i, column: j, spilt, there };
    }
  }
  if (best === null || own > best.spilt * 10 ** (ABOVE_DB / 10)) return null;
  const db = (value) => 10 * Math.log10(value);
  return { row: best.row, column: best.column, strongerDb: db(best.there / Math.max(own, 1e-30 * best.there)), reachesDb: db(best.spilt / best.there) };
}

/** A sentence on it; `metres`: distance of the neighbour on the ground. */
export function spillView({ strongerDb, reachesDb }, metres) {
  return html`<b>Side lobe of a brighter spot.</b> ${metres.toFixed(1)} m away lies an echo ${Math.min(strongerDb, 300).toFixed(0)} dB stronger. A point is drawn with side lobes
    along range and azimuth, here up to ${(-reachesDb).toFixed(0)} dB below its peak: the level of this spot is mostly that spot's, not its own.`;
}
