"""Mixed runs one after the other in one process: what memory it holds after each round, and what is kept.

    python -m benchmarks.studies.soak --count 300

A round is one run of each kind, with parameters drawn by seed. The first rounds fill bounded caches: growth
is that from the first third to the last.
"""

import argparse
import gc
import json
import random
import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

import sarmitsuba
from sarmitsuba.machine.memory import held_memory

SEED = 9
MOST_GROWTH = 0.02  # of the memory after the first third


def _scene(rng: random.Random, name: str, **more: str) -> "sarmitsuba.Scene":
    size = str(rng.choice((4, 5, 6, 8)))
    given = {"range_film.image_extent_azimuth": size, "range_film.image_extent_range": size}
    given["sar_antenna.slant_range"] = str(rng.uniform(900.0, 1100.0))
    given["sar_path.seed"] = str(rng.randrange(1000))
    return sarmitsuba.load_scene(name, parameters={**given, **more})


def _focused(rng: random.Random, folder: Path) -> None:
    raw = sarmitsuba.simulate(_scene(rng, "point"))
    sarmitsuba.write_raw(raw, folder / "raw.h5")
    sarmitsuba.focus(
        sarmitsuba.read_raw(folder / "raw.h5"),
        focuser=rng.choice(("omega_k", "backprojection", "range_doppler")),
    )


def _stored(rng: random.Random, folder: Path) -> None:
    image = sarmitsuba.render(_scene(rng, "dihedral"))
    sarmitsuba.write_image(image, folder / "image.h5")
    sarmitsuba.read_image(folder / "image.h5")
    sarmitsuba.image_quality(image)


def _picture(rng: random.Random, folder: Path) -> None:
    sarmitsuba.render(_scene(rng, "sphere")).plot(folder / "a.png")


KINDS: dict[str, Callable[[random.Random, Path], object]] = {
    "simulate": lambda rng, folder: sarmitsuba.simulate(_scene(rng, "trihedral")),
    "focus": _focused,
    "store": _stored,
    "picture": _picture,
    "image": lambda rng, folder: sarmitsuba.render(_scene(rng, "dihedral", **{"sar_path.method": "image"})),
    "link": lambda rng, folder: sarmitsuba.link_budget(_scene(rng, "point")),
    "paths": lambda rng, folder: sarmitsuba.trace_paths(_scene(rng, "dihedral")),
}


def soak(count: int, kinds: list[str]) -> list[int]:
    """Memory held after each round, bytes."""
    rng, held = random.Random(SEED), []
    with tempfile.TemporaryDirectory() as name, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for number in range(max(count // len(kinds), 3)):
            for kind in kinds:
                KINDS[kind](rng, Path(name))
            gc.collect()
            held.append(held_memory())
            print(f"round {number + 1}: {held[-1] / 1e6:.1f} MB", flush=True)
    return held


def main() -> int:
    """Run, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=300, help="runs (default: 300)")
    parser.add_argument("--kinds", default=",".join(KINDS), help="comma separated")
    parser.add_argument("-o", "--out", type=Path, default=Path("out/soak"))
    args = parser.parse_args()
    held = soak(args.count, args.kinds.split(","))
    third = max(len(held) // 3, 1)
    first, last = float(np.median(held[:third][-3:])), float(np.median(held[-3:]))
    growth = last / first - 1.0
    print(
        f"{args.count} runs: {first / 1e6:.1f} MB after the first third, {last / 1e6:.1f} MB at the end: {growth:+.1%}"
    )
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "soak.json").write_text(json.dumps({"held_bytes": held, "growth": growth}), encoding="utf-8")
    return int(growth > MOST_GROWTH)


if __name__ == "__main__":
    sys.exit(main())
