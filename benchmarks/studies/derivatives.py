"""Derivatives of raw data against central differences on drawn scenes, and the time they take.

Usage: python -m benchmarks.studies.derivatives [--count N] [--first SEED] [--kinds KIND ...] [--cost]
       [--json FILE]

For every kind of parameter, boxes on ground are drawn (``tests/support/differences.py``), and the derivative along a
drawn direction of its values is compared with differences of sixth order of whole runs, in scenes where it changes no
shadow: the error relative to the norm of the derivative. Scenes in which a ray appears or vanishes between the runs
(rounding at the edges of facets), so that differences of two orders disagree, are counted apart. Shadows that move are
compared by ``moving_edges.py``. ``--cost`` prints the time of K derivatives over that of the data alone, both as the
median of interleaved rounds.
"""

import argparse
import json
import statistics
import time
import warnings
from collections.abc import Sequence

import numpy as np

from sarmitsuba.apps.fit.forward_model import ForwardModel
from sarmitsuba.apps.fit.parsing import parse
from tests.support.differences import EXACT, Compared, compared_all, drawn

# sets of parameters whose time is measured
COSTS = (
    ("levels", "level:soil"),
    ("track, 3 axes", "track:8"),
    ("shift, 3 axes", "shift:box:x,shift:box:y,shift:box:z"),
    ("height", "height:box"),
    ("rotation", "rotation:box"),
    ("permittivity of 2", "permittivity:wall,permittivity:soil"),
    (
        "8 properties",
        "permittivity:wall,loss:wall,permittivity:soil,loss:soil,rms_height:wall,rms_height:soil,"
        "correlation_length:wall,level:soil",
    ),
)
ROUNDS = 5


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=10, help="drawn scenes of each kind")
    parser.add_argument("--first", type=int, default=1000, help="first seed")
    parser.add_argument(
        "--kinds", nargs="+", default=["alone", "beam", "house", "metal", "rough"], help="kinds of scenes"
    )
    parser.add_argument("--cost", action="store_true", help="measure times instead")
    parser.add_argument("--json", help="file for the numbers")
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    record: dict[str, object] = {}
    if args.cost:
        record["cost"] = costs()
    else:
        seeds = range(args.first, args.first + args.count)
        kinds = [(kind, parameter) for kind, parameter in EXACT if kind in args.kinds]
        record["exact"] = table(kinds, seeds)
    if args.json:
        with open(args.json, "w", encoding="utf-8") as file:
            json.dump(record, file, indent=1)


def table(kinds: Sequence[tuple[str, str]], seeds: range) -> list[dict[str, object]]:
    """Print one line for each kind of parameter."""
    print(f"relative errors, seeds {seeds.start} to {seeds.stop - 1}")
    print(
        f"{'scenes':7} {'parameter':38} {'steady':>7} {'median':>9} {'90 %':>9} {'worst':>9}   others' median"
    )
    lines: list[dict[str, object]] = []
    for kind in dict.fromkeys(kind for kind, _ in kinds):
        parameters = [parameter for scenes, parameter in kinds if scenes == kind]
        drawn_scenes = []
        for seed in seeds:
            scene = drawn(seed, kind)
            drawn_scenes.append(compared_all(scene, parameters, seed))
        for parameter, own in zip(parameters, zip(*drawn_scenes, strict=True), strict=True):
            lines.append(line(kind, parameter, own))
    return lines


def line(kind: str, parameter: str, found: Sequence[Compared]) -> dict[str, object]:
    """Print one line."""
    steady = [c.error for c in found if c.steady]
    others = [c.error for c in found if not c.steady]
    quantiles = np.quantile(steady, [0.5, 0.9, 1.0]) if steady else np.full(3, np.nan)
    rest = float(np.median(others)) if others else float("nan")
    name = "shift:box" if parameter.startswith("shift") else parameter
    numbers = " ".join(f"{q:9.2e}" for q in quantiles)
    print(f"{kind:7} {name:38} {len(steady):3d}/{len(found):3d} {numbers}   {rest:.2e}", flush=True)
    return {
        "scenes": kind,
        "parameter": parameter,
        "steady": len(steady),
        "all": len(found),
        "quantiles": quantiles.tolist(),
        "others": rest,
        "errors": [c.error for c in found],
    }


def costs() -> list[dict[str, object]]:
    """Print the time of derivatives over that of the data, on one drawn scene with a longer track."""
    scene = drawn(1, "rough", 64)
    print(f"{'parameters':20} {'values':>6} {'kernel':>6} {'time':>7} {'allowed':>8}")
    lines = []
    for title, names in COSTS:
        model = ForwardModel(scene, parse(names, scene))
        model.data(), model.derivative()
        plain, with_derivatives = [], []
        for _ in range(ROUNDS):
            for times, run in ((plain, model.data), (with_derivatives, model.derivative)):
                start = time.process_time()
                run()
                times.append(time.process_time() - start)
        ratio = statistics.median(with_derivatives) / statistics.median(plain)
        carried = model.carried
        allowed = 1.0 + 0.7 * carried
        print(f"{title:20} {len(model.names):6d} {carried:6d} {ratio:7.2f} {allowed:8.2f}", flush=True)
        lines.append({"parameters": names, "values": len(model.names), "carried": carried, "ratio": ratio})
    return lines


if __name__ == "__main__":
    main()
