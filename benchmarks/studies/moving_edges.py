"""What moving edges add to derivatives: against means over ray lattices of whole runs with the shape moved.

Usage: python -m benchmarks.studies.moving_edges [--count N] [--first SEED] [--lattices N] [--kinds KIND ...]
       [--parameters NAME ...] [--json FILE]

A single lattice of rays cannot tell the derivative of what is hidden: its rays jump from one surface to another one by
one. The reference is the mean over many lattices of central differences of whole runs. ``hidden``: a wall behind a body
that returns nothing itself (``tests/support/occluders.py``), so that all of the derivative comes from edges. ``metal``
and ``rough``: a box on ground (``tests/support/differences.py``), most of whose derivative is the phase of its own
echoes. Printed are the errors relative to the reference's norm without and with the rays beside edges, and the noise of
the reference, from its spread over the lattices.
"""

import argparse
import json
import warnings

import numpy as np

from tests.support.differences import METRES, RADIANS, drawn
from tests.support.occluders import SIDEWAYS, edge_share, hidden_wall

# parameters of the hidden wall, and their steps (None: usual)
HIDDEN = (
    ("height:body", None),
    ("shift:body:x", None),
    ("shift:body:y", SIDEWAYS),
    ("scale:body", None),
    ("rotation:body", None),
)
# steps for boxes whose own echoes turn in phase: four times those of single lattices
BOXES = (
    ("height:box", 4.0 * METRES),
    ("shift:box:x", 4.0 * METRES),
    ("scale:box", METRES),
    ("rotation:box", 4.0 * RADIANS),
)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=10, help="drawn scenes of each kind")
    parser.add_argument("--first", type=int, default=7000, help="first seed")
    parser.add_argument("--lattices", type=int, default=40, help="of rays, in the mean")
    parser.add_argument("--kinds", nargs="+", default=["hidden", "metal", "rough"], help="kinds of scenes")
    parser.add_argument("--parameters", nargs="+", help="of those that are compared; all")
    parser.add_argument("--json", help="file for the numbers")
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    seeds = range(args.first, args.first + args.count)
    print(f"{args.lattices} lattices, seeds {seeds.start} to {seeds.stop - 1}; medians and 90 %")
    print(f"{'scenes':7} {'parameter':14} {'without edges':>16} {'with edges':>16} {'noise':>16}")
    record = []
    for kind in args.kinds:
        for parameter, step in HIDDEN if kind == "hidden" else BOXES:
            if args.parameters and parameter not in args.parameters:
                continue
            found = []
            for seed in seeds:
                scene = hidden_wall(seed) if kind == "hidden" else drawn(seed, kind, 4)
                found.append(edge_share(scene, parameter, args.lattices, step))
            rows = np.array([[share.without, share.found, share.noise] for share in found])
            middle, most = np.quantile(rows, [0.5, 0.9], axis=0)
            print(
                f"{kind:7} {parameter:14} "
                + " ".join(f"{a:8.4f} {b:7.4f}" for a, b in zip(middle, most, strict=True)),
                flush=True,
            )
            record.append({"scenes": kind, "parameter": parameter, "errors": rows.tolist()})
    if args.json:
        with open(args.json, "w", encoding="utf-8") as file:
            json.dump(record, file, indent=1)


if __name__ == "__main__":
    main()
