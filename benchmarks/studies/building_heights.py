"""Heights of drawn buildings from two looks, off by up to 3 m at the start: by complex raw data and by amplitude alone.

Usage: python -m benchmarks.studies.building_heights [--buildings N] [--scenes N] [--first SEED] [--by WAYS]
       [--picture FILE] [--json FILE]

Boxes of 6 to 10 m, 2 to 15 m high, of rough concrete and rough metal on rough soil, headings drawn, 18 m apart, so
that they lie in each other's layover and shadow; X band, 200 MHz, two looks 65 degrees of heading and 10 degrees of
incidence apart, 20 dB of signal over noise. ``complex``: raw data of the model's own scatterers. ``amplitude``: the
same data by multilooked intensity. ``unknown``: by multilooked intensity, data of other scatterers than the model's.

A line for each town and way: rms and largest error at the start and in the end, buildings within 5 cm, rms of the
errors over the standard deviations that the fit states, buildings that it does not confirm, processor seconds and
memory (of the process so far). Under it the buildings that are off by more than 5 cm.
"""

import argparse
import json
import resource
import time
import warnings

import numpy as np

from sarmitsuba import Fit
from tests.support.buildings import drawn_town, names

WAYS = {"complex": ("complex", 0), "amplitude": ("amplitude", 0), "unknown": ("amplitude", 7)}
ASKED = 0.05


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--buildings", type=int, default=40, help="of each town")
    parser.add_argument("--scenes", type=int, default=3, help="drawn towns")
    parser.add_argument("--first", type=int, default=300, help="first seed")
    parser.add_argument("--by", default=",".join(WAYS), help=f"some of {','.join(WAYS)}")
    parser.add_argument("--picture", help="file for the errors on the way, of the first town")
    parser.add_argument("--json", help="file for the numbers")
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    print(
        f"{args.buildings} buildings, errors in m\n seed way        rms before  worst   rms after    worst  within 5 cm"
        "  error/sigma  unconfirmed  CPU s   GB"
    )
    lines, paths = [], {}
    for seed in range(args.first, args.first + args.scenes):
        for way in args.by.split(","):
            line, errors = one(seed, args.buildings, way)
            lines.append(line)
            if seed == args.first:
                paths[way] = errors
    if args.picture:
        picture(paths, args.picture)
    if args.json:
        with open(args.json, "w", encoding="utf-8") as file:
            json.dump(lines, file, indent=1)


def one(seed: int, count: int, way: str) -> tuple[dict[str, object], np.ndarray]:
    """Print the line of a town; its numbers, and the errors (n_steps, n) on the way, m."""
    by, speckle = WAYS[way]
    drawn = drawn_town(seed, count, speckle=speckle)
    start = time.process_time()
    found: Fit = drawn.fitted(by=by)
    seconds = time.process_time() - start
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    before, after = found.start - drawn.truth, found.values - drawn.truth
    ratio = float(np.sqrt(np.mean((after / found.sigma) ** 2)))
    within = int((np.abs(after) < ASKED).sum())
    doubtful = int((found.confirmed < 0.9).sum())
    print(
        f"{seed:5d} {way:10s} {rms(before):10.2f} {np.abs(before).max():6.2f}  {rms(after):10.5f} "
        f"{np.abs(after).max():8.5f}  {within:11d}  {ratio:11.2f}  {doubtful:11d}  {seconds:5.0f}  {memory:3.1f}",
        flush=True,
    )
    if by == "complex":
        for name, error, sigma, share in zip(names(count), after, found.sigma, found.confirmed, strict=True):
            if abs(error) >= ASKED:
                print(f"      {name}: off by {error:.3f} m, stated {sigma:.2g} m, confirmed {share:.2f}")
    line = {
        "seed": seed,
        "way": way,
        "before": before.tolist(),
        "after": after.tolist(),
        "sigma": found.sigma.tolist(),
        "confirmed": [None if not np.isfinite(x) else float(x) for x in found.confirmed],
        "seconds": seconds,
        "gigabytes": memory,
    }
    return line, found.steps - drawn.truth


def rms(errors: np.ndarray) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(errors**2)))


def picture(paths: dict[str, np.ndarray], file: str) -> None:
    """Errors of all heights after every step."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.0 * len(paths), 3.2), layout="constrained")
    axes = figure.subplots(1, len(paths), sharey=True, squeeze=False)[0]
    for axis, (way, errors) in zip(axes, paths.items(), strict=True):
        axis.semilogy(np.maximum(np.abs(errors), 1e-6), color="0.6", lw=0.7)
        axis.semilogy(np.sqrt(np.mean(errors**2, axis=1)), "k", lw=2, label="rms")
        axis.axhline(ASKED, color="C3", ls="--", lw=1, label="5 cm")
        axis.set(title=way, xlabel="step", ylim=(1e-6, 5.0))
        axis.legend(loc="lower left", fontsize=8)
    axes[0].set_ylabel("error of the heights, m")
    figure.savefig(file, dpi=100)


if __name__ == "__main__":
    main()
