"""Exact images of ideal points: their echoes in closed form, summed over all pulses pixel by pixel, in NumPy.

Formulas are those of docs/focusing.md and docs/radar.md, written again; nothing of the program's
focusers, windows, patterns or grids is used. A radar is no more than its numbers.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from sarmitsuba.core.arrays import C128, F64

SPEED_OF_LIGHT = 299_792_458.0
# 0.5 = (sin x / x)^2
HALF_POWER = 1.39155737825151
# steps of the tabulated range profile per cell, and cells on either side
_FINE, _REACH = 256, 64
# Gauss-Legendre nodes over the band: more than two per radian at the reach
_NODES = 512
# what is right
LEVEL_DB, CELLS, PHASE_DEG = 0.05, 0.05, 1.0


def _taylor(u: F64) -> F64:
    """Four nearly equal side lobes of -35 dB (Carrara, Goodman, Majewski 1995, appendix D.2)."""
    a2, n = (np.arccosh(10.0**1.75) / np.pi) ** 2, 4
    s2 = n**2 / (a2 + (n - 0.5) ** 2)
    total = np.ones_like(u)
    for m in range(1, n):
        top = np.prod([1.0 - m**2 / s2 / (a2 + (i - 0.5) ** 2) for i in range(1, n)])
        bottom = np.prod([1.0 - m**2 / i**2 for i in range(1, n) if i != m])
        total = total - (-1.0) ** m * top / bottom * np.cos(2.0 * np.pi * m * u)
    return total


WINDOWS: dict[str, Callable[[F64], F64]] = {
    "rectangular": np.ones_like,
    "hamming": lambda u: 0.54 + 0.46 * np.cos(2.0 * np.pi * u),
    "hann": lambda u: np.cos(np.pi * u) ** 2,
    "kaiser": lambda u: np.i0(2.5 * np.sqrt(np.maximum(1.0 - 4.0 * u**2, 0.0))) / np.i0(2.5),
    "taylor": _taylor,
}
"""Weights over a band -1/2 ... 1/2 by the window's name, with its default parameters."""


@dataclass(frozen=True, eq=False)
class Numbers:
    """Numbers of a radar.

    Parameters
    ----------
    sent, received : (n, 3) m, positions of the antenna; ``received`` is that of the receiver, mostly the same
    time : (n,) s
    velocity : (n, 3) m/s
    boresight, along, up : (n, 3) of the beam and of its aperture
    frequency, bandwidth : Hz
    pattern : ``isotropic``, ``gaussian`` or ``rectangular``
    beamwidths : rad, half-power, azimuth and elevation
    half_aperture : sines; infinite: all pulses serve all pixels
    """

    sent: F64
    received: F64
    time: F64
    velocity: F64
    boresight: F64
    along: F64
    up: F64
    frequency: float
    bandwidth: float
    pattern: str
    beamwidths: tuple[float, float]
    half_aperture: float

    def gain(self, direction: F64) -> F64:
        """Two-way amplitude of the beam in the directions (..., n, 3), 1 at its peak: (..., n)."""
        if self.pattern == "isotropic":
            return np.ones(direction.shape[:-1])
        total = (np.einsum("...i,...i->...", direction, self.boresight) > 0.0).astype(float)
        for axis, width in zip((self.along, self.up), self.beamwidths, strict=True):
            s = np.einsum("...i,...i->...", direction, axis) / np.sin(0.5 * width)
            total *= 2.0 ** -(s**2) if self.pattern == "gaussian" else np.sinc(HALF_POWER * s / np.pi) ** 2
        return total

    def weights(self, place: F64, window: str) -> F64:
        """Azimuth window's weight of every pulse at places (m, 3): (m, n)."""
        n, law = len(self.time), WINDOWS[window]
        if np.isinf(self.half_aperture):
            return np.broadcast_to(law((np.arange(n) + 0.5) / n - 0.5), (len(place), n))
        speed = np.linalg.norm(self.velocity, axis=1)
        forward = self.velocity / speed[:, None]
        line = place[:, None] - self.sent
        distance = lengths(line)
        sine = np.einsum("mni,ni->mn", line, forward) / distance
        off = sine - np.einsum("ni,ni->n", self.boresight, forward)
        step = np.abs(np.gradient(off, axis=1))
        inside = np.clip((self.half_aperture - np.abs(off)) / step + 0.5, 0.0, 1.0)
        return law(np.clip(off / (2.0 * self.half_aperture), -0.5, 0.5)) * inside


def lengths(vectors: F64) -> F64:
    """Of vectors (..., 3)."""
    return np.sqrt(np.einsum("...i,...i->...", vectors, vectors))


