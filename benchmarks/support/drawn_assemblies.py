"""Drawn metal bodies of several parts, and bent sheets, with their exact scattering by moments.

Long profiles (pairs of sheets, boxes and cylinders at gaps of 0.1 to 5 wavelengths, louvres, channels, bent sheets) are
solved in two dimensions by :func:`sarmitsuba.truth.theory.strips_by_moments`, short ones (pairs of plates and boxes, a
box before a plate, bent plates) by :mod:`dense_moments`. ``python -m benchmarks.support.drawn_assemblies FILE --seed
3`` draws, solves and stores them as JSON. Lengths are in wavelengths.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from benchmarks.support import dense_moments as moments
from benchmarks.support.drawn_bodies import AZIMUTH, STEP
from sarmitsuba.truth import theory

F64 = NDArray[np.float64]
Profile = list[F64]
Patch = tuple[F64, F64, F64]
# length of the long bodies, whose ends return next to nothing of the profile's square
LENGTH = 25.0
# segments on a wavelength of the solution in two dimensions, and longest over the gap
SEGMENTS, OF_GAP = 14.0, 0.5
# triangles up to which a short body is solved
MOST_TRIANGLES = 2600
GAPS = (0.1, 5.0)
# bodies of a family; seeds of those that constants are fitted to, and of those that are held out
EACH, FITTED, HELD_OUT = 12, (1, 2), 3
# sides of a circle for the solution, at least, and longest side of it for the simulator
SIDES, FINE_SIDE = 40, 0.03
# step at which distances of outlines are taken
NEAR = 0.02


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _turn(points: F64, angle: float) -> F64:
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(points @ np.array([[c, s], [-s, c]]))


def _strip(width: float) -> F64:
    return np.array([[0.0, -0.5 * width], [0.0, 0.5 * width]])


def _rectangle(a: float, b: float) -> F64:
    return 0.5 * np.array([[-a, -b], [a, -b], [a, b], [-a, b], [-a, -b]])


def _circle(radius: float, side: float) -> F64:
    n = max(SIDES, int(np.ceil(2.0 * np.pi * radius / side)))
    t = 2.0 * np.pi * np.arange(n + 1) / n
    points = np.column_stack([np.cos(t), np.sin(t)])
    points[-1] = points[0]
    return radius * points


def _beside(first: F64, second: F64, gap: float, offset: float) -> Profile:
    """Two outlines a gap apart along x, the second shifted along y by a share of the first one's width."""
    x = first[:, 0].max() + gap - second[:, 0].min()
    return [first, second + np.array([x, offset * np.ptp(first[:, 1])])]


def _bends(sizes: F64, bends: F64) -> F64:
    """Open outline of sides of these lengths, each turned from the last by a bend, rad."""
    angle = np.concatenate([[0.0], np.cumsum(bends)])
    steps = sizes[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])


# every family: its numbers are drawn by the first function and made an outline (of facets of a side) by the second
Draw = Callable[[np.random.Generator], list[float]]
Make = Callable[[list[float], float], Profile]


def _louvre(s: list[float], side: float) -> Profile:
    return [_turn(_strip(s[1]), s[3]) + np.array([0.0, i * s[2]]) for i in range(int(s[0]))]


def _channel(s: list[float], side: float) -> Profile:
    """Base and two sides at right angles."""
    return [np.array([[s[1], 0.0], [0.0, 0.0], [0.0, s[0]], [s[2], s[0]]])]


def _louvre_numbers(rng: np.random.Generator) -> list[float]:
    width = _log(rng, 0.6, 4.0)
    # blades that are turned by a right angle lie in one line: their distance is then that of their middles
    return [
        float(rng.integers(3, 6)),
        width,
        width * 0.05 + _log(rng, 0.15, 2.5),
        float(rng.uniform(0.9, 2.2)),
    ]


