"""Bent metal plates against the method of moments: double bounces where two faces do not meet squarely.

``python -m benchmarks.studies.corner_angles`` prints, for given and drawn angles and arms, the rms difference of the
levels within 20 dB of the longer face's peak over 60 degrees either side of the bisector, for the electric field
along and across the fold: of physical optics with every path closed where it hits last, traced here in two
dimensions, of the simulator, and of the simulator with the fringe currents of the edges along the fold. Two columns
tell what would help: the same optics with the fringe waves of the ends, straight and by way of the other plate's
mirror, and physical optics iterated, in which each plate is lit by the exact field of the other plate's currents.
"""

import argparse
import sys
from collections.abc import Sequence

import numpy as np
from scipy.special import hankel2

from sarmitsuba.core.arrays import C128, F64, I64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.simulation.execution.rcs import monostatic_rcs
from sarmitsuba.tracing.kernel.source import PointSource
from sarmitsuba.tracing.scatterers.edges.diffraction import FringeCurrents, edges_of
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation import targets

# lengths are in wavelengths
WAVELENGTH = 1.0
K = 2.0 * np.pi / WAVELENGTH
# between looks that squarely face a plate of a whole angle
AZIMUTH = np.radians(np.arange(-60.0, 60.1, 1.0) + 0.0137)
FLOOR_DB = 20.0
GIVEN = ((60, 10, 10), (80, 10, 10), (88, 10, 10), (90, 10, 10), (95, 10, 10), (100, 10, 10))
# length of the simulator's plates along the fold: seen squarely, it is a factor
LENGTH = 2.0
# points on a wavelength and rounds of physical optics iterated; a fourth round changes 0.1 dB
POINTS, ROUNDS = 20, 3


def plates(angle_deg: float, arms: Sequence[float]) -> list[F64]:
    """Fold and far end, (2, 2), of both plates; the bisector along x."""
    half = 0.5 * np.radians(angle_deg)
    turns = (-half, half)
    return [np.array([[0.0, 0.0], [a * np.cos(t), a * np.sin(t)]]) for a, t in zip(arms, turns, strict=True)]


def _unit(end: F64) -> F64:
    """Direction of a plate from the fold."""
    return end / np.linalg.norm(end)


def _inner(end: F64) -> F64:
    """Normal of a plate towards the bisector."""
    along = _unit(end)
    normal = np.array([-along[1], along[0]])
    return normal if normal[0] > 0.0 else -normal


def _nearest(origin: F64, way: F64, segments: Sequence[F64], left: I64) -> tuple[F64, I64]:
    """Distance and number of the segment that each ray meets first, -1 for none, but the one that it leaves."""
    best, found = np.full(origin.shape[0], np.inf), np.full(origin.shape[0], -1)
    for i, (a, b) in enumerate(segments):
        step, off = b - a, a - origin
        bottom = way[:, 0] * step[1] - way[:, 1] * step[0]
        bottom = np.where(np.abs(bottom) < 1e-14, 1e-14, bottom)
        t = (off[:, 0] * step[1] - off[:, 1] * step[0]) / bottom
        u = (off[:, 0] * way[:, 1] - off[:, 1] * way[:, 0]) / bottom
        meets = (t > 1e-9) & (u >= 0.0) & (u <= 1.0) & (left != i) & (t < best)
        best, found = np.where(meets, t, best), np.where(meets, i, found)
    return best, found


