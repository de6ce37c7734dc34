"""Shadow edges: a metal plate partly hidden by another, against physical optics over the truly lit polygon.

``python -m benchmarks.studies.shadow_edges`` prints, for rays 0.22 to 6 wavelengths apart, the error of the field
over looks up to 25 degrees off the glint (its power over the field's), and the error of the mean level off the glint.
The lit polygon is the plate less the other's central projection from the antenna, cut in NumPy; nothing of the
tracing is used for it.
"""

import argparse
import sys

import numpy as np

from benchmarks.support.random_reference import polygon_optics
from sarmitsuba.core.arrays import F64
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.simulation.execution.rcs import monostatic_rcs

SPEED_OF_LIGHT = 299_792_458.0

# Hz; plates are measured in wavelengths
FREQUENCY = 10e9
# m, far enough for a plane wave over the plates
DISTANCE = 3e5
SPACINGS = (1.0 / 4.5, 1.0, 3.0, 6.0)
# share of the strongest looks' power below which a look is off the glint
OFF_GLINT = 1e-3


def rectangle(size: tuple[float, float], turn_deg: float, middle: F64) -> F64:
    """(4, 3) corners, m, of a rectangle that faces +z, turned about it."""
    a = np.radians(turn_deg)
    x = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]) * size
    return (
        np.column_stack([x @ np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]]), np.zeros(4)])
        + middle
    )


def clipped(subject: F64, clip: F64) -> F64:
    """Convex polygon (n, 2) within another, both counter-clockwise (Sutherland and Hodgman 1974)."""
    for a, b in zip(clip, np.roll(clip, -1, axis=0), strict=True):
        out = []
        side = (b[0] - a[0]) * (subject[:, 1] - a[1]) - (b[1] - a[1]) * (subject[:, 0] - a[0])
        for i in range(len(subject)):
            j = (i + 1) % len(subject)
            if side[i] >= 0.0:
                out.append(subject[i])
            if side[i] * side[j] < 0.0:
                out.append(subject[i] + (subject[j] - subject[i]) * side[i] / (side[i] - side[j]))
        if not out:
            return np.zeros((0, 2))
        subject = np.array(out)
    return subject


def expected(plate: F64, other: F64, antenna: F64, wavenumber: float) -> complex:
    """Square root of the cross section of both plates, m: the hidden polygon is left out of the lower one, z = 0."""
    shadow = antenna + (other - antenna) * (antenna[2] / (antenna[2] - other[:, 2]))[:, None]
    hidden = clipped(plate[:, :2], shadow[:, :2])
    total = polygon_optics(plate, antenna, wavenumber) + polygon_optics(other, antenna, wavenumber)
    if len(hidden) > 2:
        total -= polygon_optics(np.column_stack([hidden, np.zeros(len(hidden))]), antenna, wavenumber)
    return total


def measure(spacing: float, scenes: int, looks: int) -> tuple[float, float]:
    """Power of the field's error over the field's, dB, and error of the mean level off the glint, dB."""
    wavelength = SPEED_OF_LIGHT / FREQUENCY
    error, power, off_got, off_want = [], [], [], []
    for seed in range(scenes):
        rng = np.random.default_rng([seed, 5])
        plate = rectangle((60 * wavelength, 40 * wavelength), rng.uniform(0, 90), np.zeros(3))
        shift = np.array([*rng.uniform(-20, 20, 2), rng.uniform(10, 40)]) * wavelength
        other = rectangle(tuple(rng.uniform(15, 40, 2) * wavelength), rng.uniform(0, 90), shift)
        away, around = np.radians(rng.uniform(1, 25, looks)), rng.uniform(0, 2 * np.pi, looks)
        direction = np.column_stack(
            [np.sin(away) * np.cos(around), np.sin(away) * np.sin(around), np.cos(away)]
        )
        vertices = np.concatenate([plate, other])
        geometry = Geometry(
            vertices,
            np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]], dtype=np.int32),
            np.zeros(4, dtype=np.int32),
            np.array([0, 0, 1, 1], dtype=np.int32),
            ("plate", "other"),
            np.array([0, 2, 4]),
        )
        middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
        found = monostatic_rcs(
            geometry,
            (Material("metal", pec=True),),
            direction,
            FREQUENCY,
            channels=("VV",),
            ray_spacing=spacing * wavelength,
            max_depth=1,
            distance=DISTANCE,
            seed=seed,
        ).amplitude[:, 0, 0]
        want = np.array(
            [expected(plate, other, middle + DISTANCE * d, 2 * np.pi / wavelength) for d in direction]
        )
        # the tool's phase is that of the middle
        want *= np.exp(2j * (2 * np.pi / wavelength) * DISTANCE)
        turn = np.vdot(found, want)
        error += list(np.abs(found * turn / abs(turn) - want) ** 2)
        power += list(np.abs(want) ** 2)
        off = np.abs(want) ** 2 < OFF_GLINT * np.abs(want).max() ** 2
        off_got.append(np.sum(np.abs(found[off]) ** 2))
        off_want.append(np.sum(np.abs(want[off]) ** 2))
    return (
        float(10 * np.log10(np.sum(error) / np.sum(power))),
        float(10 * np.log10(np.sum(off_got) / np.sum(off_want))),
    )


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", type=int, default=12)
    parser.add_argument("--looks", type=int, default=40, help="of each scene")
    args = parser.parse_args()
    print("rays apart, wavelengths | error of the field, dB | mean level off the glint, dB")
    for spacing in SPACINGS:
        error, off = measure(spacing, args.scenes, args.looks)
        print(f"{spacing:23.2f} | {error:22.1f} | {off:+.2f}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