PROFILES: dict[str, tuple[Draw, Make]] = {
    "parallel": (
        lambda r: [_log(r, 0.8, 8), _log(r, 0.8, 8), _log(r, *GAPS), float(r.uniform(-0.6, 0.6))],
        lambda s, _: _beside(_strip(s[0]), _strip(s[1]), s[2], s[3]),
    ),
    "tilted": (
        lambda r: [
            _log(r, 0.8, 7),
            _log(r, 0.8, 7),
            _log(r, *GAPS),
            float(r.uniform(-0.6, 0.6)),
            float(r.uniform(-1.2, 1.2)),
        ],
        lambda s, _: _beside(_strip(s[0]), _turn(_strip(s[1]), s[4]), s[2], s[3]),
    ),
    "in_line": (
        lambda r: [_log(r, 0.8, 7), _log(r, 0.8, 7), _log(r, *GAPS), float(r.uniform(-0.5, 0.5))],
        lambda s, _: [
            _strip(s[0]) - [0.0, 0.5 * s[0]],
            _turn(_strip(s[1]) + np.array([0.0, 0.5 * s[1]]), s[3]) + np.array([0.0, s[2]]),
        ],
    ),
    "louvre": (_louvre_numbers, _louvre),
    "channel": (lambda r: [_log(r, 0.3, 5), _log(r, 0.5, 6), _log(r, 0.5, 6)], _channel),
    "boxes": (
        lambda r: [
            *(_log(r, 0.7, 4) for _ in range(4)),
            _log(r, *GAPS),
            float(r.uniform(-0.6, 0.6)),
            float(r.choice([0.0, r.uniform(0.0, 1.5)])),
        ],
        lambda s, _: _beside(_rectangle(s[0], s[1]), _turn(_rectangle(s[2], s[3]), s[6]), s[4], s[5]),
    ),
    "box_sheet": (
        lambda r: [
            _log(r, 0.7, 4),
            _log(r, 0.7, 4),
            _log(r, 0.8, 7),
            _log(r, *GAPS),
            float(r.uniform(-0.6, 0.6)),
            float(r.choice([0.0, r.uniform(-1.2, 1.2)])),
        ],
        lambda s, _: _beside(_rectangle(s[0], s[1]), _turn(_strip(s[2]), s[5]), s[3], s[4]),
    ),
    "round": (
        lambda r: [_log(r, 0.5, 2), _log(r, 0.5, 2), _log(r, *GAPS), float(r.uniform(-0.6, 0.6))],
        lambda s, side: _beside(_circle(s[0], side), _circle(s[1], side), s[2], s[3]),
    ),
    "round_sheet": (
        lambda r: [_log(r, 0.5, 2), _log(r, 0.8, 7), _log(r, *GAPS), float(r.uniform(-0.6, 0.6))],
        lambda s, side: _beside(_circle(s[0], side), _strip(s[1]), s[2], s[3]),
    ),
    "bent": (
        lambda r: [
            float(n := r.integers(2, 5)),
            *(_log(r, 0.8, 5) for _ in range(n)),
            *(np.radians(r.uniform(3.0, 40.0, n - 1)) * r.choice([-1.0, 1.0], n - 1)).tolist(),
        ],
        lambda s, _: [_bends(np.array(s[1 : int(s[0]) + 1]), np.array(s[int(s[0]) + 1 :]))],
    ),
    "bent_alike": (
        lambda r: [float(r.integers(2, 6)), _log(r, 0.6, 4), float(np.radians(r.uniform(4.0, 24.0)))],
        lambda s, _: [_bends(np.full(int(s[0]), s[1]), np.full(int(s[0]) - 1, s[2]))],
    ),
    "bent_box": (
        lambda r: [
            float(np.radians(r.uniform(4.0, 24.0))),
            _log(r, 0.8, 4),
            _log(r, 0.8, 4),
            _log(r, 0.8, 3),
        ],
        lambda s, _: [_bent_box(*s)],
    ),
}


def _bent_box(bend: float, first: float, second: float, depth: float) -> F64:
    """Closed outline: a front of two sides with an obtuse edge, and sides and a back at its ends."""
    front = _bends(np.array([first, second]), np.array([bend]))
    across = front[-1] - front[0]
    normal = np.array([-across[1], across[0]]) / np.linalg.norm(across) * depth
    return np.concatenate([front, [front[-1] + normal, front[0] + normal, front[0]]])


