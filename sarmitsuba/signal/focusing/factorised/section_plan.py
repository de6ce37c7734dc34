"""Division of the aperture into sections and groups of pulses, and the polar grids of their subimages."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.units import amplitude_from_db, db_from_amplitude
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.aperture_weights import flight
from sarmitsuba.signal.focusing.factorised.division import PIXEL_SECONDS, Plan, Section, SubimageLevel
from sarmitsuba.signal.focusing.factorised.sampling import (
    CORRECTION,
    MARGIN_DB,
    RATIOS,
    ROW_BAND,
    TAPS,
    SubimageSampling,
    choose_sampling,
)
from sarmitsuba.signal.focusing.windows import Window
from sarmitsuba.signal.image import ImageGrid

# samples kept beyond the image: taps of the last interpolation, and the decay of its correction at the ends
GUARD = CORRECTION + 4
# operations from range compression to profiles, per sample of raw data
_PROFILE = 6e-8
# pulses per group of the finest subimages, and groups merged at once below the last merger
_GROUPS = (4, 8, 16, 32, 64, 128)
_MERGED = (4, 8, 16)
# error, dB, of a section in which an aperture ends, for a weight of 1 at the end and a length of one Fresnel length
# sqrt(lambda R / 2); its decrease for a tenfold length; and the smallest error that is stated: fitted to band-filling
# noise
_EDGE_DB, _EDGE_SLOPE_DB, _EDGE_LEAST_DB = -7.0, 26.0, -60.0
# more where the beam turns: drawn sliding spotlights exceed the law by up to 2.1 dB
_EDGE_TURNING_DB = 3.0
_SHORTEST = 4.0
# nodes along each of the image's sides for extents, and across it for spectra
_SIDE, _ACROSS = 33, 5
# assumed bound of a pattern's variation, radians per 1 / ``Antenna.per_width``
_BEAM_BAND = 3.0
# largest angle subtended by the image from a section's foot point, rad
_WIDEST = 2.0
# pulses of a section whose receive windows are checked
_LOOKED_AT = 33
# largest phase error of a merger's parabolas over that of the sampling, dB
_BOW_DB = -6.0
# margin, because spectra are computed at a few points only
_SPARE = 1.03
_UNDER = "the image extends below the track"


@dataclass(frozen=True, eq=False)
class _SectionSpectra:
    """A section's pulses and its part of the image, and the spectra that follow from them.

    Parameters
    ----------
    radar : gives carrier and band
    first, rows, origin, axes, drop : see :class:`Section`
    angles, ranges : least and largest over the image, rad and m
    antenna : (n, 3) m, of all pulses
    points : (n_points, 3) m, at which spectra are computed
    steps : two (n_points, 3), displacement of a point per m of range and per rad
    slopes : two (n, n_points), the change of the range to every pulse by those steps
    spread : widening of the band in angle by the antenna's pattern
    row_slope : largest change of the angle with the slant range along the image's rows, rad/m; infinite where a row
        does not recede
    """

    radar: Radar
    first: int
    rows: slice
    origin: F64
    axes: F64
    drop: float
    angles: tuple[float, float]
    ranges: tuple[float, float]
    antenna: F64
    points: F64
    steps: tuple[F64, F64]
    slopes: tuple[F64, F64]
    spread: float
    row_slope: float
    known: dict[int, tuple[float, float]] = field(default_factory=dict)

    def extent(self, length: int) -> tuple[float, float]:
        r"""Half of the band, rad per m of range and per rad, of groups of a given number of pulses about their centres.

        With the slope :math:`d_t` of the range and that of the centre's, :math:`d_g`, the spectrum of pulse t lies at
        :math:`k_c (d_t - d_g) + \kappa d_t`, :math:`|\kappa| \le 2 \pi B / c`.
        """
        if length not in self.known:
            n, wave = len(self.antenna), self.radar.waveform
            carrier = 4.0 * np.pi * wave.center_frequency / SPEED_OF_LIGHT
            band = 2.0 * np.pi * wave.bandwidth / SPEED_OF_LIGHT
            starts = np.arange(0, n, length)
            sums = np.add.reduceat(self.antenna, starts, axis=0)
            centers = sums / np.diff(np.append(starts, n))[:, None]
            halves = []
            for slope, step in zip(self.slopes, self.steps, strict=True):
                middle = np.repeat(_slopes(centers, self.points, step), length, axis=0)[:n]
                halves.append(float((carrier * np.abs(slope - middle) + band * np.abs(slope)).max()))
            self.known[length] = halves[0] * _SPARE, halves[1] * _SPARE + self.spread
        return self.known[length]


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
    return _mesh(along, _place_across(grid, n))


def _place_across(grid: ImageGrid, n: int) -> F64:
    """Places across, m, from the image's near to its far side."""
    distance = grid.across_distance()
    return np.linspace(distance[0], distance[-1], n)


