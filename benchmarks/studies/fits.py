"""Fits to drawn raw data: spread of material levels over noise against the bound, and tracks off by wavelengths.

Usage: python -m benchmarks.studies.fits [--scenes N] [--first SEED] [--json FILE]

The first table: fields of rough materials with a box, start levels off by up to 3 dB, 20 dB of signal over noise; the
rms error of every level over ten draws of noise over the Cramer-Rao bound. The second: knots of the antenna's track
drawn up to two wavelengths along every axis, 30 dB of signal over noise; largest error along the line of sight before
and after the fit, and processor seconds.
"""

import argparse
import json
import time
import warnings

import numpy as np

from tests.support.fits import fields, fitted_levels, fitted_track, range_error

DRAWS, MATERIALS, LEVEL_PULSES = 10, 4, 32
KNOTS, TRACK_PULSES = 4, 48


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", type=int, default=5, help="drawn scenes of each table")
    parser.add_argument("--first", type=int, default=100, help="first seed")
    parser.add_argument("--json", help="file for the numbers")
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    seeds = range(args.first, args.first + args.scenes)
    record = {"levels": levels(seeds), "track": tracks(seeds)}
    if args.json:
        with open(args.json, "w", encoding="utf-8") as file:
            json.dump(record, file, indent=1)


def levels(seeds: range) -> list[dict[str, object]]:
    """Print the spread of material levels over their bound."""
    print(
        f"material levels, {DRAWS} draws of noise at 20 dB\n{'seed':>5}  rms error over bound, by material; bound, dB"
    )
    lines: list[dict[str, object]] = []
    for seed in seeds:
        scene = fields(seed, MATERIALS, LEVEL_PULSES)
        offsets = np.random.default_rng([seed, 3]).uniform(-3.0, 3.0, MATERIALS + 1)
        truth, fits = fitted_levels(scene, offsets, 20.0, range(DRAWS))
        spread = np.sqrt(np.mean([(f.values - truth) ** 2 for f in fits], axis=0))
        ratio, bound = spread / fits[0].bound, fits[0].bound
        print(
            f"{seed:5d}  {' '.join(f'{x:5.2f}' for x in ratio)}   {' '.join(f'{x:.3f}' for x in bound)}",
            flush=True,
        )
        lines.append({"seed": seed, "ratio": ratio.tolist(), "bound_db": bound.tolist()})
    everything = np.array([line["ratio"] for line in lines])
    print(f"  all  {np.sqrt(np.mean(everything**2)):.2f} (rms), largest {everything.max():.2f}")
    return lines


def tracks(seeds: range) -> list[dict[str, object]]:
    """Print the errors of tracks before and after a fit."""
    print(
        f"\ntrack, {KNOTS} knots along three axes\n{'seed':>5} {'before':>8} {'after':>9}  wavelengths   {'CPU s':>6}"
    )
    lines: list[dict[str, object]] = []
    for seed in seeds:
        scene = fields(seed, 1, TRACK_PULSES)
        start = time.process_time()
        truth, found = fitted_track(scene, KNOTS, 2.0, seed, 30.0)
        seconds = time.process_time() - start
        before, after = (range_error(scene, KNOTS, x) for x in (truth, found.values - truth))
        print(f"{seed:5d} {before:8.2f} {after:9.5f}              {seconds:6.1f}", flush=True)
        lines.append({"seed": seed, "before": before, "after": after, "seconds": seconds})
    return lines


if __name__ == "__main__":
    main()
