"""Drawn metal bodies of a tenth to five wavelengths, and their exact scattering by :mod:`dense_moments`.

``python -m benchmarks.support.drawn_bodies FILE --seed 1 --each 5`` draws, solves and stores them as JSON.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.support import dense_moments as moments

# directions of a sweep, deg, and the step of the exact solution's mesh, wavelengths
AZIMUTH = np.arange(0.0, 360.0, 5.0)
STEP = 0.095
# triangles up to which a body is solved
MOST_TRIANGLES = 4200

Draw = Callable[[np.random.Generator], list[float]]


@dataclass(frozen=True)
class Family:
    """Bodies of one kind: how their sizes are drawn, in wavelengths, and their mesh of a given step."""

    sizes: Draw
    mesh: Callable[[list[float], float], moments.Mesh]


def _log(rng: np.random.Generator, *bounds: tuple[float, float]) -> list[float]:
    return [float(np.exp(rng.uniform(np.log(low), np.log(high)))) for low, high in bounds]


def _plate(s: list[float], step: float) -> moments.Mesh:
    return moments.welded(
        [moments.rectangle([0.0, -0.5 * s[0], -0.5 * s[1]], [0, s[0], 0], [0, 0, s[1]], step)]
    )


def _box(s: list[float], step: float) -> moments.Mesh:
    a, b = 0.5 * s[0], 0.5 * s[1]
    return moments.prism([[-a, -b], [a, -b], [a, b], [-a, b]], s[2], step)


def _polygon(rng: np.random.Generator) -> list[float]:
    n = int(rng.integers(3, 8))
    radius, height = _log(rng, (0.35, 1.2), (0.3, 2.0))
    arc = np.sort((np.arange(n) + rng.uniform(-0.25, 0.25, n)) / n)
    return [height, radius, *(float(x) for x in arc)]


def _prism(s: list[float], step: float) -> moments.Mesh:
    arc = 2.0 * np.pi * np.array(s[2:])
    return moments.prism(s[1] * np.column_stack([np.cos(arc), np.sin(arc)]), s[0], step)


def _smooth(step: float) -> float:
    """Finer facets for the simulator, which has them curved."""
    return step if step < 1.0 else 0.03


def _cylinder(s: list[float], step: float) -> moments.Mesh:
    r, h = s[0], 0.5 * s[1]
    around = min(_smooth(step), 2.0 * np.pi * r / (64 if step > 1.0 else 8))
    return moments.revolved([[0.0, -h], [r, -h], [r, h], [0.0, h]], around)


def _ellipsoid(s: list[float], step: float) -> moments.Mesh:
    largest = max(s)
    around = min(_smooth(step), 2.0 * np.pi * largest / (90 if step > 1.0 else 12))
    points, faces = moments.sphere(largest, around)
    return points * (np.array(s) / largest), faces


def _ogive(s: list[float], step: float) -> moments.Mesh:
    """Pointed at both ends: half length and radius."""
    half, radius = s
    arc = (half**2 + radius**2) / (2.0 * radius)
    z = np.linspace(-half, half, 41 if step > 1.0 else max(9, int(2.2 * half / step)))
    r = np.maximum(np.sqrt(arc**2 - z**2) - (arc - radius), 0.0)
    r[[0, -1]] = 0.0
    return moments.revolved(
        np.column_stack([r, z]), min(_smooth(step), 2.0 * np.pi * radius / (64 if step > 1 else 8))
    )


def _cone(s: list[float], step: float) -> moments.Mesh:
    r, h = s
    return moments.revolved(
        [[0.0, -0.5 * h], [r, -0.5 * h], [0.0, 0.5 * h]],
        min(_smooth(step), 2.0 * np.pi * r / (64 if step > 1.0 else 8)),
    )


def _open_box(s: list[float], step: float) -> moments.Mesh:
    """Without its side at +x: width, height, depth."""
    w, h, d = s
    o = np.array([-0.5 * d, -0.5 * w, -0.5 * h])
    x, y, z = np.diag([d, w, h])
    sides = [(o, y, z), (o, x, y), (o + z, x, y), (o, x, z), (o + y, x, z)]
    return moments.welded([moments.rectangle(c, a, b, step) for c, a, b in sides])


def _corner(s: list[float], step: float) -> moments.Mesh:
    """Two plates that share a side of the height: widths, height, angle in deg."""
    a, b, h, angle = s
    turn = np.radians(angle)
    o, z = np.array([0.0, 0.0, -0.5 * h]), np.array([0.0, 0.0, h])
    sides = [np.array([a, 0.0, 0.0]), b * np.array([np.cos(turn), np.sin(turn), 0.0])]
    return moments.welded([moments.rectangle(o, side, z, step) for side in sides])


FAMILIES = {
    "plate": Family(lambda r: _log(r, (0.5, 4.5), (0.5, 3.0)), _plate),
    "thin": Family(lambda r: _log(r, (0.7, 3.5), (0.7, 2.5), (0.012, 0.2)), _box),
    "box": Family(lambda r: _log(r, (0.5, 2.2), (0.5, 2.2), (0.5, 2.2)), _box),
    "prism": Family(_polygon, _prism),
    "cylinder": Family(lambda r: _log(r, (0.1, 0.7), (0.4, 3.0)), _cylinder),
    "ellipsoid": Family(lambda r: _log(r, (0.12, 1.4), (0.12, 1.0), (0.12, 0.6)), _ellipsoid),
    "ogive": Family(lambda r: _log(r, (0.5, 2.2), (0.15, 0.5)), _ogive),
    "cone": Family(lambda r: _log(r, (0.2, 0.7), (0.4, 2.5)), _cone),
    "open_box": Family(lambda r: _log(r, (0.5, 1.8), (0.5, 1.8), (0.5, 2.2)), _open_box),
    "corner": Family(
        lambda r: [*_log(r, (0.7, 2.2), (0.7, 2.2), (0.7, 2.5)), float(r.uniform(50.0, 130.0))], _corner
    ),
    "rod": Family(lambda r: _log(r, (0.02, 0.06), (0.3, 1.5)), _cylinder),
    "tiny": Family(lambda r: _log(r, (0.05, 0.4), (0.05, 0.4), (0.05, 0.4)), _box),
}


def body_mesh(entry: dict[str, object], step: float) -> moments.Mesh:
    """Mesh of a drawn body, wavelengths: turned as it was drawn."""
    points, faces = FAMILIES[str(entry["family"])].mesh(entry["sizes"], step)  # type: ignore[arg-type]
    return Rotation.from_quat(entry["turn"]).apply(points), faces


def drawn(seed: int, each: int) -> list[dict[str, object]]:
    """Bodies, families in turn; every second one stands upright, the others are turned at random."""
    rng = np.random.default_rng(seed)
    found = []
    for number in range(each):
        for name, family in FAMILIES.items():
            while True:
                turn = (
                    Rotation.random(random_state=rng).as_quat()
                    if number % 2
                    else np.array([0.0, 0.0, 0.0, 1.0])
                )
                entry = {
                    "family": name,
                    "sizes": [round(x, 4) for x in family.sizes(rng)],
                    "turn": [round(float(x), 6) for x in turn],
                }
                if len(body_mesh(entry, STEP)[1]) <= MOST_TRIANGLES:
                    break
            found.append(entry)
    return found


def solve(entry: dict[str, object]) -> dict[str, object]:
    """Entry with its exact levels in HH and VV, dB above a square wavelength."""
    a = np.radians(AZIMUTH)
    s = moments.amplitudes(body_mesh(entry, STEP), np.stack([np.cos(a), np.sin(a), 0.0 * a], axis=1))
    level = np.round(20.0 * np.log10(np.maximum(np.abs(s), 1e-6)), 2)
    return entry | {"HH": level[:, 0].tolist(), "VV": level[:, 1].tolist()}


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("file", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--each", type=int, default=5)
    args = parser.parse_args()
    bodies = []
    for entry in drawn(args.seed, args.each):
        start = time.process_time()
        bodies.append(solve(entry))
        print(
            entry["family"],
            entry["sizes"],
            len(body_mesh(entry, STEP)[1]),
            "triangles,",
            f"{time.process_time() - start:.0f} CPU s",
            flush=True,
        )
        args.file.write_text("[\n" + ",\n".join(json.dumps(b) for b in bodies) + "\n]\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