def _plate(y: float, z: float, normal: F64, at: F64) -> Patch:
    """Corner and two sides of a rectangle about a place."""
    side = np.cross([0.0, 0.0, 1.0], normal)
    side /= np.linalg.norm(side)
    up = np.cross(normal, side)
    return at - 0.5 * y * side - 0.5 * z * up, y * side, z * up


def _box(a: float, b: float, c: float, x: float, y: float) -> list[Patch]:
    """Six sides of a box whose nearest face stands at x."""
    o, e = np.array([x, y - 0.5 * b, -0.5 * c]), np.diag([a, b, c])
    return [
        *((o + p, e[i], e[j]) for i, j, k in ((1, 2, 0), (0, 2, 1), (0, 1, 2)) for p in (0.0 * e[k], e[k])),
    ]


def _leaning(angle: float) -> F64:
    return np.array([np.cos(angle), np.sin(angle), 0.0])


X = np.array([1.0, 0.0, 0.0])
# families of short bodies: numbers, and the rectangles they are made of
SOLIDS: dict[str, tuple[Draw, Callable[[list[float]], list[Patch]]]] = {
    "plates": (
        lambda r: [
            *(_log(r, 0.8, 2.6) for _ in range(4)),
            _log(r, 0.15, 2.5),
            float(r.uniform(-0.5, 0.5)),
            float(r.choice([0.0, r.uniform(-0.6, 0.6)])),
        ],
        lambda s: [
            _plate(s[0], s[1], X, 0.0 * X),
            _plate(
                s[2], s[3], _leaning(s[6]), X * (s[4] + 0.5 * s[2] * abs(np.sin(s[6]))) + [0, s[5] * s[0], 0]
            ),
        ],
    ),
    "solids": (
        lambda r: [*(_log(r, 0.5, 1.4) for _ in range(6)), _log(r, 0.15, 2.5), float(r.uniform(-0.5, 0.5))],
        lambda s: [*_box(*s[:3], -s[0], 0.0), *_box(*s[3:6], s[6], s[7] * s[1])],
    ),
    "solid_plate": (
        lambda r: [
            *(_log(r, 0.5, 1.4) for _ in range(3)),
            *(_log(r, 0.8, 2.4) for _ in range(2)),
            _log(r, 0.15, 2.5),
            float(r.uniform(-0.5, 0.5)),
        ],
        lambda s: [*_box(*s[:3], -s[0], 0.0), _plate(s[3], s[4], X, X * s[5] + [0.0, s[6] * s[1], 0.0])],
    ),
    "bent_plate": (
        lambda r: [*(_log(r, 0.8, 2.4) for _ in range(3)), float(np.radians(r.uniform(4.0, 30.0)))],
        lambda s: [
            (np.array([0.0, 0.0, -0.5 * s[2]]), np.array([0.0, -s[0], 0.0]), np.array([0.0, 0.0, s[2]])),
            (
                np.array([0.0, 0.0, -0.5 * s[2]]),
                s[1] * np.array([np.sin(s[3]), np.cos(s[3]), 0.0]),
                np.array([0.0, 0.0, s[2]]),
            ),
        ],
    ),
}
FAMILIES = (*PROFILES, *SOLIDS)


def profile(entry: dict[str, Any], side: float) -> Profile:
    """Outlines of a long body, turned as drawn; circles in sides of about a length."""
    lines = PROFILES[entry["family"]][1](entry["sizes"], side)
    middle = np.concatenate(lines).mean(axis=0)
    return [_turn(line - middle, entry["turn"]) for line in lines]


def least_gap(lines: Profile) -> float:
    """Smallest distance between two outlines; infinite for one."""
    fine = [
        np.concatenate(
            [
                a + np.linspace(0.0, 1.0, 2 + int(np.linalg.norm(b - a) / NEAR))[:, None] * (b - a)
                for a, b in pairwise(line)
            ]
        )
        for line in lines
    ]
    return min(
        (float(cKDTree(a).query(b)[0].min()) for i, a in enumerate(fine) for b in fine[:i]),
        default=float("inf"),
    )


