"""How the aperture is divided into sections and groups of pulses, and the polar grids of their subimages."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.constants import SPEED_OF_LIGHT
from sarmitsuba.focusing.aperture import flight
from sarmitsuba.focusing.factorised.sampling import CORRECTION, RATIOS, TAPS, Sampling, choose_sampling
from sarmitsuba.image.sar_image import ImageGrid
from sarmitsuba.radar.radar import Radar

F64 = NDArray[np.float64]

# samples kept beyond the image: what the last interpolation reads, and where its correction ends decay
GUARD = CORRECTION + 4
# processor seconds of one core: of a pulse at a sample, of a group merged into a sample, of a section at a pixel by the
# taps of the last interpolation, and of a subimage's sample on its way; benchmarks/focusers.py measures their sum
_PULSE, _MERGE, _PIXEL, _SAMPLE = 4.5e-9, 1.5e-9, {4: 6e-9, 6: 11e-9}, 4e-8
# of a section, whatever its size: launches
_SECTION = 5e-3
# sums on their way from range compression to profiles, per sample of raw data
_PROFILE = 2.5e-8
# pulses per group of the finest subimages, and groups merged at once below the last merger
_GROUPS = (4, 8, 16, 32, 64, 128)
_MERGED = (4, 8, 16)
# a section whose aperture ends within it is no shorter than this many Fresnel lengths sqrt(lambda R / 2)
_FRESNEL_LENGTHS = 4.0
# nodes along each of the image's sides for extents, and across it for spectra
_SIDE, _ACROSS = 33, 5
# a pattern's amplitude is taken to vary no faster than this many radians per one over ``Antenna.per_width``
_BEAM_BAND = 3.0
# the widest angle under which the image may be seen from a section's foot point, rad
_WIDEST = 2.0
# spectra are known at a few points: spare
_SPARE = 1.03


@dataclass(frozen=True)
class Level:
    """Subimages of all groups of one size: polar grids of one common range axis.

    Parameters
    ----------
    n_pulses : of a group
    n_groups : subimages, those of padding included
    ratio : of the angular spacing to that of the level above; 1 for the section's own
    start_angle, angle_step : rad
    n_angles : samples
    """

    n_pulses: int
    n_groups: int
    ratio: int
    start_angle: float
    angle_step: float
    n_angles: int


@dataclass(frozen=True, eq=False)
class Section:
    """Consecutive pulses that have one polar grid in common.

    Parameters
    ----------
    first, n_pulses : pulses of the radar
    origin : (3,) m, centre of the polar grid, mean antenna position
    axes : (3, 3) unit vectors: on the ground towards the image's middle, on the ground at right angles, up
    drop : m, height of the origin above the image's plane
    start_range, range_step : m, slant range from the origin
    n_ranges : samples
    levels : finest subimages first; the last is that of the whole section
    rows : of the image that it serves
    """

    first: int
    n_pulses: int
    origin: F64
    axes: F64
    drop: float
    start_range: float
    range_step: float
    n_ranges: int
    levels: tuple[Level, ...]
    rows: slice

    def local(self, positions: F64) -> F64:
        """Positions (..., 3) in the section's frame, whose origin is that of the polar grid."""
        return np.asarray((positions - self.origin) @ self.axes.T)

    @property
    def samples(self) -> int:
        """Most samples that two neighbouring levels hold together."""
        sizes = [level.n_groups * level.n_angles * self.n_ranges for level in self.levels]
        return max([sizes[-1], *(a + b for a, b in pairwise(sizes))])

    def seconds(self, width: int, n_columns: int) -> float:
        """Processor time."""
        pulses = self.levels[0].n_groups * self.levels[0].n_pulses
        work = _PULSE * pulses * self.n_ranges * self.levels[0].n_angles
        for low, high in pairwise(self.levels):
            work += _MERGE * low.n_groups * high.n_angles * self.n_ranges
        work += _SAMPLE * self.n_ranges * self.levels[-1].n_angles
        return work + _PIXEL[width] * (self.rows.stop - self.rows.start) * n_columns + _SECTION