def last_hit_optics(segments: Sequence[F64], azimuth: float, n: int = 4000, depth: int = 8) -> C128:
    """Amplitudes along and across of n rays, each closed by physical optics wherever it hits."""
    s = np.array([np.cos(azimuth), np.sin(azimuth)])
    side = np.array([-s[1], s[0]])
    ends = np.concatenate(segments) @ side
    spacing = np.ptp(ends) / n
    far = 100.0
    p = s * far + (ends.min() + spacing * (np.arange(n) + 0.5))[:, None] * side
    d, length = np.broadcast_to(-s, p.shape), np.full(n, -far)
    left, live, total = np.full(n, -1), np.full(n, True), np.zeros(2, dtype=complex)
    for order in range(depth):
        t, found = _nearest(p, d, segments, left)
        live = live & (found >= 0)
        t = np.where(live, t, 0.0)
        p, length, left = p + t[:, None] * d, length + t, found
        steps = np.array([b - a for a, b in segments])[found]
        along = steps / np.linalg.norm(steps, axis=1)[:, None]
        normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
        normal *= -np.sign(np.einsum("nc,nc->n", normal, d))[:, None]
        into, out = -np.einsum("nc,nc->n", normal, d), normal @ s
        hidden = _nearest(p, np.broadcast_to(s, p.shape), segments, left)[1] >= 0
        width = spacing / np.maximum(into, 1e-9)
        fill = np.sinc(K * np.einsum("nc,nc->n", d - s, along) * width / (2.0 * np.pi)) * width
        wave = np.where(live & (out > 0.0) & ~hidden, np.exp(-1j * K * (length - p @ s)) * fill, 0.0)
        total += ((-1.0) ** order * (wave @ into), wave @ out)
        d = d + 2.0 * into[:, None] * normal
    return np.asarray(np.sqrt(K) * total)


def mirrored_fringes(segments: Sequence[F64], azimuth: F64) -> C128:
    """(2, m) amplitudes along and across of the ends' fringe currents, lit and seen straight and in the other plate."""
    s = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    out = np.zeros((2, azimuth.size), dtype=complex)
    for i, ((_, rim), (_, other)) in enumerate(zip(segments, segments[::-1], strict=True)):
        along, own, mirror = _unit(rim), _inner(rim), _inner(other)
        image = s - 2.0 * (s @ mirror)[:, None] * mirror
        start = np.broadcast_to(rim, s.shape)
        numbers = np.full(azimuth.size, i)
        free = _nearest(start, s, segments, numbers)[1] < 0
        away, met = _nearest(start, image, segments, numbers)
        meets = (met == 1 - i) & (s @ mirror > 0.0)
        at = start + np.where(meets, away, 0.0)[:, None] * image
        meets &= _nearest(at, s, segments, np.full(azimuth.size, 1 - i))[1] < 0
        ways = ((s, free, 0), (image, meets, 1))
        for into, lit, first in ways:
            for back, seen, last in ways:
                angles = [np.arctan2(d @ own, -(d @ along)) % (2.0 * np.pi) for d in (back, into)]
                soft, hard = theory.fringe_coefficients(2.0, *angles)
                wave = np.where(lit & seen, 1j / np.sqrt(K) * np.exp(1j * K * ((into + back) @ rim)), 0.0)
                out += np.stack([(-1.0) ** (first + last) * soft * wave, -hard * wave])
    return out


def iterated_optics(segments: Sequence[F64], azimuth: F64) -> C128:
    """(2, m) amplitudes along and across of physical optics where each plate is lit by the other's currents too."""
    s = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    places, normals, steps, starts = [], [], [], []
    for i, (_, end) in enumerate(segments):
        n = int(np.ceil(np.linalg.norm(end) * POINTS))
        place = (np.arange(n) + 0.5)[:, None] / n * end
        origin, way = np.repeat(place, azimuth.size, axis=0), np.tile(s, (n, 1))
        hidden = _nearest(origin, way, segments, np.full(origin.shape[0], i))[1].reshape(n, -1) >= 0
        into = _inner(end) @ s.T
        places.append(place)
        normals.append(into)
        steps.append(np.linalg.norm(end) / n)
        starts.append(np.where((into > 0.0) & ~hidden, 2.0 * np.exp(1j * K * (place @ s.T)), 0.0))
    gap = places[0][:, None] - places[1]
    r = np.linalg.norm(gap, axis=2)
    slope = 0.25j * K * hankel2(1, K * r) / r
    faces = [slope * (gap @ _inner(end)) for _, end in segments]
    out = []
    # the field's slope along the normal is the current where the electric field is along the fold, else the field is
    for along, (first, second) in ((True, (faces[0], -faces[1].T)), (False, (-faces[1], faces[0].T))):
        sign = -1.0 if along else 1.0
        term = [a * (1j * K * b if along else 1.0) for a, b in zip(starts, normals, strict=True)]
        total = list(term)
        for _ in range(ROUNDS - 1):
            term = [sign * 2.0 * steps[1] * first @ term[1], sign * 2.0 * steps[0] * second @ term[0]]
            total = [a + b for a, b in zip(total, term, strict=True)]
        amplitude = np.zeros(azimuth.size, dtype=complex)
        for place, into, step, current in zip(places, normals, steps, total, strict=True):
            seen = step * np.exp(1j * K * (place @ s.T)) * (1.0 if along else 1j * K * into)
            amplitude += (seen * current).sum(axis=0)
        out.append(-0.5j / np.sqrt(K) * amplitude)
    return np.stack(out)


