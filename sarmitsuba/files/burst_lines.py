r"""Image of a burst on the lines of a Sentinel-1 product: equal steps of zero-Doppler time and of range.

A focused image lies on the plane of its scene, in the coordinates of a straight line along the orbit. A product has
lines at equal times t and samples at equal ranges R of zero Doppler, by the orbit itself. Polynomials map one to the
other. A pixel of the image has the phase of the point itself; one of a product has that of the path to it, and across
a burst of a turning beam the ramp that products of the S-1 IPF keep:

.. math:: s(t, R) = p \, e^{-j 4 \pi R / \lambda}, \qquad \arg s = \pi k_t (t - t_m)^2 + \ldots

Pixels are interpolated at base band, without the ramp, by splines of degree 5.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy

from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.core.constants import EARTH_GRAVITY
from sarmitsuba.core.errors import DataError
from sarmitsuba.radar.collection import Collection, Flight
from sarmitsuba.radar.geodesy import Anchor
from sarmitsuba.radar.orbit import EARTH_SPIN, StateVectors, earth_fixed_states
from sarmitsuba.signal.image import SarImage
from sarmitsuba.signal.surface import Surface, chebyshev_nodes

# s of the orbit on either side of a burst
_REACH = 20.0
# nodes along an axis of the polynomials, and pixels by which they may miss a node
_NODES, _MISS = 25, 1e-3
_STEPS = 6
# lines of no data on either side of a burst, which readers cut off (sarsen: 90)
GUARD = 100


def extend_orbit(flight: Flight, anchor: Anchor) -> StateVectors:
    """Orbit of a flight, 20 s about its middle in steps of 1 s, ECEF; times are those of the flight.

    The motion about a point mass from the state in the middle, with the constant acceleration added that the flight has
    beside it: the change of the Earth's bulge over seconds is below a centimetre.

    Raises
    ------
    DataError
        The flight is no orbit: too slow or too low.
    """
    first, _, last = flight.span
    middle, half = 0.5 * (first + last), 0.5 * (last - first)
    position = anchor.to_ecef(flight.position(np.array([first, middle, last])))
    velocity = flight.velocity_at(np.asarray(middle)) @ anchor.axes
    height = float(anchor.to_geodetic(flight.position(np.asarray(middle)))[2])
    if height < 1e5 or float(np.linalg.norm(velocity)) < 5e3 or half <= 0.0:
        raise DataError(
            f"the antenna flies {height:.4g} m high at {np.linalg.norm(velocity):.4g} m/s, which is no orbit; give "
            "orbit_altitude or state_vectors_file"
        )

    def motion(_: float, state: F64) -> F64:
        x, v = state[:3], state[3:]
        return np.concatenate([v, -EARTH_GRAVITY * x / np.linalg.norm(x) ** 3])

    start = np.concatenate([position[1], velocity + np.cross(EARTH_SPIN, position[1])])
    legs = [
        scipy.integrate.solve_ivp(
            motion, (0.0, end), start, method="DOP853", rtol=1e-12, atol=1e-5, dense_output=True
        ).sol
        for end in (_REACH, -_REACH)
    ]

    def states(time: F64) -> tuple[F64, F64]:
        inertial = np.array([legs[int(t < 0.0)](t) for t in time])
        return earth_fixed_states(inertial[:, :3], inertial[:, 3:], time)

    ends, _ = states(np.array([-half, half]))
    beside = (position[[0, 2]] - ends).sum(axis=0) / half**2
    time = np.arange(-_REACH, _REACH + 0.5)
    x, v = states(time)
    return StateVectors(
        middle + time,
        x + 0.5 * np.outer(time**2, beside),
        v + np.outer(time, beside),
        "orbit",
        flight.epoch,
        dated=True,
    )


@dataclass(frozen=True, eq=False)
class ZeroDoppler:
    """Points seen at zero Doppler from an orbit.

    Parameters
    ----------
    time : (n,) float64, s, of the orbit
    slant_range : (n,) float64, m
    rate : (n,) float64, m/s^2: half the second derivative of R^2 over R; times -2 / wavelength that of the Doppler
    """

    time: F64
    slant_range: F64
    rate: F64

    @staticmethod
    def of(orbit: StateVectors, points: F64, start: float) -> "ZeroDoppler":
        """By Newton's steps from a time, s; points (n, 3) ECEF, m.

        Raises
        ------
        DataError
            A point is never at zero Doppler while the orbit lasts.
        """
        step = 0.5
        time = np.full(len(points), start)
        low, high = orbit.time[0] + step, orbit.time[-1] - step
        for _ in range(_STEPS):
            x, v = orbit.at(time)
            bend = (orbit.at(time + step)[1] - orbit.at(time - step)[1]) / (2.0 * step)
            line = points - x
            slope = np.sum(v * v, axis=1) - np.sum(line * bend, axis=1)
            time = time + np.sum(line * v, axis=1) / slope
            if (time < low).any() or (time > high).any():
                raise DataError("the image reaches farther along the orbit than 19 s; shrink it in azimuth")
        slant = np.linalg.norm(points - orbit.at(time)[0], axis=1)
        return ZeroDoppler(time, slant, slope / slant)


@dataclass(frozen=True, eq=False)
class Lattice:
    """Lines and samples of a product, common to its bursts.

    Parameters
    ----------
    line_interval : s
    lines : of a burst, an even number
    start_range, spacing : m, slant range of the first sample and between samples
    samples : of a line
    """

    line_interval: float
    lines: int
    start_range: float
    spacing: float
    samples: int

    @property
    def ranges(self) -> F64:
        """(samples,) float64, m."""
        return np.asarray(self.start_range + self.spacing * np.arange(self.samples))

    def times(self, middle: float) -> F64:
        """(lines,) float64, s; the middle of the burst is the line after half of them."""
        return np.asarray(middle + self.line_interval * (np.arange(self.lines) - self.lines // 2))


@dataclass(frozen=True, eq=False)
class BurstMap:
    """Maps between the pixels of a burst's image and its zero-Doppler time and range.

    Parameters
    ----------
    image : of the burst, in slant range
    collection : signal and flight
    orbit : about it
    nodes : of pixels, (25 x 25)
    time, slant_range, row, column : polynomials: of time and range over row and column, and back
    middle : s, of the burst
    """

    image: SarImage
    collection: Collection
    orbit: StateVectors
    nodes: ZeroDoppler
    time: Surface
    slant_range: Surface
    row: Surface
    column: Surface
    middle: float

    @staticmethod
    def of(image: SarImage, what: str) -> "BurstMap":
        """Maps of an image.

        Raises
        ------
        DataError
            The image does not say how it was flown, was not flown in orbit, or is too large for the polynomials.
        """
        collection = Collection.read(image.metadata.get("focus", {}), what)
        try:
            orbit = extend_orbit(collection.flight, image.anchor)
            grid, middle = image.grid, 0.5 * (collection.flight.span[0] + collection.flight.span[2])
            row, column = (chebyshev_nodes(_NODES) * (n - 1) for n in grid.shape)
            axes = [
                axis[0] + pick * step
                for axis, pick, step in (
                    (grid.azimuth, row, grid.azimuth_spacing),
                    (grid.range, column, grid.range_spacing),
                )
            ]
            points = replace(grid, azimuth=axes[0], range=axes[1]).positions() + grid.offset
            seen = ZeroDoppler.of(orbit, image.anchor.to_ecef(points).reshape(-1, 3), middle)
        except DataError as error:
            raise DataError(f"{what}: {error}") from None
        rows, columns = (part.ravel() for part in np.meshgrid(row, column, indexing="ij"))
        time, slant = (Surface.fit(rows, columns, each) for each in (seen.time, seen.slant_range))
        back = [Surface.fit(seen.time, seen.slant_range, each) for each in (rows, columns)]
        for surface, true in zip(back, (rows, columns), strict=True):
            if np.abs(surface.at(seen.time, seen.slant_range) - true).max() > _MISS:
                raise DataError(f"{what}: the image is too large for its map to times and ranges; shrink it")
        return BurstMap(image, collection, orbit, seen, time, slant, back[0], back[1], middle)

    @property
    def speed(self) -> float:
        """Of the satellite over the turning Earth, m/s."""
        return float(np.linalg.norm(self.orbit.at(np.array([self.middle]))[1]))

    def point_rate(self, slant_range: F64) -> F64:
        """k_a of points at slant ranges, Hz/s; negative. A parabola through those of the image."""
        table = np.polynomial.Polynomial.fit(self.nodes.slant_range, self.nodes.rate, 2)
        return np.asarray(-2.0 / self.image.wavelength * table(slant_range))

    @property
    def beam_rate(self) -> float:
        """k_s of the beam, Hz/s; 0 for a beam at rest."""
        rate = float(self.image.metadata.get("burst", {}).get("steering_rate", 0.0))
        return 2.0 * self.speed * rate / self.image.wavelength

    def ramp(self, time: F64, slant_range: F64) -> F64:
        """Phase of the turning beam, rad, at times and slant ranges that broadcast."""
        k_a, k_s = self.point_rate(slant_range), self.beam_rate
        return np.asarray(np.pi * k_a * k_s / (k_a - k_s) * (time - self.middle) ** 2)

    @property
    def reach(self) -> float:
        """Time of zero Doppler that the burst images on either side of its middle, s; infinite for a beam at rest."""
        if not self.beam_rate:
            return np.inf
        k_a = float(self.point_rate(self.nodes.slant_range.mean()))
        whole = self.collection.duration - self.collection.signal.aperture
        return 0.5 * whole * (1.0 - self.beam_rate / k_a)

    def lattice(self) -> Lattice:
        """Lines and samples with about the image's own spacing; of a turning beam, as many as the burst images."""
        time, slant = self.nodes.time, self.nodes.slant_range
        n, m = self.image.grid.shape
        about = np.array([-0.5, 0.5])
        row, column = (0.5 * (size - 1) + about for size in (n, m))
        interval = float(np.diff(self.time.on(row, column).mean(axis=1))[0])
        spacing = float(np.diff(self.slant_range.on(row, column).mean(axis=0))[0])
        away = self.reach if np.isfinite(self.reach) else float(np.abs(time - self.middle).max())
        lines = 2 * (int(np.ceil(away / interval)) + (GUARD if self.beam_rate else 0))
        return Lattice(interval, lines, float(slant.min()), spacing, int(np.ptp(slant) / spacing) + 1)

    def resample(self, channel: str, lattice: Lattice) -> C64:
        """Square root of beta0 on the lines and samples of a product, with its phase; (lines, samples) complex64."""
        image, wavenumber = self.image, 4.0 * np.pi / self.image.wavelength
        n, m = image.grid.shape
        rows, columns = np.arange(n, dtype=np.float64), np.arange(m, dtype=np.float64)
        slant = self.slant_range.on(rows, columns)
        phase = -wavenumber * slant - self.ramp(self.time.on(rows, columns), slant)
        area = image.cell_area * np.sin(image.incidence_angle)
        base = image.total(channel) * np.exp(1j * phase) / np.sqrt(area)
        time, ranges = lattice.times(self.middle), lattice.ranges
        out = np.zeros((lattice.lines, lattice.samples), dtype=np.complex64)
        inside = np.flatnonzero(
            (time >= self.nodes.time.min())
            & (time <= self.nodes.time.max())
            & (np.abs(time - self.middle) <= self.reach)
        )
        if not inside.size:
            return out
        place = np.stack([part.on(time[inside], ranges) for part in (self.row, self.column)])
        held = (place >= -0.5).all(axis=0) & (place[0] <= n - 0.5) & (place[1] <= m - 0.5)
        found = scipy.ndimage.map_coordinates(base, place, order=5, mode="nearest")
        found *= np.exp(1j * self.ramp(time[inside, None], ranges)) * held
        out[inside] = found
        return out