def _mesh(along: F64, across: F64) -> tuple[F64, F64]:
    """Coordinates of all pairs of two axes."""
    a, c = np.meshgrid(along, across, indexing="ij")
    return a.ravel(), c.ravel()


def _sight(radar: Radar, grid: ImageGrid, first: int, n: int, rows: slice) -> _SectionSpectra | str:
    """Section of ``n`` pulses from ``first`` on; the reason where it is impossible."""
    antenna = radar.track.position[first : first + n]
    origin = antenna.mean(axis=0)
    drop = float(origin[2] - grid.height)
    border = _flat(grid, *_rectangle(grid, rows, _SIDE))
    forward = (border.mean(axis=0) - origin) * [1.0, 1.0, 0.0]
    reach = float(np.linalg.norm(forward))
    if drop <= 0.0:
        return "the antenna is not above the image's plane"
    if reach < 1e-3 * drop:
        return _UNDER
    forward = forward / reach
    axes = np.array([forward, [-forward[1], forward[0], 0.0], [0.0, 0.0, 1.0]])
    local = (border - origin) @ axes.T
    angle, distance = np.arctan2(local[:, 1], local[:, 0]), np.linalg.norm(local, axis=1)
    if np.ptp(angle) > _WIDEST or local[:, 0].min() <= 0.0:
        return _UNDER
    antenna = (antenna - origin) @ axes.T
    points = (_flat(grid, *_rectangle(grid, rows, _ACROSS)) - origin) @ axes.T
    flat = np.hypot(points[:, 0], points[:, 1])
    far, zero = np.linalg.norm(points, axis=1), np.zeros_like(flat)
    radial = np.stack([points[:, 0] * far / flat**2, points[:, 1] * far / flat**2, zero], axis=-1)
    steps = radial, np.stack([-points[:, 1], points[:, 0], zero], axis=-1)
    spread = 0.0
    if radar.antenna.directive:
        spread = _BEAM_BAND * float((flat / far).max()) * max(radar.antenna.per_width)
    return _SectionSpectra(
        radar,
        first,
        rows,
        origin,
        axes,
        drop,
        (float(angle.min()), float(angle.max())),
        (float(distance.min()), float(distance.max())),
        antenna,
        points,
        steps,
        (_slopes(antenna, points, steps[0]), _slopes(antenna, points, steps[1])),
        spread,
        _row_slope(local[:, :2], distance, axes[:2] @ grid.across),
    )


def _row_slope(places: F64, distance: F64, across: F64) -> float:
    """Largest change of the angle with the slant range along rows, rad/m, at places (n, 2) on the ground."""
    flat = np.linalg.norm(places, axis=1)
    ahead = places @ across / flat
    if ahead.min() <= 0.0:
        return np.inf
    aside = np.abs(places[:, 0] * across[1] - places[:, 1] * across[0]) / flat
    return float((aside / ahead * distance / flat**2).max())


