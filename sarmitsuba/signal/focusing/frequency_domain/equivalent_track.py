r"""Straight track in place of one in orbit, from which places lit in turn have the same range histories.

A place has in its own aperture, about the time :math:`t_c` when the beam's middle passes, nearly the history of a
straight track at the effective velocity V of the image's middle,

.. math:: R^2 = \rho^2 + (X - V t)^2, \quad X = V t_c - R \dot R / V, \quad \rho^2 = R^2 - (R \dot R / V)^2

with R and its rate at :math:`t_c` by the track itself. An image in X and :math:`\rho` is focused and interpolated at
the X and :math:`\rho` of every pixel. What is left is the change of the effective velocity over the image, and of
higher orders over an aperture.

References
----------
R. K. Raney, "Considerations for SAR image quantification unique to orbital systems", IEEE Trans. Geosci. Remote Sens.
29 (5), 1991. I. G. Cumming and F. H. Wong, Digital Processing of Synthetic Aperture Radar Data, 2005, section 4.3.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy.ndimage

from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.radar.antenna import Pointing
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.track import Track, range_acceleration
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.surface import Surface, chebyshev_nodes

# nodes along an axis of the image at which histories are computed
_NODES = 13
# pixels of the image in X and rho within a cell, and pixels beside it
_FINE, _MARGIN = 3.0, 8
# m/s, speed from which a track is that of a satellite
_ORBITAL = 1e3
# largest phase left, rad
LARGEST_PHASE = 0.2


@dataclass(frozen=True, eq=False)
class EquivalentTrack:
    """Straight track, and the map from the pixels of a slant grid to its coordinates.

    Parameters
    ----------
    radar, grid : of the curved track, and the pixels wanted
    speed : V, m/s
    middle : s, time at X = 0
    along, closest : polynomials of X and rho over row and column
    phase : rad, largest that is left in the pixels' apertures
    """

    radar: Radar
    grid: ImageGrid
    speed: float
    middle: float
    along: Surface
    closest: Surface
    phase: float

    @staticmethod
    def of(radar: Radar, grid: ImageGrid) -> "EquivalentTrack":
        """Track for a slant grid."""
        track = radar.track
        rows, columns = (chebyshev_nodes(_NODES) * (n - 1) for n in grid.shape)
        axes = [
            axis[0] + step * place
            for axis, step, place in (
                (grid.azimuth, grid.azimuth_spacing, rows),
                (grid.range, grid.range_spacing, columns),
            )
        ]
        points = replace(grid, azimuth=axes[0], range=axes[1]).positions().reshape(-1, 3)
        center = grid.positions_on_line(grid.shape[0] // 2)[grid.shape[1] // 2]
        time, middle = track.time, 0.5 * float(track.time[0] + track.time[-1])
        slant, rate, at = (np.empty(len(points)) for _ in range(3))
        histories = np.empty((len(points), track.n_pulses))
        offsets = np.empty_like(histories)
        sine = beam_sines(radar)
        speeds = np.linalg.norm(track.velocity, axis=1)
        for i, point in enumerate(points):
            line = point - track.position
            histories[i] = np.linalg.norm(line, axis=1)
            moving = np.einsum("ij,ij->i", line, track.velocity) / histories[i]  # minus the range rate
            offsets[i] = moving / speeds - sine
            at[i] = np.interp(0.0, -offsets[i], time)
            slant[i], rate[i] = np.interp(at[i], time, histories[i]), -np.interp(at[i], time, moving)
        pick = int(np.argmin(np.abs(time - at[len(points) // 2])))
        near = track.of_pulses(slice(max(pick - 1, 0), pick + 2))
        half = range_acceleration(near, center - near.position)
        v = float(np.sqrt(half[min(1, half.size - 1)]))
        x, rho = v * (at - middle) - slant * rate / v, np.sqrt(slant**2 - (slant * rate / v) ** 2)
        model = np.hypot(x[:, None] - v * (time - middle), rho[:, None])
        left = np.abs(model - histories) * (4.0 * np.pi / radar.waveform.wavelength)
        served = np.abs(offsets) < min(radar.half_aperture, radar.antenna.nulls[0])
        r, c = (part.ravel() for part in np.meshgrid(rows, columns, indexing="ij"))
        phase = float((left * served).max())
        return EquivalentTrack(radar, grid, v, middle, Surface.fit(r, c, x), Surface.fit(r, c, rho), phase)

    @property
    def stretch(self) -> float:
        """Sines of the straight track over those of the antenna: its speed over V."""
        middle = self.radar.track.center_index
        return float(np.linalg.norm(self.radar.track.velocity[middle])) / self.speed

    @property
    def straight(self) -> Radar:
        """Radar on the straight track, whose beam has the same places in its middle and is as wide."""
        radar, time = self.radar, self.radar.track.time
        position = self.grid.origin + (self.speed * (time - self.middle))[:, None] * self.grid.along
        velocity = np.broadcast_to(self.speed * self.grid.along, position.shape).copy()
        sine = (self.stretch * beam_sines(radar))[:, None]
        down = np.array([0.0, 0.0, -0.5])
        side = down + np.sqrt(0.75) * self.grid.across
        boresight = sine * self.grid.along + np.sqrt(1.0 - sine**2) * side
        azimuth = self.grid.along - sine * boresight
        azimuth = azimuth / np.linalg.norm(azimuth, axis=1, keepdims=True)
        width = 2.0 * float(np.arcsin(np.sin(0.5 * radar.antenna.azimuth_beamwidth) * self.stretch))
        return replace(
            radar,
            track=Track(time, position, velocity, radar.track.epoch),
            pointing=Pointing(boresight, azimuth, np.cross(azimuth, boresight)),
            antenna=replace(radar.antenna, azimuth_beamwidth=width)
            if radar.antenna.directive
            else radar.antenna,
            half_aperture=radar.half_aperture * self.stretch,
        )

    @property
    def straight_grid(self) -> ImageGrid:
        """Pixels in X and rho, three for each cell."""
        radar = self.radar
        rows, columns = (np.arange(n, dtype=np.float64) for n in self.grid.shape)
        few = [np.unique(np.linspace(0, axis.size - 1, 33).astype(int)) for axis in (rows, columns)]
        x, rho = (part.on(rows[few[0]], columns[few[1]]) for part in (self.along, self.closest))
        turn = radar.half_turn
        if not np.isfinite(turn):
            span = float(radar.track.time[-1] - radar.track.time[0])
            turn = 0.5 * span * self.speed / float(rho.mean())
        steps = radar.waveform.wavelength / (4.0 * turn) / _FINE, radar.waveform.range_cell / _FINE
        axes: list[F64] = [
            np.asarray(float(part.min()) + step * np.arange(-_MARGIN, int(np.ptp(part) / step) + _MARGIN + 2))
            for part, step in ((x, steps[0]), (rho, steps[1]))
        ]
        origin = self.grid.origin
        return ImageGrid(
            kind="slant",
            azimuth=axes[0],
            range=axes[1],
            origin=origin,
            along=self.grid.along,
            across=self.grid.across,
            height=float(origin[2]) - 0.5 * float(axes[1][0]),
        )

    def carrier(self, x: F64, rho: F64) -> F64:
        """Phase, rad, of the image in X and rho that broadcast: its gradient is that of a place's own aperture."""
        k, sine = 4.0 * np.pi / self.radar.waveform.wavelength, self.stretch * beam_sines(self.radar)
        place = self.speed * (self.radar.track.time - self.middle)
        middle = float(np.mean(rho))
        # X in the middle of the beam at every pulse, for the middle range
        seen = place + middle * sine / np.sqrt(1.0 - sine**2)
        sums = np.concatenate([[0.0], np.cumsum(0.5 * (sine[1:] + sine[:-1]) * np.diff(seen))])
        sums -= np.interp(0.0, seen, sums)
        inside = np.clip(x, seen.min(), seen.max())
        ends = np.where(x < inside, sine[0], sine[-1])
        return np.asarray(k * (rho + np.interp(inside, seen, sums) + (x - inside) * ends))

    def resample(self, values: C64, grid: ImageGrid) -> C64:
        """Pixels (n_layers, n_azimuth, n_range) wanted from those in X and rho."""
        rows, columns = (np.arange(n, dtype=np.float64) for n in self.grid.shape)
        x, rho = self.along.on(rows, columns), self.closest.on(rows, columns)
        base = np.exp(-1j * self.carrier(grid.azimuth[:, None], grid.range[None]))
        place = np.stack(
            [(x - grid.azimuth[0]) / grid.azimuth_spacing, (rho - grid.range[0]) / grid.range_spacing]
        )
        turn = np.exp(1j * self.carrier(x, rho))
        out = np.empty((len(values), *self.grid.shape), dtype=np.complex64)
        for layer, value in enumerate(values):
            out[layer] = scipy.ndimage.map_coordinates(value * base, place, order=5, mode="constant") * turn
        return out


def in_orbit(radar: Radar) -> bool:
    """Whether the antenna is faster than 1 km/s on a curved track."""
    speed = np.linalg.norm(radar.track.velocity[radar.track.center_index])
    return bool(speed > _ORBITAL and not radar.track.is_straight)


def beam_sines(radar: Radar) -> F64:
    """Sine of the boresight along the flight in every pulse, (n_pulses,)."""
    speed = np.linalg.norm(radar.track.velocity, axis=1)
    return np.asarray(np.einsum("ij,ij->i", radar.track.velocity, radar.pointing.boresight) / speed)
