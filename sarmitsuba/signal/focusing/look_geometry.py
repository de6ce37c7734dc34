"""Geometry of the image-domain method's looks: positions, coordinates, and validity of one response for all pixels."""

from dataclasses import dataclass, field, replace

import numpy as np

from sarmitsuba.core.arrays import F64, I64
from sarmitsuba.core.errors import DataError
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.track import effective_velocity_ratio
from sarmitsuba.signal.focusing.aperture_weights import (
    aperture_weights,
    direction_gain,
    flight,
    look_directions,
    matched_weights,
    pulse_ranges,
)
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.look_grid import BeamFan, LookGrid

LEAST_AGREEMENT = 0.99
"""Least coherence of clutter with backprojection's image for an image made from looks."""

# share of an aperture covered by one look: a wider image needs several
_ONE_LOOK = 0.5
# distance between the places at which the beam's sweep is measured, over the slant range, and its bound over the image
_BASE, _BASE_OF_IMAGE = 1e-3, 0.25
# extent beside the pixel, over the aperture, in which its aperture's illumination is tabulated; places there; and
# smallest term of its weights
_ACROSS, _SHIFTS, _LEAST_TERM = 1.5, 65, 3e-3
# smallest and largest number of bins over the band for comparing the responses of two places
_BINS = (8, 256)
# summed weight, over the largest, above which a place counts as illuminated
_DARK = 1e-3


@dataclass(frozen=True, eq=False)
class LookGeometry:
    """Looks at an image, and the pulses that illuminate its centre.

    Parameters
    ----------
    time : (n_looks,) float64, s
    position, velocity : (n_looks, 3) float64, m and m/s, scene frame
    fan, antenna : see :class:`sarmitsuba.signal.look_grid.LookGrid`
    edges : (n + 1,) ascending limits of the interval that each of the n illuminating pulses represents: time (s) from
        the look's, or with a fan the angle (rad) of the line of sight off the beam axis at the image's centre
    weights : (n,) of these pulses
    shifts : (m,) m, c of the middle pixel minus that of a scatterer, nodes of ``lit_across``
    lit_across : terms, weights (n,) and factor (m,), of that scatterer's weight in the pixel's aperture
    agreement : see :class:`sarmitsuba.signal.focusing.look.Look`
    """

    time: F64
    position: F64
    velocity: F64
    fan: BeamFan | None
    antenna: F64
    edges: F64
    weights: F64
    shifts: F64 = field(default_factory=lambda: np.zeros(0))
    lit_across: tuple[tuple[F64, F64], ...] = ()
    agreement: float = 1.0

    def grid(
        self,
        width: int,
        steps: tuple[float, float],
        reference_range: float = 0.0,
        origin: tuple[float, float] = (0.0, 0.0),
        shape: tuple[int, int] = (1, 1),
    ) -> LookGrid:
        """Grid of these looks with that kernel width, cells, reference range, first cell and size."""
        return LookGrid(
            position=self.position,
            velocity=self.velocity,
            fan=self.fan,
            antenna=self.antenna,
            reference_range=reference_range,
            range0=origin[0],
            range_step=steps[0],
            n_range=shape[0],
            azimuth0=origin[1],
            azimuth_step=steps[1],
            n_azimuth=shape[1],
            width=width,
        )

    def nearest(self, grid: LookGrid, places: F64) -> int | I64:
        """Nearest look to the time when the beam passes over places (..., 3)."""
        if grid.n_looks == 1:
            return 0
        middle = grid.n_looks // 2
        azimuth = grid.coordinates(*grid.state(places, middle), middle)[1]
        look = np.rint((azimuth - self.antenna[0]) / grid.spacing)
        return np.asarray(np.clip(look, 0, grid.n_looks - 1), dtype=np.int64)


def sweeps(radar: Radar) -> bool:
    """Whether a beam passes over the pixels one after the other."""
    return radar.mode_law.own_apertures and radar.antenna.directive