def profile(window: str) -> Callable[[F64], F64]:
    """Range profile of a point over the distance in cells, 1 at the point: the windowed band's transform."""
    u, weight = np.polynomial.legendre.leggauss(_NODES)
    weight = weight * WINDOWS[window](0.5 * u)
    x = np.arange(-_REACH * _FINE, _REACH * _FINE + 1) / _FINE
    table = np.cos(np.pi * np.outer(x, u)) @ weight / weight.sum()

    def at(cells: F64) -> F64:
        return np.interp(cells, x, table, left=0.0, right=0.0)

    return at


def exact_image(
    radar: Numbers,
    places: F64,
    points: list[tuple[F64, complex]],
    range_window: str,
    azimuth_window: str,
    *,
    batch: int = 2_000_000,
) -> C128:
    r"""Matched sum of the exact echoes of points, (m,) complex128 of the unit of the points' amplitudes.

    .. math:: I(p) = \frac{\sum_t w_t g_t(p) A_t(p)^2 \sum_q a_q g_t(q) A_t(q)^{-2} h(R_t(p) - R_t(q))
              e^{j k (R_t(p) - R_t(q))}}{\sum_t w_t g_t(p)^2}

    with R half the way to a place and to the receiver, and A^2 the product of both.

    Parameters
    ----------
    places : (m, 3) m, pixels
    points : positions (n, 3) m in every pulse, and complex amplitudes (root of the RCS)
    batch : pixels times pulses at a time
    """
    cell = SPEED_OF_LIGHT / (2.0 * radar.bandwidth)
    wavenumber = 4.0 * np.pi * radar.frequency / SPEED_OF_LIGHT
    shape = profile(range_window)

    def ways(place: F64) -> tuple[F64, F64, F64]:
        first = place - radar.sent
        one = lengths(first)
        two = one if radar.received is radar.sent else lengths(place - radar.received)
        return 0.5 * (one + two), one * two, radar.gain(first / one[..., None])

    echoes = []
    for position, amplitude in points:
        r, spreading, gain = ways(position)
        echoes.append((r, amplitude * gain / spreading))
    out = np.empty(len(places), dtype=np.complex128)
    step = max(1, batch // len(radar.time))
    for start in range(0, len(places), step):
        some = places[start : start + step]
        r, spreading, gain = ways(some[:, None])
        weight = radar.weights(some, azimuth_window)
        total = np.zeros(len(some), dtype=np.complex128)
        for distance, echo in echoes:
            beside = r - distance
            turn = np.exp(1j * wavenumber * beside)
            total += np.sum(weight * gain * spreading * echo * shape(beside / cell) * turn, axis=1)
        out[start : start + step] = total / np.maximum(np.sum(weight * gain**2, axis=1), 1e-300)
    return out


@dataclass(frozen=True)
class Deviation:
    """How an image of a point differs from the exact one.

    Parameters
    ----------
    level_db : of the main lobe's intensity
    azimuth, range : shift, in cells
    phase_deg : of the main lobe
    """

    level_db: float
    azimuth: float
    range: float
    phase_deg: float

    def badness(self) -> float:
        """The largest of them, over 0.05 dB, 0.05 cells and 1 degree."""
        parts = (
            self.level_db / LEVEL_DB,
            self.azimuth / CELLS,
            self.range / CELLS,
            self.phase_deg / PHASE_DEG,
        )
        return max(abs(part) for part in parts)

    def __str__(self) -> str:
        return f"{self.level_db:+.3f} dB, {self.azimuth:+.3f} and {self.range:+.3f} cells, {self.phase_deg:+.2f} deg"


def deviation(pixels: C128, exact: C128, moved: Sequence[C128], step: float) -> Deviation:
    """Level, place and phase of a main lobe against the exact one, by least squares of the intensity.

    Parameters
    ----------
    pixels, exact : (m,) of a chip about the point
    moved : the exact image of the chip's places moved by ``+-step`` cells in azimuth, then in range
    step : cells
    """
    lobe = np.abs(exact) > 0.5 * np.abs(exact).max()
    power = np.abs(exact[lobe]) ** 2
    slopes = [(np.abs(moved[i][lobe]) ** 2 - np.abs(moved[i + 1][lobe]) ** 2) / (2.0 * step) for i in (0, 2)]
    columns = np.stack([power, *(-s for s in slopes)], axis=1)
    # the nearer to the peak, the more: a lobe that is a little wider has no other level
    weight = power / power.max()
    level, azimuth, rng = np.linalg.lstsq(
        columns * weight[:, None], np.abs(pixels[lobe]) ** 2 * weight, rcond=None
    )[0]
    if level <= 0.0:
        return Deviation(-np.inf, np.inf, np.inf, 180.0)
    phase = float(np.angle(np.vdot(exact[lobe], pixels[lobe]), deg=True))
    return Deviation(10.0 * float(np.log10(level)), float(azimuth / level), float(rng / level), phase)