@dataclass(frozen=True)
class Plan:
    """All sections, and how their subimages are sampled.

    Parameters
    ----------
    sections : in the order of the pulses
    sampling : common to all
    seconds : processor time of one layer
    """

    sections: tuple[Section, ...]
    sampling: Sampling
    seconds: float

    @property
    def merges(self) -> int:
        """Mergers between pulses and pixels."""
        return max(len(section.levels) for section in self.sections) - 1

    @property
    def error_db(self) -> float:
        """Predicted error."""
        return self.sampling.error_db(self.merges)

    @property
    def n_bytes(self) -> int:
        """Of one layer's subimages, with the copies that their correction makes."""
        return max(8 * section.samples + 24 * section.n_ranges * section.levels[-1].n_angles
                   for section in self.sections)


@dataclass(frozen=True, eq=False)
class _Sight:
    """Spectrum of a section's pulses: slopes of their ranges at a few points, per m of range and per rad."""

    radar: Radar
    across: F64
    along: F64
    antenna: F64
    points: F64
    tangent: F64
    radial: F64
    spread: float

    def extent(self, length: int) -> tuple[float, float]:
        """Half of the band, rad/m and rad/rad, of groups of that many pulses about their centres."""
        n, wave = len(self.antenna), self.radar.waveform
        carrier = 4.0 * np.pi * wave.center_frequency / SPEED_OF_LIGHT
        band = 2.0 * np.pi * wave.bandwidth / SPEED_OF_LIGHT
        starts = np.arange(0, n, length)
        sums = np.add.reduceat(self.antenna, starts, axis=0)
        centers = sums / np.diff(np.append(starts, n))[:, None]
        group = np.minimum(np.arange(n) // length, len(starts) - 1)
        if length >= n:
            centers = np.zeros((1, 3))
        out = []
        for slope, direction in ((self.across, self.radial), (self.along, self.tangent)):
            middle = _slopes(centers, self.points, direction)[group]
            out.append(float((carrier * np.abs(slope - middle) + band * np.abs(slope)).max()))
        return out[0] * _SPARE, out[1] * _SPARE + self.spread


def _slopes(antenna: F64, points: F64, direction: F64) -> F64:
    """Change of the range (n_antenna, n_points) per step along ``direction`` (n_points, 3)."""
    line = points - antenna[:, None]
    return np.asarray(np.einsum("tpi,pi->tp", line, direction) / np.linalg.norm(line, axis=-1))


def _flat(grid: ImageGrid, rows: F64, columns: F64) -> F64:
    """Positions (n, 3) of rows and columns, both (n,), m, of the image plane."""
    base = grid.origin * np.array([1.0, 1.0, 0.0]) + np.array([0.0, 0.0, grid.height])
    return np.asarray(base + rows[:, None] * grid.along + columns[:, None] * grid.across)


def _rectangle(grid: ImageGrid, rows: slice, n: int) -> tuple[F64, F64]:
    """Coordinates along and across, m, of n x n points that span rows of the image."""
    along = np.linspace(grid.azimuth[rows.start], grid.azimuth[rows.stop - 1], n)
    across = np.linspace(*grid.across_distance()[[0, -1]], n)
    return tuple(np.asarray(part).ravel() for part in np.meshgrid(along, across, indexing="ij"))  # type: ignore[return-value]


def make_section(
    radar: Radar, grid: ImageGrid, first: int, n: int, rows: slice, lengths: tuple[int, ...], sampling: Sampling
) -> Section | str:
    """Section of ``n`` pulses from ``first`` on, with groups of ``lengths``; what is in the way where there is none."""
    antenna = radar.track.position[first : first + n]
    origin = antenna.mean(axis=0)
    drop = float(origin[2] - grid.height)
    border = _flat(grid, *_rectangle(grid, rows, _SIDE))
    forward = (border.mean(axis=0) - origin) * [1.0, 1.0, 0.0]
    reach = float(np.linalg.norm(forward))
    if drop <= 0.0 or reach < 1e-3 * drop:
        return "the image lies under the track"
    forward = forward / reach
    axes = np.array([forward, [-forward[1], forward[0], 0.0], [0.0, 0.0, 1.0]])
    local = (border - origin) @ axes.T
    angle = np.arctan2(local[:, 1], local[:, 0])
    if np.ptp(angle) > _WIDEST or local[:, 0].min() <= 0.0:
        return "the image reaches under the track"
    sight = _sight(radar, grid, first, n, rows, origin, axes)
    band_range, band_angle = sight.extent(n)
    range_step = np.pi / (band_range * sampling.upsampling)
    angle_step = np.pi / (band_angle * sampling.upsampling)
    distance = np.linalg.norm(local, axis=1)
    start_range = float(distance.min()) - GUARD * range_step
    if start_range <= drop:
        return "the image reaches under the track"
    n_ranges = int(np.ceil(np.ptp(distance) / range_step)) + 2 * GUARD + 2
    start = float(angle.min()) - GUARD * angle_step
    levels = _levels(sight, n, lengths, sampling.upsampling, (start, angle_step, float(np.ptp(angle))))
    if levels is None:
        return f"groups of {lengths[0]} pulses are no smaller than their section"
    return Section(first, n, origin, axes, drop, start_range, float(range_step), n_ranges, levels, rows)


def _sight(
    radar: Radar, grid: ImageGrid, first: int, n: int, rows: slice, origin: F64, axes: F64
) -> _Sight:
    points = (_flat(grid, *_rectangle(grid, rows, _ACROSS)) - origin) @ axes.T
    antenna = (radar.track.position[first : first + n] - origin) @ axes.T
    flat = np.hypot(points[:, 0], points[:, 1])
    unit = points[:, :2] / flat[:, None]
    zero = np.zeros_like(flat)
    tangent = np.stack([-points[:, 1], points[:, 0], zero], axis=-1)
    radial = np.stack([*(unit * (np.linalg.norm(points, axis=1) / flat)[:, None]).T, zero], axis=-1)
    spread = 0.0
    if radar.antenna.pattern != "isotropic":
        turn = float((flat / np.linalg.norm(points, axis=1)).max())
        spread = _BEAM_BAND * turn * max(radar.antenna.per_width[0], 0.0)
    across, along = _slopes(antenna, points, radial), _slopes(antenna, points, tangent)
    return _Sight(radar, across, along, antenna, points, tangent, radial, spread)


def _levels(
    sight: _Sight, n: int, lengths: tuple[int, ...], upsampling: float, top: tuple[float, float, float]
) -> tuple[Level, ...] | None:
    """Levels from the section's own down; None where a smaller group needs no fewer angles."""
    start, step, extent = top
    n_angles = int(np.ceil(extent / step)) + 2 * GUARD + 2
    above = Level(n, 1, 1, start, step, n_angles)
    levels = [above]
    for length in reversed(lengths):
        coarsest = np.pi / (sight.extent(length)[1] * upsampling)
        ratio = next((r for r in RATIOS if r * above.angle_step <= coarsest), None)
        if ratio is None:
            return None
        chunks = -(-above.n_angles // ratio)
        levels[-1] = replace(above, n_angles=chunks * ratio)
        step = above.angle_step * ratio
        below_start = above.start_angle - (TAPS // 2 - 1) * step - 0.5 * above.angle_step
        above = Level(length, 0, ratio, below_start, step, chunks + TAPS)
        levels.append(above)
    levels[-1] = replace(above, n_angles=4 * -(-above.n_angles // 4))
    return _padded(levels[::-1], n)


def _padded(levels: list[Level], n: int) -> tuple[Level, ...]:
    """Numbers of groups, such that each level's are a whole multiple of those above."""
    merged = [high.n_pulses // low.n_pulses for low, high in pairwise(levels[:-1])]
    groups = 1
    out = [levels[-1]]
    for i in range(len(levels) - 2, -1, -1):
        groups *= merged[i] if i < len(merged) else -(-n // levels[i].n_pulses)
        out.append(replace(levels[i], n_groups=groups))
    return tuple(out[::-1])


def _rows_served(radar: Radar, grid: ImageGrid, first: int, n: int) -> slice | None:
    """Rows of the image whose own aperture has pulses of these; None where there are none."""
    if np.isinf(radar.half_aperture):
        return slice(0, grid.shape[0])
    forward, center, gap = flight(radar)
    pick = np.unique(np.linspace(first, first + n - 1, 9).astype(int))
    index = np.unique(np.linspace(0, grid.shape[0] - 1, min(grid.shape[0], 513)).astype(int))
    across = np.linspace(*grid.across_distance()[[0, -1]], _ACROSS)
    a, c = (part.ravel() for part in np.meshgrid(grid.azimuth[index], across, indexing="ij"))
    line = _flat(grid, a, c)[:, None] - radar.track.position[pick]
    distance = np.linalg.norm(line, axis=-1)
    sine = np.einsum("ptk,tk->pt", line, forward[pick]) / distance
    # a pulse, and the pulses between those looked at
    spare = (1.0 + n / len(pick)) * gap[pick] / distance
    inside = (np.abs(sine - center[pick]) < radar.half_aperture + spare).any(axis=1)
    rows = np.flatnonzero(inside.reshape(index.size, -1).any(axis=1))
    if rows.size == 0:
        return None
    low, high = index[max(rows[0] - 1, 0)], index[min(rows[-1] + 1, index.size - 1)]
    return slice(int(low), int(high) + 1)


def _chains(n: int, stages: int) -> Iterator[tuple[int, ...]]:
    """Lengths of groups below a section of n pulses, finest first, for the number of stages wanted (0: any)."""
    if stages in (0, 2):
        yield ()
    for length in _GROUPS:
        if stages in (0, 3) and 2 * length <= n:
            yield (length,)
        for merged in _MERGED:
            if stages in (0, 4) and 2 * length * merged <= n:
                yield length, length * merged


def _shortest(radar: Radar, grid: ImageGrid) -> float:
    """Fewest pulses of a section."""
    if np.isinf(radar.half_aperture) or radar.track.n_pulses < 2:
        return 2.0
    middle = grid.positions_on_line(grid.shape[0] // 2)
    far = float(np.linalg.norm(middle - radar.track.center_position, axis=1).max())
    gap = float(np.linalg.norm(np.diff(radar.track.position, axis=0), axis=1).mean())
    return _FRESNEL_LENGTHS * float(np.sqrt(0.5 * radar.waveform.wavelength * far)) / max(gap, 1e-9)


def _cut(n: int, parts: int) -> list[tuple[int, int]]:
    """First pulse and number of pulses of equal parts."""
    ends = np.linspace(0, n, parts + 1).round().astype(int)
    return [(int(a), int(b - a)) for a, b in pairwise(ends) if b > a]


def _divisions(radar: Radar, grid: ImageGrid, stages: int) -> Iterator[tuple[int, tuple[int, ...]]]:
    """Numbers of sections, and lengths of groups, to choose from."""
    n, shortest = radar.track.n_pulses, _shortest(radar, grid)
    parts = 1
    while parts == 1 or n / parts >= shortest:
        for lengths in _chains(-(-n // parts), stages if np.isinf(radar.half_aperture) else 2):
            yield parts, lengths
        parts = parts + 1 if parts < 4 else parts + parts // 3


def make_plan(radar: Radar, grid: ImageGrid, error_db: float, upsampling: float, stages: int) -> Plan | str:
    """The division of the aperture with the least processor time; what is in the way where there is none.

    Parameters
    ----------
    radar, grid : data and image
    error_db, upsampling : see :func:`sarmitsuba.focusing.factorised.sampling.choose_sampling`
    stages : between pulses and pixels: 2, 3 or 4; 0 = that of least time
    """
    best: tuple[float, int, tuple[int, ...], Sampling] | None = None
    reason = "there are too few pulses to divide"
    pixels = float(np.prod(grid.shape))
    for parts, lengths in _divisions(radar, grid, stages):
        sampling = choose_sampling(error_db, upsampling, len(lengths))
        cuts = _cut(radar.track.n_pulses, parts)
        sample = sorted({0, len(cuts) // 2, len(cuts) - 1})
        costs = []
        for i in sample:
            rows = _rows_served(radar, grid, *cuts[i])
            if rows is None:
                continue
            section = make_section(radar, grid, *cuts[i], rows, lengths, sampling)
            if isinstance(section, str):
                reason, costs = section, []
                break
            costs.append(section.seconds(sampling.width, grid.shape[1]))
        if costs and (best is None or np.mean(costs) * parts < best[0]):
            best = float(np.mean(costs)) * parts, parts, lengths, sampling
        # more sections take longer from here on
        if best and parts * _PIXEL[sampling.width] * pixels > 4.0 * best[0] and np.isinf(radar.half_aperture):
            break
    if best is None:
        return reason
    _, parts, lengths, sampling = best
    sections = []
    for cut in _cut(radar.track.n_pulses, parts):
        rows = _rows_served(radar, grid, *cut)
        if rows is not None:
            section = make_section(radar, grid, *cut, rows, lengths, sampling)
            if isinstance(section, str):
                return section
            sections.append(section)
    if not sections:
        return "no pulse serves the image"
    seconds = sum(section.seconds(sampling.width, grid.shape[1]) for section in sections)
    return Plan(tuple(sections), sampling, seconds + _PROFILE * radar.track.n_pulses * radar.window.n_samples)


__all__ = ["GUARD", "Level", "Plan", "Section", "make_plan", "make_section"]
