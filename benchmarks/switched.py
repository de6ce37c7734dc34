"""What an effect costs in a scene that has it: processor seconds with it and with it switched off, in pairs.

Run ``benchmarks/switched.py SCENE EFFECT ... [--set NAME=VALUE ...] [--rounds N] [--out FOLDER]``. Prints a Markdown
table; with ``--out`` writes ``switched.json``. Seconds are those of simulating raw data, summed over all threads, with
compiled kernels; on and off take turns, and the least of the rounds counts: what disturbs a run only makes it longer.
"""

import argparse
import json
import time
import warnings
from pathlib import Path

import numpy as np

from sarmitsuba import load_scene, simulate
from sarmitsuba.errors import SarmitsubaWarning
from sarmitsuba.loader.library import resolve
from sarmitsuba.scene.scene import Scene


def seconds(scene: Scene) -> tuple[float, float]:
    """Processor seconds of one simulation, and the norm of its data."""
    before = time.process_time()
    data = simulate(scene, seed=1).data
    return time.process_time() - before, float(np.linalg.norm(data))


def row(scene: Scene, effect: str, rounds: int) -> dict[str, float | str]:
    """One line: on, off, ratio and change of the data's energy."""
    on, off = scene.replace(**{effect: "on"}), scene.replace(**{effect: "off"})
    for one in (on, off):  # compile
        seconds(one)
    times: dict[bool, list[float]] = {True: [], False: []}
    norms = {}
    for number in range(rounds):
        for which in (True, False) if number % 2 else (False, True):
            spent, norms[which] = seconds(on if which else off)
            times[which].append(spent)
    with_it, without = min(times[True]), min(times[False])
    return {
        "effect": effect,
        "on": with_it,
        "off": without,
        "ratio": with_it / without,
        "energy_db": 20.0 * float(np.log10(norms[True] / norms[False])),
    }


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scene")
    parser.add_argument("effect", nargs="+")
    parser.add_argument("--set", nargs="+", default=[], metavar="NAME=VALUE", help="of the integrator")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    settings = dict(word.split("=", 1) for word in given.set)
    scene = load_scene(resolve(given.scene)).replace(**settings)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SarmitsubaWarning)  # effects switched off on purpose
        rows = [row(scene, effect, given.rounds) for effect in given.effect]
    print(f"{given.scene}, {given.rounds} rounds\n")
    print("| effect | on (s) | off (s) | ratio | energy, on over off (dB) |\n|---|---|---|---|---|")
    for r in rows:
        print(
            f"| `{r['effect']}` | {r['on']:.2f} | {r['off']:.2f} | {r['ratio']:.2f} | {r['energy_db']:.2f} |"
        )
    if given.out:
        given.out.mkdir(parents=True, exist_ok=True)
        (given.out / "switched.json").write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
