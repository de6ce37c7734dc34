"""Stated error of the theory against the true one, for drawn metal bodies solved by the method of moments.

``python benchmarks/studies/theory_error.py`` sweeps every body with ``rcs_sweep`` by ray optics and prints its rms
error in HH and VV, true and stated, then for each family and for all bodies how often the true error is above the
stated one by 2 dB, and the stated error over the true one. Bodies are those to which the laws were fitted, and those
drawn anew afterwards (held out). ``--set bodies`` takes single bodies, ``--set assemblies`` those of several parts and
bent sheets, of which the fitted ones are solved again; ``--only held_out`` and ``--family plate`` take some.
``benchmarks/support/drawn_bodies.py`` and ``drawn_assemblies.py`` draw and solve others.
"""

import argparse
import json
import sys
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import _support
import drawn_assemblies
import drawn_bodies
import numpy as np

from sarmitsuba.constants import SPEED_OF_LIGHT
from sarmitsuba.errors import SarmitsubaWarning
from sarmitsuba.loader.build import SceneMesh, build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.simulation.turntable import Aspects, RcsSweep, rcs_sweep

SETS = {"bodies": drawn_bodies, "assemblies": drawn_assemblies}
CHANNELS = ("HH", "VV")
# dB below the peak of the exact pattern that is compared, and margin of a statement
STRONG, MARGIN = 20.0, 2.0


@dataclass(frozen=True)
class BodyError:
    """Rms error of a body, dB, HH and VV: true and stated (infinite: not known), and the text of the statement."""

    family: str
    true: tuple[float, float]
    stated: tuple[float, float]
    text: str


def sweep_of(entry: dict[str, object], full_wave: str = "off") -> RcsSweep:
    """Sweep of a drawn body at a wavelength of 1 m with default settings but for the switch of solved currents."""
    of = drawn_assemblies if entry["family"] in drawn_assemblies.FAMILIES else drawn_bodies
    vertices, faces = of.body_mesh(entry, 1e9)
    scene = build_scene(
        [SceneMesh(vertices, faces.astype(np.int32), "pec", "body")],
        radar=RadarDescription(center_frequency=SPEED_OF_LIGHT),
        name=str(entry["family"]),
    )
    azimuth = np.radians(drawn_bodies.AZIMUTH)
    return rcs_sweep(
        scene.replace(full_wave=full_wave), Aspects(azimuth, np.zeros_like(azimuth)), channels=CHANNELS
    )


def entries(which: str, of: str = "bodies") -> Iterator[dict[str, object]]:
    """Bodies ``fitted`` or ``held_out`` of a set, with their exact levels."""
    stored = json.loads(Path(str(SETS[of].__file__)).with_suffix(".json").read_text(encoding="utf-8"))
    if of == "bodies":
        yield from stored[which]
    elif which == "held_out":
        yield from stored
    else:
        for seed in drawn_assemblies.FITTED:
            yield from map(drawn_assemblies.solve, drawn_assemblies.drawn(seed, drawn_assemblies.EACH))


def errors(
    which: str, families: tuple[str, ...] = (), of: str = "bodies", full_wave: str = "off"
) -> Iterator[BodyError]:
    """Errors of the bodies ``fitted`` or ``held_out`` of a set, of some families or of all."""
    for entry in entries(which, of):
        if families and entry["family"] not in families:
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SarmitsubaWarning)  # most bodies are small
            sweep = sweep_of(entry, full_wave)
        true = []
        for channel in CHANNELS:
            exact = np.array(entry[channel])
            strong = exact >= exact.max() - STRONG
            true.append(float(np.sqrt(np.mean(np.square(sweep.dbsm(channel) - exact)[strong]))))
        stated = tuple(float(v) for v in sweep.statement.total_db)
        yield BodyError(
            entry["family"],
            (true[0], true[1]),
            (stated[0], stated[1]),
            sweep.statement.currents or sweep.statement.theory.text,
        )


def summary(name: str, found: list[BodyError]) -> str:
    """One line on the distribution over bodies and channels."""
    true, stated = (np.array([getattr(f, n) for f in found]).ravel() for n in ("true", "stated"))
    known = np.isfinite(stated)
    if not known.any():
        return f"{name}: {known.size} rows, none known"
    factor, over = stated[known] / true[known], true[known] - stated[known]
    low, middle, high = np.quantile(factor, [0.05, 0.5, 0.95])
    return (
        f"{name}: {known.size} rows, {known.sum()} known; "
        f"true above stated by {MARGIN:g} dB in {(over > MARGIN).sum()}, "
        f"at most by {over.max():.1f} dB; stated over true: median {middle:.2f}, 5 to 95 % {low:.2f} to {high:.2f}"
    )


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--set", choices=SETS, action="append", default=[])
    parser.add_argument("--only", choices=("fitted", "held_out"))
    parser.add_argument("--family", action="append", default=[])
    parser.add_argument(
        "--full-wave",
        choices=("off", "auto"),
        default="off",
        help="auto: with solved currents, as users run it",
    )
    args = parser.parse_args()
    for of in args.set or SETS:
        for which in (args.only,) if args.only else ("fitted", "held_out"):
            found = []
            for one in errors(which, tuple(args.family), of, args.full_wave):
                found.append(one)
                print(
                    f"{one.family:9s} true {np.round(one.true, 1)} stated {np.round(one.stated, 1)} {one.text}",
                    flush=True,
                )
            for family in dict.fromkeys(f.family for f in found):
                print(summary(f"{of}, {which}, {family}", [f for f in found if f.family == family]))
            if found:
                print(summary(f"{of}, {which}", found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