def body_mesh(entry: dict[str, Any], step: float = 1e9) -> moments.Mesh:
    """Mesh of a drawn body; circles of long bodies and sides of short ones in pieces of a step at most."""
    if entry["family"] in PROFILES:
        quads = [
            np.array([[*p, z] for p, z in ((a, -h), (b, -h), (b, h), (a, h))])
            for h in (0.5 * LENGTH,)
            for line in profile(entry, FINE_SIDE)
            for a, b in pairwise(line)
        ]
        faces = np.array([[0, 1, 2], [0, 2, 3]])
        return moments.welded([(quad, faces) for quad in quads])
    patches = SOLIDS[entry["family"]][1](entry["sizes"])
    points, faces = moments.welded([moments.rectangle(*patch, step) for patch in patches])
    return Rotation.from_quat(entry["turn"]).apply(points), faces


def drawn(seed: int, each: int, families: tuple[str, ...] = FAMILIES) -> list[dict[str, Any]]:
    """Bodies, families in turn, half as many round ones; every family has random numbers of its own."""
    found = []
    for name in families:
        rng = np.random.default_rng([seed, FAMILIES.index(name)])
        for number in range(each // 2 if name.startswith("round") else each):
            while True:
                if name in PROFILES:
                    entry = {"family": name, "turn": round(float(rng.uniform(0.0, 2.0 * np.pi)), 4)}
                else:
                    turn = Rotation.random(random_state=rng).as_quat() if number % 2 else [0.0, 0.0, 0.0, 1.0]
                    entry = {"family": name, "turn": [round(float(x), 6) for x in turn]}
                draw = (PROFILES | SOLIDS)[name][0]  # type: ignore[operator]
                entry["sizes"] = [round(float(x), 4) for x in draw(rng)]
                if _feasible(entry):
                    break
            found.append(entry)
    return found


def _feasible(entry: dict[str, Any]) -> bool:
    """Whether parts are apart, and the solution is of affordable size."""
    if entry["family"] in PROFILES:
        lines = profile(entry, 1.0 / SEGMENTS)
        around = sum(np.linalg.norm(np.diff(line, axis=0), axis=1).sum() for line in lines)
        return least_gap(lines) > 0.09 and bool(around < 34.0)
    return len(body_mesh(entry, STEP)[1]) <= MOST_TRIANGLES


def solve(entry: dict[str, Any]) -> dict[str, Any]:
    """Entry with its exact levels in HH and VV, dB above a square wavelength."""
    azimuth = np.radians(AZIMUTH)
    if entry["family"] in PROFILES:
        lines = profile(entry, 1.0 / SEGMENTS)
        step = max(1.0 / 40.0, min(1.0 / SEGMENTS, OF_GAP * least_gap(lines)))
        along, across = theory.strips_by_moments(lines, 1.0, azimuth, step=step)
        fields = np.sqrt(2.0) * LENGTH * np.stack([across, along])  # HH is across the axis
    else:
        looks = np.stack([np.cos(azimuth), np.sin(azimuth), 0.0 * azimuth], axis=1)
        fields = moments.amplitudes(body_mesh(entry, STEP), looks).T
    level = np.round(20.0 * np.log10(np.maximum(np.abs(fields), 1e-6)), 1)
    return entry | {"HH": level[0].tolist(), "VV": level[1].tolist()}


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("file", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--each", type=int, default=EACH)
    parser.add_argument("--family", action="append", default=[], choices=FAMILIES)
    args = parser.parse_args()
    bodies = []
    for entry in drawn(args.seed, args.each, tuple(args.family) or FAMILIES):
        start = time.process_time()
        bodies.append(solve(entry))
        print(entry["family"], entry["sizes"], f"{time.process_time() - start:.0f} CPU s", flush=True)
        rows = ",\n".join(json.dumps(b, separators=(",", ":")) for b in bodies)
        args.file.write_text(f"[\n{rows}\n]\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