def geometries(radar: Radar, image: ImageGrid, azimuth_window: str) -> LookGeometry:
    """Looks whose common response is closest to that of every pixel.

    Raises
    ------
    DataError
        No pulse illuminates the image's centre, or the coherence is too low.
    """
    middle = image.positions_on_line(image.shape[0] // 2)[image.shape[1] // 2]
    weights = matched_weights(radar, middle, azimuth_window)
    if not weights.any():
        raise DataError("method image: no pulse illuminates the image's centre; move the image into the beam")
    found: list[LookGeometry] = []
    if not np.isfinite(radar.half_aperture):
        found.append(_one_look(radar, weights))
    if sweeps(radar):
        found += _looks_along_sweep(radar, image, middle, azimuth_window)
    rated = [(*_agreement(radar, image, azimuth_window, one), one) for one in found]
    if not rated:
        raise DataError(
            "method image: the beam does not sweep uniformly over the image, so that one impulse response is not "
            "valid for all pixels; use method hybrid"
        )
    least, place, best = max(rated, key=lambda entry: entry[0])
    if not least >= LEAST_AGREEMENT:
        off = float(np.linalg.norm(place - middle))
        raise DataError(
            f"method image: one impulse response is not valid for all pixels: {off:.4g} m off the image's centre its "
            f"coherence with their own is {least:.3f}, below {LEAST_AGREEMENT:g}; take method hybrid, or shrink the "
            "image"
        )
    return replace(best, agreement=least)


def _one_look(radar: Radar, weights: F64) -> LookGeometry:
    """Look of pulses with these weights at all pixels, from their centroid."""
    track = radar.track
    share = weights / weights.sum()
    time = float(share @ track.time)
    position = np.array([np.interp(time, track.time, track.position[:, i]) for i in range(3)])
    centered = track.time - time
    spread = float(share @ centered**2)
    velocity = track.velocity[track.center_index]
    if spread > 0.0:
        velocity = (share * centered) @ (track.position - share @ track.position) / spread
    tau, weights = _cut_to_lit(track.time - time, weights)
    return LookGeometry(
        np.array([time]), position[None], velocity[None], None, np.zeros(1), _edges(tau, 1e-6), weights
    )


def _looks_along_sweep(
    radar: Radar, image: ImageGrid, middle: F64, azimuth_window: str
) -> list[LookGeometry]:
    """Looks of a sweeping beam; none where it does not sweep, or rotates about a place in the image.

    Parameters
    ----------
    middle : (3,) m, the image's central pixel
    azimuth_window : over the pulses of each pixel
    """
    track = radar.track
    distance = float(np.linalg.norm(middle - track.center_position))
    base = image.along * min(_BASE * distance, max(_BASE_OF_IMAGE * float(np.ptp(image.azimuth)), 1.0))
    crossing = [passing_time(radar, middle + shift) for shift in (-base, 0.0 * base, base)]
    if None in crossing:
        return []
    before, time, after = (float(t) for t in crossing if t is not None)
    pulse = int(np.clip(np.searchsorted(track.time, time), 0, track.n_pulses - 1))
    speed = float(np.linalg.norm(track.velocity[pulse])) * np.sqrt(
        effective_velocity_ratio(track, middle, pulse)
    )
    bare = _geometry(radar, np.array([time]), speed, time, None)
    h, rate = bare.grid(4, (1.0, 1.0)).state(middle)
    sine = -float(rate) / speed
    cosine = float(np.sqrt(1.0 - sine**2))
    # on a line along the flight the crossings are 1 + kappa r / cos apart, over the places
    swept = speed * (after - before) / (2.0 * float(np.linalg.norm(base)))
    closest = float(h) * cosine
    fan = BeamFan(float(h) * sine, closest, sine, (swept - 1.0) * cosine / closest, speed)

    # angles off the axis at the middle pixel, in the order of the band
    legs = middle - track.position
    towards = np.einsum("ij,ij->i", legs, track.velocity) / np.linalg.norm(legs, axis=1) / speed
    weights = matched_weights(radar, middle, azimuth_window)
    angle, lit = _cut_to_lit(np.arcsin(np.clip(towards, -1.0, 1.0)) - np.arcsin(sine), weights)
    order = np.argsort(angle, kind="stable")
    angle, lit = angle[order], lit[order]
    aperture = float(lit.sum() ** 2 / np.sum(lit**2)) * speed * float(np.mean(np.diff(track.time)))

    bare = _geometry(radar, np.array([time]), speed, time, fan)
    corners = image.positions()[:: max(image.shape[0] - 1, 1), :: max(image.shape[1] - 1, 1)]
    one = bare.grid(4, (1.0, 1.0))
    with np.errstate(all="ignore"):
        own = np.asarray(one.coordinates(*one.state(corners)))
    if not np.isfinite(own).all() or own[2].min() <= 0.0:  # beyond the beam's rotation point
        return []
    low, high = float(own[1].min()), float(own[1].max())
    if high - low <= _ONE_LOOK * aperture:
        places = np.array([0.5 * (low + high)])
    else:
        places = np.linspace(low, high, 1 + int(np.ceil((high - low) / aperture)))
    looks = _geometry(radar, time + places / speed, speed, time, fan)
    shifts = np.linspace(-_ACROSS * aperture, _ACROSS * aperture, _SHIFTS)
    beside = middle - image.along * (shifts / swept)[:, None]  # shifts are those of the pixel
    near = slice(*(np.flatnonzero(weights > 0.0)[[0, -1]] + [0, 1]))
    lit_radar = radar.of_pulses(near)
    gain = direction_gain(lit_radar, slice(None), look_directions(lit_radar, np.vstack([middle, beside])))
    across = (gain[1:] * gain[0] * aperture_weights(radar, middle, azimuth_window)[near])[:, order]
    size, factor = np.linalg.eigh(across @ across.T)
    kept = factor[:, size > _LEAST_TERM**2 * size[-1]].T
    terms = tuple(zip(kept @ across, kept, strict=True))
    return [
        replace(
            looks,
            edges=_edges(angle, 1e-9),
            weights=lit,
            shifts=shifts,
            lit_across=terms,
        )
    ]


def _geometry(radar: Radar, time: F64, speed: float, zero: float, fan: BeamFan | None) -> LookGeometry:
    """Looks at these times (s); the azimuth of the antenna is zero at the time ``zero``."""
    track = radar.track
    position, velocity = (
        np.stack([np.interp(time, track.time, states[:, i]) for i in range(3)], axis=-1)
        for states in (track.position, track.velocity)
    )
    ends = np.clip(time, track.time[0], track.time[-1])
    position = position + velocity * (time - ends)[:, None]
    return LookGeometry(time, position, velocity, fan, speed * (time - zero), np.zeros(2), np.ones(1))


def passing_time(radar: Radar, point: F64) -> float | None:
    """Time when the beam axis passes over a point (3,), s; None where it does not, or more than once."""
    forward, boresight, _ = flight(radar)
    line = point - radar.track.position
    offset = np.einsum("ij,ij->i", line, forward) / np.linalg.norm(line, axis=1) - boresight
    turns = np.flatnonzero(np.signbit(offset[1:]) != np.signbit(offset[:-1]))
    if turns.size != 1:
        return None
    i = int(turns[0])
    part = offset[i] / (offset[i] - offset[i + 1])
    time = radar.track.time
    return float(time[i] + part * (time[i + 1] - time[i]))


def _cut_to_lit(place: F64, weights: F64) -> tuple[F64, F64]:
    """Places of the pulses from the first to the last that has a weight, and the weights."""
    lit = np.flatnonzero(weights > 0.0)
    return place[lit[0] : lit[-1] + 1], weights[lit[0] : lit[-1] + 1]


def _edges(place: F64, alone: float) -> F64:
    """(n + 1,) limits of the part of the aperture of each of n pulses; ``alone``: of one pulse."""
    if place.size < 2:
        return np.array([place[0] - 0.5, place[0] + 0.5]) * alone
    middle = 0.5 * (place[1:] + place[:-1])
    return np.concatenate([[2.0 * place[0] - middle[0]], middle, [2.0 * place[-1] - middle[-1]]])


def _agreement(
    radar: Radar, image: ImageGrid, azimuth_window: str, geometry: LookGeometry
) -> tuple[float, F64]:
    r"""Least coherence of clutter with backprojection's image over nine places, and that place (3,).

    White clutter has the coherence of the two responses, by Parseval that of their spectra: a pulse t of weight w is in
    both at the gradient of its range over the grid's coordinates.

    .. math:: \gamma = \frac{\int S_P S \, dk}{\sqrt{\int S_P^2 \, dk \int S^2 \, dk}}

    Notes
    -----
    Uses the band's shape at the carrier: shifts along the range coordinate count by the part of the band that they
    leave.
    """
    grid = geometry.grid(4, (1.0, 1.0))
    lines = [image.positions_on_line(i) for i in (0, image.shape[0] // 2, image.shape[0] - 1)]
    columns = sorted({0, image.shape[1] // 2, image.shape[1] - 1})
    places = np.array([line[columns] for line in lines]).reshape(-1, 3)
    every = matched_weights(radar, places, azimuth_window)
    total = every.sum(axis=1)
    edges, summed = geometry.edges, np.concatenate([[0.0], np.cumsum(geometry.weights)])
    stretch = 1.0
    if geometry.fan is not None:
        edges, stretch = np.sin(edges), geometry.fan.stretch
    edges = edges * stretch
    wave_cells = radar.waveform.center_frequency / radar.waveform.bandwidth
    worst, where = 1.0, places[places.shape[0] // 2]
    for place, weights, light in zip(places, every, total, strict=True):
        if light <= _DARK * total.max():
            if geometry.fan is not None:
                return 0.0, place
            continue  # outside the beam of all pulses: no comparison possible
        along, ahead = _wavenumbers(radar, grid, geometry, place)
        along, ahead = (_cut_to_lit(v, weights)[0] for v in (along, ahead))
        lit = _cut_to_lit(along, weights)[1]
        order = np.argsort(along, kind="stable")
        along, ahead, lit = along[order], ahead[order], lit[order]
        own = np.concatenate([[0.0], np.cumsum(lit)])
        ends = _edges(along, 1e-9 if geometry.fan else 1e-6)
        # no finer than the pulses: their position at the band's ends differs from pixel to pixel
        count = int(np.clip(lit.size, *_BINS))
        bins = np.linspace(min(ends[0], edges[0]), max(ends[-1], edges[-1]), count + 1)
        a, b = (np.diff(np.interp(bins, *pair)) for pair in ((ends, own), (edges, summed)))
        # along the range coordinate the response lies on a circle about the origin, or on a line
        model = np.sqrt(1.0 - (along / stretch) ** 2) if geometry.fan is not None else 1.0
        inside = np.clip(1.0 - np.abs(ahead - model) * wave_cells, 0.0, 1.0)
        kept = np.interp(0.5 * (bins[1:] + bins[:-1]), along, inside)
        coherence = float(np.sum(a * b * kept) / np.sqrt(np.sum(a * a) * np.sum(b * b)))
        if not coherence >= worst:
            worst, where = coherence, place
    return worst, where


def _wavenumbers(radar: Radar, grid: LookGrid, geometry: LookGeometry, place: F64) -> tuple[F64, F64]:
    """Gradients of the range of every pulse over the grid's azimuth and range coordinate at a place (3,)."""
    step = 1e-6 * float(np.linalg.norm(place - radar.track.center_position))
    axes = np.array([radar.track.along, radar.across]) * step
    near = place + np.array([axes, -axes])
    look = geometry.nearest(grid, place[None])
    index = look if isinstance(look, int) else int(look[0])
    r, s, _ = grid.coordinates(*grid.state(near, index), index)
    change = np.stack([r[0] - r[1], s[0] - s[1]], axis=-1)  # (axis, coordinate)
    ranges = pulse_ranges(radar, near)
    ahead, along = np.linalg.solve(change, ranges[0] - ranges[1])
    return along, ahead
