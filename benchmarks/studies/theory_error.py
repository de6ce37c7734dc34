"""Stated error of the theory against the true one, for drawn metal bodies solved by the method of moments.

``python -m benchmarks.studies.theory_error`` sweeps every body with ``rcs_sweep`` by ray optics and prints its rms
error in HH and VV, true and stated, then for each family and for all bodies how often the true error is above the
stated one by 2 dB, and the stated error over the true one. Bodies are those to which the laws were fitted, and those
drawn anew afterwards (held out). ``--set bodies`` takes single bodies, ``--set assemblies`` those of several parts and
bent sheets, of which the fitted ones are solved again; ``--only held_out`` and ``--family plate`` take some.
``--set folds`` draws plates of 1 to 20 wavelengths that meet at 40 to 140 degrees, held out always, against moments in
two dimensions: share of statements too small by 3 dB or more, 20 lg of true over stated, and median looseness.
``benchmarks/support/drawn_bodies.py`` and ``drawn_assemblies.py`` draw and solve others.
"""

import argparse
import json
import sys
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.support import drawn_assemblies, drawn_bodies
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import SarmitsubaWarning
from sarmitsuba.loading.build import SceneMesh, build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.simulation.execution.turntable import Aspects, RcsSweep, rcs_sweep
from sarmitsuba.truth import theory

SETS = {"bodies": drawn_bodies, "assemblies": drawn_assemblies}
CHANNELS = ("HH", "VV")
# dB below the peak of the exact pattern that is compared, and margin of a statement
STRONG, MARGIN = 20.0, 2.0


# degrees and wavelengths of drawn folds, and their length, wavelengths
FOLD_ANGLES, FOLD_WIDTHS, FOLD_LENGTH = (40.0, 140.0), (1.0, 20.0), 10.0


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


def fold_errors(seed: int, count: int, widest: float = FOLD_WIDTHS[1]) -> Iterator[BodyError]:
    """Errors of drawn folds, seen squarely to their length within 60 degrees of the bisector or of the faces' rims."""
    rng = np.random.default_rng([seed, 0xF01D])
    for _ in range(count):
        angle = rng.uniform(*FOLD_ANGLES)
        width = np.exp(rng.uniform(np.log(FOLD_WIDTHS[0]), np.log(widest), 2))
        turns = 0.5 * np.radians(angle) * np.array([-1.0, 1.0])
        ends = width[:, None] * np.stack([np.cos(turns), np.sin(turns)], axis=1)
        azimuth = np.radians(np.arange(-60.0, 60.1, 3.0) + rng.uniform(0.0, 1.0))
        exact = theory.strips_by_moments([[ends[0], [0.0, 0.0], ends[1]]], 1.0, azimuth, step=1.0 / 15.0)
        low, high = -0.5 * FOLD_LENGTH, 0.5 * FOLD_LENGTH
        vertices = np.array([[*place, z] for place in ([0.0, 0.0], *ends) for z in (low, high)])
        faces = np.array([[0, 1, 2], [2, 1, 3], [0, 4, 1], [1, 4, 5]], dtype=np.int32)
        scene = build_scene(
            [SceneMesh(vertices, faces, "pec", "fold")],
            radar=RadarDescription(center_frequency=SPEED_OF_LIGHT),
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SarmitsubaWarning)
            sweep = rcs_sweep(
                scene.replace(full_wave="off", edge_diffraction="on"),
                Aspects(azimuth, np.zeros_like(azimuth)),
                channels=CHANNELS,
            )
        true = []
        for channel, field in zip(CHANNELS, exact[::-1], strict=True):  # HH is across the fold
            level = 20.0 * np.log10(np.abs(field)) + 10.0 * np.log10(2.0 * FOLD_LENGTH**2)
            strong = level >= level.max() - STRONG
            true.append(float(np.sqrt(np.mean(np.square(sweep.dbsm(channel) - level)[strong]))))
        stated = sweep.statement.total_db
        text = (
            f"{angle:.0f} deg, {width[0]:.1f} and {width[1]:.1f} wavelengths: {sweep.statement.theory.text}"
        )
        yield BodyError("fold", (true[0], true[1]), (float(stated[0]), float(stated[1])), text)


def fold_summary(found: list[BodyError]) -> str:
    """One line on drawn folds: true errors, statements too small, and looseness."""
    true, stated = (np.array([getattr(f, n) for f in found]).ravel() for n in ("true", "stated"))
    loose = 20.0 * np.log10(stated / true)
    return (
        f"folds: {true.size} rows; true rms error median {np.median(true):.2f} dB, worst {true.max():.2f} dB, above "
        f"2 dB in {(true > 2.0).sum()}; stated too small by more than 3 dB in {(loose < -3.0).sum()}, at most by "
        f"{max(-loose.min(), 0.0):.1f} dB; median looseness {np.median(loose):.1f} dB"
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
    parser.add_argument("--set", choices=(*SETS, "folds"), action="append", default=[])
    parser.add_argument("--count", type=int, default=30, help="drawn folds")
    parser.add_argument("--seed", type=int, default=48, help="of drawn folds")
    parser.add_argument("--only", choices=("fitted", "held_out"))
    parser.add_argument("--family", action="append", default=[])
    parser.add_argument(
        "--full-wave",
        choices=("off", "auto"),
        default="off",
        help="auto: with solved currents, as users run it",
    )
    args = parser.parse_args()
    if not args.set or "folds" in args.set:
        folds = []
        for one in fold_errors(args.seed, args.count):
            folds.append(one)
            print(
                f"fold true {np.round(one.true, 2)} stated {np.round(one.stated, 2)} {one.text}", flush=True
            )
        print(fold_summary(folds))
    for of in [name for name in args.set or SETS if name in SETS]:
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
