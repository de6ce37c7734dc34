"""Fits drawn at random: whether each ends right, or says that it does not.

Usage: python -m benchmarks.studies.fit_combinations [--draw combinations|scenes|forms|places|outside] [--count N]
       [--first SEED] [--json FILE]

A building of 5 to 12 m on rough ground, X band, 200 MHz, 10 or 20 dB of signal over noise; drawn by seed.
``combinations``: one to three of shift, height, rotation, scale, levels, permittivity, rms height, gain, track and
clock; one or two looks at any heading, HH, VV or all channels, spotlight or stripmap, complex or by amplitude, with or
without a prior, data of the model's scatterers or (one in five) of others. ``scenes``: a shape alone, with the gain or
with all levels, to data of the model's own scatterers, of others, or of another building. ``forms``: a rotation or
scale of up to 0.09, perhaps with a shift. ``places``: height and place off by up to a metre, two looks. ``outside``:
from VHF to Ka band, orbit, aircraft, drone and separate receiver, 0 to 30 dB, data of another look than the scene's
radar has, and of a building more or less.

Of each: whether it is ``right`` (within four stated standard deviations, and confirmed), ``not confirmed``, ``doubted``
(right, and not confirmed: a false refusal), ``refused`` or ``WRONG`` (a false confirmation); the largest error over its
standard deviation, the least `Fit.confirmed`, processor seconds.
"""

import argparse
import json
import time
import warnings
from collections import Counter

from tests.support.fit_draws import combination, form, other_scene, outside, place

DRAWS = {
    "combinations": combination,
    "scenes": other_scene,
    "forms": form,
    "places": place,
    "outside": outside,
}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--draw", choices=DRAWS, default="combinations")
    parser.add_argument("--count", type=int, default=40, help="drawn fits")
    parser.add_argument("--first", type=int, default=5000, help="first seed")
    parser.add_argument("--json", help="file for the numbers")
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    lines: list[dict[str, object]] = []
    for seed in range(args.first, args.first + args.count):
        drawn = DRAWS[args.draw](seed)
        start = time.process_time()
        ended = drawn.ended()
        seconds = time.process_time() - start
        prior = " prior" if drawn.priors else ""
        print(
            f"{seed} {drawn.told:16s} {drawn.by:9s} {drawn.snr_db:3.0f} dB {drawn.source:7s} {ended.how:13s} "
            f"{ended.worst:8.2f} sigma, confirmed {ended.confirmed:5.2f}, {seconds:4.0f} s  "
            f"{drawn.parameters}{prior}",
            flush=True,
        )
        if ended.how not in ("right", "not confirmed"):
            print(f"      {ended.told}", flush=True)
        lines.append(
            {"seed": seed, "source": drawn.source, "by": drawn.by, "seconds": seconds, **vars(ended)}
        )
    for source in sorted({str(line["source"]) for line in lines}):
        counts = Counter(str(line["how"]) for line in lines if line["source"] == source)
        print(f"data {source}: " + ", ".join(f"{n} {how}" for how, n in counts.most_common()))
    if args.json:
        with open(args.json, "w", encoding="utf-8") as file:
            json.dump(lines, file, indent=1)


if __name__ == "__main__":
    main()