def simulated(segments: Sequence[F64], edges: bool) -> list[F64]:
    """Levels of the simulator's scattering width along and across, dB."""
    faces = [targets.parallelogram([*a, 0.0], [*(b - a), 0.0], [0.0, 0.0, LENGTH]) for a, b in segments]
    shape = targets.geometry(faces)
    found = edges_of(shape, targets.PEC, WAVELENGTH)
    found = found.of(np.abs(found.along[:, 2]) > 0.5)
    result = monostatic_rcs(
        shape,
        targets.PEC,
        targets.from_azimuth(AZIMUTH),
        SPEED_OF_LIGHT / WAVELENGTH,
        sources=(PointSource(FringeCurrents(found)),) if edges else (),
    )
    scale = 10.0 * np.log10(2.0 * LENGTH**2 / WAVELENGTH)
    return [result.rcs_dbsm(channel) - scale for channel in ("VV", "HH")]


def row(angle_deg: float, arms: tuple[float, float]) -> list[float]:
    """Ten rms differences, dB: along and across of the five columns."""
    segments = plates(angle_deg, arms)
    exact = theory.strips_by_moments([[segments[0][1], [0.0, 0.0], segments[1][1]]], WAVELENGTH, AZIMUTH)
    want = [20.0 * np.log10(np.abs(x)) for x in exact]
    floor = 10.0 * np.log10(K * max(arms) ** 2) - FLOOR_DB
    optics = np.array([last_hit_optics(segments, a) for a in AZIMUTH]).T
    ways = (optics, optics + mirrored_fringes(segments, AZIMUTH), iterated_optics(segments, AZIMUTH))
    levels, mirrored, iterated = (20.0 * np.log10(np.maximum(np.abs(x), 1e-12)) for x in ways)
    out = []
    for got in (levels, simulated(segments, False), simulated(segments, True), mirrored, iterated):
        for a, b in zip(got, want, strict=True):
            out.append(float(np.sqrt(np.mean(np.square(a - b)[b > floor]))))
    return out


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--drawn", type=int, default=20, help="drawn corners of 80 to 100 degrees")
    parser.add_argument("--seed", type=int, default=11)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    drawn = [(rng.uniform(80.0, 100.0), *rng.uniform(5.0, 15.0, 2)) for _ in range(options.drawn)]
    print("rms difference from the method of moments, dB, field along and across the fold\n")
    print(
        "| angle, deg | arms, wavelengths | closed where it hits last | simulator | with edges "
        "| the first with mirrored edges | optics iterated |"
    )
    print("|---|---|---|---|---|---|---|")
    rows = []
    for angle, *arms in (*GIVEN, *drawn):
        got = row(angle, (arms[0], arms[1]))
        rows.append(got)
        cells = " | ".join(f"{a:.2f}, {b:.2f}" for a, b in zip(got[::2], got[1::2], strict=True))
        print(f"| {angle:.1f} | {arms[0]:.1f}, {arms[1]:.1f} | {cells} |", flush=True)
    if drawn:
        for name, wanted in (("below 90", lambda a: a < 90.0), ("above 90", lambda a: a >= 90.0)):
            some = np.array([r for r, (a, *_) in zip(rows[len(GIVEN) :], drawn, strict=True) if wanted(a)])
            if some.size:
                mean = np.sqrt(np.mean(np.square(some), axis=0))
                cells = " | ".join(f"{a:.2f}, {b:.2f}" for a, b in zip(mean[::2], mean[1::2], strict=True))
                print(f"| {name} | all {len(some)} drawn | {cells} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