def _section(sight: _SectionSpectra, lengths: tuple[int, ...], sampling: SubimageSampling) -> Section | str:
    """Section with groups of ``lengths``, finest first; the reason where it is impossible."""
    n = len(sight.antenna)
    range_step, angle_step = (np.pi / (half * sampling.upsampling) for half in sight.extent(n))
    start_range = sight.ranges[0] - GUARD * range_step
    if start_range <= sight.drop:
        return _UNDER
    n_ranges = int(np.ceil((sight.ranges[1] - sight.ranges[0]) / range_step)) + 2 * GUARD + 2
    n_angles = int(np.ceil((sight.angles[1] - sight.angles[0]) / angle_step)) + 2 * GUARD + 2
    top = SubimageLevel(n, 1, 1, sight.angles[0] - GUARD * angle_step, angle_step, n_angles)
    levels = _levels(sight, top, lengths, sampling)
    if levels is None:
        return f"groups of {lengths[0]} pulses are no smaller than their section"
    return Section(
        sight.first,
        n,
        sight.origin,
        sight.axes,
        sight.drop,
        start_range,
        range_step,
        n_ranges,
        levels,
        sight.rows,
        sight.row_slope * range_step <= ROW_BAND * angle_step,
    )


def _levels(
    sight: _SectionSpectra, top: SubimageLevel, lengths: tuple[int, ...], sampling: SubimageSampling
) -> tuple[SubimageLevel, ...] | None:
    """Levels from the section's downwards; None where a smaller group does not need fewer angles."""
    above, tolerance = top, amplitude_from_db(sampling.error_db(len(lengths)) + _BOW_DB)
    levels = [above]
    for length in reversed(lengths):
        coarsest = np.pi / (sight.extent(length)[1] * sampling.upsampling)
        steps = ((r, r * above.angle_step) for r in RATIOS)
        ratio = next(
            (r for r, step in steps if step <= coarsest and _bow(r, step, sampling.upsampling) <= tolerance),
            None,
        )
        if ratio is None:
            return None
        chunks = -(-above.n_angles // ratio)
        levels[-1] = replace(above, n_angles=chunks * ratio)
        step = above.angle_step * ratio
        below_start = above.start_angle - (TAPS // 2 - 1) * step - 0.5 * above.angle_step
        above = SubimageLevel(length, 0, ratio, below_start, step, chunks + TAPS)
        levels.append(above)
    levels[-1] = replace(above, n_angles=4 * -(-above.n_angles // 4))
    return _pad_levels(levels[::-1], top.n_pulses)


def _bow(ratio: int, step: float, upsampling: float) -> float:
    r"""Largest phase error, rad, of the parabola over the angles merged from between two samples ``step`` apart.

    A phase :math:`K \sin\varphi` whose frequency fills the band, :math:`K = \pi / u \Delta`, loses
    :math:`K h^3 / 9 \sqrt 3` within :math:`h = \Delta (r - 1) / 2 r`; twice that where the line of sight is steep.
    """
    half = 0.5 * step * (ratio - 1) / ratio
    return float(2.0 * np.pi / (upsampling * step) * half**3 / (9.0 * np.sqrt(3.0)))


def _pad_levels(levels: list[SubimageLevel], n: int) -> tuple[SubimageLevel, ...]:
    """Numbers of groups, padded so that each level's is a multiple of that above."""
    merged = [high.n_pulses // low.n_pulses for low, high in pairwise(levels[:-1])]
    groups = 1
    out = [levels[-1]]
    for i in range(len(levels) - 2, -1, -1):
        groups *= merged[i] if i < len(merged) else -(-n // levels[i].n_pulses)
        out.append(replace(levels[i], n_groups=groups))
    return tuple(out[::-1])


def _rows_served(radar: Radar, grid: ImageGrid, first: int, n: int) -> slice | None:
    """Rows of the image whose own aperture contains pulses of the section; None where there are none."""
    if np.isinf(radar.half_aperture):
        return slice(0, grid.shape[0])
    forward, center, gap = flight(radar)
    pick = np.unique(np.linspace(first, first + n - 1, 9).astype(int))
    index = np.unique(np.linspace(0, grid.shape[0] - 1, min(grid.shape[0], 513)).astype(int))
    a, c = _mesh(grid.azimuth[index], _place_across(grid, _ACROSS))
    line = _flat(grid, a, c)[:, None] - radar.track.position[pick]
    distance = np.linalg.norm(line, axis=-1)
    sine = np.einsum("ptk,tk->pt", line, forward[pick]) / distance
    # a pulse, and the pulses between those checked
    spare = (1.0 + n / len(pick)) * gap[pick] / distance
    inside = (np.abs(sine - center[pick]) < radar.half_aperture + spare).any(axis=1)
    rows = np.flatnonzero(inside.reshape(index.size, -1).any(axis=1))
    if rows.size == 0:
        return None
    low, high = index[max(rows[0] - 1, 0)], index[min(rows[-1] + 1, index.size - 1)]
    return slice(int(low), int(high) + 1)


def _chains(n: int, stages: int, own_bands: bool) -> Iterator[tuple[int, ...]]:
    """Lengths of groups below a section of n pulses, finest first, for the number of stages wanted (0: any)."""
    if own_bands:
        yield ()
        return
    if stages in (0, 2):
        yield ()
    for length in _GROUPS:
        if stages in (0, 3) and 2 * length <= n:
            yield (length,)
        for merged in _MERGED:
            if stages in (0, 4) and 2 * length * merged <= n:
                yield length, length * merged


@dataclass(frozen=True)
class _ApertureEnds:
    """Ends of the pixels' apertures.

    Parameters
    ----------
    weight_db : window and antenna at the aperture's end, dB, with the part of a turning beam
    fresnel : Fresnel length in pulses
    """

    weight_db: float
    fresnel: float

    @classmethod
    def of(cls, radar: Radar, grid: ImageGrid, window: Window) -> "_ApertureEnds | None":
        """Aperture ends of a radar; None where all pulses serve all pixels."""
        if np.isinf(radar.half_aperture) or radar.track.n_pulses < 2:
            return None
        middle = grid.positions_on_line(grid.shape[0] // 2)
        far = float(np.linalg.norm(middle - radar.track.center_position, axis=1).max())
        gap = float(np.linalg.norm(np.diff(radar.track.position, axis=0), axis=1).mean())
        beam = radar.antenna.two_way_amplitude(np.array(radar.half_aperture), np.array(0.0))
        weight = float(window(np.array(0.5))) * float(beam)
        fresnel = np.sqrt(0.5 * radar.waveform.wavelength * far) / max(gap, 1e-9)
        turning = _EDGE_TURNING_DB if abs(1.0 - radar.footprint_speed) > 1e-9 else 0.0
        return cls(db_from_amplitude(max(weight, 1e-9)) + turning, float(fresnel))

    def error_db(self, n: float) -> float:
        """Error of sections of n pulses, dB."""
        lost = _EDGE_SLOPE_DB * float(np.log10(max(n / self.fresnel, 1.0)))
        return max(_EDGE_DB + self.weight_db - lost, _EDGE_LEAST_DB)

    def shortest(self, error_db: float) -> float:
        """Number of pulses of sections with a given error."""
        lengths = 10.0 ** ((_EDGE_DB + self.weight_db - max(error_db, _EDGE_LEAST_DB)) / _EDGE_SLOPE_DB)
        return float(self.fresnel * max(_SHORTEST, lengths))


def _cut(n: int, parts: int) -> list[tuple[int, int]]:
    """First pulse and number of pulses of equal parts."""
    ends = np.linspace(0, n, parts + 1).round().astype(int)
    return [(int(a), int(b - a)) for a, b in pairwise(ends) if b > a]


def _parts(n: int, shortest: float) -> Iterator[int]:
    """Candidate numbers of sections for n pulses in total and a least number in each."""
    parts = 1
    while parts == 1 or n / parts >= shortest:
        yield parts
        parts += 1 if parts < 4 else parts // 3


@lru_cache(maxsize=8)
def make_plan(
    radar: Radar, grid: ImageGrid, window: Window, error_db: float, upsampling: float, stages: int
) -> Plan | str:
    """Division of the aperture with the least processor time; the reason where there is none.

    Parameters
    ----------
    radar, grid : data and image
    window : in azimuth
    error_db, upsampling : see :func:`sarmitsuba.signal.focusing.factorised.sampling.choose_sampling`
    stages : between pulses and pixels: 2, 3 or 4; 0 = the fastest
    """
    best: tuple[float, int, tuple[int, ...]] | None = None
    reason = "there are too few pulses to divide"
    pixels = float(np.prod(grid.shape))
    edges = _ApertureEnds.of(radar, grid, window)
    shortest = edges.shortest(error_db - MARGIN_DB) if edges else 2.0
    for parts in _parts(radar.track.n_pulses, shortest):
        cuts = _cut(radar.track.n_pulses, parts)
        some = _sights(radar, grid, [cuts[i] for i in sorted({0, len(cuts) // 2, len(cuts) - 1})])
        if isinstance(some, str):
            reason = some
            continue
        for lengths in _chains(-(-radar.track.n_pulses // parts), stages, edges is not None):
            sampling = choose_sampling(error_db, upsampling, len(lengths))
            costs: list[float] = []
            for sight in some:
                section = _section(sight, lengths, sampling)
                if isinstance(section, str):
                    reason, costs = section, []
                    break
                costs.append(section.seconds(sampling.width, grid.shape[1]))
            if costs and (best is None or np.mean(costs) * parts < best[0]):
                best = float(np.mean(costs)) * parts, parts, lengths
        # from here on the last interpolation alone takes longer
        if best and edges is None and parts * PIXEL_SECONDS[4] * pixels > best[0]:
            break
    if best is None:
        return reason
    _, parts, lengths = best
    sampling = choose_sampling(error_db, upsampling, len(lengths))
    sights = _sights(radar, grid, _cut(radar.track.n_pulses, parts))
    if isinstance(sights, str):
        return sights
    sections = []
    for sight in sights:
        section = _section(sight, lengths, sampling)
        if isinstance(section, str):
            return section
        sections.append(section)
    seconds = sum(section.seconds(sampling.width, grid.shape[1]) for section in sections)
    seconds += _PROFILE * radar.track.n_pulses * radar.window.n_samples
    edge_db = edges.error_db(radar.track.n_pulses / parts) if edges else -np.inf
    return Plan(tuple(sections), sampling, seconds, edge_db)


def _leaves_window(radar: Radar, sight: _SectionSpectra) -> bool:
    """Whether a point of the image is outside the receive window of a pulse that serves it."""
    n, window = len(sight.antenna), radar.window
    pick = np.unique(np.linspace(0, n - 1, _LOOKED_AT).astype(int))
    own = pick + sight.first
    line = sight.points - sight.antenna[pick][:, None]
    distance = np.linalg.norm(line, axis=-1)
    start = window.start_range[own][:, None]
    end = start + (window.n_samples - 1) * window.sample_spacing
    outside = (distance < start) | (distance > end)
    if np.isfinite(radar.half_aperture):
        forward, center, _ = flight(radar)
        sine = np.einsum("tpi,ti->tp", line, forward[own] @ sight.axes.T) / distance
        outside &= np.abs(sine - center[own][:, None]) < radar.half_aperture
    return bool(outside.any())


def _sights(radar: Radar, grid: ImageGrid, cuts: list[tuple[int, int]]) -> list[_SectionSpectra] | str:
    """Sections that serve the image; the reason where one of them is impossible or none does."""
    out = []
    for first, n in cuts:
        rows = _rows_served(radar, grid, first, n)
        if rows is not None:
            sight = _sight(radar, grid, first, n, rows)
            if isinstance(sight, str):
                return sight
            if _leaves_window(radar, sight):
                return "the image leaves the receive window of pulses that serve it"
            out.append(sight)
    return out or "no pulse serves the image"
